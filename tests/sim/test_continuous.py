"""Continuous actions: one step of the body each, and many agents move as one does."""

from __future__ import annotations

import math

import gymnasium
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env, data_equivalence
from gymnasium.vector import AutoresetMode, SyncVectorEnv

import gn0
from gn0.device.host import DeviceHost
from gn0.errors import ConfigError, SimError
from gn0.maps.navigation import NavigationMap
from gn0.missions.episode import AgentSpec
from gn0.sim.continuous import read_action
from gn0.sim.device_env import VectorEnvDevice
from gn0.sim.env import ENVIRONMENTS, GoalNavEnv
from gn0.sim.kinematics import plan_journey
from gn0.sim.open import open_simulator
from gn0.sim.state import Action, Displacement
from gn0.sim.vector import VectorEnv
from gn0.testing.scenes import (
    build_floor_plan,
    build_map_scene,
    build_point_episodes,
    build_room_scene,
)

gn0.register_envs()
BODY = AgentSpec()


@pytest.fixture(scope="module")
def plan():
    scene = build_map_scene(build_floor_plan(0), "plan")
    return scene, build_point_episodes(scene, NavigationMap(scene.grid, 0.2), 8, seed=5)


def random_actions(rng, shape) -> np.ndarray:
    """Mostly ahead, so that walls are met; some out of bounds, some STOPs."""
    actions = rng.normal([0.8, 0.0, 0.0, -1.2], 0.8, (*shape, 4))
    actions[rng.random(shape) < 0.1, :3] = 0
    return actions.astype(np.float32)


@pytest.mark.parametrize("name", sorted(ENVIRONMENTS))
def test_every_id_takes_continuous_actions(name: str) -> None:
    made = gymnasium.make(name, action_space="continuous", preset="vlnce")
    check_env(made.unwrapped)
    made.close()


def test_an_action_costs_one_step_of_the_body(plan) -> None:
    """By the journey's own count, wherever it is taken; bounded by the step and the turn."""
    scene, episodes = plan
    simulator = open_simulator(scene, max_steps=10**6)
    simulator.reset(episodes[0])
    rng = np.random.default_rng(3)
    for action in random_actions(rng, (400,)):
        code = read_action(action, BODY)
        if code is Action.STOP:
            continue
        assert isinstance(code, Displacement)
        pose = simulator.pose
        assert plan_journey(pose, *code.at(pose), simulator.agent).steps == 1
        result = simulator.step(code)
        assert result.steps == 1
        assert result.moved <= BODY.forward_step + 1e-9
        assert abs(code.turn) <= math.radians(BODY.turn_degrees)


@pytest.mark.parametrize(
    ("action", "meaning"),
    [
        ((1, 0, 0, 0), (0.25, 0, 0)),
        ((0.5, 0.4, -0.4, 0), (0.125, 0, 0)),
        ((9, 0, 0, 0), (0.25, 0, 0)),
        ((0.02, 0, 0, 0), (0, 0, 0)),
        ((0.2, 0, 0.5, 0), (0, 0, math.radians(7.5))),
        ((0.2, -0.6, 0.5, 0), (0, 0, -math.radians(9))),
        ((-1, 0, 0, 0), (0, 0, 0)),
    ],
)
def test_a_body_goes_or_turns(action, meaning) -> None:
    assert read_action(np.array(action, np.float32), BODY) == pytest.approx(meaning, abs=1e-7)


def test_stop_is_said_by_the_fourth_number() -> None:
    assert read_action(np.array([1, 0, 0, 0.51]), BODY) is Action.STOP
    assert read_action(np.array([0, 0, 0, 0.5]), BODY) == Displacement(0, 0, 0)


@pytest.mark.parametrize("sliding", [False, True])
def test_many_move_as_one_does(plan, sliding: bool) -> None:
    """Observations, rewards, ends and infos of VectorEnv are GoalNavEnv's, to the bit."""
    scene, episodes = plan
    settings = {
        "episodes": episodes,
        "sensors": ("ranges", "goal_vector", "pose", "instruction_tokens"),
        "max_steps": 25,
        "agent": AgentSpec(sliding=sliding),
        "action_space": "continuous",
    }
    env = VectorEnv(5, scene, **settings)
    twin = SyncVectorEnv(
        [lambda: GoalNavEnv(scene, **settings)] * 5, autoreset_mode=AutoresetMode.SAME_STEP
    )
    assert env.single_observation_space == twin.single_observation_space
    assert env.action_space == twin.action_space
    assert data_equivalence(env.reset(seed=4)[0], twin.reset(seed=4)[0], exact=True)
    rng = np.random.default_rng(0)
    bumps = ends = 0
    for actions in random_actions(rng, (80, 5)):
        mine, theirs = env.step(actions), twin.step(actions)
        for a, b in zip(mine[:4], theirs[:4], strict=True):
            assert data_equivalence(a, b, exact=True)
        for key in ("pose", "distance_to_goal"):
            np.testing.assert_array_equal(mine[4][key], theirs[4][key])
        ended = mine[2] | mine[3]
        for i in np.flatnonzero(ended):
            assert data_equivalence(mine[4]["final_obs"][i], theirs[4]["final_obs"][i], exact=True)
        bumps += int(mine[0]["collided"].sum())
        ends += int(ended.sum())
    assert bumps > 20
    assert ends > 20


def test_pictures_are_drawn_where_a_continuous_agent_stands() -> None:
    settings = {
        "sensors": ("rgb", "history"), "preset": "vlnce", "action_space": "continuous",
    }  # fmt: skip
    scene = build_room_scene()
    env = VectorEnv(2, scene, **settings)
    twin = SyncVectorEnv([lambda: GoalNavEnv(scene, **settings)] * 2, autoreset_mode="SameStep")
    assert data_equivalence(env.reset(seed=4)[0], twin.reset(seed=4)[0], exact=True)
    for row in ([0.7, 0, 0, 0], [0, 0, -0.3, 0], [0.4, 0, 0.1, 0]):
        actions = np.array([row, [1, 0, 0, 0]], np.float32)
        assert data_equivalence(env.step(actions)[0], twin.step(actions)[0], exact=True)


def test_bad_continuous_actions_move_nobody(plan) -> None:
    scene, episodes = plan
    env = VectorEnv(2, scene, episodes=episodes, sensors=(), action_space="continuous")
    _, infos = env.reset(seed=0)
    good = [1.0, 0, 0, 0]
    for actions in ([1, 1], [good], [good, [1, 0, 0]], [good, [math.nan, 0, 0, 0]], ["a", "b"]):
        with pytest.raises(SimError, match="action"):
            env.step(actions)
    np.testing.assert_array_equal(env.batch.poses(), infos["pose"])
    one = GoalNavEnv(scene, episodes=episodes, sensors=(), action_space="continuous")
    one.reset(seed=0)
    for action in (1, [1.0], [math.inf, 0, 0, 0], None):
        with pytest.raises(SimError, match="action"):
            one.step(action)
    with pytest.raises(ConfigError, match="no action space 'fast'"):
        GoalNavEnv(scene, episodes=episodes, action_space="fast")


def test_a_device_says_that_it_takes_no_continuous_actions(plan) -> None:
    scene, episodes = plan
    settings = {"episodes": episodes, "device": DeviceHost()}
    with pytest.raises(ConfigError, match="continuous"):
        VectorEnvDevice(2, scene, action_space="continuous", **settings)
