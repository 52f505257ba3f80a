"""Generated flats: the same for the same seed, walkable, free of collisions, fully labelled."""

from __future__ import annotations

import itertools
import math
from collections import Counter
from functools import cache

import numpy as np
import pytest

from gn0.errors import Gn0Error, SceneError
from gn0.maps.navigation import NavigationMap
from gn0.scenes.occupancy import build_occupancy
from gn0.scenes.procedural.apartment import draft_apartment
from gn0.scenes.procedural.building import AGENT_RADIUS, check_reach
from gn0.scenes.procedural.draft import SceneDraft
from gn0.scenes.procedural.materials import pattern_names
from gn0.scenes.procedural.plan import SIZES, FloorPlan, plan_apartment
from gn0.scenes.scene import SceneObject
from gn0.storage import content_hash

QUICK = 5  # flats: each takes a second to plan and furnish; the long tests look at the others
SEEDS = [
    pytest.param(seed, marks=[pytest.mark.slow] if seed >= QUICK else []) for seed in range(20)
]
LARGE = {
    *("sofa", "armchair", "bed", "wardrobe", "dresser", "bookshelf", "cabinet", "tv stand", "desk"),
    *("kitchen counter", "fridge", "toilet", "bathtub", "shower", "washbasin", "washing machine"),
    *("shoe rack", "console table", "dining table", "coffee table", "nightstand", "serving cart"),
}


@cache
def flat(seed: int) -> tuple[SceneDraft, FloorPlan]:
    size = ("small", "medium", "large")[seed % 3]
    return draft_apartment(seed, size=size), plan_apartment(seed, size)


def digest(draft: SceneDraft) -> str:
    m = draft.mesh
    return content_hash(
        m.vertices, m.faces, m.uv, m.material, m.instance, repr(draft.objects).encode(),
        repr((draft.materials, draft.lamps, draft.sun, draft.rooms)).encode(),
    )  # fmt: skip


def corners(thing: SceneObject) -> np.ndarray:
    return thing.box.corners()[:4, :2]


def penetration(a: SceneObject, b: SceneObject) -> float:
    """How deep two upright boxes overlap [m]; 0 when they do not (separating axes)."""
    za, zb = a.box.centre[2], b.box.centre[2]
    deep = (a.box.size[2] + b.box.size[2]) / 2 - abs(za - zb)
    for yaw in (a.box.yaw, b.box.yaw):
        for axis in (
            np.array([math.cos(yaw), math.sin(yaw)]),
            np.array([-math.sin(yaw), math.cos(yaw)]),
        ):
            p, q = corners(a) @ axis, corners(b) @ axis
            deep = min(deep, min(p.max(), q.max()) - max(p.min(), q.min()))
    return max(deep, 0.0)


def test_the_same_seed_gives_the_same_bytes() -> None:
    first, again = draft_apartment(11, size="small"), draft_apartment(11, size="small")
    assert digest(first) == digest(again)
    assert digest(first) != digest(draft_apartment(12, size="small"))


def test_style_is_chosen_or_refused() -> None:
    classic = draft_apartment(3, size="small", style="classic")
    modern = draft_apartment(3, size="small", style="dark modern")
    assert {m.colour for m in classic.materials} != {m.colour for m in modern.materials}
    with pytest.raises(SceneError, match="unknown style") as caught:
        draft_apartment(3, style="baroque")
    assert isinstance(caught.value, Gn0Error)


@pytest.mark.parametrize("size", SIZES)
def test_plans_are_flats(size: str) -> None:
    """Four to eight rooms of realistic size, each with a door; every wall of one thickness."""
    for seed in range(30):
        plan = plan_apartment(seed, size)
        types = Counter(room.type for room in plan.rooms)
        assert 4 <= len(plan.rooms) <= 8
        assert {"living room", "kitchen", "hallway", "bathroom", "bedroom"} <= set(types)
        assert SIZES[size][0] <= plan.area <= SIZES[size][1]
        assert 2.5 <= plan.ceiling <= 2.8
        graph = {room.id: {room.id} for room in plan.rooms}
        for o in plan.openings:
            if o.kind in ("door", "passage"):
                assert 0.85 <= o.width <= 1.95
                a, b = o.rooms
                assert a is not None and b is not None
                both = graph[a] | graph[b]
                for id in both:
                    graph[id] = both
        assert len(graph[plan.rooms[0].id]) == len(plan.rooms)
        for room in plan.rooms:
            assert min(room.width, room.depth) > 1.2
        for a, b in itertools.combinations(plan.rooms, 2):
            assert a.x1 <= b.x0 or b.x1 <= a.x0 or a.y1 <= b.y0 or b.y1 <= a.y0
        for wall in plan.walls:
            assert 0.10 <= wall.thickness <= 0.25
        bright = {id for o in plan.openings if o.kind == "window" for id in o.rooms}
        assert {r.id for r in plan.rooms if r.type in ("living room", "bedroom")} <= bright


