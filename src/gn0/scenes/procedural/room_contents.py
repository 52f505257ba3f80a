"""What belongs in each kind of room, and in which order it is placed."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator

import numpy as np

from gn0.scenes.procedural.assembly import Placed
from gn0.scenes.procedural.catalogue import bath, kitchen, light
from gn0.scenes.procedural.catalogue.clutter import on_floor
from gn0.scenes.procedural.catalogue.decor import greenery, pictures
from gn0.scenes.procedural.catalogue.seats import chairs, sofas
from gn0.scenes.procedural.catalogue.storage import books, cloakroom, cupboards
from gn0.scenes.procedural.catalogue.tables import high_tables, rugs
from gn0.scenes.procedural.groups import (
    dress_windows,
    hang_above_counter,
    hang_over,
    hang_pictures,
    light_ceiling,
    place_bed,
    place_corner_things,
    place_desk,
    place_dining,
    place_shower,
    place_sofa_group,
)
from gn0.scenes.procedural.layout import Block, RoomLayout, draw_between, dress, footprint
from gn0.scenes.procedural.palette import plain
from gn0.scenes.procedural.shell import SIDES, Side


def furnish_room(layout: RoomLayout) -> None:
    """Place everything that belongs in the layout's room."""
    recipe: dict[str, Callable[[RoomLayout], None]] = {
        "living room": furnish_living,
        "kitchen": furnish_kitchen,
        "bedroom": furnish_bedroom,
        "bathroom": furnish_bathroom,
        "hallway": furnish_hallway,
        "study": furnish_study,
    }
    recipe[layout.room.type](layout)


def furnish_living(layout: RoomLayout) -> None:
    """Living room, with the dining set when it is large enough."""
    rng, palette = layout.rng, layout.palette
    dress_windows(layout)
    kelvin = light.draw_kelvin(rng)
    tv_side = place_sofa_group(layout)
    if layout.room.area > 21:
        place_dining(layout, 6 if layout.room.area > 32 else 4, kelvin=2900.0)
    shelves = 1 + int(layout.room.area > 26)
    for _ in range(shelves):
        shelf = dress(books.build_bookshelf(rng, palette), "shelf", rng, palette, count=10)
        layout.place_on_wall(shelf, prefer="corner")
    if rng.random() < 0.7:
        lamp = light.build_table_lamp(rng, palette, kelvin=kelvin)
        board = dress(
            cupboards.build_sideboard(rng, palette),
            "sideboard",
            rng,
            palette,
            count=5,
            first=[lamp],
        )
        layout.place_on_wall(board, prefer="any", front=0.4)
    if rng.random() < 0.4:
        cart = dress(
            high_tables.build_serving_cart(rng, palette), "dining table", rng, palette, count=5
        )
        layout.place_on_wall(cart, prefer="any")
    place_corner_things(layout, plants=3, lamp=2700.0)
    if rng.random() < 0.5:
        pouf = chairs.build_stool(rng, palette)
        layout.place_on_wall(pouf, prefer="any", gap=0.3, reach=False)
    if rng.random() < 0.35:
        layout.place_on_wall(on_floor.build_teddy(rng, palette), gap=0.1, reach=False)
    light_ceiling(layout, kelvin)
    hang_pictures(layout, 5, clock=rng.random() < 0.6)
    if tv_side is not None and rng.random() < 0.5:
        ball = on_floor.build_ball_toy(rng, palette)
        layout.place_on_wall(ball, gap=0.12, reach=False)


