"""Near-duplicate paths: gates on start and goal, then "is the discrete Fréchet distance below d?".

By default paths are compared whose starts and whose goals lie within 1 m of each other, and d is
0.75 m (`gn0.paper`).

The question needs no distance. A pair of points counts only while it lies closer than d, so whole
rows fall away and most comparisons end after a few of them. The answer is the one that the full
distance would give, bit for bit: it is always the distance of some pair of points.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from gn0.config import Config
from gn0.jit import njit
from gn0.missions.paths import resample_path
from gn0.paper import FRECHET, GOAL_RADIUS, START_RADIUS
from gn0.storage import content_hash


class SimilaritySettings(Config, frozen=True):
    """When two paths count as the same task (paper, Alg. 'Post-Generation … Filtering').

    Attributes:
        start_radius: compare only paths whose starts are this close [m].
        goal_radius: compare only paths whose goals are this close [m].
        frechet: a smaller discrete Fréchet distance means near-duplicate [m].
        samples: points a path is resampled to before comparison.
    """

    start_radius: float = START_RADIUS
    goal_radius: float = GOAL_RADIUS
    frechet: float = FRECHET
    samples: int = 48


@njit
def _is_closer(p, q, limit, reach):  # type: ignore[no-untyped-def]
    """Whether the discrete Fréchet distance of p [N, 2] and q [M, 2] is below `limit`.

    reach: bool [M], working space; only the columns first..last of the row above can lead on.
    """
    n, m = len(p), len(q)
    first, last = 0, 0
    for j in range(m):
        reach[j] = False
    for i in range(n):
        new_first, new_last = m, -1
        diagonal = False  # reach of (i − 1, j − 1)
        for j in range(first, m):
            above = reach[j]
            left = j > first and reach[j - 1]
            if i == 0:
                open_ = j == 0 or left
            else:
                open_ = above or diagonal or left
            if open_:
                dx, dy = p[i, 0] - q[j, 0], p[i, 1] - q[j, 1]
                open_ = math.sqrt(dx * dx + dy * dy) < limit
            elif j > last:
                break  # nothing further right can be reached; those cells are unset already
            reach[j] = open_
            diagonal = above
            if open_:
                new_first = min(new_first, j)
                new_last = j
        if new_last < 0:
            return False
        first, last = new_first, new_last + 1
    return reach[m - 1]


@njit
def _find_similar(path, paths, ends, count, start_radius, goal_radius, limit, reach):  # type: ignore[no-untyped-def]
    """Index of the first of `count` kept paths [·, S, 2] that the gates let pass and is close; −1.

    ends: [·, 4] start and goal of each kept path.
    """
    s = len(path) - 1
    for k in range(count):
        if math.hypot(path[0, 0] - ends[k, 0], path[0, 1] - ends[k, 1]) > start_radius:
            continue
        if math.hypot(path[s, 0] - ends[k, 2], path[s, 1] - ends[k, 3]) > goal_radius:
            continue
        if _is_closer(path, paths[k], limit, reach):
            return k
    return -1


def is_closer(p: NDArray[np.floating], q: NDArray[np.floating], limit: float) -> bool:
    """Whether the discrete Fréchet distance of polylines [N, 2] and [M, 2] is below `limit` [m].

    The same answer as `discrete_frechet(p, q) < limit`, found with less work.
    """
    a = np.ascontiguousarray(p, np.float64).reshape(-1, 2)
    b = np.ascontiguousarray(q, np.float64).reshape(-1, 2)
    return bool(_is_closer(a, b, float(limit), np.empty(len(b), np.bool_)))


def path_signature(points: NDArray[np.floating]) -> str:
    """Digest of a path [N, 2] rounded to millimetres: equal paths have equal signatures."""
    return content_hash(np.round(np.asarray(points, np.float64) * 1000).astype(np.int64))


class KnownPaths:
    """Paths that were accepted, and the question whether another is one of them again.

    Args:
        samples: points that paths are resampled to for comparison.
    """

    def __init__(self, samples: int = SimilaritySettings().samples) -> None:
        self._samples = samples
        self._signatures: dict[str, int] = {}
        self._paths = np.empty((16, samples, 2))
        self._ends = np.empty((16, 4))
        self._reach = np.empty(samples, np.bool_)
        self._count = 0

    def __len__(self) -> int:
        return self._count

    def find_same(self, points: NDArray[np.floating]) -> int:
        """Number of the known path that equals this one [N, 2] m to the millimetre; −1."""
        return self._signatures.get(path_signature(points), -1)

    def find_similar(self, points: NDArray[np.floating], settings: SimilaritySettings) -> int:
        """Number of the first known path that is a near-duplicate of this one [N, 2] m; −1."""
        return int(
            _find_similar(
                resample_path(points, self._samples),
                self._paths,
                self._ends,
                self._count,
                settings.start_radius,
                settings.goal_radius,
                settings.frechet,
                self._reach,
            )
        )

    def add(self, points: NDArray[np.floating]) -> None:
        """Remember a path [N, 2] m."""
        if self._count == len(self._paths):
            self._paths = np.concatenate([self._paths, np.empty_like(self._paths)])
            self._ends = np.concatenate([self._ends, np.empty_like(self._ends)])
        sampled = resample_path(points, self._samples)
        self._paths[self._count] = sampled
        self._ends[self._count] = (*sampled[0], *sampled[-1])
        self._signatures.setdefault(path_signature(points), self._count)
        self._count += 1
