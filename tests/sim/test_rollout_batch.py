"""Many episodes at once are the episodes one at a time."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from gn0.errors import PolicyError
from gn0.maps.navigation import NavigationMap
from gn0.missions.episode import AgentSpec
from gn0.policies.simple import PolicyRandom, PolicyWallFollower
from gn0.sim.open import open_simulator
from gn0.sim.policy import PolicyBatchEach
from gn0.sim.rollout import run_episode
from gn0.sim.rollout_batch import run_episodes
from gn0.sim.state import Action, Displacement
from gn0.sim.vector import VectorEnv
from gn0.testing.scenes import (
    build_floor_plan,
    build_map_scene,
    build_point_episodes,
    build_room_scene,
)


class PolicySeeing:
    """Turns what it sees into an action, so that any other byte is another way."""

    name = "seeing"

    def __init__(self, *sensors: str) -> None:
        self.sensors = frozenset(sensors)

    def reset(self, instruction, rng) -> None:
        self.rng = rng
        self.sum = len(instruction)

    def act(self, seen) -> Action:
        for name in sorted(self.sensors):
            value = getattr(seen, name)
            self.sum += int(np.abs(np.nan_to_num(np.asarray(value, np.float64))).sum() * 8)
        self.sum += seen.step + seen.collided
        return Action(1 + (self.sum + int(self.rng.integers(3))) % 3)


@pytest.fixture(scope="module")
def plans():
    scenes = [build_map_scene(build_floor_plan(k), f"plan-{k}") for k in range(2)]
    listed = [build_point_episodes(s, NavigationMap(s.grid, 0.2), 6, seed=1) for s in scenes]
    return scenes, [e for group in zip(*listed, strict=True) for e in group]


@pytest.mark.parametrize("count", [1, 5, 20])
@pytest.mark.parametrize("policy", [PolicyRandom, PolicyWallFollower])
def test_trajectories_are_those_of_single_episodes(plans, count: int, policy) -> None:
    """Fewer agents than episodes, and more; two scenes; poses to the bit."""
    scenes, episodes = plans
    batch = PolicyBatchEach(policy)
    env = VectorEnv(count, scenes, episodes=episodes, sensors=batch.sensors, max_steps=60)
    heard = []
    found = run_episodes(env, batch, episodes, progress=lambda *step: heard.append(step[1:]))
    assert heard[-1] == (12, 12)
    for episode, got in zip(episodes, found, strict=True):
        scene = next(s for s in scenes if s.id == episode.scene_id)
        twin = open_simulator(scene, sensors=policy().sensors, max_steps=60)
        assert got == run_episode(twin, policy(), episode)


@pytest.mark.parametrize(
    ("mode", "sensors"),
    [
        ("prior", ("rgb", "depth", "occupancy", "goal_vector", "ranges", "pose")),
        ("explored", ("bev", "occupancy", "history", "goal_picture")),
    ],
)
def test_policies_see_the_same_bytes(mode: str, sensors: tuple[str, ...]) -> None:
    flat = build_room_scene()
    scenes = [replace(flat, id=name) for name in ("left", "right")]
    episodes = [
        e
        for s in scenes
        for e in build_point_episodes(s, NavigationMap(s.grid, 0.2), 2, agent=AgentSpec())
    ]
    env = VectorEnv(
        3, scenes, episodes=episodes, sensors=sensors, preset="vlnce", max_steps=5, map_mode=mode
    )
    found = run_episodes(env, PolicyBatchEach(lambda: PolicySeeing(*sensors)), episodes)
    for episode, got in zip(episodes, found, strict=True):
        scene = next(s for s in scenes if s.id == episode.scene_id)
        twin = open_simulator(scene, "vlnce", sensors=sensors, max_steps=5, map_mode=mode)
        assert got == run_episode(twin, PolicySeeing(*sensors), episode)


def test_it_says_what_is_wrong(plans) -> None:
    scenes, episodes = plans
    env = VectorEnv(2, scenes, episodes=episodes, sensors=())
    assert run_episodes(env, PolicyBatchEach(PolicyRandom), []) == []
    with pytest.raises(PolicyError, match=r"reads \['ranges'\]"):
        run_episodes(env, PolicyBatchEach(lambda: PolicySeeing("ranges")), episodes)

    class PolicyOdd(PolicySeeing):
        def __init__(self, answer) -> None:
            super().__init__()
            self.answer = answer

        def act(self, seen):
            return self.answer

    for answer, words in ((7, "not an action"), (Displacement(1, 0, 0), "local actions only")):
        with pytest.raises(PolicyError, match=words):
            run_episodes(env, PolicyBatchEach(lambda a=answer: PolicyOdd(a)), episodes)


def test_the_environment_can_be_used_again(plans) -> None:
    scenes, episodes = plans
    env = VectorEnv(2, scenes, episodes=episodes, sensors=(), max_steps=20)
    before = env.reset(seed=3)[1]["pose"]
    run_episodes(env, PolicyBatchEach(PolicyRandom), episodes[:3])
    import gymnasium

    with pytest.raises(gymnasium.error.ResetNeeded):
        env.step(np.array([1, 1]))
    np.testing.assert_array_equal(env.reset(seed=3)[1]["pose"], before)
