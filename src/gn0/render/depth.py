"""Depth as stored in pictures: whole millimetres in 16 bits, 0 where nothing is seen.

A pixel of a renderer's depth [m] becomes the nearest millimetre, halves to the even one, and at
least 1 and at most 65,535; +inf (alpha < 0.5) and NaN become 0. The arithmetic is float32, so a
kernel that does the same gives the same values.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from gn0.geometry import F32

FARTHEST = 65_535  # mm


def to_millimetres(depth: F32) -> NDArray[np.uint16]:
    """Depth [...] m as whole millimetres; see above."""
    metres = np.asarray(depth, np.float32)
    with np.errstate(over="ignore", invalid="ignore"):
        steps = np.rint(metres * np.float32(1000)).clip(1, FARTHEST)
        seen = metres < np.inf
    return np.where(seen, steps, 0).astype(np.uint16)


def to_metres(millimetres: NDArray[np.uint16], depth_range: tuple[float, float]) -> F32:
    """What a sensor of that range (min, max) [m] reads: [...] m, max where nothing is seen."""
    low, high = map(np.float32, depth_range)
    metres = (np.asarray(millimetres).astype(np.float32) / np.float32(1000)).clip(low, high)
    return np.where(np.asarray(millimetres) == 0, high, metres).astype(np.float32)
