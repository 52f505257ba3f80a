"""The yardsticks do what their docstrings say, and no more."""

from __future__ import annotations

import math

import msgspec
import numpy as np
import pytest

from gn0.policies.simple import PolicyRandom, PolicyStraight, PolicyWallFollower, sector_minimum
from gn0.seeds import random_stream
from gn0.sim.open import open_simulator
from gn0.sim.rollout import run_episode
from gn0.sim.state import Action, Observation
from gn0.testing.policy_check import check_policy
from gn0.testing.scenes import build_floor_plan, build_map_scene, build_point_episodes


def told(forward: float, left: float, collided: bool = False) -> Observation:
    return Observation(0, 0.0, "Go.", goal_vector=(forward, left), collided=collided)


def ringed(ahead: float, right: float, elsewhere: float = 3.0, step: int = 0) -> Observation:
    bearings = np.degrees(2 * np.pi * np.arange(72) / 72)
    ranges = np.full(72, elsewhere, np.float32)
    ranges[np.minimum(bearings, 360 - bearings) <= 20] = ahead
    ranges[np.abs(bearings - 270) <= 20] = right
    return Observation(step, 0.0, "Go.", ranges=ranges)


@pytest.fixture
def straight() -> PolicyStraight:
    policy = PolicyStraight()
    policy.reset("Go.", random_stream(0))
    return policy


@pytest.mark.parametrize("policy", [PolicyStraight, PolicyWallFollower, PolicyRandom])
def test_they_keep_the_contract(policy) -> None:
    check_policy(policy)


def test_straight_turns_walks_and_stops(straight) -> None:
    assert straight.act(told(1.0, 1.0)) == Action.LEFT
    assert straight.act(told(1.0, 0.1)) == Action.FORWARD
    straight.reset("Go.", random_stream(0))
    assert straight.act(told(1.0, -1.0)) == Action.RIGHT
    assert straight.act(told(0.2, 0.1)) == Action.STOP


def test_straight_never_turns_straight_back(straight) -> None:
    assert straight.act(told(-1.0, 0.01)) == Action.LEFT
    assert straight.act(told(-1.0, -0.01)) == Action.FORWARD


def test_a_bump_sends_straight_round_the_goal_s_side_then_the_other(straight) -> None:
    assert straight.act(told(2.0, 0.1)) == Action.FORWARD
    detour = [straight.act(told(2.0, 0.1, collided=i == 0)) for i in range(5)]
    assert detour == [Action.LEFT] * 3 + [Action.FORWARD] * 2
    detour = [straight.act(told(2.0, 0.1, collided=i == 0)) for i in range(6)]
    assert detour == [Action.RIGHT] * 4 + [Action.FORWARD] * 2


def test_straight_arrives_where_nothing_is_in_the_way(room_scene_open) -> None:
    simulator, episodes = room_scene_open
    for episode in episodes:
        trajectory = run_episode(simulator, PolicyStraight(), episode)
        end = trajectory.poses[-1]
        assert trajectory.stopped
        assert math.hypot(end.x - episode.goal[0], end.y - episode.goal[1]) <= 0.25


@pytest.fixture
def room_scene_open():
    grid = build_floor_plan(0, width=4.2, depth=4.2, clutter=0)
    scene = build_map_scene(grid, "hall")
    simulator = open_simulator(scene, sensors={"goal_vector"})
    return simulator, build_point_episodes(scene, simulator.navigation, 8, 3, minimum=1.0)


def test_the_follower_turns_from_walls_and_round_corners() -> None:
    policy = PolicyWallFollower(budget=10)
    policy.reset("Go.", random_stream(0))
    assert policy.act(ringed(3.0, 3.0)) == Action.FORWARD  # no wall met yet
    assert policy.act(ringed(0.2, 3.0)) == Action.LEFT
    assert policy.act(ringed(3.0, 0.3)) == Action.FORWARD
    assert policy.act(ringed(3.0, 2.0)) == Action.RIGHT  # the wall has ended
    assert policy.act(ringed(3.0, 2.0)) == Action.FORWARD
    assert policy.act(ringed(3.0, 0.02)) == Action.LEFT
    assert policy.act(ringed(3.0, 3.0, step=10)) == Action.STOP


def test_the_follower_goes_round_a_room_without_bumping() -> None:
    scene = build_map_scene(build_floor_plan(2), "plan")
    simulator = open_simulator(scene, sensors={"ranges"})
    for episode in build_point_episodes(scene, simulator.navigation, 4, 5):
        trajectory = run_episode(simulator, PolicyWallFollower(), episode)
        assert sum(trajectory.collided) <= 2
        xy = np.array(trajectory.poses)[:, :2]
        assert np.ptp(xy, axis=0).max() > 1.0


def test_sectors_wrap_and_coarse_rings_use_the_nearest_ray() -> None:
    ranges = np.array([1.0, 2.0, 3.0, 4.0], np.float32)
    assert sector_minimum(ranges, 0.0, 95.0) == 1.0
    assert sector_minimum(ranges, -90.0, 10.0) == 4.0
    assert sector_minimum(ranges, 80.0, 5.0) == 2.0
    assert sector_minimum(ranges, 180.0, 90.0) == 2.0


def test_random_draws_vlnce_s_shares() -> None:
    policy = PolicyRandom()
    policy.reset("Go.", random_stream(1))
    draws = [policy.act(told(0, 0)) for _ in range(20_000)]
    shares = np.bincount(draws, minlength=4) / len(draws)
    np.testing.assert_allclose(shares, policy.probabilities, atol=0.012)


def test_random_is_the_episode_s(room_scene_open) -> None:
    simulator, episodes = room_scene_open
    runs = [run_episode(simulator, PolicyRandom(), episodes[0]).actions for _ in range(2)]
    assert runs[0] == runs[1]
    other = msgspec.structs.replace(episodes[0], seed=77)
    assert run_episode(simulator, PolicyRandom(), other).actions != runs[0]
