"""Doors, windows and the walls round them: leaves swing clear, daylight comes in, no gaps."""

from __future__ import annotations

import itertools
import math

import numpy as np
import pytest

from gn0.scenes.procedural.assembly import Assembly, Placed
from gn0.scenes.procedural.draft import Lamp
from gn0.scenes.procedural.layout import RoomLayout
from gn0.scenes.procedural.palette import STEEL, STYLES, TRIM, WHITE, Palette, plain
from gn0.scenes.procedural.plan import FloorPlan, Opening, Room
from gn0.scenes.procedural.shapes import Shape
from gn0.scenes.procedural.shell import (
    SIDES,
    RoomFinish,
    build_door,
    build_room_shell,
    build_window,
    room_sides,
)

LOWER, UPPER = (0.0, 0.0, 6.0, 3.0), (0.0, 3.12, 6.0, 6.0)  # rooms on both sides of a wall
PAINT = plain("test paint", "paint", "#808080")


def two_rooms(axis: str, **more: object) -> tuple[FloorPlan, Opening]:
    """Two rooms side by side, and an opening from 2.6 to 3.5 m along the wall between them."""
    turn = (0, 1, 2, 3) if axis == "x" else (1, 0, 3, 2)
    rooms = tuple(
        Room(id, "study", *(corners[k] for k in turn))
        for id, corners in (("lower", LOWER), ("upper", UPPER))
    )
    about: dict[str, object] = {
        "kind": "door", "axis": axis, "at": 3.06, "low": 2.6, "high": 3.5, "bottom": 0.0,
        "top": 2.05, "thickness": 0.12, "rooms": ("lower", "upper"),
    }  # fmt: skip
    hole = Opening(**{**about, **more})  # type: ignore[arg-type]
    return FloorPlan(rooms, (), (hole,), 2.6), hole


def points_of(placed: Placed) -> np.ndarray:
    assembly = Assembly()
    assembly.add_item(placed, None)
    return assembly.finish()[0].corners().reshape(-1, 3)


@pytest.mark.parametrize(
    ("axis", "room", "hinge"), list(itertools.product("xy", ("lower", "upper"), ("low", "high")))
)
def test_an_open_leaf_lies_beside_its_door_where_furniture_makes_room(
    axis: str, room: str, hinge: str
) -> None:
    plan, door = two_rooms(axis, leaf=room, hinge=hinge)
    points = points_of(build_door(door, WHITE, STEEL, 0))
    points = points[(points[:, 2] > 0.3) & (points[:, 2] < 1.9)]
    t, off = (points[:, 0], points[:, 1]) if axis == "x" else (points[:, 1], points[:, 0])
    assert not ((t > door.low + 0.02) & (t < door.high - 0.02)).any(), "stands in the doorway"
    beside = (t < door.low - 0.2) if hinge == "low" else (t > door.high + 0.2)
    assert beside.any() and ((off[beside] < 3.06) == (room == "lower")).all()
    layout = RoomLayout(plan, plan.room(room), np.random.default_rng(0), Palette(STYLES[0]))
    (block,) = layout.blocks
    x0, y0, x1, y1 = block.rect
    leaf = points[beside]
    assert (leaf[:, 0] > x0 - 0.05).all() and (leaf[:, 0] < x1 + 0.05).all()
    assert (leaf[:, 1] > y0 - 0.05).all() and (leaf[:, 1] < y1 + 0.05).all()


@pytest.mark.parametrize(("axis", "room"), list(itertools.product("xy", ("lower", "upper"))))
def test_daylight_comes_in(axis: str, room: str) -> None:
    """The window's light shines into its room, and its sky is seen from there."""
    rooms = (None, room) if room == "upper" else (room, None)
    _, hole = two_rooms(axis, kind="window", rooms=rooms, bottom=0.9)
    assembly = Assembly()
    assembly.add_item(build_window(hole, np.random.default_rng(0), 3), room)
    mesh, materials = assembly.finish()
    inward = np.array([0.0, 1.0, 0.0] if axis == "x" else [1.0, 0.0, 0.0])
    inward *= 1.0 if room == "upper" else -1.0
    (lamp,) = assembly.lamps
    assert lamp.shape == "window"
    np.testing.assert_allclose(lamp.direction, inward, atol=1e-6)
    sky = np.array([m.pattern == "sky" for m in materials])[mesh.material]
    np.testing.assert_allclose(mesh.normals()[sky] @ inward, 1.0, atol=1e-6)
    assert min(max(m.emission) for m in materials if m.pattern == "sky") > 0


def test_lamps_turn_with_their_item() -> None:
    lamp = Lamp(centre=(0.0, -1.0, 2.0), size=(1.0, 1.0), shape="window", colour=(1.0, 1.0, 1.0),
                direction=(0.0, -1.0, 0.0))  # fmt: skip
    _, hole = two_rooms("x", kind="window", rooms=(None, "upper"), bottom=0.9)
    item = build_window(hole, np.random.default_rng(0), 3).item
    assembly = Assembly()
    assembly.add_item(Placed(type(item)("lamp", item.shapes, lamps=(lamp,)), 5, 5, 0, math.pi / 2),
                      None)  # fmt: skip
    (found,) = assembly.lamps
    assert found.direction == pytest.approx((1.0, 0.0, 0.0), abs=1e-6)
    assert found.centre == pytest.approx((6.0, 5.0, 2.0), abs=1e-5)


def walls_of(plan: FloorPlan, room: Room) -> tuple[list[Shape], list[Shape]]:
    """Panels of the walls, and boards of the skirting."""
    shell = build_room_shell(plan, room, RoomFinish(dict.fromkeys(SIDES, PAINT), WHITE))
    return [s for s in shell if s.material == PAINT], [s for s in shell if s.material == TRIM]


@pytest.mark.parametrize("bottom", [0.0, 0.9])
def test_walls_fill_all_but_their_holes(bottom: float) -> None:
    plan, hole = two_rooms("x", bottom=bottom, top=2.05)
    room = plan.room("lower")
    panels, boards = walls_of(plan, room)
    area = 0.0
    for panel in panels:
        p = panel.vertices[panel.faces]
        area += np.linalg.norm(np.cross(p[:, 1] - p[:, 0], p[:, 2] - p[:, 0]), axis=1).sum() / 2
    whole = 2 * (room.width + room.depth) * plan.ceiling
    assert area == pytest.approx(whole - hole.width * (hole.top - hole.bottom), rel=1e-6)
    inside = [
        board
        for board in boards
        if (board.vertices[:, 1] > 2.9).all()
        and board.vertices[:, 0].min() < 3.0 < board.vertices[:, 0].max()
    ]
    assert len(inside) == (bottom > 0), "skirting runs under windows and stops at doors"


def test_the_pattern_of_a_wall_runs_on_round_its_openings() -> None:
    plan, _ = two_rooms("x", bottom=0.9)
    room = plan.room("lower")
    panels, _ = walls_of(plan, room)
    side = room_sides(plan, room)["north"]
    mine = [p for p in panels if np.allclose(p.vertices[:, 1], room.y1)]
    assert len(mine) == 4
    for panel in mine:
        corner = panel.vertices[panel.faces]
        t = (corner[..., :2] - side.start) @ np.array(side.along)
        np.testing.assert_allclose(panel.uv[..., 0] + t, side.length, atol=1e-5)
        np.testing.assert_allclose(panel.uv[..., 1], corner[..., 2], atol=1e-5)
