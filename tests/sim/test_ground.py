"""Fields that are built side by side are those that each would have been alone."""

from __future__ import annotations

import shutil

import numpy as np
import pytest
from msgspec.structs import replace

from gn0.device.host import DeviceHost
from gn0.errors import EpisodeError, PlanError, SceneError
from gn0.maps.grid import OccupancyGrid
from gn0.maps.navigation import NavigationMap
from gn0.sim import device_store
from gn0.sim.device_env import VectorEnvDevice
from gn0.sim.ground import MAPS_KEPT, MAPS_TOGETHER, Destination, GroundStore
from gn0.testing.scenes import build_floor_plan, build_map_scene, build_point_episodes

PLACED = ("x", "y", "rows", "cols", "goal_x", "goal_y", "reach", "number", "scene")  # of a row


@pytest.fixture(scope="module")
def plans():
    """More scenes than are open at a time, with four goals each."""
    grids = [build_floor_plan(seed) for seed in range(MAPS_KEPT + MAPS_TOGETHER + 3)]
    scenes = {f"plan-{k}": build_map_scene(grid, f"plan-{k}") for k, grid in enumerate(grids)}
    goals: list[Destination] = []
    for scene_id, scene in scenes.items():
        ground = NavigationMap(scene.grid, 0.2)
        goals += [(scene_id, e.destination) for e in build_point_episodes(scene, ground, 4, seed=1)]
    return scenes, list(dict.fromkeys(goals))


def _store(scenes) -> GroundStore:
    return GroundStore({k: lambda s=s: s for k, s in scenes.items()}, 0.2, memory=2**30)


def _arrays(store: GroundStore, goal: Destination) -> list[np.ndarray]:
    return [*store.field(goal), *store.ways(goal)]


def test_fields_and_ways_side_by_side_are_those_of_each_alone(plans) -> None:
    scenes, goals = plans
    together, alone = _store(scenes), _store(scenes)
    together.with_ways = alone.with_ways = True
    together.build_all(goals, 4)
    assert together.fields_built == len(goals)
    for goal in goals:
        for mine, theirs in zip(_arrays(together, goal), _arrays(alone, goal), strict=True):
            assert mine.dtype == theirs.dtype and mine.tobytes() == theirs.tobytes()
    assert together.fields_built == alone.fields_built == len(goals)
    assert len(together._kept) <= MAPS_KEPT


def test_what_cannot_be_built_is_passed_over_and_said_in_its_turn(plans) -> None:
    scenes, goals = plans
    solid = OccupancyGrid(np.ones((20, 20), np.uint8), 0.1, (0.0, 0.0))
    store = _store({**scenes, "solid": build_map_scene(solid, "solid")})
    inside, nowhere, blocked = (
        ("solid", (1.0, 1.0)),
        ("gone", (1.0, 1.0)),
        (goals[0][0], (-99.0, 0.0)),
    )
    store.build_all([inside, goals[0], nowhere, blocked, goals[-1], goals[0]], 3)
    assert store.fields_built == 2
    store.field(goals[0]), store.field(goals[-1])
    assert store.fields_built == 2
    for goal, kind in ((inside, SceneError), (nowhere, EpisodeError), (blocked, PlanError)):
        with pytest.raises(kind):
            store.field(goal)


@pytest.mark.skipif(not shutil.which("g++"), reason="the host emulation needs g++")
def test_episodes_of_many_scenes_are_brought_in_parts_as_one_by_one(plans, monkeypatch) -> None:
    """The same places, the same distances, and the same refusal, after which nothing is pinned."""
    scenes, _ = plans
    listed = [
        build_point_episodes(scene, NavigationMap(scene.grid, 0.2), 4, seed=3)
        for scene in scenes.values()
    ]
    episodes = [episode for group in zip(*listed, strict=True) for episode in group]
    told = []
    for many in (device_store._MANY, 10**9):
        monkeypatch.setattr(device_store, "_MANY", many)
        away = replace(episodes[-1].mission, goal=(-99.0, 0.0))
        broken = replace(episodes[-1], mission=away)
        env = VectorEnvDevice(
            48, list(scenes.values()), episodes=[*episodes, broken], sensors=("goal_vector",),
            device=DeviceHost(), ahead=1,
        )  # fmt: skip
        store = env.simulator.store
        numbers = np.arange(len(episodes))
        with pytest.raises(EpisodeError) as caught:
            store.pin(np.append(numbers, len(episodes)))
        assert not store.seats[1].any()
        slots = store.pin(numbers)
        rows = store._rows[slots]
        told.append((str(caught.value), slots.tolist(), rows[list(PLACED)].tolist()))
        assert store.fields_built <= len(episodes)
    assert told[0] == told[1]
