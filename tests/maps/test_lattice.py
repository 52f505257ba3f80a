"""The action planner: exact on the lattice, equal to brute force, calm and close to the path."""

from __future__ import annotations

import itertools
import math
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from gn0.errors import ConfigError, PlanError
from gn0.geometry import Pose2D, polyline_length, wrap_angle
from gn0.maps.grid import OccupancyGrid
from gn0.maps.lattice import (
    ActionPlanner,
    LatticeCosts,
    LatticeProblem,
    discretize_path,
)
from gn0.maps.lattice_states import ROOT_POWERS
from gn0.maps.navigation import NavigationMap
from gn0.maps.ray import is_line_free
from gn0.maps.ros import load_ros_map
from gn0.paper import FORWARD, LEFT, RIGHT, STOP
from gn0.seeds import random_stream

STEP, TURN = 0.25, math.radians(15)


def curve(seed: int, length: float = 6.0) -> np.ndarray:
    """A smooth random curve that starts in the origin."""
    rng = random_stream(seed, "curve")
    steps = int(length / 0.05)
    bend = np.convolve(rng.normal(0, 0.5, steps), np.ones(15) / 15, "same")
    yaw = np.cumsum(bend * 0.35)
    return np.vstack([[0, 0], 0.05 * np.cumsum(np.column_stack([np.cos(yaw), np.sin(yaw)]), 0)])


def test_the_roots_of_unity_multiply_as_they_should():
    basis = np.exp(2j * np.pi * np.arange(8) / 24)
    np.testing.assert_allclose(ROOT_POWERS @ basis, np.exp(2j * np.pi * np.arange(24) / 24))
    assert np.abs(ROOT_POWERS).max() == 1


def brute_force(problem: LatticeProblem, pose: Pose2D, arc: float, last: int, horizon: int):
    """The least cost over all allowed sequences, walked in plain floats."""
    points, arcs = problem.points, problem.arcs
    costs = problem.costs
    low, high = arc - 0.5, arc + horizon * STEP + 0.5
    legs = problem.legs_between(low, high)

    def nearest(x, y):
        best = (math.inf, 0.0)
        for i in range(*legs):
            leg = points[i + 1] - points[i]
            t = min(max(float((np.array([x, y]) - points[i]) @ leg / (leg @ leg)), 0.0), 1.0)
            away = math.hypot(*(points[i] + t * leg - (x, y)))
            best = min(best, (away, arcs[i] + t * math.hypot(*leg)))
        return best

    best = math.inf
    away0, arc0 = nearest(pose.x, pose.y)

    def visit(x, y, k, away, s, before, cost, left):
        nonlocal best
        if left == 0:
            ahead = s + problem.look_ahead
            tx, ty = (np.interp(ahead, arcs, points[:, j]) for j in range(2))
            error = abs(wrap_angle(math.atan2(ty - y, tx - x) - pose.yaw - k * TURN))
            cost += costs.remaining * (arcs[-1] - s)
            cost += costs.heading * max(0.0, error - TURN / 2) / TURN
            best = min(best, cost)
            return
        for action in (FORWARD, LEFT, RIGHT):
            if {action, before} == {LEFT, RIGHT}:
                continue
            nx, ny, nk, nd, ns = x, y, k, away, s
            if action == FORWARD:
                nx += STEP * math.cos(pose.yaw + k * TURN)
                ny += STEP * math.sin(pose.yaw + k * TURN)
                if problem.move(x, y, nx, ny)[2]:
                    continue
                nd, ns = nearest(nx, ny)
            else:
                nk += 1 if action == LEFT else -1
            price = cost + costs.step + costs.turn * (action != FORWARD)
            price += costs.lateral * max(0.0, nd - costs.slack) ** 2
            price += costs.backward * min(0.0, ns - s) ** 2
            end = math.hypot(nx - points[-1, 0], ny - points[-1, 1])
            if action == FORWARD and end <= problem.stop_distance:
                best = min(best, price)
            else:
                visit(nx, ny, nk, nd, ns, action, price, left - 1)

    visit(pose.x, pose.y, 0, away0, arc0, last, 0.0, horizon)
    return best


