"""Metrics against an implementation that shares no code, no algorithm and no library with ours."""

from __future__ import annotations

import heapq
import math
from functools import cache
from itertools import pairwise
from pathlib import Path

import msgspec
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from gn0.bench.metrics import METRICS, compute_metrics, dynamic_time_warping
from gn0.errors import EpisodeError
from gn0.geometry import Pose2D
from gn0.missions.episode import Episode, MissionGoal
from gn0.sim.state import Trajectory

SIDE = 12  # cells a side of the little worlds below, 0.5 m each
CELL = 0.5


def dijkstra(free: list[list[bool]], goal: tuple[int, int]) -> dict[tuple[int, int], float]:
    """Octile distance [m] of every reachable cell to the goal, with a heap and plain Python."""
    best = {goal: 0.0}
    heap = [(0.0, goal)]
    while heap:
        far, (r, c) = heapq.heappop(heap)
        if far > best[(r, c)]:
            continue
        for dr in (-1, 0, 1):
            for dc in (-1, 0, 1):
                n = (r + dr, c + dc)
                if (dr, dc) == (0, 0) or not (0 <= n[0] < SIDE and 0 <= n[1] < SIDE):
                    continue
                if not free[n[0]][n[1]]:
                    continue
                if dr and dc and not (free[r + dr][c] and free[r][c + dc]):
                    continue
                step = far + CELL * math.sqrt(dr * dr + dc * dc)
                if step < best.get(n, math.inf):
                    best[n] = step
                    heapq.heappush(heap, (step, n))
    return best


def slow_dtw(p: list[tuple[float, float]], q: list[tuple[float, float]]) -> float:
    """DTW by its recursive definition."""

    @cache
    def cost(i: int, j: int) -> float:
        here = math.dist(p[i], q[j])
        if i == 0 and j == 0:
            return here
        before = [
            cost(a, b) for a, b in ((i - 1, j), (i, j - 1), (i - 1, j - 1)) if a >= 0 and b >= 0
        ]
        return here + min(before)

    return cost(len(p) - 1, len(q) - 1)


