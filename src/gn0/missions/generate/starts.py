"""Algorithm 2, lines 5 to 11: where paths begin.

How long a path from there to its goal must and may be is in `MissionSettings` (settings.py) and is
applied by judge.py; where goals are, in reachable_goals.py.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from gn0.geometry import F64
from gn0.missions.generate.settings import StartMode
from gn0.missions.paths import densify_path

if TYPE_CHECKING:
    from gn0.maps.navigation import NavigationMap

FAR_CANDIDATES = 24  # cells of which the one farthest from earlier starts is taken


class StartSampler:
    """Draws start cells of a component and remembers what was drawn.

    Args:
        safe: the map whose free cells may be starts.
        mode: see `MissionSettings.starts`.
        zone: side of a square zone [m].
    """

    def __init__(self, safe: NavigationMap, mode: StartMode = "zones", zone: float = 1.0) -> None:
        self._mode = mode
        self._zone = zone
        grid = safe.inflated
        cells = np.argwhere(safe.regions >= 0)
        self.points: F64 = grid.centres_of(cells)
        self._low = np.asarray(grid.origin, np.float64)
        columns = int(np.ceil(grid.shape[1] * grid.resolution / zone)) + 1
        rows = int(np.ceil(grid.shape[0] * grid.resolution / zone)) + 1
        self._shape = (rows, columns)
        self._visits = np.zeros(rows * columns, np.int64)
        zones = self._zones_of(self.points)
        regions = safe.regions[cells[:, 0], cells[:, 1]]
        # cells of each component, zone by zone
        self._by_region: dict[int, tuple[NDArray, NDArray, NDArray]] = {}
        for region in range(len(safe.region_areas)):
            index = np.flatnonzero(regions == region)
            index = index[np.argsort(zones[index], kind="stable")]
            names, begins = np.unique(zones[index], return_index=True)
            self._by_region[region] = (index, names, np.r_[begins, len(index)])
        self._starts: list[tuple[float, float]] = []

    def _zones_of(self, points: NDArray[np.floating]) -> NDArray[np.int64]:
        at = np.floor((np.asarray(points, np.float64).reshape(-1, 2) - self._low) / self._zone)
        rows, columns = self._shape
        col = np.clip(at[:, 0], 0, columns - 1).astype(np.int64)
        row = np.clip(at[:, 1], 0, rows - 1).astype(np.int64)
        return row * columns + col

    @property
    def mode(self) -> StartMode:
        """The mode in force now: `auto` resolved."""
        if self._mode != "auto":
            return self._mode
        if self._visits.any():
            return "zones"
        return "far" if self._starts else "uniform"

    def draw(self, region: int, rng: np.random.Generator) -> tuple[float, float]:
        """A start (x, y) [m] of a component: the centre of a safe cell."""
        index, zones, begins = self._by_region[region]
        mode = self.mode
        if mode == "zones":
            weights = 1.0 / (1.0 + self._visits[zones]) ** 2
            chosen = int(rng.choice(len(zones), p=weights / weights.sum()))
            k = int(index[rng.integers(begins[chosen], begins[chosen + 1])])
        elif mode == "far" and self._starts:
            drawn = index[rng.integers(0, len(index), FAR_CANDIDATES)]
            gaps = self.points[drawn][:, None] - np.array(self._starts)[None]
            k = int(drawn[np.argmax((gaps**2).sum(axis=2).min(axis=1))])
        else:
            k = int(index[rng.integers(0, len(index))])
        return float(self.points[k, 0]), float(self.points[k, 1])

    def visit(self, path: NDArray[np.floating]) -> None:
        """A path [N, 2] m was accepted: its zones are denser now, its start is used."""
        p = densify_path(path, self._zone / 4)
        self._visits[np.unique(self._zones_of(p))] += 1
        self._starts.append((float(p[0, 0]), float(p[0, 1])))

    def visit_earlier(self, paths: Iterable[NDArray[np.floating]]) -> None:
        """Paths of earlier runs count as visits as well."""
        for path in paths:
            self.visit(path)

    @property
    def visited_share(self) -> float:
        """Share of the zones with walkable ground that some path goes through."""
        zones = np.unique(self._zones_of(self.points))
        return float((self._visits[zones] > 0).mean()) if len(zones) else 0.0
