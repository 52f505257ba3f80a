"""Straight legs that touch no blocked cell at all: every cell under the segment counts.

Bresenham's line, by which moves are judged, leaves out cells that a segment only grazes. A drawn
path goes through those as well. Here a leg is clear when the segment itself stays on free cells,
corners included.
"""

from __future__ import annotations

import itertools
import math

import numpy as np
from numpy.typing import NDArray

from gn0.geometry import F64
from gn0.jit import njit
from gn0.maps.astar import PlannerAstar
from gn0.maps.grid import OccupancyGrid
from gn0.maps.ray import is_blocked

_CORNER = 1e-9  # cells; a segment this close to a corner is taken to pass through it


@njit
def _enters_blocked(blocked, u0, v0, u1, v1):  # type: ignore[no-untyped-def]
    """Whether the segment (u0, v0) → (u1, v1) [cells] meets a blocked cell (Amanatides, Woo 1987).

    Where it passes through a corner, all four cells there are met.
    """
    height, width = blocked.shape
    for u, v in ((u0, v0), (u1, v1)):  # what is outside may be no int64, too
        if not (0.0 <= u < width and 0.0 <= v < height):
            return True
    col, row = math.floor(u0), math.floor(v0)
    last_col, last_row = math.floor(u1), math.floor(v1)
    if is_blocked(blocked, row, col) or is_blocked(blocked, last_row, last_col):
        return True
    du, dv = u1 - u0, v1 - v0
    right, up = (1 if du > 0 else -1), (1 if dv > 0 else -1)
    per_u = abs(1.0 / du) if du != 0.0 else np.inf
    per_v = abs(1.0 / dv) if dv != 0.0 else np.inf
    next_u = ((col + 1 - u0) if du > 0 else (u0 - col)) * per_u if du != 0.0 else np.inf
    next_v = ((row + 1 - v0) if dv > 0 else (v0 - row)) * per_v if dv != 0.0 else np.inf
    slack_u, slack_v = _CORNER * per_u, _CORNER * per_v
    while col != last_col or row != last_row:
        if min(next_u, next_v) > 1.0 + 1e-12:
            break  # the end was reached within rounding
        if abs(next_u - next_v) <= max(min(slack_u, 1.0), min(slack_v, 1.0)):
            if is_blocked(blocked, row, col + right) or is_blocked(blocked, row + up, col):
                return True
            col += right
            row += up
            next_u += per_u
            next_v += per_v
        elif next_u < next_v:
            col += right
            next_u += per_u
        else:
            row += up
            next_v += per_v
        if is_blocked(blocked, row, col):
            return True
    return False


@njit
def _count_blocked_legs(blocked, points, origin_x, origin_y, resolution):  # type: ignore[no-untyped-def]
    count = 0
    for i in range(len(points) - 1):
        count += _enters_blocked(
            blocked,
            (points[i, 0] - origin_x) / resolution,
            (points[i, 1] - origin_y) / resolution,
            (points[i + 1, 0] - origin_x) / resolution,
            (points[i + 1, 1] - origin_y) / resolution,
        )
    return count


@njit
def _shorten(blocked, points, origin_x, origin_y, resolution):  # type: ignore[no-untyped-def]
    """Indices kept by line-of-sight simplification: the farthest point in sight, again and again.

    One leg of the input is always taken as it is.
    """
    kept = [0]
    here = 0
    while here < len(points) - 1:
        there = len(points) - 1
        while there > here + 1 and _enters_blocked(
            blocked,
            (points[here, 0] - origin_x) / resolution,
            (points[here, 1] - origin_y) / resolution,
            (points[there, 0] - origin_x) / resolution,
            (points[there, 1] - origin_y) / resolution,
        ):
            there -= 1
        kept.append(there)
        here = there
    return np.array(kept)


def count_blocked_legs(grid: OccupancyGrid, points: NDArray[np.floating]) -> int:
    """How many legs of a polyline [N, 2] m touch a blocked cell of the grid."""
    p = np.ascontiguousarray(points, np.float64).reshape(-1, 2)
    return int(_count_blocked_legs(grid.blocked, p, *_frame(grid)))


def clear_path(grid: OccupancyGrid, points: NDArray[np.floating]) -> F64:
    """A short polyline [M, 2] m with the same ends whose legs touch free cells only.

    Legs that graze a blocked cell are led round it by A*; then the line of sight, again judged by
    every cell under it, drops what points it can (paper, Alg. 'Goal-Conditioned Reference
    Trajectory Generation').

    Args:
        grid: the inflated grid.
        points: polyline [N, 2] m, from cell centre to cell centre.

    Raises:
        PlanError: a point is blocked, or two in a row are not connected.
    """
    p = np.ascontiguousarray(points, np.float64).reshape(-1, 2)
    blocked, frame = grid.blocked, _frame(grid)
    if _count_blocked_legs(blocked, p, *frame):
        planner = PlannerAstar(grid)
        legs = [p[:1]]
        for a, b in itertools.pairwise(p):
            if _count_blocked_legs(blocked, np.stack([a, b]), *frame):
                detour = planner.plan(grid.cell_of(*a), grid.cell_of(*b))
                legs.append(grid.centres_of(detour.cells)[1:-1])
            legs.append(b[None])
        p = np.concatenate(legs)
    return p[_shorten(blocked, p, *frame)]


def _frame(grid: OccupancyGrid) -> tuple[float, float, float]:
    return float(grid.origin[0]), float(grid.origin[1]), float(grid.resolution)
