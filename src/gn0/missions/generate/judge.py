"""Algorithm 3: which candidates are kept, and why the others are not."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from gn0.geometry import polyline_length
from gn0.maps.grid import OccupancyGrid
from gn0.maps.sweep import count_blocked_legs
from gn0.missions.generate.settings import MissionSettings
from gn0.missions.similarity import KnownPaths

Verdict = Literal[
    "accepted", "malformed", "blocked", "short", "long", "trivial", "duplicate", "similar"
]
REASONS: dict[str, str] = {
    "no way": "no path from start to goal",
    "malformed": "fewer than two points, or a value that is not finite",
    "blocked": "touches a cell that is blocked for the agent",
    "short": "shorter than the minimum length",
    "long": "longer than the maximum length",
    "trivial": "ends too near to where it began",
    "duplicate": "equals a path that was accepted before",
    "similar": "start, goal and Fréchet distance too near to a path that was accepted before",
}


class PathJudge:
    """Judges candidates one by one; what it accepts, later ones are held against.

    Args:
        settings: lengths and similarity.
        earlier: paths [N, 2] m of earlier runs, accepted already.
        grid: what no leg may touch; None leaves that out.
    """

    def __init__(
        self,
        settings: MissionSettings,
        earlier: Iterable[NDArray[np.floating]] = (),
        grid: OccupancyGrid | None = None,
    ) -> None:
        self._settings = settings
        self._grid = grid
        self._known = KnownPaths(settings.similarity.samples)
        for path in earlier:
            self._known.add(path)
        self._earlier = len(self._known)
        self.fell: Counter[str] = Counter()
        self.against_earlier = 0
        self.accepted = 0

    @property
    def judged(self) -> int:
        """Candidates so far."""
        return self.accepted + sum(self.fell.values())

    def judge(self, points: NDArray[np.floating]) -> Verdict:
        """The verdict on a path [N, 2] m; an accepted one is remembered.

        Tests go from the cheapest to the dearest; the first that fails gives the verdict.
        """
        verdict, known = self._verdict(points)
        if verdict == "accepted":
            self._known.add(points)
            self.accepted += 1
        else:
            self.fell[verdict] += 1
            self.against_earlier += 0 <= known < self._earlier
        return verdict

    def drop(self, reason: str) -> None:
        """Count a candidate that fell before there was a path to judge."""
        self.fell[reason] += 1

    def _verdict(self, points: NDArray[np.floating]) -> tuple[Verdict, int]:
        s = self._settings
        p = np.asarray(points, np.float64)
        if p.ndim != 2 or p.shape[1:] != (2,) or len(p) < 2 or not np.isfinite(p).all():
            return "malformed", -1
        length = polyline_length(p)
        if length < s.minimum_length:
            return "short", -1
        if length > s.maximum_length:
            return "long", -1
        if float(np.hypot(*(p[-1] - p[0]))) < s.minimum_displacement:
            return "trivial", -1
        if self._grid is not None and count_blocked_legs(self._grid, p):
            return "blocked", -1
        known = self._known.find_same(p)
        if known >= 0:
            return "duplicate", known
        known = self._known.find_similar(p, s.similarity)
        return ("similar", known) if known >= 0 else ("accepted", -1)
