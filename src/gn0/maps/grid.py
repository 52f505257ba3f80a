"""Occupancy grids: cells, resolution and origin in the world frame."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from gn0.errors import FormatError
from gn0.geometry import F64, U8
from gn0.storage import content_hash

FREE, OCCUPIED, UNKNOWN = 0, 1, 2
FAR = 2.0**31  # cells; places beyond are counted as this far, which is outside any grid
GREY_OF_CELL = np.array([255, 0, 127], np.uint8)  # free, occupied, unknown: as InteriorGS


@dataclass(frozen=True, eq=False)
class OccupancyGrid:
    """A grid of free, occupied and unknown cells.

    `cells[row, col]`: col along world +x, row along world +y; cell (0, 0) has its outer corner at
    `origin`, so the centre of (row, col) is origin + ((col + .5), (row + .5)) · resolution.

    Attributes:
        cells: uint8 [H, W]: 0 free, 1 occupied, 2 unknown.
        resolution: cell size [m].
        origin: (x, y) [m] of the outer corner of cell (0, 0).
    """

    cells: U8
    resolution: float
    origin: tuple[float, float]

    def __post_init__(self) -> None:
        if self.cells.ndim != 2 or 0 in self.cells.shape:
            raise FormatError(f"grid has shape {self.cells.shape}, expected [H, W]", field="cells")
        if not (math.isfinite(self.resolution) and self.resolution > 0):
            raise FormatError(f"grid resolution is {self.resolution}", field="resolution")
        if not all(math.isfinite(v) for v in self.origin):
            raise FormatError(f"grid origin is {self.origin}", field="origin")
        cells = np.ascontiguousarray(self.cells, np.uint8)
        if cells.max(initial=0) > UNKNOWN:
            raise FormatError("grid cells hold values other than 0, 1, 2", field="cells")
        object.__setattr__(self, "cells", cells)

    @property
    def shape(self) -> tuple[int, int]:
        """(H, W) in cells."""
        height, width = self.cells.shape
        return height, width

    @property
    def bounds(self) -> tuple[float, float, float, float]:
        """(x_min, y_min, x_max, y_max) [m] of the outer edges."""
        h, w = self.shape
        x, y = self.origin
        return x, y, x + w * self.resolution, y + h * self.resolution

    @property
    def blocked(self) -> NDArray[np.bool_]:
        """Cells [H, W] an agent may not enter: occupied or unknown."""
        return self.cells != FREE

    @property
    def free_area(self) -> float:
        """Area of free cells [m²]."""
        return float((self.cells == FREE).sum()) * self.resolution**2

    def cell_of(self, x: float, y: float) -> tuple[int, int]:
        """(row, col) of the cell that holds a world point [m]; may lie outside the grid.

        No further than `FAR`, so that a cell fits into an int64 whatever the point.
        """
        u = (x - self.origin[0]) / self.resolution
        v = (y - self.origin[1]) / self.resolution
        if abs(u) > FAR:
            u = math.copysign(FAR, u)
        if abs(v) > FAR:
            v = math.copysign(FAR, v)
        return math.floor(v), math.floor(u)

    def cells_of(self, points: NDArray[np.floating]) -> NDArray[np.int64]:
        """(row, col) [N, 2] of world points [N, 2] m; may lie outside the grid, by 2³¹ at most."""
        p = np.asarray(points, np.float64).reshape(-1, 2) - self.origin
        far = FAR * self.resolution
        p = np.minimum(np.maximum(p, -far), far) / self.resolution
        return np.floor(p).astype(np.int64)[:, ::-1]

    def centre_of(self, row: int, col: int) -> tuple[float, float]:
        """World point (x, y) [m] at the centre of a cell."""
        return (
            self.origin[0] + (col + 0.5) * self.resolution,
            self.origin[1] + (row + 0.5) * self.resolution,
        )

    def centres_of(self, cells: NDArray[np.integer]) -> F64:
        """World points [N, 2] m at the centres of cells (row, col) [N, 2]."""
        rc = np.asarray(cells, np.float64).reshape(-1, 2)
        return (rc[:, ::-1] + 0.5) * self.resolution + np.asarray(self.origin)

    def contains(self, row: int, col: int) -> bool:
        """Whether (row, col) lies in the grid."""
        return 0 <= row < self.cells.shape[0] and 0 <= col < self.cells.shape[1]

    def is_free(self, x: float, y: float) -> bool:
        """Whether the cell at a world point [m] exists and is free."""
        row, col = self.cell_of(x, y)
        return self.contains(row, col) and bool(self.cells[row, col] == FREE)

    def with_cells(self, cells: U8) -> OccupancyGrid:
        """The same frame with other cells [H, W]."""
        return replace(self, cells=cells)

    @cached_property
    def content_hash(self) -> str:
        """Digest of cells, resolution and origin."""
        return content_hash(self.cells, float(self.resolution), *map(float, self.origin))