def furnish_kitchen(layout: RoomLayout) -> None:
    """A counter with appliances, wall units, fridge, and a table or an island."""
    rng, palette, room = layout.rng, layout.palette, layout.room
    front = palette.painted(rng) if rng.random() < 0.65 else palette.wood(rng, 0)
    top = [
        palette.wood(rng, 0),
        plain("stone", "marble", "#d9d6d0", second="#9a9690", scale=0.35, contrast=0.4, detail=0.8),
        plain(
            "dark stone", "marble", "#3a3b3d", second="#5f6063", scale=0.3, contrast=0.4, detail=0.8
        ),
    ][int(rng.integers(3))]
    fridge = kitchen.build_fridge(rng, palette)
    lengths = []
    for name, side in layout.sides.items():
        for a, b in layout.intervals(side, kitchen.COUNTER_DEPTH + 0.02, 1.0):
            lengths.append((b - a, name, a, b))
    lengths.sort(key=lambda g: (-g[0], g[1]))
    for side, t, width, flip, with_fridge in _counter_places(layout, lengths):
        rough = layout.strip(side, t - width / 2, t + width / 2, kitchen.COUNTER_DEPTH)
        if not (layout.is_clear(rough) and layout.is_passable([rough])):
            continue
        counter = kitchen.build_counter(rng, palette, width, front, top)
        extras = [kitchen.build_kettle(rng, palette)]
        for maker in (
            kitchen.build_toaster,
            lambda r, p: kitchen.build_microwave(r),
            lambda r, p: kitchen.build_coffee_machine(r),
        ):
            if rng.random() < 0.6:
                extras.append(maker(rng, palette))
        counter = dress(counter, "counter", rng, palette, count=6, first=extras, turn=0.15)
        placed = layout.against_wall(side, counter, t, 0.005)
        edge = t + (width / 2 + 0.36) * (1 if not flip else -1)
        cold = layout.against_wall(side, fridge, edge, 0.02)
        spot = side.point(t, 1.0)
        wanted = [placed, cold] if with_fridge else [placed]
        rects = [footprint(p) for p in wanted]
        if not (all(map(layout.is_clear, rects)) and layout.is_passable(rects, [spot])):
            continue
        for thing in wanted:
            layout.add(thing)
        layout.reach.append(spot)
        hang_above_counter(layout, side, t, width, front, counter)
        if not with_fridge and layout.place_on_wall(fridge, prefer="corner") is None:
            layout.place_on_wall(fridge, prefer="any", reach=False)
        break
    if room.area > 8.5:
        seats_at = 4 if room.area > 11.5 else 2
        if not place_dining(layout, seats_at, kelvin=3000.0) and seats_at == 4:
            place_dining(layout, 2, kelvin=3000.0)
    if room.area > 15 and rng.random() < 0.6:
        shelf = dress(cupboards.build_sideboard(rng, palette), "counter", rng, palette, count=5)
        layout.place_on_wall(shelf, prefer="any", front=0.4)
    layout.place_on_wall(on_floor.build_bin(rng, palette), prefer="corner", gap=0.02, reach=False)
    dress_windows(layout, curtains=False)
    place_corner_things(layout, plants=1, basket=rng.random() < 0.3)
    light_ceiling(layout, 3500.0 if rng.random() < 0.5 else 3000.0)
    hang_pictures(layout, 3, clock=True)


def _counter_places(
    layout: RoomLayout, lengths: list[tuple[float, str, float, float]]
) -> Iterator[tuple[Side, float, float, bool, bool]]:
    """Where a counter may stand, longest first: side, middle, width, which end, fridge beside."""
    for with_fridge in (True, False):
        for span, name, a, b in lengths:
            longest = int((span - 0.04 - (0.7 if with_fridge else 0.0)) / 0.6 + 1e-6)
            for units in range(min(longest, 6), 1, -1):
                width = units * 0.6
                for flip in (bool(f) for f in layout.rng.permutation([False, True])):
                    t = a + 0.02 + width / 2 if not flip else b - 0.02 - width / 2
                    yield layout.sides[name], t, width, flip, with_fridge


