"""Lines over cells: Bresenham's line, the paper's truncated move, and range rays.

Two rules make a move (paper, Eq. collision). The cells of Bresenham's line from the source's cell
to the target's are tested in order, and the move ends in the last cell before the first blocked
one. A diagonal step between two blocked cells is refused as well: Bresenham's line alone would slip
through the seam of two cells that touch in a corner, into a region the planner calls unreachable.
Everything outside the grid is blocked. So an agent that starts in a free cell is always in a free
cell, and always in the same connected region.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from gn0.errors import PlanError
from gn0.geometry import F32
from gn0.jit import njit
from gn0.maps.grid import FAR, OccupancyGrid


@njit(inline="always")
def is_blocked(blocked, row, col):  # type: ignore[no-untyped-def]
    """Whether a cell is blocked or outside the grid."""
    if row < 0 or col < 0 or row >= blocked.shape[0] or col >= blocked.shape[1]:
        return True
    return blocked[row, col]


@njit
def trace_cells(blocked, row0, col0, row1, col1):  # type: ignore[no-untyped-def]
    """Follow Bresenham's line; (row, col, steps, hit) of the last free cell before a blocked one.

    `steps` is k of Eq. collision: −1 when the first cell itself is blocked.
    """
    row, col, steps = row0, col0, 0
    if is_blocked(blocked, row, col):
        return row, col, -1, True
    across, down = abs(col1 - col0), abs(row1 - row0)
    right = 1 if col1 > col0 else -1
    up = 1 if row1 > row0 else -1
    error = across - down
    while row != row1 or col != col1:
        twice = 2 * error
        next_row, next_col = row, col
        if twice > -down:
            error -= down
            next_col += right
        if twice < across:
            error += across
            next_row += up
        if is_blocked(blocked, next_row, next_col):
            return row, col, steps, True
        if (
            next_row != row
            and next_col != col
            and is_blocked(blocked, row, next_col)
            and is_blocked(blocked, next_row, col)
        ):
            return row, col, steps, True
        row, col = next_row, next_col
        steps += 1
    return row, col, steps, False


@njit
def trace_points(blocked, origin_x, origin_y, resolution, x0, y0, x1, y1):  # type: ignore[no-untyped-def]
    """`trace_move` on plain values; NaN must have been refused by the caller."""
    far = FAR
    col0 = math.floor(min(max((x0 - origin_x) / resolution, -far), far))
    row0 = math.floor(min(max((y0 - origin_y) / resolution, -far), far))
    col1 = math.floor(min(max((x1 - origin_x) / resolution, -far), far))
    row1 = math.floor(min(max((y1 - origin_y) / resolution, -far), far))
    row, col, steps, hit = trace_cells(blocked, row0, col0, row1, col1)
    if not hit:
        return x1, y1, False
    if steps <= 0:  # p_0 is the source itself, not the centre of its cell
        return x0, y0, True
    return origin_x + (col + 0.5) * resolution, origin_y + (row + 0.5) * resolution, True


@njit
def _line_cells(row0, col0, row1, col1):  # type: ignore[no-untyped-def]
    across, down = abs(col1 - col0), abs(row1 - row0)
    right = 1 if col1 > col0 else -1
    up = 1 if row1 > row0 else -1
    cells = np.empty((max(across, down) + 1, 2), np.int64)
    error = across - down
    row, col = row0, col0
    for i in range(len(cells)):
        cells[i, 0], cells[i, 1] = row, col
        twice = 2 * error
        if twice > -down:
            error -= down
            col += right
        if twice < across:
            error += across
            row += up
    return cells


@njit
def cast_rays_cells(blocked, u, v, angles, limit, out):  # type: ignore[no-untyped-def]
    """Exact distance [cells] along each ray to the edge of the first blocked cell."""
    for k in range(len(angles)):
        dx, dy = math.cos(angles[k]), math.sin(angles[k])
        col, row = math.floor(u), math.floor(v)
        if is_blocked(blocked, row, col):
            out[k] = 0.0
            continue
        step_x = 1 if dx > 0 else -1
        step_y = 1 if dy > 0 else -1
        per_x = abs(1.0 / dx) if dx != 0 else np.inf
        per_y = abs(1.0 / dy) if dy != 0 else np.inf
        next_x = ((col + 1 - u) if dx > 0 else (u - col)) * per_x if dx != 0 else np.inf
        next_y = ((row + 1 - v) if dy > 0 else (v - row)) * per_y if dy != 0 else np.inf
        distance = 0.0
        while True:
            if next_x < next_y:
                distance = next_x
                next_x += per_x
                col += step_x
            else:
                distance = next_y
                next_y += per_y
                row += step_y
            if distance >= limit:
                distance = limit
                break
            if is_blocked(blocked, row, col):
                break
        out[k] = distance


def line_cells(start: tuple[int, int], end: tuple[int, int]) -> NDArray[np.int64]:
    """Bresenham's line between two cells, both included: (row, col) [N, 2]."""
    return _line_cells(int(start[0]), int(start[1]), int(end[0]), int(end[1]))


def trace_move(
    blocked: OccupancyGrid, source: tuple[float, float], target: tuple[float, float]
) -> tuple[float, float, bool]:
    """Move a point until it meets a blocked cell (paper, Eq. collision).

    Args:
        blocked: the inflated grid; occupied and unknown cells and all outside it stop the move.
        source: (x, y) m; should lie in a free cell.
        target: (x, y) m, the intended end.

    Returns:
        (x, y, hit): exactly the target when nothing is in the way; else, with hit True, the centre
        p_k of the last free cell of Bresenham's line, or the source itself when k = 0.

    Raises:
        PlanError: a coordinate is not finite.
    """
    if not all(map(math.isfinite, (*source, *target))):
        raise PlanError(f"move from {source} to {target} is not finite")
    return trace_points(
        blocked.blocked,
        *map(float, blocked.origin),
        float(blocked.resolution),
        *map(float, source),
        *map(float, target),
    )


def is_line_free(
    blocked: OccupancyGrid, source: tuple[float, float], target: tuple[float, float]
) -> bool:
    """Whether a move from source to target (x, y) m would not be truncated."""
    return not trace_move(blocked, source, target)[2]


def cast_rays(
    blocked: OccupancyGrid,
    x: float,
    y: float,
    angles: NDArray[np.floating],
    max_range: float = 10.0,
) -> F32:
    """Distance along rays to the edge of the first blocked cell: a planar lidar.

    Args:
        blocked: occupied and unknown cells stop a ray; so does the edge of the grid.
        x: world x of the sensor [m].
        y: world y of the sensor [m].
        angles: world directions [R] rad.
        max_range: longest reading [m].

    Returns:
        float32 [R] m in 0..max_range; 0 where the sensor itself is in a blocked cell.
    """
    if not (math.isfinite(x) and math.isfinite(y)):
        raise PlanError(f"rays from ({x}, {y}) are not finite")
    directions = np.ascontiguousarray(angles, np.float64).ravel()
    out = np.empty(len(directions))
    s = float(blocked.resolution)
    u = min(max((x - blocked.origin[0]) / s, -FAR), FAR)
    v = min(max((y - blocked.origin[1]) / s, -FAR), FAR)
    cast_rays_cells(blocked.blocked, u, v, directions, float(max_range) / s, out)
    return (out * s).astype(np.float32)
