"""People around agents on the device: bit by bit those of VectorEnv, in numbers."""

from __future__ import annotations

import msgspec
import numpy as np
import pytest

from gn0.maps.navigation import NavigationMap
from gn0.missions.episode import AgentSpec
from gn0.people.plan import PeopleSettings, plan_people
from gn0.scenes import build_example_scene
from gn0.sim.device_env import VectorEnvDevice
from gn0.sim.follow_device import FollowVectorEnvDevice
from gn0.sim.follow_vector import FollowVectorEnv
from gn0.sim.vector import VectorEnv
from gn0.testing.scenes import build_floor_plan, build_map_scene, build_point_episodes

BODY = AgentSpec(radius=0.25, step_seconds=0.2)
WALK = [0.03, 0.67, 0.15, 0.15]


@pytest.fixture(scope="module")
def crowded():
    """Two floor plans, and episodes of up to eight people in them."""
    scenes = [
        build_map_scene(build_floor_plan(k, width=8.0, depth=7.0), f"plan-{k}") for k in range(2)
    ]
    episodes = []
    for scene in scenes:
        ground = NavigationMap(scene.grid, BODY.radius)
        for k, bare in enumerate(build_point_episodes(scene, ground, 4, agent=BODY)):
            people = plan_people(scene, bare, PeopleSettings(count=8, seed=k))
            episodes.append(msgspec.structs.replace(bare, id=f"{scene.id}-{k}", people=people))
    return scenes, episodes


def assert_same(there, here, device, steps, names) -> int:
    """Step both; how many moves people cut."""
    seen, want = there.reset(seed=5), here.reset(seed=5)
    rng, hits = np.random.default_rng(1), 0
    for t in range(steps):
        for name in want[0]:
            assert seen[0][name].numpy().tobytes() == want[0][name].tobytes(), (t, name)
        for name in names:
            assert seen[-1][name].numpy().tobytes() == want[-1][name].tobytes(), (t, name)
        actions = rng.choice(4, there.num_envs, p=WALK)
        seen, want = there.step(device.upload(actions)), here.step(actions)
        for k in (1, 2, 3):
            assert seen[k].numpy().tobytes() == want[k].tobytes(), (t, k)
        hits += int((want[-1]["hit_person"] > 0).sum())
    return hits


@pytest.mark.small
def test_people_are_those_of_the_cpu(device, crowded) -> None:
    scenes, episodes = crowded
    count, steps = (2048, 150) if device.kind == "cuda" else (12, 55)
    settings = {"episodes": episodes, "sensors": ("goal_vector", "ranges", "pose"),
                "max_steps": 60, "agent": BODY}  # fmt: skip
    there = VectorEnvDevice(count, scenes, device=device, ahead=2, **settings)
    here = VectorEnv(count, scenes, **settings)
    names = ("people", "hit_person", "hit_tick", "pose")
    assert assert_same(there, here, device, steps, names) > 0


@pytest.mark.small
def test_who_goes_round_far_from_its_way_is_that_of_the_cpu(device) -> None:
    """People who go round each other for four seconds, a metre and more beside their ways."""
    plans = (3, 24), (3, 25), (6, 9), (6, 21)  # of places and of people
    scenes = [
        build_map_scene(build_floor_plan(k, width=12.0, depth=12.0), f"plan-{k}") for k in (3, 6)
    ]
    episodes = []
    for scene in scenes:
        ground = NavigationMap(scene.grid, BODY.radius)
        for number, k in (one for one in plans if f"plan-{one[0]}" == scene.id):
            bare = build_point_episodes(scene, ground, 32, agent=BODY)[k]
            people = plan_people(scene, bare, PeopleSettings(count=8, seed=k))
            episodes.append(msgspec.structs.replace(bare, id=f"{number}-{k}", people=people))
    settings = {"episodes": episodes, "agent": BODY, "sensors": ("pose",), "max_steps": 500}
    count = 2048 if device.kind == "cuda" else 192
    there = VectorEnvDevice(count, scenes, device=device, **settings)
    assert_same(there, VectorEnv(count, scenes, **settings), device, 80, ("people",))


@pytest.mark.small
def test_following_is_that_of_the_cpu(device) -> None:
    """The built-in flat, one person ahead on every way."""
    flat = build_example_scene()
    count, steps = (2048, 150) if device.kind == "cuda" else (6, 20)
    settings = {"sensors": ("ranges", "pose"), "max_steps": 60}
    there = FollowVectorEnvDevice(count, flat, device=device, **settings)
    here = FollowVectorEnv(count, flat, **settings)
    names = ("people", "follows", "faced", "person_distance")
    assert_same(there, here, device, steps, names)