def furnish_bedroom(layout: RoomLayout) -> None:
    """A bed with nightstands and lamps, wardrobe, dresser; toys and a desk in a child's room."""
    rng, palette, room = layout.rng, layout.palette, layout.room
    dress_windows(layout)
    child = room.id != "bedroom_1" and rng.random() < 0.55
    double = not child and room.area > 8.5
    kelvin = 2700.0 if rng.random() < 0.6 else 3000.0
    placed = place_bed(layout, double, kelvin)
    if placed is None:
        place_bed(layout, False, kelvin)
    wardrobe = dress(cupboards.build_wardrobe(rng, palette), "floor", rng, palette, count=2)
    if layout.place_on_wall(wardrobe, prefer="corner", front=0.45) is None:
        layout.place_on_wall(cupboards.build_wardrobe(rng, palette), prefer="any")
    if child or (room.area > 13 and rng.random() < 0.4):
        place_desk(layout, kelvin=3500.0)
    if child:
        shelf = dress(
            books.build_bookshelf(rng, palette, 0.8),
            "shelf",
            rng,
            palette,
            count=6,
            first=[on_floor.build_teddy(rng, palette)],
        )
        layout.place_on_wall(shelf, prefer="corner")
        for maker in (on_floor.build_blocks, on_floor.build_teddy, on_floor.build_ball_toy):
            layout.place_on_wall(maker(rng, palette), gap=0.15, reach=False)
    elif rng.random() < 0.75:
        lamp = light.build_table_lamp(rng, palette, kelvin=kelvin)
        dresser = dress(
            cupboards.build_dresser(rng, palette),
            "sideboard",
            rng,
            palette,
            count=4,
            first=[lamp] if rng.random() < 0.4 else [],
        )
        spot = layout.place_on_wall(dresser, prefer="any", front=0.45)
        if spot is not None:
            hang_over(
                layout,
                spot,
                pictures.build_mirror(rng, palette, 0.7, float(rng.choice([0.7, 0.95]))),
                1.5,
            )
    if rng.random() < 0.4:
        layout.place_on_wall(sofas.build_sofa(rng, palette, seats=1), prefer="corner", gap=0.08)
    place_corner_things(layout, plants=2, basket=rng.random() < 0.6)
    if rng.random() < 0.25:
        layout.place_on_wall(on_floor.build_suitcase(rng, palette), prefer="corner", reach=False)
    light_ceiling(layout, kelvin, flux=6.5)
    hang_pictures(layout, 3)


def furnish_study(layout: RoomLayout) -> None:
    """A desk, bookshelves and a reading chair."""
    rng, palette = layout.rng, layout.palette
    dress_windows(layout)
    place_desk(layout, kelvin=3500.0, large=True)
    for _ in range(2):
        shelf = dress(books.build_bookshelf(rng, palette), "shelf", rng, palette, count=9)
        layout.place_on_wall(shelf, prefer="corner", front=0.3)
    if layout.room.area > 8:
        layout.place_on_wall(sofas.build_sofa(rng, palette, seats=1), prefer="corner", gap=0.1)
    rug = rugs.build_rug(rng, palette, 1.7, 1.2)
    middle = Placed(
        rug, (layout.room.x0 + layout.room.x1) / 2, (layout.room.y0 + layout.room.y1) / 2
    )
    layout.placed.append(middle)
    layout.place_on_wall(on_floor.build_bin(rng, palette), prefer="corner", reach=False)
    place_corner_things(layout, plants=2, lamp=2900.0, basket=False)
    light_ceiling(layout, 3500.0)
    hang_pictures(layout, 4, clock=True)


