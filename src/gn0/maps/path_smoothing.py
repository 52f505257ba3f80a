"""Paths as polylines: line-of-sight smoothing, densifying, adaptive resampling.

A leg is good when `trace_move` would not truncate it: planner and simulator use one rule.
"""

from __future__ import annotations

import itertools
import math

import numpy as np
from numpy.typing import NDArray

from gn0.errors import ConfigError
from gn0.geometry import F64
from gn0.maps.astar import PlannerAstar
from gn0.maps.grid import OccupancyGrid
from gn0.maps.ray import line_cells, trace_points


class LineChecker:
    """Tests legs of one grid without rebuilding its mask for each."""

    def __init__(self, grid: OccupancyGrid) -> None:
        self._frame = (grid.blocked, *map(float, grid.origin), float(grid.resolution))

    def is_free(self, a: NDArray[np.floating], b: NDArray[np.floating]) -> bool:
        """Whether the move from a to b (x, y) m is not truncated."""
        return not trace_points(*self._frame, float(a[0]), float(a[1]), float(b[0]), float(b[1]))[2]


def _without_repeats(points: F64) -> F64:
    if len(points) < 2:
        return points
    keep = np.r_[True, (np.abs(np.diff(points, axis=0)) > 0).any(axis=1)]
    return points[keep]


def smooth_path(grid: OccupancyGrid, points: NDArray[np.floating]) -> F64:
    """Line-of-sight simplification: the farthest point in sight, again and again.

    Sight is sought from the far end first, so a leg is as long as it can be; one leg of the input
    is always taken as it is.

    Args:
        grid: the inflated grid the path was planned on.
        points: polyline [N, 2] m.

    Returns:
        A subset of the points [M, 2] m with the same ends.
    """
    p = np.asarray(points, np.float64).reshape(-1, 2)
    checker = LineChecker(grid)
    kept = [0] if len(p) else []
    while kept and kept[-1] < len(p) - 1:
        here = kept[-1]
        there = len(p) - 1
        while there > here + 1 and not checker.is_free(p[here], p[there]):
            there -= 1
        kept.append(there)
    return p[kept]


def densify_path(grid: OccupancyGrid, points: NDArray[np.floating]) -> F64:
    """The centres [M, 2] m of all cells on the Bresenham lines of a polyline, ends included."""
    cells = grid.cells_of(points)
    if len(cells) == 0:
        return np.empty((0, 2))
    lines = [cells[:1]]
    for a, b in itertools.pairwise(cells):
        lines.append(line_cells((a[0], a[1]), (b[0], b[1]))[1:])
    return grid.centres_of(np.concatenate(lines))


def resample_path(points: NDArray[np.floating], spacing: float) -> F64:
    """Points [M, 2] m at equal steps of arc length, at most `spacing` [m] apart, ends kept.

    Raises:
        ConfigError: the spacing is not a positive number.
    """
    if not (math.isfinite(spacing) and spacing > 0):
        raise ConfigError(f"spacing is {spacing} m", remedy="give a positive length")
    p = _without_repeats(np.asarray(points, np.float64).reshape(-1, 2))
    if len(p) < 2:
        return p.copy()
    arc = np.r_[0.0, np.cumsum(np.hypot(*np.diff(p, axis=0).T))]
    count = max(1, math.ceil(arc[-1] / spacing - 1e-9))
    at = np.linspace(0.0, arc[-1], count + 1)
    out = np.column_stack([np.interp(at, arc, p[:, 0]), np.interp(at, arc, p[:, 1])])
    out[0], out[-1] = p[0], p[-1]
    return out


def resample_adaptive(
    points: NDArray[np.floating], *, tolerance: float = 0.10, longest: float = 2.0
) -> F64:
    """Compact keypoints [M, 2] m: dense in bends, sparse on straights (paper, data generation).

    A subset of the points is kept such that the polyline never strays more than `tolerance` from
    them (Douglas–Peucker); legs longer than `longest` are then divided evenly.

    Args:
        points: polyline [N, 2] m, usually densified.
        tolerance: largest distance [m] of a dropped point from its leg.
        longest: longest leg [m].

    Raises:
        ConfigError: tolerance or longest is not a positive number.
    """
    if not (tolerance > 0 and longest > 0 and math.isfinite(tolerance + longest)):
        raise ConfigError(
            f"tolerance {tolerance} m, longest {longest} m", remedy="give positive lengths"
        )
    p = _without_repeats(np.asarray(points, np.float64).reshape(-1, 2))
    if len(p) < 2:
        return p.copy()
    keep = np.zeros(len(p), bool)
    keep[[0, -1]] = True
    spans = [(0, len(p) - 1)]
    while spans:
        a, b = spans.pop()
        if b - a < 2:
            continue
        away = _distance_to_leg(p[a + 1 : b], p[a], p[b])
        worst = int(np.argmax(away))
        if away[worst] > tolerance:
            middle = a + 1 + worst
            keep[middle] = True
            spans += [(a, middle), (middle, b)]
    corners = p[keep]
    out = [corners[:1]]
    for a, b in itertools.pairwise(corners):
        out.append(resample_path(np.array([a, b]), longest)[1:])
    return np.concatenate(out)


def _distance_to_leg(points: F64, a: F64, b: F64) -> F64:
    leg = b - a
    squared = float(leg @ leg)
    if squared == 0:
        return np.hypot(*(points - a).T)
    t = np.clip((points - a) @ leg / squared, 0.0, 1.0)
    return np.hypot(*(points - a - t[:, None] * leg).T)


def follow_corners(grid: OccupancyGrid, bends: NDArray[np.floating]) -> F64:
    """A drivable polyline [N, 2] m along a taut path whose inner points are obstacle corners.

    Each bend moves to the centre of the free cell opposite its obstacle. A leg that the rounding of
    Bresenham's line still blocks is mended by A* between its ends.
    """
    points = np.asarray(bends, np.float64).reshape(-1, 2).copy()
    blocked = grid.blocked
    for i in range(1, len(points) - 1):
        u = round((points[i, 0] - grid.origin[0]) / grid.resolution)
        v = round((points[i, 1] - grid.origin[1]) / grid.resolution)
        # exactly one of the four cells round a convex corner is blocked; take the opposite one
        around = blocked[v - 1 : v + 1, u - 1 : u + 1]
        row, col = np.argwhere(around)[0]
        points[i] = grid.centre_of(v - int(row), u - int(col))
    points = _without_repeats(points)
    checker = LineChecker(grid)
    planner: PlannerAstar | None = None
    legs = [points[:1]]
    for a, b in itertools.pairwise(points):
        if checker.is_free(a, b):
            legs.append(b[None])
            continue
        planner = planner or PlannerAstar(grid)
        detour = grid.centres_of(planner.plan(grid.cell_of(*a), grid.cell_of(*b)).cells)
        legs.append(np.vstack([detour[1:-1], b]))
    return smooth_path(grid, np.concatenate(legs))
