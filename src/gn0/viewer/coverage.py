"""Where paths go: how many pass through each spot of a scene's ground, as a tint on its view."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from gn0.geometry import F64
from gn0.maps.grid import FREE, OccupancyGrid
from gn0.missions.paths import densify_path

SPOT = 0.25  # m, side of a spot
# few, some, many paths: RGBA stops of the tint
_STOPS = np.array([
    [52, 84, 209, 120], [38, 170, 170, 150], [250, 205, 60, 185], [226, 60, 44, 215],
], np.float64)  # fmt: skip
_UNTOUCHED = (255, 255, 255, 70)


def count_paths(
    grid: OccupancyGrid, paths: Sequence[NDArray[np.floating]], spot: float = SPOT
) -> NDArray[np.int64]:
    """How many paths [N, 2] m pass through each spot [H, W]; −1 where no ground is free.

    Spots are squares of side `spot` [m] from the grid's origin on; row along y, column along x.
    """
    height, width = grid.shape
    per = max(1, round(spot / grid.resolution))
    rows, cols = -(-height // per), -(-width // per)
    free = np.zeros((rows * per, cols * per), np.bool_)
    free[:height, :width] = grid.cells == FREE
    counts = np.where(free.reshape(rows, per, cols, per).any(axis=(1, 3)), 0, -1).astype(np.int64)
    for path in paths:
        cells = grid.cells_of(densify_path(path, grid.resolution)) // per
        inside = ((cells >= 0) & (cells < (rows, cols))).all(axis=1)
        cells = np.unique(cells[inside], axis=0)
        counts[cells[:, 0], cells[:, 1]] = np.maximum(counts[cells[:, 0], cells[:, 1]], 0) + 1
    return counts


def covered_share(counts: NDArray[np.int64]) -> float:
    """Share of the spots with free ground that some path passes through."""
    ground = counts >= 0
    return float((counts[ground] > 0).mean()) if ground.any() else 0.0


def tint_coverage(
    counts: NDArray[np.int64],
    grid: OccupancyGrid,
    size: tuple[int, int],
    window: tuple[float, float, float, float],
    spot: float = SPOT,
) -> Image.Image:
    """The counts as an RGBA layer of `size` (w, h) [px] over a window (x0, y0, x1, y1) [m].

    The scale is logarithmic and ends at the busiest spot; ground that no path touches is pale.
    """
    per = max(1, round(spot / grid.resolution)) * grid.resolution
    x0, y0, x1, y1 = window
    cols = np.floor((np.linspace(x0, x1, size[0], False) - grid.origin[0]) / per).astype(np.int64)
    rows = np.floor((np.linspace(y1, y0, size[1], False) - grid.origin[1]) / per).astype(np.int64)
    h, w = counts.shape
    inside = ((rows >= 0) & (rows < h))[:, None] & ((cols >= 0) & (cols < w))[None]
    picked = counts[np.clip(rows, 0, h - 1)[:, None], np.clip(cols, 0, w - 1)[None]]
    picked = np.where(inside, picked, -1)
    most = max(int(counts.max(initial=0)), 1)
    level: F64 = np.log1p(np.maximum(picked, 0)) / np.log1p(most) * (len(_STOPS) - 1)
    at = np.minimum(np.floor(level), len(_STOPS) - 2).astype(np.int64)
    part = (level - at)[..., None]
    layer = (_STOPS[at] * (1 - part) + _STOPS[at + 1] * part).astype(np.uint8)
    layer[picked == 0] = _UNTOUCHED
    layer[picked < 0] = 0
    return Image.fromarray(layer, "RGBA")
