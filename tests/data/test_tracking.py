"""The paper's tracking objective: exact against brute force, and never a spin on the spot."""

from __future__ import annotations

import itertools
import math

import numpy as np
import pytest

from gn0.data.expert_labels import LabelSettings, label_states, walk_actions
from gn0.data.tracking import GUARD, actions_left, plan_tracking
from gn0.errors import ConfigError
from gn0.maps.grid import OccupancyGrid
from gn0.maps.navigation import NavigationMap
from gn0.missions.episode import AgentSpec
from gn0.scenes.example import build_example_scene

AGENT = AgentSpec()
GAMMA = 0.95
TURN = math.radians(15)


def distance_to(way: np.ndarray, point: np.ndarray) -> tuple[float, float]:
    """Distance [m] of a point to a polyline, and the arc [m] of the nearest place."""
    best, arc, before = math.inf, 0.0, 0.0
    for a, b in itertools.pairwise(way):
        length = float(np.hypot(*(b - a)))
        t = min(max(float((point - a) @ (b - a)) / length**2, 0.0), 1.0)
        away = float(np.hypot(*(a + t * (b - a) - point)))
        if away < best - 1e-12:
            best, arc = away, before + t * length
        before += length
    return best, arc


def judge(
    navigation: NavigationMap, pose: np.ndarray, way: np.ndarray, actions: tuple[int, ...]
) -> tuple[float, int, float] | None:
    """Literal objective, turns and φ of a sequence; None where it may not be."""
    if any(a + b == 5 for a, b in itertools.pairwise(actions)):
        return None
    poses, cut = walk_actions(navigation, AGENT, pose, np.array(actions))
    if cut.any():
        return None
    cost = sum(GAMMA ** (k + 1) * distance_to(way, poses[k + 1, :2])[0] ** 2 for k in range(6))
    arcs = np.r_[0.0, np.cumsum(np.hypot(*np.diff(way, axis=0).T))]
    _, arc = distance_to(way, poses[-1, :2])
    left = actions_left(poses[-1:, :2], poses[-1:, 2], np.array([arc]), way, arcs, 0.25, TURN)
    return cost, sum(a > 1 for a in actions), float(left[0])


def test_the_search_finds_the_best_of_all_sequences() -> None:
    """All 3⁶ sequences, by the objective as it is written down, with the same guard."""
    navigation = NavigationMap(build_example_scene().grid, 0.2)
    rng = np.random.default_rng(0)
    free = np.argwhere(navigation.regions == 0)
    for _ in range(25):
        place = navigation.grid.centre_of(*free[rng.integers(len(free))].tolist())
        goal = navigation.grid.centre_of(*free[rng.integers(len(free))].tolist())
        pose = np.array([*place, rng.uniform(-3, 3)])
        labels = label_states(navigation, goal, pose[None])
        if labels.valid[0] < 13:
            continue
        ahead = labels.waypoints[0].astype(float)
        c, s = math.cos(pose[2]), math.sin(pose[2])
        way = ahead @ np.array([[c, s], [-s, c]]) + pose[:2]
        plan = plan_tracking(
            navigation.inflated, tuple(pose), ahead, stop_distance=0.0, horizon=6, discount=GAMMA
        )
        judged = {
            actions: found
            for actions in itertools.product((1, 2, 3), repeat=6)
            if (found := judge(navigation, pose, way, actions)) is not None
        }
        quickest = min(left for _, _, left in judged.values())
        admitted = [f for f in judged.values() if f[2] <= quickest + GUARD + 1e-9]
        best = min(cost for cost, _, _ in admitted)
        mine = judged[tuple(plan)]
        assert mine[0] <= best + 1e-9
        assert mine[2] <= quickest + GUARD + 1e-6


def test_a_discount_says_how_much_later_states_count() -> None:
    """A way that bends at once and back: who counts the first states most stays nearer to it."""
    grid = OccupancyGrid(np.zeros((80, 80), np.uint8), 0.1, (-4.0, -4.0))
    way = np.array([[0.0, 0.0], [0.3, 0.3], [0.6, 0.0], [2.0, 0.0]])
    plans = {
        discount: [
            plan_tracking(
                grid, (0.0, 0.0, yaw), way @ np.array([[c, -s], [s, c]]),
                stop_distance=0.0, discount=discount,
            )
            for yaw in np.linspace(-1.0, 1.0, 9)
            for c, s in [(math.cos(yaw), math.sin(yaw))]
        ]
        for discount in (0.05, 1.0)
    }  # fmt: skip
    assert plans[0.05] != plans[1.0]


def test_the_literal_objective_would_spin_and_the_guard_does_not() -> None:
    """On a way that no heading of the lattice meets exactly, turning for ever costs nothing."""
    navigation = NavigationMap(OccupancyGrid(np.zeros((80, 80), np.uint8), 0.1, (0.0, 0.0)), 0.1)
    pose = np.array([1.0, 4.0, math.radians(7)])
    way = np.array([[1.0, 4.0], [6.0, 4.0]])
    spin = judge(navigation, pose, way, (2, 2, 2, 2, 2, 2))
    walk = judge(navigation, pose, way, (1, 1, 1, 1, 1, 1))
    assert spin is not None and walk is not None
    assert spin[0] < 1e-20 < walk[0]
    labels = label_states(
        navigation, (6.0, 4.0), pose[None], LabelSettings(variant="mpc", discount=GAMMA)
    )
    assert (labels.actions6[0] == 1).sum() >= 4


def test_six_actions_at_a_time_lead_to_the_goal_and_stop() -> None:
    navigation = NavigationMap(build_example_scene().grid, 0.2)
    rng = np.random.default_rng(3)
    free = np.argwhere(navigation.regions == 0)
    rules = LabelSettings(variant="mpc")
    for _ in range(12):
        cells = free[rng.integers(len(free), size=2)]
        place, goal = navigation.grid.centres_of(cells)
        state = np.array([*place, rng.uniform(-3, 3)])
        for _ in range(60):
            ahead = label_states(navigation, (goal[0], goal[1]), state[None], rules).actions6[0]
            stops = np.flatnonzero(ahead == 0)
            poses, cut = walk_actions(
                navigation, AGENT, state, ahead[: stops[0]] if len(stops) else ahead
            )
            assert not cut.any()
            state = poses[-1]
            if len(stops):
                break
        assert len(stops)
        assert navigation.geodesic((goal[0], goal[1])).distance_at(*state[:2]) <= 0.25


def test_turns_off_the_lattice_are_refused() -> None:
    grid = OccupancyGrid(np.zeros((20, 20), np.uint8), 0.1, (0.0, 0.0))
    with pytest.raises(ConfigError, match="lattice"):
        plan_tracking(grid, (1.0, 1.0, 0.0), np.array([[0, 0], [1, 0]]), stop_distance=0.1,
                      turn_degrees=10.0)  # fmt: skip
    assert plan_tracking(grid, (1.0, 1.0, 0.0), np.zeros((1, 2)), stop_distance=0.1) == []
