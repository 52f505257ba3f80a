"""Offices, corridors and large homes: full, walkable, apart, the same for the same seed."""

from __future__ import annotations

import itertools
import math
from collections import Counter
from functools import cache

import numpy as np
import pytest

from gn0.errors import SceneError
from gn0.maps.navigation import NavigationMap
from gn0.scenes.occupancy import build_occupancy
from gn0.scenes.procedural.building import AGENT_RADIUS, check_reach
from gn0.scenes.procedural.corridor import THEMES, draw_theme, plan_corridor
from gn0.scenes.procedural.draft import SceneDraft
from gn0.scenes.procedural.finish import floor_area
from gn0.scenes.procedural.kinds import KINDS
from gn0.scenes.procedural.materials import pattern_names
from gn0.scenes.procedural.office import plan_office
from gn0.scenes.procedural.plan import FloorPlan, Room
from gn0.scenes.procedural.plan_cells import (
    NO_JOINT,
    Joint,
    close_cells,
    spread_windows,
    turn_cells,
)
from gn0.scenes.procedural.residence import plan_residence
from gn0.scenes.scene import SceneObject
from gn0.seeds import random_stream
from gn0.storage import content_hash

PLANS = {"office": plan_office, "corridor": plan_corridor, "residence": plan_residence}
BUILDINGS = tuple(PLANS)
SEED = {"office": 1, "corridor": 4, "residence": 5}
# fewest objects a m² and categories of the small ones
FULLNESS = {"office": (4.2, 70), "corridor": (1.6, 35), "residence": (2.6, 60)}
LARGE = {
    *("sofa", "armchair", "bed", "wardrobe", "dresser", "bookshelf", "cabinet", "tv stand", "desk"),
    *("kitchen counter", "fridge", "toilet", "bathtub", "washbasin", "washing machine", "shelf"),
    *("dining table", "coffee table", "conference table", "reception desk", "printer", "locker"),
    *("vending machine", "water cooler", "hospital bed", "school desk", "server rack", "bench"),
    *("open wardrobe", "drying rack", "trolley", "wheelchair", "console table", "shoe rack"),
}
IN_WALLS = ("window", "door", "curtain", "blind", "interior window")


@cache
def building(kind: str, size: str = "small") -> SceneDraft:
    return KINDS[kind].draft(SEED[kind], size=size)  # type: ignore[index]


@cache
def plan_of(kind: str, seed: int, size: str) -> FloorPlan:
    return PLANS[kind](seed, size)


def digest(draft: SceneDraft) -> str:
    m = draft.mesh
    return content_hash(
        m.vertices, m.faces, m.uv, m.material, m.instance, repr(draft.objects).encode(),
        repr((draft.materials, draft.lamps, draft.sun, draft.rooms)).encode(),
    )  # fmt: skip


def penetration(a: SceneObject, b: SceneObject) -> float:
    """How deep two upright boxes overlap [m]; 0 when they do not (separating axes)."""
    deep = (a.box.size[2] + b.box.size[2]) / 2 - abs(a.box.centre[2] - b.box.centre[2])
    for yaw in (a.box.yaw, b.box.yaw):
        for axis in ((math.cos(yaw), math.sin(yaw)), (-math.sin(yaw), math.cos(yaw))):
            p, q = (thing.box.corners()[:4, :2] @ np.array(axis) for thing in (a, b))
            deep = min(deep, min(p.max(), q.max()) - max(p.min(), q.min()))
    return max(float(deep), 0.0)


@pytest.mark.parametrize("kind", BUILDINGS)
def test_plans_are_closed_and_connected(kind: str) -> None:
    """Rooms apart, every one joined to the others by doors wide enough, in the promised area."""
    for seed, size in itertools.product(range(8), ("small", "medium", "large")):
        plan = plan_of(kind, seed, size)
        low, high = KINDS[kind].area_of(size)  # type: ignore[index,arg-type]
        assert low <= plan.area <= high
        assert 2.5 <= plan.ceiling <= 3.2
        for a, b in itertools.combinations(plan.rooms, 2):
            assert a.x1 <= b.x0 or b.x1 <= a.x0 or a.y1 <= b.y0 or b.y1 <= a.y0
        joined = {room.id: {room.id} for room in plan.rooms}
        for o in plan.openings:
            if o.kind in ("door", "passage"):
                assert o.width > 0.85
                a, b = o.rooms
                both = joined[a] | joined[b]  # type: ignore[index]
                joined |= dict.fromkeys(both, both)
        assert len(joined[plan.rooms[0].id]) == len(plan.rooms)
        assert any(o.kind == "entrance" for o in plan.openings)


@pytest.mark.parametrize("kind", BUILDINGS)
def test_openings_of_one_wall_do_not_overlap(kind: str) -> None:
    for seed in range(25):
        openings = plan_of(kind, seed, "medium").openings
        for a, b in itertools.combinations(openings, 2):
            if a.axis == b.axis and abs(a.at - b.at) < 0.25:
                assert a.high <= b.low or b.high <= a.low, (seed, a, b)


@pytest.mark.parametrize("kind", BUILDINGS)
def test_every_room_can_be_walked_to(kind: str) -> None:
    """For an agent of 0.20 m: each room joined to the others, each door passable."""
    draft, plan = building(kind), plan_of(kind, SEED[kind], "small")
    grid = build_occupancy(draft.mesh)
    reach = check_reach(draft, plan, grid)
    assert reach.cut_off == () and reach.share > 0.9
    navigation = NavigationMap(grid, AGENT_RADIUS)
    for o in plan.openings:
        if o.kind in ("door", "passage"):
            assert navigation.region_of(*o.centre) == 0, o


