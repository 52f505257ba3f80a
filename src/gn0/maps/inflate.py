"""Exact Euclidean distances to obstacles, and inflation by the agent's disc.

A cell is blocked for an agent of radius r when its centre lies within r of the centre of a blocked
cell: the paper's M ⊕ B_r (Sec. "Collision Handling") on the lattice of cell centres. Squared
distances are integers, so the test has no rounding. What lies outside the grid is unknown, and
unknown counts as occupied: the border is inflated like any wall unless the caller says otherwise.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from gn0.errors import ConfigError
from gn0.geometry import F64
from gn0.jit import njit
from gn0.maps.grid import FREE, OCCUPIED, OccupancyGrid

NOWHERE = np.iinfo(np.int64).max  # squared distance when there is no obstacle at all


@njit
def _squared_distances(blocked):  # type: ignore[no-untyped-def]
    """Squared centre distance [H, W] int64 to the nearest blocked cell (Meijster et al. 2000)."""
    height, width = blocked.shape
    far = height + width + 1
    column = np.empty((height, width), np.int64)
    for c in range(width):
        column[0, c] = 0 if blocked[0, c] else far
    for r in range(1, height):
        for c in range(width):
            column[r, c] = 0 if blocked[r, c] else min(column[r - 1, c] + 1, far)
    for r in range(height - 2, -1, -1):
        for c in range(width):
            if column[r + 1, c] + 1 < column[r, c]:
                column[r, c] = column[r + 1, c] + 1
    out = np.empty((height, width), np.int64)
    site = np.empty(width, np.int64)
    begin = np.empty(width, np.int64)
    for r in range(height):
        last = 0
        site[0] = 0
        begin[0] = 0
        for u in range(1, width):
            gu = column[r, u] * column[r, u]
            while last >= 0:
                i = site[last]
                d = begin[last] - i
                e = begin[last] - u
                if d * d + column[r, i] * column[r, i] > e * e + gu:
                    last -= 1
                else:
                    break
            if last < 0:
                last = 0
                site[0] = u
                begin[0] = 0
            else:
                i = site[last]
                gi = column[r, i] * column[r, i]
                start = 1 + (u * u - i * i + gu - gi) // (2 * (u - i))
                if start < width:
                    last += 1
                    site[last] = u
                    begin[last] = start
        for c in range(width - 1, -1, -1):
            i = site[last]
            g = column[r, i]
            out[r, c] = NOWHERE if g >= far else (c - i) * (c - i) + g * g
            if c == begin[last]:
                last -= 1
    return out


def squared_distances(
    blocked: NDArray[np.bool_], *, outside_blocked: bool = True
) -> NDArray[np.int64]:
    """Squared distance [cells²] between each cell's centre and the nearest blocked centre.

    Args:
        blocked: [H, W].
        outside_blocked: whether cells beyond the grid are blocked too.

    Returns:
        int64 [H, W]; 0 in blocked cells, `NOWHERE` when there is no obstacle.
    """
    mask = np.ascontiguousarray(blocked, np.bool_)
    if outside_blocked:
        padded = np.pad(mask, 1, constant_values=True)
        return np.ascontiguousarray(_squared_distances(padded)[1:-1, 1:-1])
    return _squared_distances(mask)


def build_clearance(grid: OccupancyGrid, *, outside_blocked: bool = True) -> F64:
    """Distance [H, W] m from each cell's centre to the nearest blocked centre; inf if none."""
    squared = squared_distances(grid.blocked, outside_blocked=outside_blocked)
    clearance = np.sqrt(squared) * grid.resolution
    clearance[squared == NOWHERE] = np.inf
    return clearance


def inflate(grid: OccupancyGrid, radius: float, *, outside_blocked: bool = True) -> OccupancyGrid:
    """The grid with obstacles grown by a disc of `radius` [m]: M ⊕ B_r of the paper.

    A free cell becomes occupied iff its centre is within `radius` of the centre of an occupied or
    unknown cell. Occupied and unknown cells stay what they are.

    Raises:
        ConfigError: the radius is negative or not finite.
    """
    if not (math.isfinite(radius) and radius >= 0):
        raise ConfigError(f"inflation radius is {radius} m", remedy="give a radius of 0 m or more")
    # the slack lets 0.20 m / 0.05 m mean four cells whatever its last bit
    limit = math.floor((radius / grid.resolution) ** 2 * (1 + 1e-9) + 1e-9)
    squared = squared_distances(grid.blocked, outside_blocked=outside_blocked)
    cells = grid.cells.copy()
    cells[(squared <= limit) & (cells == FREE)] = OCCUPIED
    return grid.with_cells(cells)