@pytest.mark.parametrize("seed", range(10))
def test_the_plan_costs_what_brute_force_finds(seed):
    rng = random_stream(seed, "pose")
    path = curve(seed)[:: rng.integers(1, 20)]
    cells = (rng.random((160, 160)) < 0.004).astype(np.uint8)
    cells[78:82, 78:82] = 0
    walls = OccupancyGrid(cells, 0.1, (-8.0, -8.0)) if seed % 2 else None
    problem = LatticeProblem(path, is_move_free=walls)
    at = int(rng.integers(len(path))) if seed % 3 else 0
    pose = Pose2D(*(path[at] + rng.normal(0, 0.05, 2)), float(rng.uniform(-3, 3)))
    last = int(rng.integers(1, 4))
    actions, cost = problem.plan(pose, problem.arcs[at], last_action=last, horizon=6)
    truth = brute_force(problem, pose, problem.arcs[at], last, 6)
    assert cost == pytest.approx(truth, abs=1e-9)
    assert not any({a, b} == {LEFT, RIGHT} for a, b in pairwise([last, *actions]))


def test_a_straight_walk_sees_its_path_to_the_last_step():
    """A path of short legs, walked straight on: the last step still lies on it."""
    problem = LatticeProblem(np.column_stack([np.arange(0, 6, 0.05), np.zeros(120)]))
    actions, cost = problem.plan(Pose2D(0, 0, 0), 0.0, horizon=6)
    assert actions == [FORWARD] * 6
    assert cost == pytest.approx(brute_force(problem, Pose2D(0, 0, 0), 0.0, 1, 6), abs=1e-9)


def test_a_longer_horizon_and_the_programme_are_exact_where_states_merge():
    # LEFT×24 comes back to the start: without merging the count would be 3^16
    problem = LatticeProblem(curve(3))
    actions, cost = problem.plan(Pose2D(0, 0, 0), 0.0, horizon=12)
    assert len(actions) == 12 and cost < math.inf


def test_a_function_and_a_grid_give_the_same_plan():
    cells = np.zeros((80, 80), np.uint8)
    cells[40:44, 46] = 1
    grid = OccupancyGrid(cells, 0.1, (-4.0, -4.0))
    path = np.array([[0.0, 0.0], [3.0, 0.2]])

    def check(x0, y0, x1, y1):
        return is_line_free(grid, (x0, y0), (x1, y1))

    a = discretize_path(path, Pose2D(0, 0, 0.3), is_move_free=grid)
    b = discretize_path(path, Pose2D(0, 0, 0.3), is_move_free=check)
    assert a.actions == b.actions


@pytest.mark.parametrize("seed", range(12))
def test_curves_are_followed_closely_without_dithering(seed):
    path = curve(seed)
    walk = discretize_path(path, Pose2D(0.0, 0.0, 0.0))
    assert walk.actions[-1] == STOP and len(walk.actions) < 75
    assert math.hypot(*(walk.poses[-1, :2] - path[-1])) <= 0.15
    assert not any({a, b} == {LEFT, RIGHT} for a, b in pairwise(walk.actions))
    assert walk.travelled <= 1.03 * polyline_length(path) + 0.1
    away = np.hypot(*(walk.poses[:, None, :2] - path[None]).transpose(2, 0, 1)).min(axis=1)
    assert away.mean() < 0.05 and away.max() < 0.2


def test_the_programme_stays_closer_to_the_path_than_pursuit():
    away = {}
    for method in ("dp", "greedy"):
        away[method] = 0.0
        for seed in range(12):
            path = curve(seed)
            poses = discretize_path(path, Pose2D(0, 0, 0), method=method).poses
            apart = poses[:, None, :2] - path[None]
            away[method] += np.hypot(*apart.transpose(2, 0, 1)).min(axis=1).mean()
    assert away["dp"] < 0.8 * away["greedy"]


@pytest.fixture(scope="module")
def house(shared_data):
    grid = load_ros_map(shared_data / "worlds/small_house/maps/turtlebot3_waffle_pi/map.yaml")
    return NavigationMap(grid, 0.20)


def test_walks_through_a_real_house_are_short_and_free_of_collisions(house):
    centres = house.grid.centres_of(np.argwhere(house.regions == 0))
    rng = random_stream(0, "walks")
    spl, ratio = [], []
    while len(spl) < 15:
        start, goal = centres[rng.integers(len(centres), size=2)]
        field = house.geodesic(tuple(goal))
        shortest = field.distance_at(*start)
        if shortest < 5:
            continue
        pose = Pose2D(*start, float(rng.uniform(-3, 3)))
        walk = discretize_path(field.path(*start), pose, is_move_free=house)
        arrived = math.hypot(*(walk.poses[-1, :2] - goal)) <= 0.25
        spl.append(arrived * shortest / max(shortest, walk.travelled))
        ratio.append(walk.travelled / shortest)
        assert arrived and walk.collisions == 0
        assert all(house.is_free(x, y) for x, y, _ in walk.poses)
    assert np.mean(spl) >= 0.97
    assert max(ratio) <= 1.03


