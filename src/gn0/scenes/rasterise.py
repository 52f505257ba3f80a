"""Exact rasterisation of triangles, cut to a height band, into the cells of a grid.

Cells are half-open squares, so every point belongs to exactly one of them. A cell is marked when
it holds any point of the cut triangle's shadow on the floor: nothing is missed between samples and
nothing beyond is added. A shadow that reaches less than a ten-thousandth of a cell into its last
row or column does not count there, so that solids which end on a cell border do not grow.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from gn0.geometry import F64, U8
from gn0.jit import njit

_SLIVER = 1e-4  # cells


@njit
def _cut(points: F64, count: int, axis: int, limit: float, sign: float, out: F64) -> int:
    """Keep a convex polygon where sign · (coordinate − limit) ≥ 0 (Sutherland–Hodgman)."""
    kept = 0
    for i in range(count):
        j = i + 1 if i + 1 < count else 0
        a = sign * (points[i, axis] - limit)
        b = sign * (points[j, axis] - limit)
        if a >= 0.0:
            out[kept] = points[i]
            kept += 1
        if (a >= 0.0) != (b >= 0.0):
            t = a / (a - b)
            for k in range(3):
                out[kept, k] = points[i, k] + t * (points[j, k] - points[i, k])
            out[kept, axis] = limit
            kept += 1
    return kept


@njit
def _mark_faces(
    corners: F64, low: float, high: float, x0: float, y0: float, size: float, cells: U8
) -> None:
    h, w = cells.shape
    first = np.empty((12, 3))
    second = np.empty((12, 3))
    row = np.empty((12, 3))
    spare = np.empty((12, 3))
    for f in range(len(corners)):
        first[:3] = corners[f]
        n = _cut(first, 3, 2, low, 1.0, second)
        n = _cut(second, n, 2, high, -1.0, first)
        if n == 0:
            continue
        y_min, y_max = np.inf, -np.inf
        for i in range(n):
            y_min = min(y_min, first[i, 1])
            y_max = max(y_max, first[i, 1])
        r0 = math.floor((y_min - y0) / size + _SLIVER)
        r1 = max(r0, math.floor((y_max - y0) / size - _SLIVER))
        for r in range(max(r0, 0), min(r1, h - 1) + 1):
            # the outermost rows are not cut again: a last-bit difference there would lose the face
            m = n
            row[:n] = first[:n]
            if r > r0:
                m = _cut(row, m, 1, y0 + r * size, 1.0, spare)
                row[:m] = spare[:m]
            if r < r1:
                m = _cut(row, m, 1, y0 + (r + 1) * size, -1.0, spare)
                row[:m] = spare[:m]
            if m == 0:
                continue
            x_min, x_max = np.inf, -np.inf
            for i in range(m):
                x_min = min(x_min, row[i, 0])
                x_max = max(x_max, row[i, 0])
            c0 = math.floor((x_min - x0) / size + _SLIVER)
            c1 = max(c0, math.floor((x_max - x0) / size - _SLIVER))
            for c in range(max(c0, 0), min(c1, w - 1) + 1):
                cells[r, c] = 1


def mark_faces(
    corners: F64,
    *,
    band: tuple[float, float],
    origin: tuple[float, float],
    resolution: float,
    shape: tuple[int, int],
) -> NDArray[np.bool_]:
    """Cells [H, W] that hold any part of the faces within a height band.

    Args:
        corners: face corners [F, 3, 3] m.
        band: lowest and highest z [m] that count.
        origin: outer corner of cell (0, 0) [m].
        resolution: cell size [m].
        shape: (H, W).
    """
    cells = np.zeros(shape, np.uint8)
    if len(corners):
        _mark_faces(
            np.ascontiguousarray(corners, np.float64),
            float(band[0]),
            float(band[1]),
            float(origin[0]),
            float(origin[1]),
            float(resolution),
            cells,
        )
    return cells.astype(bool)
