"""The pose search against brute force, and its promises on random maps."""

from __future__ import annotations

import itertools
import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from gn0.errors import PlanError
from gn0.maps.grid import OccupancyGrid
from gn0.maps.navigation import NavigationMap
from gn0.maps.pose_astar import WEIGHTS, plan_actions
from gn0.paper import FORWARD, LEFT, RIGHT

TURN_COST = 0.02


def cycle(yaw: float, count: int = 24) -> list[float]:
    return [yaw + 2 * math.pi * k / count for k in range(count)]


def replay(
    navigation: NavigationMap,
    start: tuple[float, float],
    yaws: list[float],
    plan: list[int],
    step: float = 0.25,
) -> tuple[float, float] | None:
    """Where a plan ends; None when a move is cut."""
    (x, y), k = start, 0
    for action in plan:
        if action == FORWARD:
            nx, ny = x + step * math.cos(yaws[k]), y + step * math.sin(yaws[k])
            x, y, hit = navigation.move(x, y, nx, ny)
            if hit:
                return None
        else:
            k = (k + (1 if action == LEFT else -1)) % len(yaws)
    return x, y


def cost(plan: list[int]) -> float:
    return sum(0.25 if a == FORWARD else TURN_COST for a in plan)


def noise_map(seed: int, density: float) -> NavigationMap:
    rng = np.random.default_rng(seed)
    cells = (rng.random((40, 40)) < density).astype(np.uint8)
    return NavigationMap(OccupancyGrid(cells, 0.1, (-2.0, 3.0)), 0.1)


def two_points(navigation: NavigationMap, seed: int) -> tuple[tuple[float, float], ...] | None:
    """A start and a goal in the largest region, off the centres of their cells."""
    rng = np.random.default_rng(seed)
    free = np.argwhere(navigation.regions == 0)
    if len(free) < 20:
        return None
    points = navigation.grid.centres_of(free[rng.integers(len(free), size=2)])
    points += rng.uniform(-0.04, 0.04, (2, 2))
    return tuple((float(x), float(y)) for x, y in points)


@settings(max_examples=120, deadline=None)
@given(st.integers(0, 2**32), st.floats(0.0, 0.3), st.floats(-3.1, 3.1))
def test_a_plan_replays_to_the_goal(seed: int, density: float, yaw: float) -> None:
    navigation = noise_map(seed, density)
    pair = two_points(navigation, seed)
    if pair is None:
        return
    start, goal = pair
    field = navigation.geodesic(goal)
    try:
        plan = plan_actions(field, start, cycle(yaw)).tolist()
    except PlanError:
        return  # a pocket that 0.25 m steps cannot enter
    end = replay(navigation, start, cycle(yaw), plan)
    assert end is not None
    assert math.dist(end, goal) <= 0.25
    assert field.distance_at(*end) <= 0.25 + 1e-9
    assert not any(
        {a, b} == {LEFT, RIGHT} for a, b in itertools.pairwise(plan)
    )  # no turn is taken back
    assert not plan or plan[-1] == FORWARD


@pytest.mark.parametrize("seed", range(12))
def test_no_short_sequence_is_cheaper(seed: int) -> None:
    """Brute force over all sequences of up to seven actions."""
    navigation = noise_map(seed, 0.04)
    rng = np.random.default_rng(seed + 1000)
    pair = two_points(navigation, seed)
    assert pair is not None
    start, _ = pair
    yaws = cycle(float(rng.uniform(-3, 3)), 12)
    reachable: dict[tuple[int, ...], tuple[float, float]] = {}
    for length in range(1, 8):
        for plan in itertools.product((FORWARD, LEFT, RIGHT), repeat=length):
            if plan[-1] == FORWARD:
                end = replay(navigation, start, yaws, list(plan))
                if end is not None:
                    reachable[plan] = end
    ends = list(reachable.values())
    for _ in range(5):
        goal = ends[int(rng.integers(len(ends)))]
        near = [
            p
            for p, end in reachable.items()
            if math.dist(end, goal) <= 0.1 and not navigation.move(*end, *goal)[2]
        ]
        best = min(map(cost, near), default=math.inf)
        field = navigation.geodesic(goal)
        plan = plan_actions(field, start, yaws, tolerance=0.1, turn_cost=TURN_COST).tolist()
        # merging in sub-cells may cost a turn or two; the weight bounds the rest
        assert cost(plan) <= best * WEIGHTS[0] + 2 * TURN_COST + 1e-9


def test_open_ground_is_walked_at_its_length() -> None:
    navigation = NavigationMap(OccupancyGrid(np.zeros((200, 200), np.uint8), 0.05, (0, 0)), 0.2)
    field = navigation.geodesic((8.0, 7.0))
    for yaw in np.linspace(-3, 3, 9):
        plan = plan_actions(field, (1.0, 1.0), cycle(float(yaw)))
        length = 0.25 * (plan == FORWARD).sum()
        needed = math.dist((1, 1), (8, 7)) - 0.25
        # 15 degree headings cost at most 1 / cos 7.5 degrees; the last step may overshoot
        assert length <= needed / math.cos(math.radians(7.5)) * WEIGHTS[0] + 0.25
        assert (plan != FORWARD).sum() <= 12 + 3  # face it, then correct a few times


def test_the_same_question_has_the_same_answer() -> None:
    navigation = noise_map(5, 0.08)
    start, goal = two_points(navigation, 5) or ((0, 0), (0, 0))
    plans = {plan_actions(navigation.geodesic(goal), start, cycle(0.4)).tobytes() for _ in "abc"}
    assert len(plans) == 1


def test_nothing_to_do_is_an_empty_plan() -> None:
    navigation = noise_map(0, 0.0)
    assert len(plan_actions(navigation.geodesic((0.0, 5.0)), (0.1, 5.0), cycle(0.0))) == 0


def test_behind_a_thin_wall_is_not_near() -> None:
    cells = np.zeros((60, 60), np.uint8)
    cells[:50, 30] = 1
    navigation = NavigationMap(OccupancyGrid(cells, 0.05, (0, 0)), 0.0)
    start, goal = (1.45, 0.5), (1.6, 0.5)  # 0.15 m apart, with the wall between them
    plan = plan_actions(navigation.geodesic(goal), start, cycle(1.0))
    assert 0.25 * (plan == FORWARD).sum() > 3.0


def test_a_plan_ends_in_sight_of_the_goal() -> None:
    """Both sides of one blocked cell of 5 cm: near as the crow flies and on foot, but not seen."""
    cells = np.zeros((40, 40), np.uint8)
    cells[20, 20] = 1
    navigation = NavigationMap(OccupancyGrid(cells, 0.05, (0, 0)), 0.0)
    start, goal = (1.125, 1.025), (0.925, 1.025)
    assert navigation.geodesic(goal).distance_at(*start) < 0.22
    plan = plan_actions(navigation.geodesic(goal), start, cycle(2.0), step=0.1)
    assert len(plan) > 0
