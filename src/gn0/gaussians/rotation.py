"""Rotations as packed formats store them: three components, and which one was left out."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from gn0.geometry import F32


def scatter_rotation(three: NDArray[Any], largest: NDArray[Any], which: NDArray[Any]) -> F32:
    """Quaternions [R, 4] of three components in order and the one at index `which`."""
    quats = np.empty((len(three), 4), np.float32)
    for slot in range(4):
        rows = np.flatnonzero(which == slot)
        if len(rows):
            quats[rows, slot] = largest[rows]
            for column, other in enumerate(i for i in range(4) if i != slot):
                quats[rows, other] = three[rows, column]
    return quats
