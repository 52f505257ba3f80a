"""Z-order of points: neighbours in space become neighbours in the file and in memory."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from gn0.geometry import F32

_BITS = 21  # an axis; 63 bits in all


def morton_codes(means: F32) -> NDArray[np.uint64]:
    """63-bit Z-order codes [N] of points [N, 3]; each axis is cut into 2²¹ parts of its own extent.

    The axes are scaled apart, as splat-transform does, so that repacking its files keeps their
    chunks. Points that are not finite get the largest code.
    """
    points = means.astype(np.float64)
    finite = np.isfinite(points).all(axis=1)
    if not finite.any():
        return np.full(len(points), np.iinfo(np.uint64).max, np.uint64)
    low = points[finite].min(axis=0) if not finite.all() else points.min(axis=0)
    high = points[finite].max(axis=0) if not finite.all() else points.max(axis=0)
    extent = np.where(high > low, high - low, 1.0)
    cells = (1 << _BITS) - 1
    codes = np.zeros(len(points), np.uint64)
    with np.errstate(invalid="ignore"):
        for axis in range(3):
            unit = (points[:, axis] - low[axis]) / extent[axis]
            cell = np.where(finite, unit * cells, 0.0).astype(np.uint64)
            codes |= _spread(cell) << np.uint64(axis)
    codes[~finite] = np.iinfo(np.uint64).max
    return codes


def morton_order(means: F32) -> NDArray[np.int64]:
    """Indices [N] that sort points [N, 3] along a Z-order curve; ties keep their order.

    Sorting twice changes nothing, so a cloud saved in this order is read back in it.
    """
    return np.argsort(morton_codes(means), kind="stable")


def _spread(x: NDArray[np.uint64]) -> NDArray[np.uint64]:
    """Two zero bits after each of the low 21 bits (Morton 1966; masks by binary doubling)."""
    for shift, mask in (
        (32, 0x1F00000000FFFF),
        (16, 0x1F0000FF0000FF),
        (8, 0x100F00F00F00F00F),
        (4, 0x10C30C30C30C30C3),
        (2, 0x1249249249249249),
    ):
        x = (x | (x << np.uint64(shift))) & np.uint64(mask)
    return x