def test_a_truncated_move_does_not_confuse_the_planner(house):
    """The agent's own map is thinner than the world's: it bumps, and must still arrive."""
    blind = house.grid
    centres = house.grid.centres_of(np.argwhere(house.regions == 0))
    rng = random_stream(1, "walks")
    for _ in range(5):
        start, goal = centres[rng.integers(len(centres), size=2)]
        path = house.plan(tuple(start), tuple(goal))
        planner = ActionPlanner(path, is_move_free=blind)
        pose = Pose2D(*start, 0.0)
        for _ in range(400):
            action = planner.next_action(pose)
            if action == STOP:
                break
            if action == FORWARD:
                target = (
                    pose.x + STEP * math.cos(pose.yaw),
                    pose.y + STEP * math.sin(pose.yaw),
                )
                x, y, _ = house.move(pose.x, pose.y, *target)
                pose = Pose2D(x, y, pose.yaw)
            else:
                turn = TURN if action == LEFT else -TURN
                pose = Pose2D(pose.x, pose.y, wrap_angle(pose.yaw + turn))
        assert math.hypot(pose.x - goal[0], pose.y - goal[1]) <= 0.3


@settings(max_examples=25, deadline=None)
@given(st.floats(-3.1, 3.1), st.floats(-0.4, 0.4), st.sampled_from([15.0, 30.0, 45.0]))
def test_any_start_pose_comes_to_the_path_and_stops(yaw, offset, turn):
    path = np.array([[0.0, 0.0], [2.5, 0.0], [2.5, 2.0]])
    walk = discretize_path(path, Pose2D(0.0, offset, yaw), turn_degrees=turn, stop_distance=0.2)
    assert len(walk.actions) < 60
    assert math.hypot(walk.poses[-1, 0] - 2.5, walk.poses[-1, 1] - 2.0) <= 0.2


def test_a_sealed_agent_gives_up():
    cells = np.ones((9, 9), np.uint8)
    cells[4, 4] = 0
    grid = OccupancyGrid(cells, 0.1, (0.0, 0.0))
    path = np.array([[0.45, 0.45], [5.0, 0.45]])
    walk = discretize_path(path, Pose2D(0.45, 0.45, 0.0), is_move_free=grid)
    assert walk.actions[-1] == STOP and len(walk.actions) < 100
    np.testing.assert_allclose(walk.poses[:, :2], 0.45)


def test_a_path_of_one_point_is_stopped_at_once():
    walk = discretize_path(np.array([[1.0, 1.0]]), Pose2D(1.05, 1.0, 2.0))
    assert walk.actions == (STOP,)
    assert walk.travelled == 0


def test_the_end_of_a_loop_is_not_reached_at_its_start():
    angle = np.linspace(0, 2 * math.pi, 60)
    loop = np.column_stack([np.sin(angle), 1 - np.cos(angle)])
    planner = ActionPlanner(loop[:-1])
    planner.next_action(Pose2D(0.0, 0.0, 0.0))
    walk = discretize_path(loop[3:-1], Pose2D(*loop[3], 0.3))
    assert walk.travelled > 5.0


@pytest.mark.parametrize(
    ("kwargs", "message"),
    [
        ({"turn_degrees": 10.0}, "not on the lattice"),
        ({"step": 0.0}, "step 0"),
        ({"method": "magic"}, "method"),
        ({"horizon": 99}, "horizon"),
    ],
)
def test_settings_without_meaning_are_refused(kwargs, message):
    with pytest.raises(ConfigError, match=message):
        discretize_path(np.array([[0.0, 0.0], [1.0, 0.0]]), Pose2D(0, 0, 0), **kwargs)


def test_paths_and_poses_without_meaning_are_refused():
    for path in (np.empty((0, 2)), np.array([[0.0, math.nan]])):
        with pytest.raises(PlanError, match="path"):
            ActionPlanner(path)
    with pytest.raises(PlanError, match="pose"):
        ActionPlanner(np.zeros((1, 2))).next_action(Pose2D(math.nan, 0, 0))


def test_the_same_walk_again():
    walks = [discretize_path(curve(5), Pose2D(0, 0, 1.0), costs=LatticeCosts()) for _ in range(2)]
    assert walks[0].actions == walks[1].actions
    assert walks[0].poses.tobytes() == walks[1].poses.tobytes()


def test_brute_force_visits_the_allowed_sequences():
    allowed = [
        s
        for s in itertools.product((FORWARD, LEFT, RIGHT), repeat=6)
        if not any({a, b} == {LEFT, RIGHT} for a, b in pairwise(s))
    ]
    assert len(allowed) == 239
