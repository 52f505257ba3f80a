"""Connected regions of walkable cells, and the nearest walkable cell.

Regions agree with the planner: two cells are connected when a path of 8-connected moves without
corner cutting joins them. As a diagonal needs both of its side cells free, that is the same as
being joined by shared edges.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from gn0.jit import njit
from gn0.maps.grid import FREE, OccupancyGrid
from gn0.maps.ray import is_blocked


def label_regions(grid: OccupancyGrid) -> NDArray[np.int32]:
    """Region of each cell [H, W]: −1 blocked, else 0, 1, … from the largest region down.

    Regions of one size are numbered in reading order of their first cell.
    """
    labels, sizes = _flood(grid.cells == FREE)
    rank = np.empty(len(sizes) + 1, np.int32)
    rank[-1] = -1  # that of the cells whose label is −1
    rank[np.argsort(-sizes, kind="stable")] = np.arange(len(sizes), dtype=np.int32)
    return rank[labels]


# here and not from scipy.ndimage, whose import is a fifth of the start of every worker
@njit
def _flood(free):  # type: ignore[no-untyped-def]
    """Label [H, W] of each free cell in reading order of first cells, else −1; sizes."""
    height, width = free.shape
    labels = np.full((height, width), -1, np.int32)
    sizes = np.zeros(height * width, np.int64)
    found = np.empty(height * width, np.int64)
    count = 0
    for start in range(height * width):
        if not free[start // width, start % width] or labels[start // width, start % width] >= 0:
            continue
        labels[start // width, start % width] = count
        found[0] = start
        waiting = 1
        while waiting:
            waiting -= 1
            row, col = found[waiting] // width, found[waiting] % width
            sizes[count] += 1
            for down, right in ((-1, 0), (0, -1), (0, 1), (1, 0)):
                r, c = row + down, col + right
                if 0 <= r < height and 0 <= c < width and free[r, c] and labels[r, c] < 0:
                    labels[r, c] = count
                    found[waiting] = r * width + c
                    waiting += 1
        count += 1
    return labels, sizes[:count].copy()


@njit
def _leaves_once(solid, row0, col0, row1, col1):  # type: ignore[no-untyped-def]
    """Whether Bresenham's line, once it has left solid cells, never meets one again."""
    across, down = abs(col1 - col0), abs(row1 - row0)
    right = 1 if col1 > col0 else -1
    up = 1 if row1 > row0 else -1
    error = across - down
    row, col = row0, col0
    free_seen = False
    while True:
        if is_blocked(solid, row, col):
            if free_seen:
                return False
        else:
            free_seen = True
        if row == row1 and col == col1:
            return free_seen
        twice = 2 * error
        if twice > -down:
            error -= down
            col += right
        if twice < across:
            error += across
            row += up


@njit
def _nearest(allowed, solid, u, v, in_sight, reach):  # type: ignore[no-untyped-def]
    """Nearest allowed cell to (u, v) [cells] by centre distance; (−1, −1) if there is none."""
    height, width = allowed.shape
    row0, col0 = math.floor(v), math.floor(u)
    best, best_row, best_col = reach * reach, -1, -1
    ring = 0
    # rings that do not touch the grid yet are skipped, those past it end the search
    ring = max(ring, -row0, row0 - height + 1, -col0, col0 - width + 1)
    last = max(row0, height - 1 - row0, col0, width - 1 - col0)
    while ring <= last:
        if ring - 1.0 > 0 and (ring - 1.0) * (ring - 1.0) > best:
            break
        for row in range(max(row0 - ring, 0), min(row0 + ring, height - 1) + 1):
            first, behind, step = col0 - ring, col0 + ring + 1, 2 * ring
            if abs(row - row0) == ring:  # all of it; far from the grid most lies beside it
                first, behind, step = max(first, 0), min(behind, width), 1
            for col in range(first, behind, step):
                if col < 0 or col >= width or not allowed[row, col]:
                    continue
                du, dv = col + 0.5 - u, row + 0.5 - v
                squared = du * du + dv * dv
                if squared < best and (not in_sight or _leaves_once(solid, row0, col0, row, col)):
                    best, best_row, best_col = squared, row, col
        ring += 1
    return best_row, best_col


def find_nearest_cell(
    grid: OccupancyGrid,
    x: float,
    y: float,
    *,
    allowed: NDArray[np.bool_] | None = None,
    solid: NDArray[np.bool_] | None = None,
    reach: float = math.inf,
) -> tuple[int, int] | None:
    """The allowed cell whose centre is nearest to a world point, or None.

    Args:
        grid: gives the frame and, without `allowed`, the free cells.
        x: world x [m].
        y: world y [m].
        allowed: cells [H, W] to choose from; default the free cells.
        solid: cells [H, W] that block sight. The straight line from the point may start in solid
            cells (the middle of a sofa) but must not meet one again after leaving them (a wall).
        reach: give up beyond this distance [m].

    Returns:
        (row, col); ties go to the first in ring and reading order.
    """
    if not (math.isfinite(x) and math.isfinite(y)):
        return None
    choose = grid.cells == FREE if allowed is None else np.ascontiguousarray(allowed, np.bool_)
    s = grid.resolution
    far = 2.0**30
    u = min(max((x - grid.origin[0]) / s, -far), far)
    v = min(max((y - grid.origin[1]) / s, -far), far)
    sight = solid is not None
    walls = np.ascontiguousarray(solid, np.bool_) if solid is not None else choose
    row, col = _nearest(choose, walls, u, v, sight, reach / s)
    return None if row < 0 else (int(row), int(col))
