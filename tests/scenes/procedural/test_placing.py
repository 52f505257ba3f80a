"""Furniture in a room: clear of doors, windows, leaves and of one another; small things on it."""

from __future__ import annotations

import math

import numpy as np
import pytest

from gn0.scenes.procedural.assembly import Assembly, Item, Placed, Support
from gn0.scenes.procedural.building import Building, check_reach
from gn0.scenes.procedural.catalogue.decor.pictures import build_picture
from gn0.scenes.procedural.catalogue.light import CEILING_FLUX
from gn0.scenes.procedural.draft import SceneDraft
from gn0.scenes.procedural.fixtures import hang_by_doors
from gn0.scenes.procedural.groups import light_ceiling, place_dining
from gn0.scenes.procedural.layout import RoomLayout, dress, footprint, overlaps
from gn0.scenes.procedural.palette import STYLES, WHITE, Palette
from gn0.scenes.procedural.plan import FloorPlan, Opening, Room, plan_apartment
from gn0.scenes.procedural.plots import plan_hall
from gn0.scenes.procedural.shapes import build_box
from gn0.scenes.procedural.shell import SIDES, RoomFinish, build_room_shell

PALETTE = Palette(STYLES[0])


def opening(kind: str, axis: str, at: float, low: float, high: float, bottom: float = 0.0,
            rooms: tuple[str | None, str | None] = (None, "room")) -> Opening:  # fmt: skip
    return Opening(kind, axis, at, low, high, bottom, 2.1, 0.12, rooms)


def layout_of(wide: float, deep: float, *openings: Opening) -> RoomLayout:
    """An empty room with its lower corner at the origin."""
    room = Room("room", "study", 0.0, 0.0, wide, deep)
    plan = FloorPlan((room,), (), openings, 2.6)
    return RoomLayout(plan, room, np.random.default_rng(3), PALETTE)


def box(size: tuple[float, float, float], name: str = "thing", **more: object) -> Item:
    return Item(name, (build_box(size, WHITE),), **more)  # type: ignore[arg-type]


def test_high_furniture_leaves_windows_and_doors_clear() -> None:
    room = layout_of(6.0, 4.0, opening("window", "x", -0.06, 1.0, 2.5, 0.9),
                     opening("door", "x", -0.06, 4.0, 4.9))  # fmt: skip
    side = room.sides["south"]
    for depth, height, window in ((0.6, 2.1, False), (0.6, 0.7, True)):
        free = room.intervals(side, depth, height)
        assert any(a <= 1.0 and b >= 2.5 for a, b in free) == window
        assert not any(a < 4.9 and b > 4.0 for a, b in free)
    assert room.is_clear((0.5, 0.0, 2.0, 0.5))
    assert not room.is_clear((4.2, 0.0, 4.6, 0.5)), "stands in the doorway"
    assert not room.is_clear((-0.2, 1.0, 0.5, 1.5)), "stands in the wall"


def test_what_fits_to_the_ulp_is_placed_or_left_out() -> None:
    """A stretch as wide as the item: rounding puts the ends of its middle either way round."""
    turned = 0
    for width in np.linspace(0.6, 1.4, 400):
        low, high = 0.12 + width / 2, width + 2 * 0.12 - 0.12 - width / 2
        turned += high < low
        room = layout_of(width + 2 * 0.12, 3.0)
        room.place_on_wall(box((width, 0.4, 0.5)), prefer="any", margin=0.12, reach=False)
    assert turned > 20


def test_the_way_between_two_doors_stays_wide_enough_for_a_person() -> None:
    doors = (opening("door", "y", -0.06, 1.0, 1.9), opening("door", "y", 6.06, 1.0, 1.9))
    room = layout_of(6.0, 3.0, doors[0], Opening(**{**vars(doors[1]), "rooms": ("room", None)}))
    assert len(room.targets) == 2
    assert room.is_passable([(2.5, 0.0, 3.5, 2.1)])  # 0.9 m are left
    assert not room.is_passable([(2.5, 0.0, 3.5, 2.45)])  # 0.55 m
    assert not room.is_passable([(2.5, 0.0, 3.5, 3.0)])


@pytest.mark.parametrize("name", SIDES)
def test_furniture_has_its_back_to_the_wall_and_looks_into_the_room(name: str) -> None:
    room = layout_of(5.0, 4.0)
    sofa = room.place_on_wall(box((1.8, 0.8, 0.8), "sofa"), sides=[name], gap=0.02)
    assert sofa is not None
    side = room.sides[name]
    front = (math.sin(sofa.yaw), -math.cos(sofa.yaw))
    assert front == pytest.approx(side.normal, abs=1e-9)
    x0, y0, x1, y1 = footprint(sofa)
    assert 0.0 < x0 < x1 < 5.0 and 0.0 < y0 < y1 < 4.0
    near = {"south": y0, "north": 4.0 - y1, "west": x0, "east": 5.0 - x1}
    assert near[name] == pytest.approx(0.02)


def test_pictures_hang_beside_windows() -> None:
    room = layout_of(6.0, 4.0, opening("window", "x", -0.06, 2.0, 4.0, 0.9))
    picture = build_picture(np.random.default_rng(0), PALETTE, 0.6, 0.4)
    side = room.sides["south"]
    assert room.hang(side, picture, 3.0, 1.5) is None
    assert room.hang(side, picture, 1.0, 1.5) is not None
    assert room.hang(side, picture, 1.2, 1.5) is None, "hangs on another"
    assert room.hang(side, picture, 5.0, 2.4) is None, "hangs in the ceiling"


