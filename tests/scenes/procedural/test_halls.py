"""Supermarkets, warehouses and yards: full, walkable, in zones, the same for the same seed."""

from __future__ import annotations

import math
from collections import Counter
from functools import cache

import numpy as np
import pytest
from shapely.geometry import Polygon

from gn0.errors import SceneError
from gn0.maps.navigation import NavigationMap
from gn0.missions.targets import find_standing_cell, is_goal_worthy
from gn0.scenes.occupancy import build_occupancy
from gn0.scenes.procedural.building import AGENT_RADIUS
from gn0.scenes.procedural.draft import SceneDraft
from gn0.scenes.procedural.finish import floor_area
from gn0.scenes.procedural.kinds import KINDS
from gn0.scenes.procedural.materials import pattern_names
from gn0.scenes.scene import Scene, SceneObject, SceneSourceInfo
from gn0.scenes.sky import VAULT
from gn0.storage import content_hash

HALLS = ("supermarket", "warehouse", "courtyard")
HALLS_IN_TIME = (*(pytest.param(kind, marks=pytest.mark.slow) for kind in HALLS[:2]), HALLS[2])
SEED = 3


@cache
def hall(kind: str, size: str = "medium", seed: int = SEED) -> SceneDraft:
    return KINDS[kind].draft(seed, size=size)  # type: ignore[index]


@cache
def navigation(kind: str) -> NavigationMap:
    return NavigationMap(build_occupancy(hall(kind).mesh), AGENT_RADIUS)


def digest(draft: SceneDraft) -> str:
    m = draft.mesh
    return content_hash(
        m.vertices, m.faces, m.uv, m.material, m.instance, repr(draft.objects).encode(),
        repr((draft.materials, draft.lamps, draft.sun, draft.sky, draft.rooms)).encode(),
    )  # fmt: skip


@pytest.mark.parametrize("kind", HALLS_IN_TIME)
def test_area_lies_in_the_promised_range(kind: str) -> None:
    for size in ("small", "medium"):
        low, high = KINDS[kind].area_of(size)  # type: ignore[index]
        assert low <= floor_area(hall(kind, size)) <= high


@pytest.mark.parametrize("kind", HALLS_IN_TIME)
def test_the_same_seed_gives_the_same_draft_and_another_one_another(kind: str) -> None:
    first = hall(kind, "small")
    again = KINDS[kind].draft(SEED, size="small")  # type: ignore[index]
    assert digest(again) == digest(first) != digest(hall(kind))


@pytest.mark.parametrize("kind", HALLS)
def test_every_zone_can_be_walked_to(kind: str) -> None:
    nav, draft = navigation(kind), hall(kind)
    areas = np.asarray(nav.region_areas)
    assert areas.max() > 0.98 * areas.sum()
    main = int(areas.argmax())
    cells = np.argwhere(np.asarray(nav.regions) == main)
    points = nav.grid.centres_of(cells)
    for room in draft.rooms:
        low, high = np.min(room.polygon, axis=0), np.max(room.polygon, axis=0)
        assert ((points > low) & (points < high)).all(axis=1).any(), room.id


@pytest.mark.parametrize("kind", HALLS)
def test_zones_do_not_overlap(kind: str) -> None:
    shapes = [Polygon(room.polygon) for room in hall(kind).rooms]
    for k, a in enumerate(shapes):
        for b in shapes[:k]:
            assert a.intersection(b).area < 1e-6
    assert len({room.id for room in hall(kind).rooms}) == len(shapes)


