"""How closely the disc on the map matches the disc of the body.

Inflation measures between centres of cells (`gn0.maps.inflate`), while a body may stand anywhere in
a free cell and an obstacle fills its cell to the corners. So the rim of a body may reach into a
blocked cell: by less than √2 cells for any radius.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from gn0.geometry import F64
from gn0.maps.grid import OccupancyGrid


def disc_overlap(radius: float, resolution: float) -> float:
    """How far [m] a disc of `radius` [m] may reach into a blocked cell at most.

    Over all offsets of two cells that inflation lets stand: radius − least gap of their squares.
    """
    cells = radius / resolution
    limit = math.floor(cells**2 * (1 + 1e-9) + 1e-9)  # as `inflate` has it
    reach = int(cells) + 3
    dx, dy = np.meshgrid(np.arange(reach), np.arange(reach))
    free = dx * dx + dy * dy > limit
    gap = np.hypot(np.maximum(dx - 1, 0), np.maximum(dy - 1, 0))[free].min()
    return max(0.0, radius - float(gap) * resolution)


def square_distances(grid: OccupancyGrid, points: NDArray[np.floating], reach: float) -> F64:
    """Exact distances [N] m of points [N, 2] m to the squares of blocked cells, up to `reach` m.

    The map's surroundings are blocked too. Brute force, cell by cell: a check, not for planning.
    """
    size = grid.resolution
    around = math.ceil(reach / size) + 1
    blocked = np.pad(grid.blocked, around, constant_values=True)
    local = (np.asarray(points, np.float64) - grid.origin) / size
    cell = np.floor(local).astype(np.int64)  # column, row
    inner = local - cell
    best = np.full(len(local), float(around))
    for dr in range(-around, around + 1):
        for dc in range(-around, around + 1):
            hit = blocked[cell[:, 1] + dr + around, cell[:, 0] + dc + around]
            off_x = np.maximum(np.maximum(dc - inner[:, 0], inner[:, 0] - dc - 1), 0)
            off_y = np.maximum(np.maximum(dr - inner[:, 1], inner[:, 1] - dr - 1), 0)
            best = np.where(hit, np.minimum(best, np.hypot(off_x, off_y)), best)
    return np.minimum(best * size, reach)