def slow_metrics(
    poses: list[tuple[float, float]],
    hits: list[bool],
    stopped: bool,
    goal: tuple[float, float],
    reference: list[tuple[float, float]],
    distance: dict[tuple[int, int], float],
    radius: float = 3.0,
) -> dict[str, float]:
    """The metrics page, word for word."""
    far = [distance.get((int(y // CELL), int(x // CELL)), math.inf) for x, y in poses]
    tl = sum(math.dist(a, b) for a, b in pairwise(poses))
    moving = [p for i, p in enumerate(poses) if i == 0 or p != poses[i - 1]]
    sr = 1.0 if stopped and far[-1] < radius else 0.0
    longest = max(far[0], tl)
    ndtw = math.exp(-slow_dtw(moving, reference) / (len(reference) * radius))
    straight = math.dist(poses[-1], goal)
    return {
        "SR": sr,
        "SPL": sr * (far[0] / longest if longest else 1.0),
        "OS": 1.0 if any(f < radius for f in far) else 0.0,
        "NE_geo": far[-1],
        "NE_euclid": straight,
        "nDTW": ndtw,
        "SDTW": sr * ndtw,
        "SR_euclid": 1.0 if stopped and straight < radius else 0.0,
        "TL": tl,
        "steps": float(len(poses) - 1),
        "collision_rate": sum(hits) / (len(poses) - 1) if len(poses) > 1 else 0.0,
    }


def episode_of(goal: tuple[float, float], reference: list[tuple[float, float]]) -> Episode:
    mission = MissionGoal(goal=goal, object_id="o", category="sofa", instruction="Go to the sofa.")
    return Episode(
        id="e", scene_id="s", mission=mission, start=(*reference[0], 0.0), path=tuple(reference)
    )


def random_case(rng: np.random.Generator) -> float:
    """One random episode in a random little world; the largest difference of any metric."""
    free = (rng.random((SIDE, SIDE)) > 0.25).tolist()
    cells = [(r, c) for r in range(SIDE) for c in range(SIDE) if free[r][c]]
    goal_cell = cells[rng.integers(len(cells))]
    distance = dijkstra(free, goal_cell)
    inside = sorted(distance)

    def spot(cell: tuple[int, int]) -> tuple[float, float]:
        x, y = (cell[1] + rng.random()) * CELL, (cell[0] + rng.random()) * CELL
        return float(x), float(y)

    goal = spot(goal_cell)
    poses = [spot(inside[rng.integers(len(inside))]) for _ in range(rng.integers(1, 9))]
    poses = [p for p in poses for _ in range(rng.integers(1, 3))]  # turns: the same place twice
    reference = [spot(inside[rng.integers(len(inside))]) for _ in range(rng.integers(1, 7))]
    hits = [bool(h) for h in rng.random(len(poses) - 1) < 0.2]
    stopped = bool(rng.random() < 0.6)

    def lookup(points: np.ndarray) -> np.ndarray:
        return np.array([distance[int(y // CELL), int(x // CELL)] for x, y in points])

    trajectory = Trajectory(
        poses=tuple(Pose2D(x, y, 0.0) for x, y in poses),
        actions=tuple(1 for _ in hits),
        collided=tuple(hits),
        stopped=stopped,
    )
    ours = compute_metrics(trajectory, episode_of(goal, reference), lookup)
    judged = slow_metrics(poses, hits, stopped, goal, reference, distance)
    return max(abs(float(getattr(ours, m.field)) - judged[m.key]) for m in METRICS)


def test_ten_thousand_random_episodes_agree_to_1e_9() -> None:
    rng = np.random.default_rng(20261121)
    worst = max(random_case(rng) for _ in range(10_000))
    assert worst <= 1e-9


@given(st.lists(st.tuples(*[st.floats(-50, 50)] * 2), min_size=1, max_size=7),
       st.lists(st.tuples(*[st.floats(-50, 50)] * 2), min_size=1, max_size=7))  # fmt: skip
@settings(deadline=None, max_examples=200)
def test_dtw_is_the_recursive_definition(
    p: list[tuple[float, float]], q: list[tuple[float, float]]
) -> None:
    assert dynamic_time_warping(np.array(p), np.array(q)) == pytest.approx(slow_dtw(p, q), abs=1e-9)


def walk(*points: tuple[float, float], stopped: bool = True) -> Trajectory:
    poses = tuple(Pose2D(x, y, 0.0) for x, y in points)
    n = len(poses) - 1
    return Trajectory(poses=poses, actions=(1,) * n, collided=(False,) * n, stopped=stopped)


def straight_line(points: np.ndarray) -> np.ndarray:
    return np.hypot(points[:, 0] - 10.0, points[:, 1])


GOAL = episode_of((10.0, 0.0), [(0.0, 0.0), (10.0, 0.0)])


def test_the_success_radius_is_strict() -> None:
    assert compute_metrics(walk((0, 0), (7.0001, 0)), GOAL, straight_line).success
    edge = compute_metrics(walk((0, 0), (7.0, 0)), GOAL, straight_line)
    assert not edge.success and not edge.oracle_success and not edge.success_euclid


def test_running_out_of_steps_is_no_success_but_may_be_an_oracle_success() -> None:
    m = compute_metrics(walk((0, 0), (9.9, 0), stopped=False), GOAL, straight_line)
    assert (m.success, m.oracle_success, m.spl, m.sdtw) == (False, True, 0.0, 0.0)


def test_stopping_in_the_goal_itself_is_a_success() -> None:
    m = compute_metrics(walk((10, 0)), GOAL, straight_line)
    assert (m.success, m.spl, m.steps, m.collision_rate) == (True, 1.0, 0, 0.0)


def test_a_shortcut_never_lifts_spl_above_one() -> None:
    assert compute_metrics(walk((0, 0), (9.0, 0)), GOAL, straight_line).spl == 1.0


def test_a_wall_between_makes_the_two_errors_differ() -> None:
    m = compute_metrics(walk((0, 0), (9.0, 0)), GOAL, lambda p: straight_line(p) + 8.0)
    assert m.success_euclid and not m.success
    assert (m.navigation_error_euclid, m.navigation_error_geodesic) == (1.0, 9.0)


@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf])
def test_a_pose_that_is_not_finite_makes_the_episode_invalid(bad: float) -> None:
    for pose in ((bad, 0.0), (0.0, bad)):
        with pytest.raises(EpisodeError, match="pose after action 1 is not finite"):
            compute_metrics(walk((0, 0), pose), GOAL, straight_line)


def test_an_unreachable_goal_is_never_averaged() -> None:
    with pytest.raises(EpisodeError, match="no way to the goal"):
        compute_metrics(walk((0, 0), (1, 0)), GOAL, lambda p: np.full(len(p), np.inf))


def test_poses_and_actions_must_match() -> None:
    broken = Trajectory(poses=(Pose2D(0, 0, 0),), actions=(1,), collided=(False,), stopped=True)
    with pytest.raises(EpisodeError, match="1 poses for 1 actions"):
        compute_metrics(broken, GOAL, straight_line)


def test_every_metric_is_on_the_page_and_every_row_of_the_page_is_a_metric() -> None:
    page = Path(__file__).resolve().parents[2] / "docs" / "metrics.md"
    table = page.read_text().split("## What comes out")[1].split("##")[0]
    keys = [line.split("`")[1] for line in table.splitlines() if line.startswith("| `")]
    assert keys == [info.key for info in METRICS]
    fields = {
        f.name
        for f in msgspec.structs.fields(type(compute_metrics(walk((0, 0)), GOAL, straight_line)))
    }
    assert {info.field for info in METRICS} <= fields
