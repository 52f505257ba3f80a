"""Metrics of one episode. `docs/metrics.md` defines them; this module implements that page.

A value that is not finite is never repaired and never averaged: the episode is invalid, and says
why. Metrics read the trajectory, the episode and a geodesic distance; nothing else.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import msgspec
import numpy as np
from numpy.typing import NDArray

from gn0.errors import EpisodeError
from gn0.geometry import F64, polyline_length
from gn0.jit import njit
from gn0.missions.episode import Episode
from gn0.paper import SUCCESS_RADIUS
from gn0.sim.state import Trajectory

# geodesic distance to the goal [m] of points [N, 2] m, +inf where there is no way
DistanceToGoal = Callable[[F64], NDArray[np.floating]]


class EpisodeMetrics(msgspec.Struct, frozen=True, kw_only=True):
    """What one episode scored.

    Attributes:
        steps: steps taken, STOP included: one an action, a move of any length those of walking it.
        trajectory_length: TL, sum of the distances between successive poses [m].
        shortest_length: geodesic distance from start to goal [m].
        navigation_error_euclid: straight distance from the last pose to the goal [m] (the paper's).
        navigation_error_geodesic: walking distance from the last pose to the goal [m]. Of a goal
            set, all distances are to its nearest place.
        success: the agent said STOP at a geodesic distance < 3.0 m; of a goal that is an area,
            inside it.
        success_euclid: the agent said STOP at a straight distance < 3.0 m; an area: as `success`.
        oracle_success: the geodesic distance was < 3.0 m at any pose, or a pose inside the area.
        spl: success · shortest / max(shortest, TL), Anderson et al. 2018.
        ndtw: exp(−DTW / (|reference| · 3.0 m)), Ilharco et al. 2019.
        sdtw: success · nDTW.
        collisions: actions that an obstacle cut short.
        collision_rate: collisions / steps, a cut move being one; 0 when there was no step.
    """

    steps: int
    trajectory_length: float
    shortest_length: float
    navigation_error_euclid: float
    navigation_error_geodesic: float
    success: bool
    success_euclid: bool
    oracle_success: bool
    spl: float
    ndtw: float
    sdtw: float
    collisions: int
    collision_rate: float


class MetricInfo(msgspec.Struct, frozen=True, kw_only=True):
    """How a metric is named and shown.

    Attributes:
        key: name in `summary.json` and in tables.
        field: field of `EpisodeMetrics`.
        title: one line for people.
        unit: "m", "%" or "".
        better: "up", "down" or "" where neither is better.
    """

    key: str
    field: str
    title: str
    unit: str
    better: str


METRICS: tuple[MetricInfo, ...] = tuple(
    MetricInfo(key=key, field=field, title=title, unit=unit, better=better)
    for key, field, title, unit, better in (
        ("SR", "success", "success: STOP within 3 m walking distance", "%", "up"),
        ("SPL", "spl", "success weighted by path length", "%", "up"),
        ("OS", "oracle_success", "oracle success: ever within 3 m", "%", "up"),
        ("NE_geo", "navigation_error_geodesic", "walking distance left at the end", "m", "down"),
        ("NE_euclid", "navigation_error_euclid", "straight distance left (the paper's)", "m",
         "down"),
        ("nDTW", "ndtw", "agreement with the reference path", "%", "up"),
        ("SDTW", "sdtw", "nDTW where successful, else 0", "%", "up"),
        ("SR_euclid", "success_euclid", "success by straight distance", "%", "up"),
        ("TL", "trajectory_length", "trajectory length", "m", ""),
        ("steps", "steps", "steps taken", "", ""),
        ("collision_rate", "collision_rate", "share of steps cut short", "%", "down"),
    )
)  # fmt: skip

TOUCHED = MetricInfo(
    key="CR", field="touches", title="episodes in which a move met a person", unit="%",
    better="down",
)  # fmt: skip
"""Of runs with people, beside the others; in `EpisodeResult.touches`, as a walk does not tell."""


@njit
def _dtw(path: F64, reference: F64) -> float:  # [N, 2], [M, 2] m
    n, m = len(path), len(reference)
    row = np.full(m + 1, np.inf)
    row[0] = 0.0
    for i in range(n):
        diagonal = row[0]
        row[0] = np.inf
        for j in range(m):
            dx = path[i, 0] - reference[j, 0]
            dy = path[i, 1] - reference[j, 1]
            best = min(diagonal, row[j + 1], row[j])
            diagonal = row[j + 1]
            row[j + 1] = math.sqrt(dx * dx + dy * dy) + best
    return row[m]


def dynamic_time_warping(path: NDArray[np.floating], reference: NDArray[np.floating]) -> float:
    """Exact DTW cost [m] between two polylines [N, 2] and [M, 2], Euclidean point distance."""
    a = np.ascontiguousarray(path, np.float64).reshape(-1, 2)
    b = np.ascontiguousarray(reference, np.float64).reshape(-1, 2)
    return float(_dtw(a, b))


def without_repeats(points: NDArray[np.floating]) -> F64:
    """Points [N, 2] without those equal to their predecessor: turning adds no position."""
    p = np.asarray(points, np.float64).reshape(-1, 2)
    if len(p) < 2:
        return p
    keep = np.r_[True, (np.diff(p, axis=0) != 0).any(axis=1)]
    return p[keep]


def compute_metrics(
    trajectory: Trajectory,
    episode: Episode,
    distance_to_goal: DistanceToGoal,
    *,
    success_radius: float = SUCCESS_RADIUS,
) -> EpisodeMetrics:
    """Score a trajectory.

    Args:
        trajectory: poses after reset and after each action.
        episode: goal and reference path, world frame [m].
        distance_to_goal: geodesic distance [m] of points [N, 2].
        success_radius: [m], strictly less counts as success; a goal set may have its own.

    Raises:
        EpisodeError: a pose or a metric is not finite; the episode counts as invalid.
    """
    where = f"episode {episode.id!r}"
    positions = np.array([(pose.x, pose.y) for pose in trajectory.poses], np.float64)
    if not len(positions) or len(trajectory.actions) != len(positions) - 1:
        raise EpisodeError(
            f"{len(positions)} poses for {len(trajectory.actions)} actions, expected one more",
            where=where,
            remedy="a trajectory holds the start pose and one pose per action",
        )
    bad = [i for i, pose in enumerate(trajectory.poses) if not pose.is_finite()]
    if bad:
        raise EpisodeError(
            f"the pose after action {bad[0]} is not finite", where=where, remedy="fix the policy"
        )
    geodesic = np.asarray(distance_to_goal(positions), np.float64)
    if not np.isfinite(geodesic).all():
        first = int(np.flatnonzero(~np.isfinite(geodesic))[0])
        raise EpisodeError(
            f"no path to the goal from the pose after action {first}",
            where=where,
            remedy="unreachable goals are refused when a suite is built: check the scene's map",
        )
    error_euclid = straight_to_goal(episode, *positions[-1].tolist())
    length = polyline_length(positions)
    shortest = float(geodesic[0])
    within = episode.success_within(success_radius)
    there = geodesic < within
    success = trajectory.stopped and bool(there[-1])
    longer = max(shortest, length)
    reference = np.array(episode.path, np.float64).reshape(-1, 2)
    if not len(reference):
        raise EpisodeError("the reference path is empty", where=where, remedy="rebuild the suite")
    dtw = dynamic_time_warping(without_repeats(positions), reference)
    ndtw = math.exp(-dtw / (len(reference) * success_radius))
    steps = trajectory.steps
    collisions = int(sum(trajectory.collided))
    metrics = EpisodeMetrics(
        steps=steps,
        trajectory_length=length,
        shortest_length=shortest,
        navigation_error_euclid=error_euclid,
        navigation_error_geodesic=float(geodesic[-1]),
        success=success,
        success_euclid=success if episode.in_area else trajectory.stopped and error_euclid < within,
        oracle_success=bool(there.any()),
        spl=(shortest / longer if longer > 0 else 1.0) if success else 0.0,
        ndtw=ndtw,
        sdtw=ndtw if success else 0.0,
        collisions=collisions,
        collision_rate=collisions / steps if steps else 0.0,
    )
    return check_finite(metrics, where)


def straight_to_goal(episode: Episode, x: float, y: float) -> float:
    """Straight distance [m] from (x, y) m to an episode's goal, the nearest place of a set."""
    if episode.goal_set is not None:
        return episode.goal_set.distance(x, y)
    return float(np.hypot(*(np.array([x, y]) - np.array(episode.goal, np.float64))))


def check_finite(metrics: EpisodeMetrics, where: str) -> EpisodeMetrics:
    """The metrics themselves, if every value is finite.

    Raises:
        EpisodeError: names the metric that is not.
    """
    values: dict[str, Any] = msgspec.structs.asdict(metrics)
    for name, value in values.items():
        if not math.isfinite(value):
            raise EpisodeError(f"{name} is {value}", where=where, remedy="counted as invalid")
    return metrics
