"""What hides a person from an agent's eye: all that is occupied, but for low furniture."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from gn0.maps.grid import FREE, OCCUPIED, OccupancyGrid
from gn0.scenes.scene import ObjectBox, Scene

BELOW = 0.2  # m below the eye: what ends lower hides nobody from it
_EDGE = 0.05  # m by which a footprint is larger than its box: cells are drawn outwards


def sight_grid(scene: Scene, eye: float) -> OccupancyGrid:
    """The occupancy of what hides people; that of the scene where nothing is labelled.

    Args:
        scene: where.
        eye: height of the agent's eye [m].
    """
    grid = scene.grid
    low = np.zeros(grid.shape, np.bool_)
    tall = np.zeros(grid.shape, np.bool_)
    for thing in scene.objects:
        box = thing.box
        bottom, top = box.centre[2] - box.size[2] / 2, box.centre[2] + box.size[2] / 2
        if top <= eye - BELOW:
            low |= _covered(grid, box)
        elif bottom < eye:
            tall |= _covered(grid, box)
    cells = grid.cells.copy()
    cells[low & ~tall & (cells == OCCUPIED)] = FREE
    return grid.with_cells(cells)


def _covered(grid: OccupancyGrid, box: ObjectBox) -> NDArray[np.bool_]:
    """Cells whose centres a box stands over, its edge included."""
    rows, cols = np.indices(grid.shape)
    x = grid.origin[0] + (cols + 0.5) * grid.resolution - box.centre[0]
    y = grid.origin[1] + (rows + 0.5) * grid.resolution - box.centre[1]
    c, s = np.cos(box.yaw), np.sin(box.yaw)
    along, aside = c * x + s * y, -s * x + c * y
    inside = np.abs(along) <= box.size[0] / 2 + _EDGE
    return np.asarray(inside & (np.abs(aside) <= box.size[1] / 2 + _EDGE), np.bool_)