@pytest.mark.parametrize("seed", SEEDS)
def test_every_room_can_be_walked_to(seed: int) -> None:
    """For an agent of 0.20 m: each room joined to the others, each door passable."""
    draft, plan = flat(seed)
    grid = build_occupancy(draft.mesh)
    reach = check_reach(draft, plan, grid)
    assert reach.cut_off == () and reach.share > 0.9
    navigation = NavigationMap(grid, AGENT_RADIUS)
    for o in plan.openings:
        if o.kind in ("door", "passage"):
            x, y = o.centre
            assert navigation.is_free(x, y) and navigation.region_of(x, y) == 0, o


@pytest.mark.parametrize("seed", SEEDS)
def test_objects_stand_in_their_rooms_and_apart(seed: int) -> None:
    draft, plan = flat(seed)
    rooms = {room.id: room for room in plan.rooms}
    for thing in draft.objects:
        assert thing.room in rooms
        if thing.category in ("window", "door", "curtain", "blind"):
            continue
        room = rooms[thing.room]
        for x, y in corners(thing):
            assert room.contains(x, y, -0.03), f"{thing.id} leaves {room.id}"
        assert thing.box.centre[2] - thing.box.size[2] / 2 > -0.02
        assert thing.box.centre[2] + thing.box.size[2] / 2 < plan.ceiling + 0.02
    large = [o for o in draft.objects if o.category in LARGE]
    for a, b in itertools.combinations(large, 2):
        chaise = {a.category, b.category} == {"sofa", "coffee table"}  # the table stands in its L
        if a.room == b.room and not (chaise and max(a.box.size[1], b.box.size[1]) > 1.2):
            assert penetration(a, b) < 0.03, f"{a.id} runs into {b.id}"


@pytest.mark.parametrize("seed", SEEDS)
def test_meshes_are_sound_and_boxes_hold_them(seed: int) -> None:
    draft, _ = flat(seed)
    mesh = draft.mesh
    assert 60_000 <= len(mesh) <= 280_000
    assert np.isfinite(mesh.vertices).all() and np.isfinite(mesh.uv).all()
    assert (mesh.areas() > 1e-10).all()
    assert mesh.material.min() == 0 and mesh.material.max() < len(draft.materials)
    assert set(np.unique(mesh.instance)) == {-1, *range(len(draft.objects))}
    for k in range(0, len(draft.objects), 7):
        box = draft.objects[k].box
        points = mesh.vertices[np.unique(mesh.faces[mesh.instance == k])] - box.centre
        c, s = math.cos(box.yaw), math.sin(box.yaw)
        local = points @ np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]])
        assert (np.abs(local) <= np.array(box.size) / 2 + 1e-4).all(), draft.objects[k].id
    assert {m.pattern for m in draft.materials} <= set(pattern_names())


def test_shell_faces_look_into_the_rooms() -> None:
    """Floors up, ceilings down, walls towards the middle of their room."""
    draft, plan = flat(0)
    mesh = draft.mesh
    shell = mesh.instance == -1
    centre, normal, area = mesh.corners().mean(axis=1), mesh.normals(), mesh.areas()
    for room in plan.rooms:
        middle = np.array([(room.x0 + room.x1) / 2, (room.y0 + room.y1) / 2, plan.ceiling / 2])
        inside = (
            shell
            & (centre[:, 0] > room.x0 - 1e-6)
            & (centre[:, 0] < room.x1 + 1e-6)
            & (centre[:, 1] > room.y0 - 1e-6)
            & (centre[:, 1] < room.y1 + 1e-6)
            & (area > 0.3)
        )
        towards = ((middle - centre[inside]) * normal[inside]).sum(axis=1)
        assert inside.sum() >= 10 and (towards > 0).all()


def test_flats_are_full_of_things() -> None:
    """At least thirty categories over all flats, twenty-five in each; several lamps in each."""
    every: Counter[str] = Counter()
    for seed in range(QUICK):
        draft, plan = flat(seed)
        here = {o.category for o in draft.objects}
        every.update(here)
        assert len(here) >= 25
        assert all(name == name.lower() for name in here)
        kinds = Counter(lamp.shape for lamp in draft.lamps)
        assert kinds["window"] >= 3 and kinds["rectangle"] + kinds["sphere"] >= len(plan.rooms)
        assert draft.sun is not None and draft.sun.direction[2] < -0.3
    assert len(every) >= 60
    wanted = {"sofa", "bed", "toilet", "fridge", "kitchen counter", "door", "window", "picture"}
    assert all(every[name] == QUICK for name in wanted), every


def test_the_sun_shines_in_through_the_window_of_the_living_room() -> None:
    for seed in range(QUICK):
        draft, plan = flat(seed)
        room = plan.rooms[0]
        assert room.type == "living room" and draft.sun is not None
        window = next(o for o in plan.openings if o.kind == "window" and room.id in o.rooms)
        inward = 1.0 if window.rooms[1] == room.id else -1.0
        assert draft.sun.direction[1 if window.axis == "x" else 0] * inward > 0.3
