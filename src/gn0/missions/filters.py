"""What keeps a set of episodes diverse: path signatures and near-duplicate suppression."""

from __future__ import annotations

import math

import msgspec
import numpy as np
from numpy.typing import NDArray

from gn0.geometry import F64
from gn0.jit import njit
from gn0.missions.similarity import KnownPaths, SimilaritySettings, path_signature

__all__ = ["PathFilter", "SimilaritySettings", "discrete_frechet", "path_signature"]


@njit
def _frechet(p: F64, q: F64) -> float:
    n, m = len(p), len(q)
    row = np.empty(m)
    for i in range(n):
        diagonal = row[0]
        for j in range(m):
            d = math.sqrt((p[i, 0] - q[j, 0]) ** 2 + (p[i, 1] - q[j, 1]) ** 2)
            above = row[j]
            if i == 0 and j == 0:
                reach = d
            elif i == 0:
                reach = max(row[j - 1], d)
            elif j == 0:
                reach = max(above, d)
            else:
                reach = max(min(above, row[j - 1], diagonal), d)
            diagonal = above
            row[j] = reach
    return row[m - 1]


def discrete_frechet(p: NDArray[np.floating], q: NDArray[np.floating]) -> float:
    """Discrete Fréchet distance [m] of polylines [N, 2] and [M, 2] (Eiter and Mannila 1994)."""
    return float(
        _frechet(
            np.ascontiguousarray(p, np.float64).reshape(-1, 2),
            np.ascontiguousarray(q, np.float64).reshape(-1, 2),
        )
    )


class PathFilter:
    """Accepts paths one by one and refuses exact and near duplicates of those accepted."""

    def __init__(self, settings: SimilaritySettings | None = None) -> None:
        self.settings = settings or SimilaritySettings()
        self._known = KnownPaths(self.settings.samples)

    def relax(self, frechet: float) -> None:
        """Lower the near-duplicate threshold [m]; exact duplicates stay refused."""
        self.settings = msgspec.structs.replace(self.settings, frechet=frechet)

    def accept(self, points: NDArray[np.floating]) -> bool:
        """Whether the path [N, 2] m is new; if so it is remembered."""
        if self._known.find_same(points) >= 0:
            return False
        if self._known.find_similar(points, self.settings) >= 0:
            return False
        self._known.add(points)
        return True
