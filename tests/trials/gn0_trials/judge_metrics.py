"""The metrics page computed again by other means: the judge of `gn0.bench.metrics`.

It shares no code and no algorithm with what it judges: heaps and recursion in plain Python, written
from `docs/metrics.md` alone. A stranger's harness can be held against it as well.
"""

from __future__ import annotations

import heapq
import math
from collections.abc import Callable, Sequence
from functools import cache
from itertools import pairwise

import numpy as np

from gn0.bench.metrics import METRICS, compute_metrics
from gn0.geometry import Pose2D
from gn0.missions.episode import Episode, MissionGoal
from gn0.sim.state import Trajectory

SIDE, CELL = 12, 0.5  # cells a side of the random worlds; cell size [m]

Point = tuple[float, float]
Cell = tuple[int, int]


def judge_distances(free: Sequence[Sequence[bool]], goal: Cell, cell: float) -> dict[Cell, float]:
    """Octile distance [m] of every cell that can reach `goal`, no corner cutting (Dijkstra)."""
    best = {goal: 0.0}
    heap = [(0.0, goal)]
    while heap:
        far, (r, c) = heapq.heappop(heap)
        if far > best[(r, c)]:
            continue
        for dr in (-1, 0, 1):
            for dc in (-1, 0, 1):
                n = (r + dr, c + dc)
                if n == (r, c) or not (0 <= n[0] < len(free) and 0 <= n[1] < len(free[0])):
                    continue
                if not free[n[0]][n[1]]:
                    continue
                if dr and dc and not (free[r + dr][c] and free[r][c + dc]):
                    continue
                step = far + cell * math.sqrt(dr * dr + dc * dc)
                if step < best.get(n, math.inf):
                    best[n] = step
                    heapq.heappush(heap, (step, n))
    return best


def judge_dtw(path: Sequence[Point], reference: Sequence[Point]) -> float:
    """Dynamic time warping [m] by its recursive definition; for short paths only."""

    @cache
    def cost(i: int, j: int) -> float:
        here = math.dist(path[i], reference[j])
        before = [
            cost(a, b) for a, b in ((i - 1, j), (i, j - 1), (i - 1, j - 1)) if a >= 0 and b >= 0
        ]
        return here + min(before, default=0.0)

    return cost(len(path) - 1, len(reference) - 1)


def judge_metrics(
    positions: Sequence[Point],
    cut_short: Sequence[bool],
    stopped: bool,
    goal: Point,
    reference: Sequence[Point],
    geodesic: Callable[[Point], float],
    radius: float = 3.0,
) -> dict[str, float]:
    """Every metric of `docs/metrics.md` by its key, word for word.

    Args:
        positions: of the agent after reset and after each action [m].
        cut_short: which actions an obstacle cut short.
        stopped: whether the agent said STOP.
        goal: (x, y) [m].
        reference: reference path [m].
        geodesic: walking distance of a point to the goal [m].
        radius: success radius [m].
    """
    far = [geodesic(p) for p in positions]
    travelled = sum(math.dist(a, b) for a, b in pairwise(positions))
    moving = [p for i, p in enumerate(positions) if i == 0 or p != positions[i - 1]]
    success = 1.0 if stopped and far[-1] < radius else 0.0
    longest = max(far[0], travelled)
    ndtw = math.exp(-judge_dtw(moving, reference) / (len(reference) * radius))
    straight = math.dist(positions[-1], goal)
    steps = len(positions) - 1
    return {
        "SR": success,
        "SPL": success * (far[0] / longest if longest else 1.0),
        "OS": 1.0 if any(f < radius for f in far) else 0.0,
        "NE_geo": far[-1],
        "NE_euclid": straight,
        "nDTW": ndtw,
        "SDTW": success * ndtw,
        "SR_euclid": 1.0 if stopped and straight < radius else 0.0,
        "TL": travelled,
        "steps": float(steps),
        "collision_rate": sum(cut_short) / steps if steps else 0.0,
    }


def worst_disagreement(episodes: int, seed: int = 0) -> float:
    """Largest difference of any metric between us and the judge over random episodes.

    Each episode is a random walk (with turns on the spot and collisions) in a random little world,
    with a random goal and a random reference path.
    """
    rng = np.random.default_rng(seed)
    return max(_disagreement(rng) for _ in range(episodes))


def _disagreement(rng: np.random.Generator) -> float:
    free = (rng.random((SIDE, SIDE)) > 0.25).tolist()
    cells = [(r, c) for r in range(SIDE) for c in range(SIDE) if free[r][c]]
    goal_cell = cells[rng.integers(len(cells))]
    distance = judge_distances(free, goal_cell, CELL)
    inside = sorted(distance)

    def spot(cell: Cell) -> Point:
        return float((cell[1] + rng.random()) * CELL), float((cell[0] + rng.random()) * CELL)

    def geodesic(point: Point) -> float:
        return distance[int(point[1] // CELL), int(point[0] // CELL)]

    goal = spot(goal_cell)
    visited = [spot(inside[rng.integers(len(inside))]) for _ in range(rng.integers(1, 9))]
    positions = [p for p in visited for _ in range(rng.integers(1, 3))]  # turns on the spot
    reference = [spot(inside[rng.integers(len(inside))]) for _ in range(rng.integers(1, 7))]
    cut = [bool(hit) for hit in rng.random(len(positions) - 1) < 0.2]
    stopped = bool(rng.random() < 0.6)
    mission = MissionGoal(goal=goal, object_id="o", category="sofa", instruction="Go to the sofa.")
    episode = Episode(
        id="e", scene_id="s", mission=mission, start=(*reference[0], 0.0), path=tuple(reference)
    )
    trajectory = Trajectory(
        poses=tuple(Pose2D(x, y, 0.0) for x, y in positions),
        actions=(1,) * len(cut),
        collided=tuple(cut),
        stopped=stopped,
    )
    ours = compute_metrics(
        trajectory, episode, lambda points: np.array([geodesic((x, y)) for x, y in points])
    )
    judged = judge_metrics(positions, cut, stopped, goal, reference, geodesic)
    return max(abs(float(getattr(ours, m.field)) - judged[m.key]) for m in METRICS)
