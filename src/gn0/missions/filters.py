"""What keeps a set of episodes diverse: path signatures and near-duplicate suppression."""

from __future__ import annotations

import math

import msgspec
import numpy as np
from numpy.typing import NDArray

from gn0.config import Config
from gn0.geometry import F64
from gn0.jit import njit
from gn0.missions.paths import resample_path
from gn0.storage import content_hash


class SimilaritySettings(Config, frozen=True):
    """When two paths count as the same task (paper, Alg. 'Post-Generation … Filtering').

    Attributes:
        start_radius: only paths whose starts are this close are compared [m].
        goal_radius: only paths whose goals are this close are compared [m].
        frechet: a smaller discrete Fréchet distance means near-duplicate [m].
        samples: points a path is resampled to before comparison.
    """

    start_radius: float = 1.0
    goal_radius: float = 1.0
    frechet: float = 0.75
    samples: int = 48


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


def path_signature(points: NDArray[np.floating]) -> str:
    """Digest of a path [N, 2] rounded to millimetres: equal paths have equal signatures."""
    return content_hash(np.round(np.asarray(points, np.float64) * 1000).astype(np.int64))


class PathFilter:
    """Accepts paths one by one and refuses exact and near duplicates of those accepted."""

    def __init__(self, settings: SimilaritySettings | None = None) -> None:
        self.settings = settings or SimilaritySettings()
        self._signatures: set[str] = set()
        self._paths: list[F64] = []

    def relax(self, frechet: float) -> None:
        """Lower the near-duplicate threshold [m]; exact duplicates stay refused."""
        self.settings = msgspec.structs.replace(self.settings, frechet=frechet)

    def accept(self, points: NDArray[np.floating]) -> bool:
        """Whether the path [N, 2] m is new; if so it is remembered."""
        s = self.settings
        signature = path_signature(points)
        if signature in self._signatures:
            return False
        candidate = resample_path(points, s.samples)
        for kept in self._paths:
            if np.hypot(*(candidate[0] - kept[0])) > s.start_radius:
                continue
            if np.hypot(*(candidate[-1] - kept[-1])) > s.goal_radius:
                continue
            if discrete_frechet(candidate, kept) < s.frechet:
                return False
        self._signatures.add(signature)
        self._paths.append(candidate)
        return True