def furnish_bathroom(layout: RoomLayout) -> None:
    """Tub or shower, toilet, washbasin with mirror, washing machine, towels."""
    rng, palette, room = layout.rng, layout.palette, layout.room
    tub_done = False
    if room.area > 4.6 and rng.random() < 0.75:
        long = (
            float(np.clip(min(room.width, room.depth) - 0.06, 1.5, 1.75))
            if min(room.width, room.depth) > 1.55
            else 1.6
        )
        tub_done = (
            layout.place_on_wall(bath.build_bathtub(rng, palette, long), prefer="corner", gap=0.01)
            is not None
        )
    if not tub_done or room.area > 8:
        place_shower(layout)
    basin = dress(bath.build_washbasin(rng, palette), "bath", rng, palette, count=2)
    spot = layout.place_on_wall(basin, prefer="any", gap=0.005, front=0.4, margin=0.05)
    if spot is not None:
        w = float(basin.size[0])
        tall = w if rng.random() < 0.4 else 0.8
        hang_over(
            layout, spot, pictures.build_mirror(rng, palette, min(w, 0.7), min(tall, 0.8)), 1.55
        )
    toilet = layout.place_on_wall(
        bath.build_toilet(rng), prefer="any", gap=0.005, front=0.45, margin=0.12
    )
    if toilet is not None:
        layout.place_on_wall(bath.build_toilet_brush(), prefer="any", gap=0.03, reach=False)
    if room.area > 4.4:
        machine = dress(bath.build_washing_machine(rng), "bath", rng, palette, count=2)
        layout.place_on_wall(machine, prefer="corner", front=0.4)
    layout.place_on_wall(bath.build_laundry(rng, palette), prefer="corner", reach=False)
    layout.place_on_wall(on_floor.build_bin(rng, palette), prefer="corner", reach=False)
    if rng.random() < 0.5:
        layout.place_on_wall(greenery.build_plant(rng, palette, 0.6), prefer="corner", reach=False)
    mat = bath.build_bath_mat(rng, palette)
    r = layout.room
    for _ in range(20):
        at = Placed(
            mat,
            float(rng.uniform(r.x0 + 0.5, r.x1 - 0.5)),
            float(rng.uniform(r.y0 + 0.5, r.y1 - 0.5)),
            0.0,
            float(rng.choice([0, math.pi / 2])),
        )
        if layout.is_clear(footprint(at), ignore_keep=True):
            layout.placed.append(at)
            break
    for item, z in (
        (bath.build_towel_rail(rng, palette), 1.35),
        (bath.build_towel_rail(rng, palette), 1.35),
        (bath.build_paper_roll(rng), 0.75),
    ):
        for name in rng.permutation(list(SIDES)):
            side = layout.sides[str(name)]
            low, high = item.full_extent()
            gaps = layout.wall_gaps(side, z + float(low[2]), z + float(high[2]))
            if (
                gaps
                and layout.hang(
                    side,
                    item,
                    float(
                        rng.uniform(gaps[0][0] + 0.35, max(gaps[0][0] + 0.36, gaps[0][1] - 0.35))
                    ),
                    z,
                )
                is not None
            ):
                break
    dress_windows(layout, curtains=False)
    light_ceiling(layout, 4000.0 if rng.random() < 0.5 else 3500.0, flux=6.0)


def furnish_hallway(layout: RoomLayout) -> None:
    """Coat rack, shoe rack, console with mirror, a runner and pictures."""
    rng, palette, room = layout.rng, layout.palette, layout.room
    rack = dress(cloakroom.build_shoe_rack(rng, palette), "floor", rng, palette, count=1)
    layout.place_on_wall(rack, prefer="any", gap=0.01)
    console = dress(
        high_tables.build_console(rng, palette),
        "sideboard",
        rng,
        palette,
        count=3,
        first=[light.build_table_lamp(rng, palette, kelvin=2700.0)],
    )
    spot = layout.place_on_wall(console, prefer="any", gap=0.01)
    if spot is not None:
        hang_over(
            layout,
            spot,
            pictures.build_mirror(rng, palette, 0.6, float(rng.choice([0.6, 0.9]))),
            1.55,
        )
    coats = cloakroom.build_coat_rack(rng, palette)
    for name in rng.permutation(list(SIDES)):
        side = layout.sides[str(name)]
        gaps = layout.wall_gaps(side, 0.6, 1.8)
        wide = coats.size[0]
        if gaps and gaps[0][1] - gaps[0][0] > wide + 0.1:
            t = draw_between(rng, gaps[0][0] + wide / 2 + 0.05, gaps[0][1] - wide / 2 - 0.05)
            strip = layout.strip(side, t - wide / 2, t + wide / 2, 0.2)
            if (
                layout.is_clear(strip)
                and layout.is_passable([strip])
                and layout.hang(side, coats, t, 0.0) is not None
            ):
                layout.blocks.append(Block(strip, 1.8))
                break
    layout.place_on_wall(cloakroom.build_umbrella_stand(rng, palette), prefer="corner", reach=False)
    place_corner_things(layout, plants=2, basket=False, widest=0.5)
    long, short = max(room.width, room.depth), min(room.width, room.depth)
    runner = rugs.build_rug(rng, palette, min(long * 0.6, 3.2), min(0.75, short - 0.5))
    yaw = 0.0 if room.width >= room.depth else math.pi / 2
    layout.placed.append(Placed(runner, (room.x0 + room.x1) / 2, (room.y0 + room.y1) / 2, 0.0, yaw))
    light_ceiling(layout, 2900.0, flux=8.0)
    hang_pictures(layout, 4)