@pytest.mark.parametrize("kind", HALLS)
def test_almost_all_goals_have_ground_to_stand_on(kind: str) -> None:
    draft, nav = hall(kind), navigation(kind)
    scene = Scene(
        id=kind, source=SceneSourceInfo(kind="procedural"), grid=nav.grid, objects=draft.objects,
        rooms=draft.rooms, bounds=np.zeros((2, 3)), walls=draft.walls,
        load_cloud=lambda: pytest.fail("no splats are needed"),
    )  # fmt: skip
    goals = [t for t in draft.objects if is_goal_worthy(t) and max(t.box.size) > 0.45]
    some = goals[:: max(1, len(goals) // 120)]
    lost = [t.category for t in some if find_standing_cell(scene, nav, t) is None]
    assert len(lost) <= 0.05 * len(some), Counter(lost)


@pytest.mark.parametrize("kind", HALLS)
def test_meshes_are_sound(kind: str) -> None:
    draft = hall(kind)
    mesh = draft.mesh
    assert np.isfinite(mesh.vertices).all() and (mesh.areas() > 0).all()
    assert mesh.material.max() < len(draft.materials) and mesh.instance.max() < len(draft.objects)
    assert {m.pattern for m in draft.materials} <= set(pattern_names())
    assert len(mesh) < 400_000
    ids = [thing.id for thing in draft.objects]
    assert len(set(ids)) == len(ids)
    zones = {room.id for room in draft.rooms}
    assert {thing.room for thing in draft.objects} <= {*zones, None}
    # boxes hold their faces
    corner = mesh.corners()
    for k in range(0, len(draft.objects), 97):
        mine = corner[mesh.instance == k].reshape(-1, 3)
        box = draft.objects[k].box
        c, s = np.cos(box.yaw), np.sin(box.yaw)
        d = mine - box.centre
        local = np.column_stack([c * d[:, 0] + s * d[:, 1], -s * d[:, 0] + c * d[:, 1], d[:, 2]])
        assert (np.abs(local) <= np.array(box.size) / 2 + 2e-3).all(), ids[k]


def of_category(things: tuple[SceneObject, ...], category: str) -> list[SceneObject]:
    return [t for t in things if t.category == category]


def test_a_supermarket_is_stocked() -> None:
    draft = hall("supermarket")
    count = Counter(thing.category for thing in draft.objects)
    assert len(draft.objects) > 1800 and len(count) >= 60
    for category in ("shelf", "refrigerator", "freezer", "produce stand", "checkout", "sign",
                     "shopping trolley", "entrance gate", "bakery counter"):  # fmt: skip
        assert count[category] >= 1, category
    types = {room.type for room in draft.rooms}
    assert {"produce section", "bakery", "dairy section", "checkout area", "storage room"} <= types
    aisles = {t for t in types if t.endswith("aisle")}
    assert len(aisles) >= 3
    # goods belong to the zone that their shelf faces, and are a small part of the whole each
    shelves = {t.room for t in of_category(draft.objects, "shelf")}
    assert {room.id for room in draft.rooms if room.id.startswith("aisle")} <= shelves


def test_shelves_of_an_aisle_stand_along_it_and_look_into_it() -> None:
    draft = hall("supermarket")
    rooms = {room.id: room for room in draft.rooms}
    looked = 0
    for thing in draft.objects:
        if thing.category != "shelf" or not (thing.room or "").startswith("aisle"):
            continue
        x, y = thing.box.centre[:2]
        reach = thing.box.size[1] / 2 + 0.2
        x, y = x + math.sin(thing.box.yaw) * reach, y - math.cos(thing.box.yaw) * reach
        (x0, y0), (x1, y1) = (f(rooms[thing.room].polygon, axis=0) for f in (np.min, np.max))
        if y0 < thing.box.centre[1] < y1 and thing.box.size[0] > 1.3:  # not at the end of a row
            looked += 1
            assert x0 < x < x1 and y0 < y < y1, thing.id
    assert looked >= 6


def test_a_warehouse_has_what_warehouses_have() -> None:
    draft = hall("warehouse")
    count = Counter(thing.category for thing in draft.objects)
    assert len(count) >= 30
    for category in ("pallet rack", "pallet", "cardboard box", "loading dock", "packing table",
                     "forklift", "pallet truck", "hand truck", "barrel", "safety sign", "desk",
                     "conveyor", "fire extinguisher"):  # fmt: skip
        assert count[category] >= 1, category
    assert count["cardboard box"] > 400
    assert {"rack aisle", "loading area", "packing area", "office"} <= {r.type for r in draft.rooms}
    office = next(room for room in draft.rooms if room.type == "office")
    desk = of_category(draft.objects, "desk")[0]
    assert desk.room == office.id


def test_a_yard_is_outdoors() -> None:
    draft = hall("courtyard")
    count = Counter(thing.category for thing in draft.objects)
    assert len(count) >= 30
    for category in ("tree", "bench", "planter", "facade", "window", "door", "street lamp"):
        assert count[category] >= 2, category
    assert draft.sky is not None and draft.sun is not None and not draft.lamps
    assert VAULT in {m.pattern for m in draft.materials}
    # one walks on grass and under trees, but not through beds and hedges
    nav = navigation("courtyard")
    lawn = next(room for room in draft.rooms if room.type in ("lawn", "orchard"))
    low, high = np.min(lawn.polygon, axis=0), np.max(lawn.polygon, axis=0)
    rows, cols = np.clip(nav.grid.cells_of(np.array([low, high])), 0, None).T
    patch = nav.grid.cells[rows[0] : rows[1], cols[0] : cols[1]]
    assert (patch == 0).mean() > 0.6
    for thing in draft.objects:
        if thing.category in ("hedge", "flower bed", "fountain"):
            assert nav.region_of(*thing.box.centre[:2]) < 0, thing.id


def test_the_ground_of_a_yard_ends_where_its_zones_end() -> None:
    draft = hall("courtyard")
    triangles = draft.mesh.vertices[draft.mesh.faces]
    level = (np.ptp(triangles[..., 2], axis=1) < 1e-6) & (draft.mesh.instance < 0)
    for room in draft.rooms:
        low, high = np.min(room.polygon, axis=0), np.max(room.polygon, axis=0)
        corners = [low, (high[0], low[1]), high, (low[0], high[1])]
        # a level face of the shell has its corners in those of the zone
        wide = triangles[level & (np.ptp(triangles[..., 0], axis=1) > 0.9 * (high - low)[0])]
        near = (
            np.abs(wide[:, :, None, :2] - np.array(corners)[None, None]).max(axis=-1).min(axis=-1)
        )
        assert (near.max(axis=1) < 1e-3).any(), room.id


@pytest.mark.parametrize("seed", range(3))
def test_a_clear_sky_is_palest_at_the_horizon(seed: int) -> None:
    sky = hall("courtyard", "small", seed).sky
    assert sky is not None
    assert all(up < down for up, down in zip(sky.zenith, sky.horizon, strict=True))
    assert max(sky.horizon) < 1.0


def test_an_unknown_style_is_refused() -> None:
    for kind in HALLS:
        with pytest.raises(SceneError, match="unknown style"):
            KINDS[kind].draft(0, size="small", style="baroque")  # type: ignore[index]