@pytest.mark.parametrize("kind", BUILDINGS)
def test_buildings_are_full_of_labelled_things(kind: str) -> None:
    draft = building(kind)
    per_area, categories = FULLNESS[kind]
    counts = Counter(o.category for o in draft.objects)
    assert len(draft.objects) > per_area * floor_area(draft)
    assert len(counts) >= categories
    assert all(name == name.lower() for name in counts)
    assert len({o.id for o in draft.objects}) == len(draft.objects)
    rooms = {room.id for room in draft.rooms}
    assert {o.room for o in draft.objects} <= rooms
    lit = {o.room for o in draft.objects if o.category in ("ceiling lamp", "pendant lamp")}
    assert lit == rooms


def test_an_office_is_an_office() -> None:
    counts = Counter(o.category for o in building("office").objects)
    assert counts["desk"] >= 15 and counts["office chair"] >= 15 and counts["monitor"] >= 15
    wanted = ("reception desk", "conference table", "whiteboard", "printer", "fridge", "plant")
    assert all(counts[name] >= 1 for name in wanted), counts


@pytest.mark.parametrize("kind", BUILDINGS)
def test_objects_stand_in_their_rooms_and_apart(kind: str) -> None:
    draft = building(kind)
    rooms = {room.id: room for room in plan_of(kind, SEED[kind], "small").rooms}
    for thing in draft.objects:
        if thing.category in IN_WALLS:
            continue
        room = rooms[thing.room]  # type: ignore[index]
        for x, y in thing.box.corners()[:4, :2]:
            assert room.contains(x, y, -0.04), f"{thing.id} leaves {room.id}"
        middle, tall = thing.box.centre[2], thing.box.size[2]
        assert middle - tall / 2 > -0.02 and middle + tall / 2 < draft.ceiling + 0.02, thing.id
    large = [o for o in draft.objects if o.category in LARGE]
    for a, b in itertools.combinations(large, 2):
        pair = {a.category, b.category}
        chaise = pair == {"sofa", "coffee table"}  # the table stands in the sofa's L
        nested = pair == {"kitchen counter", "fridge"}
        if a.room == b.room and not chaise and not nested:
            assert penetration(a, b) < 0.03, f"{a.id} runs into {b.id}"


@pytest.mark.parametrize("kind", BUILDINGS)
def test_meshes_are_sound_and_affordable(kind: str) -> None:
    draft = building(kind)
    mesh = draft.mesh
    assert len(mesh) < 3000 * floor_area(draft)
    assert np.isfinite(mesh.vertices).all() and np.isfinite(mesh.uv).all()
    assert (mesh.areas() > 1e-10).all()
    assert set(np.unique(mesh.instance)) == {-1, *range(len(draft.objects))}
    assert {m.pattern for m in draft.materials} <= set(pattern_names())


@pytest.mark.slow  # as test_apartment.py and test_halls.py say of quicker kinds
def test_the_same_seed_gives_the_same_corridor() -> None:
    again = KINDS["corridor"].draft(SEED["corridor"], size="small")
    assert digest(again) == digest(building("corridor"))


def test_corridors_come_from_three_kinds_of_house() -> None:
    names = {draw_theme(seed).name for seed in range(20)}
    assert names == {theme.name for theme in THEMES}


def test_an_unknown_style_is_refused() -> None:
    for kind in BUILDINGS:
        with pytest.raises(SceneError, match="unknown style"):
            KINDS[kind].draft(3, style="baroque")  # type: ignore[index]


def test_rooms_that_nothing_joins_make_no_plan() -> None:
    cells = [("hallway", 0.0, 0.0, 5.0, 2.0), ("study", 0.0, 2.0, 5.0, 5.0)]
    rng = random_stream(0, "cells")

    def joined(a: Room, b: Room) -> Joint:
        return Joint("door", glazing=0.9)

    def close(rule: object, entrance: str) -> FloorPlan | None:
        return close_cells(
            rng, cells, ceiling=2.6, joint=rule, entrance=entrance,  # type: ignore[arg-type]
            windows=lambda room, wall, low, high: spread_windows(
                low, high, width=1.2, bottom=0.9, top=2.2
            ),
        )  # fmt: skip

    assert close(lambda a, b: NO_JOINT, "hallway") is None
    assert close(joined, "kitchen") is None  # no such room has an outer wall
    plan = close(joined, "hallway")
    assert plan is not None
    kinds = Counter(o.kind for o in plan.openings)
    assert kinds["door"] == 1 and kinds["glazing"] == 1 and kinds["entrance"] == 1
    assert kinds["window"] >= 5


def test_turned_layouts_keep_their_shape() -> None:
    cells = [("a", 1.0, 2.0, 4.0, 4.0), ("b", 4.0, 2.0, 9.0, 7.0)]
    for seed in range(12):
        turned = turn_cells(random_stream(seed, "turn"), cells)
        assert min(c[1] for c in turned) == 0.0 and min(c[2] for c in turned) == 0.0
        for before, after in zip(cells, turned, strict=True):
            old = sorted((before[3] - before[1], before[4] - before[2]))
            assert np.allclose(sorted((after[3] - after[1], after[4] - after[2])), old)


def test_windows_are_spread_evenly() -> None:
    for low, high in ((0.0, 12.0), (1.0, 3.0), (0.0, 1.2)):
        found = spread_windows(low, high, width=1.5, bottom=0.9, top=2.2, gap=0.5)
        for a, b in itertools.pairwise(found):
            assert b[0] - a[1] > 0.4
        assert all(low <= a and b <= high for a, b, _, _ in found)
    assert len(spread_windows(0.0, 12.0, width=1.5, bottom=0.9, top=2.2, gap=0.5)) == 5
    assert spread_windows(0.0, 1.2, width=1.5, bottom=0.9, top=2.2, gap=0.5) == []
