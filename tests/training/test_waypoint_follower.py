"""Actions along waypoints: those of many are what the lattice's exact planner finds for one."""

from __future__ import annotations

import math

import numpy as np
import pytest

torch = pytest.importorskip("torch")

from gn0.paper import FORWARD, LEFT, RIGHT, STOP  # noqa: E402
from gn0.policies.bae.waypoint_plan import plan_along  # noqa: E402
from gn0.training.exams.waypoint_follower import WaypointFollower  # noqa: E402


def _draw_ways(count: int, seed: int) -> np.ndarray:
    """Smooth and jagged ways of twelve points, some to a goal near by, behind which all is it."""
    rng = np.random.default_rng(seed)
    bend = rng.normal(0, 0.35, (count, 12)).cumsum(1) * rng.random((count, 1))
    yaw = rng.uniform(-math.pi, math.pi, (count, 1)) * (rng.random((count, 1)) < 0.5) + bend
    step = 0.25 * rng.uniform(0.5, 1.2, (count, 12))
    ways = np.stack([step * np.cos(yaw), step * np.sin(yaw)], -1).cumsum(1)
    for way, last in zip(ways[::3], rng.integers(0, 12, count), strict=False):
        way[last:] = way[last]
    return ways


def test_many_agents_get_the_plans_of_the_exact_planner() -> None:
    ways = _draw_ways(600, 5)
    found = WaypointFollower("cpu").plan(torch.from_numpy(ways)).numpy()
    wanted = np.array([plan_along(way) for way in ways])
    # but for plans whose costs float32 does not tell apart
    assert (found != wanted).any(1).sum() <= 3
    assert {FORWARD, LEFT, RIGHT, STOP} == set(found.flat)


@pytest.mark.parametrize("plan", [plan_along, lambda way: WaypointFollower("cpu").plan(
    torch.tensor(np.array(way))[None]
)[0].tolist()], ids=["one", "many"])  # fmt: skip
def test_plain_ways_are_walked_as_anybody_would(plan) -> None:  # type: ignore[no-untyped-def]
    ahead = np.stack([np.arange(1, 13) * 0.25, np.zeros(12)], -1)
    assert plan(ahead) == [FORWARD] * 6
    assert plan(np.minimum(ahead, 0.5)) == [FORWARD] * 2 + [STOP] * 4
    assert plan(0 * ahead) == [STOP] * 6
    left = ahead[:, ::-1]  # 90°: six turns
    assert plan(left) == [LEFT] * 6
    assert plan(-left) == [RIGHT] * 6
