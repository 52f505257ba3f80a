"""Halls and yards: whose zone a thing is in, what stands round what, what lies outside."""

from __future__ import annotations

import math

import numpy as np
import pytest

from gn0.scenes.procedural import courtyard
from gn0.scenes.procedural.assembly import Item
from gn0.scenes.procedural.courtyard import OUTSIDE, build_vault, plan_yard
from gn0.scenes.procedural.palette import WHITE
from gn0.scenes.procedural.plan import Room
from gn0.scenes.procedural.plots import Plot
from gn0.scenes.procedural.shapes import build_box

SOUTH = Room("south", "aisle", 0.0, 0.0, 4.0, 2.0)
NORTH = Room("north", "aisle", 0.0, 2.0, 4.0, 4.0)


def plot_of(*zones: Room) -> Plot:
    return Plot(np.random.default_rng(2), list(zones))


def box(wide: float, deep: float, name: str = "shelf") -> Item:
    return Item(name, (build_box((wide, deep, 1.0), WHITE),))


@pytest.mark.parametrize(("yaw", "zone"), [(0.0, "south"), (math.pi, "north"), (math.pi / 2, None)])
def test_a_shelf_belongs_to_the_zone_that_it_faces(yaw: float, zone: str | None) -> None:
    plot = plot_of(SOUTH, NORTH)
    plot.put(box(1.0, 0.5), 3.9 if zone is None else 2.0, 2.0, yaw, front=0.3)
    assert plot.assembly.objects[0].room == zone


def test_scattered_things_leave_a_way_between_them() -> None:
    plot = plot_of(Room("yard", "yard", 0.0, 0.0, 6.0, 6.0))
    done = plot.scatter(lambda: box(0.4, 0.4), 12, (0.0, 0.0, 6.0, 6.0), margin=0.75)
    assert 6 <= done == len(plot.taken)
    for k, a in enumerate(plot.taken):
        for b in plot.taken[:k]:
            assert max(a[0] - b[2], b[0] - a[2], a[1] - b[3], b[1] - a[3]) > 0.74
        assert not plot.is_free(a) and not plot.is_free((a[2] + 0.1, a[1], a[2] + 0.3, a[3]), 0.2)


def test_guests_of_a_terrace_look_at_their_table() -> None:
    room = Room("terrace_1", "terrace", 0.0, 0.0, 7.0, 7.0)
    plot = plot_of(room)
    courtyard._set_tables(plot, room)
    tables = [o.box.centre for o in plot.assembly.objects if "table" in o.category]
    chairs = [o.box for o in plot.assembly.objects if "chair" in o.category]
    assert len(tables) >= 2 and len(chairs) >= 4
    for chair in chairs:
        there = min((np.subtract(t, chair.centre)[:2] for t in tables), key=np.linalg.norm)
        way = np.array([math.sin(chair.yaw), -math.cos(chair.yaw)])
        assert way @ there / np.linalg.norm(there) > 0.5


def test_the_sky_is_seen_from_inside() -> None:
    vault = build_vault(20.0, 14.0, WHITE)
    p = vault.vertices[vault.faces]
    normal = np.cross(p[:, 1] - p[:, 0], p[:, 2] - p[:, 0])
    inward = np.array([10.0, 7.0, 1.5]) - p.mean(axis=1)
    assert ((normal * inward).sum(axis=1) > 0).mean() > 0.99


def test_nobody_can_stand_behind_the_garden_wall() -> None:
    sides = set()
    for seed in range(12):
        yard = plan_yard(seed, "small")
        sides.add(yard.open_side)
        for ground in courtyard._ground_beyond(yard, WHITE):
            assert (ground.vertices[:, 2] == OUTSIDE).all() and OUTSIDE < -0.1
    assert len(sides) >= 3
