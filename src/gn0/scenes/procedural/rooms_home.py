"""Rooms that only larger homes have, and the fuller furnishing of those that all homes have."""

from __future__ import annotations

import math
from collections.abc import Sequence

from gn0.scenes.procedural.assembly import Item, Placed
from gn0.scenes.procedural.catalogue import bath, home
from gn0.scenes.procedural.catalogue.clutter import on_floor, on_table
from gn0.scenes.procedural.catalogue.decor import pictures
from gn0.scenes.procedural.catalogue.storage import books, cloakroom, cupboards
from gn0.scenes.procedural.catalogue.tables import rugs
from gn0.scenes.procedural.fixtures import fit_fixtures
from gn0.scenes.procedural.groups import (
    dress_windows,
    hang_pictures,
    light_ceiling,
    place_corner_things,
    place_dining,
)
from gn0.scenes.procedural.layout import RoomLayout, dress
from gn0.scenes.procedural.room_contents import furnish_room


def furnish_home(layout: RoomLayout) -> None:
    """Place everything that belongs in a room of a large home."""
    recipe = {
        "dining room": _furnish_dining,
        "laundry room": _furnish_laundry,
        "closet": _furnish_closet,
    }
    kind = layout.room.type
    recipe.get(kind, furnish_room)(layout)
    if kind == "living room":
        _add_shelves(layout, 2)
        _scatter(layout, [on_table.build_magazines(layout.rng, layout.palette)])
    elif kind == "bedroom":
        _furnish_bedroom_more(layout)
    elif kind == "kitchen":
        _lay_tables(layout)
    elif kind == "study":
        _add_shelves(layout, 1)
        box = cupboards.build_storage_box(layout.rng, layout.palette)
        layout.place_on_wall(box, prefer="corner", reach=False)
    fit_fixtures(layout)


def _furnish_dining(layout: RoomLayout) -> None:
    """A long table, laid at times, a sideboard with glasses, a cabinet."""
    rng, palette = layout.rng, layout.palette
    dress_windows(layout)
    count = 8 if min(layout.room.width, layout.room.depth) > 3.4 and rng.random() < 0.6 else 6
    if not place_dining(layout, count, kelvin=2900.0) and not place_dining(layout, 6, kelvin=2900):
        place_dining(layout, 4, kelvin=2900.0)
    _lay_tables(layout)
    board = dress(cupboards.build_sideboard(rng, palette), "sideboard", rng, palette, count=6)
    layout.place_on_wall(board, prefer="centre", front=0.35)
    _add_shelves(layout, 1)
    place_corner_things(layout, plants=2, basket=False)
    light_ceiling(layout, 2900.0, flux=4.5)
    hang_pictures(layout, 4)


def _lay_tables(layout: RoomLayout) -> None:
    """Lay a place at each seat of the dining table."""
    rng = layout.rng
    for k, placed in enumerate(layout.placed):
        if placed.item.category == "dining table" and rng.random() < 0.8:
            chairs = sum(p.item.category == "chair" for p in layout.placed)
            laid = home.lay_table(placed.item, rng, layout.palette, chairs)
            layout.placed[k] = Placed(laid, placed.x, placed.y, placed.z, placed.yaw)


def _furnish_laundry(layout: RoomLayout) -> None:
    """Washing machine, detergents on a shelf, baskets, an ironing board, an airer."""
    rng, palette = layout.rng, layout.palette
    agents = [home.build_detergent(rng) for _ in range(3)]
    machine = dress(
        bath.build_washing_machine(rng), "bath", rng, palette, count=1, first=agents[:1]
    )
    layout.place_on_wall(machine, prefer="corner", front=0.5)
    if rng.random() < 0.5:
        layout.place_on_wall(bath.build_washing_machine(rng), prefer="corner", front=0.5)
    stock: list[Item] = [home.build_detergent(rng) for _ in range(int(rng.integers(5, 9)))]
    stock += [cupboards.build_towel_stack(rng, palette) for _ in range(3)]
    stock += [cupboards.build_storage_box(rng, palette) for _ in range(2)]
    rack = dress(
        home.build_utility_shelf(rng), "bath", rng, palette, count=0, first=stock, turn=0.1
    )
    layout.place_on_wall(rack, prefer="corner")
    for maker in (home.build_dryer, lambda r: home.build_ironing_board(r, palette)):
        if layout.room.area > 6.0:
            layout.place_on_wall(maker(rng), prefer="any", gap=0.05, reach=False)
    for _ in range(2):
        basket = bath.build_laundry(rng, palette)
        layout.place_on_wall(basket, prefer="corner", reach=False)
    layout.place_on_wall(on_floor.build_bin(rng, palette), prefer="corner", reach=False)
    dress_windows(layout, curtains=False)
    light_ceiling(layout, 4000.0, flux=6.0)
    hang_pictures(layout, 1)


def _furnish_closet(layout: RoomLayout) -> None:
    """Open wardrobes along the walls, a mirror, a stool."""
    rng, palette = layout.rng, layout.palette
    for width in (1.8, 1.4, 1.0):
        rail = home.build_rail(rng, palette, width)
        layout.place_on_wall(rail, prefer="corner", front=0.5)
    rack = dress(cloakroom.build_shoe_rack(rng, palette), "floor", rng, palette, count=1)
    layout.place_on_wall(rack, prefer="any")
    layout.place_on_wall(on_floor.build_suitcase(rng, palette), prefer="corner", reach=False)
    for side in layout.sides.values():
        gaps = layout.wall_gaps(side, 0.6, 2.0)
        if gaps and gaps[0][1] - gaps[0][0] > 0.7:
            mirror = pictures.build_mirror(rng, palette, 0.5, 1.3)
            if layout.hang(side, mirror, sum(gaps[0]) / 2, 1.2) is not None:
                break
    rug = rugs.build_rug(rng, palette, 1.0, 0.7)
    r = layout.room
    yaw = 0.0 if r.width > r.depth else math.pi / 2
    layout.placed.append(Placed(rug, (r.x0 + r.x1) / 2, (r.y0 + r.y1) / 2, 0.0, yaw))
    light_ceiling(layout, 3000.0, flux=14.0)


def _furnish_bedroom_more(layout: RoomLayout) -> None:
    """Books, and toys where there already are some."""
    rng, palette = layout.rng, layout.palette
    if rng.random() < 0.6:
        _add_shelves(layout, 1)
    if any(p.item.category == "toy" for p in layout.placed):
        toys = [home.build_toy_car(rng, palette) for _ in range(3)]
        toys += [home.build_stacking_rings(rng, palette), on_floor.build_blocks(rng, palette)]
        _scatter(layout, toys)


def _add_shelves(layout: RoomLayout, count: int) -> None:
    rng, palette = layout.rng, layout.palette
    for _ in range(count):
        shelf = dress(books.build_bookshelf(rng, palette), "shelf", rng, palette, count=10)
        layout.place_on_wall(shelf, prefer="corner", front=0.3)


def _scatter(layout: RoomLayout, things: Sequence[Item]) -> None:
    """Small things on the floor along the walls, where nobody must step over them."""
    for thing in things:
        layout.place_on_wall(
            thing, prefer="any", gap=float(layout.rng.uniform(0.08, 0.3)), reach=False
        )
