"""Reference paths: planned on the inflated map, resampled, and drawn into cells."""

from __future__ import annotations

from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from gn0.errors import PlanError
from gn0.geometry import F64
from gn0.maps.goal_places import GoalSet
from gn0.maps.grid import OccupancyGrid
from gn0.paper import SPACING

if TYPE_CHECKING:
    from gn0.maps.navigation import NavigationMap


def resample_path(points: NDArray[np.floating], count: int) -> F64:
    """`count` points [count, 2] at equal arc length along a polyline [N, 2] m, ends kept."""
    p = np.asarray(points, np.float64).reshape(-1, 2)
    lengths = np.r_[0.0, np.cumsum(np.sqrt((np.diff(p, axis=0) ** 2).sum(axis=1)))]
    at = np.linspace(0.0, lengths[-1], count)
    out = np.column_stack([np.interp(at, lengths, p[:, k]) for k in (0, 1)])
    out[0], out[-1] = p[0], p[-1]
    return out


def densify_path(points: NDArray[np.floating], spacing: float = SPACING) -> F64:
    """A polyline [N, 2] m with every corner kept and no gap longer than `spacing` [m]."""
    p = np.asarray(points, np.float64).reshape(-1, 2)
    parts = [p[:1]]
    for a, b in pairwise(p):
        gap = float(np.hypot(*(b - a)))
        if gap == 0.0:
            continue
        pieces = max(1, int(np.ceil(gap / spacing - 1e-9)))
        t = np.arange(1, pieces + 1)[:, None] / pieces
        step = a + (b - a) * t
        step[-1] = b
        parts.append(step)
    return np.concatenate(parts)


def plan_reference(
    navigation: NavigationMap,
    start: tuple[float, float],
    goal: tuple[float, float] | GoalSet,
    spacing: float = SPACING,
) -> F64:
    """The shortest any-angle path [N, 2] m from start to goal on the agent's inflated map.

    Of a set of goals it leads to the nearest.

    Paper, Alg. 'Goal-Conditioned Reference Trajectory Generation': search, line-of-sight
    simplification and resampling; the any-angle field does the first two at once.

    Raises:
        PlanError: no way from start to goal.
    """
    field = navigation.geodesic(goal)
    if not np.isfinite(field.distance(np.array([start], np.float64))[0]):
        raise PlanError(
            f"no path from {start} to {goal}",
            remedy="choose start and goal in one connected region",
        )
    line = np.asarray(field.path(*start), np.float64).reshape(-1, 2)
    if not len(line):
        line = np.array([start, field.goal], np.float64)
    if tuple(line[0]) != tuple(start):
        line = np.vstack([[start], line])
    if not isinstance(goal, GoalSet) and tuple(line[-1]) != tuple(goal):
        line = np.vstack([line, [goal]])
    return densify_path(line, spacing)


def rasterise_path(grid: OccupancyGrid, points: NDArray[np.floating]) -> NDArray[np.int64]:
    """Cells (row, col) [N, 2] along a polyline [M, 2] m, each cell once in a row.

    GN-Matrix's `path_raster_*` columns hold such a dense path.
    """
    dense = densify_path(points, grid.resolution / 2)
    cells = grid.cells_of(dense)
    h, w = grid.shape
    cells = np.clip(cells, 0, (h - 1, w - 1))
    keep = np.r_[True, (np.diff(cells, axis=0) != 0).any(axis=1)]
    return cells[keep]