def test_small_things_fit_under_the_board_above_and_stand_apart() -> None:
    shelf = box((1.0, 0.4, 1.0), supports=(Support(-0.4, 0.4, -0.15, 0.15, 0.5, 0.25),))
    rng = np.random.default_rng(1)
    tall = dress(shelf, "shelf", rng, PALETTE, count=0, first=[box((0.1, 0.1, 0.3))])
    assert tall.parts == ()
    cups = dress(shelf, "shelf", rng, PALETTE, count=0, first=[box((0.1, 0.1, 0.1))] * 8, turn=0.0)
    assert len(cups.parts) >= 4
    for k, cup in enumerate(cups.parts):
        assert cup.z == 0.5
        assert not any(overlaps(footprint(cup), footprint(other)) for other in cups.parts[:k])


def test_parts_turn_with_what_they_lie_on() -> None:
    sofa = box((2.0, 0.9, 0.8), "sofa").with_parts([Placed(box((0.4, 0.2, 0.1)), 0.5, 0, 0.4, 0.3)])
    assembly = Assembly()
    assembly.add_item(Placed(sofa, 3.0, 2.0, 0.0, math.pi / 2), "room")
    whole, cushion = (thing.box for thing in assembly.objects)
    assert whole.yaw == pytest.approx(math.pi / 2) and whole.centre[2] == pytest.approx(0.4)
    assert cushion.yaw == pytest.approx(math.pi / 2 + 0.3)
    assert cushion.centre == pytest.approx((3.0, 2.5, 0.45))


def test_boards_of_one_wood_do_not_repeat_one_another() -> None:
    board = build_box((1.0, 0.02, 0.2), WHITE)
    assembly = Assembly()
    assembly.add_shell(board)
    assembly.add_item(Placed(Item("shelf", (board, board.moved(z=0.3))), 0, 0), None)
    mesh, _ = assembly.finish()
    shell, first, second = np.split(mesh.uv, 3)
    np.testing.assert_array_equal(shell, board.uv)  # the floor runs on from zone to zone
    assert np.abs(first - second).min() > 0.05


def test_diners_look_at_their_table() -> None:
    room = layout_of(6.0, 5.0)
    assert place_dining(room, 6, kelvin=3000.0)
    table = next(p for p in room.placed if p.item.category == "dining table")
    chairs = [p for p in room.placed if p.item.category == "chair"]
    assert len(chairs) >= 4
    for chair in chairs:
        way = np.array([math.sin(chair.yaw), -math.cos(chair.yaw)])  # its front
        there = np.array([table.x - chair.x, table.y - chair.y])
        assert way @ there / np.linalg.norm(there) > 0.5


@pytest.mark.parametrize("size", [(3.5, 4.0), (9.0, 3.0)])
def test_a_room_has_the_light_of_its_area_from_one_lamp_or_two(size: tuple[float, float]) -> None:
    room = layout_of(*size)
    light_ceiling(room, 3000.0)
    lamps = [lamp for p in room.placed for lamp in p.item.lamps]
    assert len(lamps) == 1 + (size == (9.0, 3.0))
    flux = sum(max(lamp.colour) * math.pi * lamp.size[0] * lamp.size[1] for lamp in lamps)
    wanted = CEILING_FLUX * min(1.3, max(0.5, size[0] * size[1] / 14))
    assert flux == pytest.approx(wanted, rel=0.02)


def test_a_switch_is_beside_the_door() -> None:
    room = layout_of(4.0, 4.0, opening("door", "x", -0.06, 1.5, 2.4))
    assert hang_by_doors(room, box((0.08, 0.01, 0.08)), 1.1) == 1
    (switch,) = room.placed
    assert switch.y < 0.05 and (1.2 < switch.x < 1.5 or 2.4 < switch.x < 2.7)


def test_every_room_has_what_it_needs_and_draws_of_its_own() -> None:
    """A furnisher that forgets the bed of most bedrooms is asked again."""
    first: dict[str, float] = {}

    def furnish(layout: RoomLayout) -> None:
        first.setdefault(layout.room.id, layout.rng.random())
        if layout.rng.random() < 0.5:
            room = layout.room
            middle = (room.x0 + room.x1) / 2, (room.y0 + room.y1) / 2
            layout.placed.append(Placed(box((0.2, 0.2, 0.02), "bed"), *middle))

    plan = plan_apartment(4, "large")
    bedrooms = {room.id for room in plan.rooms if room.type == "bedroom"}
    assert len(bedrooms) >= 2
    for seed in range(2):
        house = Building("test", seed, plan, PALETTE, furnish, needed={"bedroom": {"bed"}})
        beds = {thing.room for thing in house.draft().objects if thing.category == "bed"}
        assert bedrooms <= beds
    assert len(set(first.values())) == len(plan.rooms)


def test_a_room_of_which_a_part_is_cut_off_is_not_reached() -> None:
    plan = plan_hall([("hall", -0.12, -0.12, 6.12, 4.12)], [], 2.6)
    room = plan.rooms[0]

    def reached(*barriers: float) -> tuple[tuple[str, ...], float]:
        assembly = Assembly()
        finish = RoomFinish(dict.fromkeys(SIDES, WHITE), WHITE)
        assembly.add_shell(*build_room_shell(plan, room, finish))
        for x in barriers:
            wall = box((0.2, room.depth, 1.0))
            assembly.add_item(Placed(wall, x, (room.y0 + room.y1) / 2), None)
        mesh, materials = assembly.finish()
        draft = SceneDraft(mesh, materials, tuple(assembly.objects), (), (), (), (), None, 2.6)
        found = check_reach(draft, plan)
        return found.cut_off, found.share

    assert reached() == ((), 1.0)
    cut_off, share = reached(4.0)
    assert cut_off == ("hall",) and 0.5 < share < 0.8
