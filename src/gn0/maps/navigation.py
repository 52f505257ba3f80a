"""One grid and one agent radius: everything that navigation asks of a map."""

from __future__ import annotations

import math
import threading
from collections import OrderedDict
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from gn0.errors import PlanError
from gn0.geometry import F64
from gn0.maps.distance import GeodesicField, GeodesicMap, find_area
from gn0.maps.goal_places import GoalSet
from gn0.maps.grid import FREE, OccupancyGrid
from gn0.maps.inflate import build_clearance, inflate
from gn0.maps.ray import trace_points
from gn0.maps.regions import find_nearest_cell, label_regions
from gn0.maps.slide import slide_points
from gn0.paper import BODY_RADIUS

FIELDS_KEPT = 64  # geodesic fields in the cache; about 0.7 MB each on a 400 × 400 grid


class NavigationMap:
    """A grid inflated for an agent, with its regions, moves, distances and paths.

    Immutable to its users; safe to share between threads.

    Args:
        grid: the raw occupancy; unknown counts as occupied.
        radius: the agent's radius [m].
    """

    def __init__(self, grid: OccupancyGrid, radius: float = BODY_RADIUS) -> None:
        self.grid = grid
        self.radius = float(radius)
        self.inflated = inflate(grid, radius)
        self.blocked: NDArray[np.bool_] = self.inflated.blocked
        x, y = grid.origin
        self._frame = (self.blocked, float(x), float(y), float(grid.resolution))
        self._fields: OrderedDict[tuple[float, float] | GoalSet, GeodesicField] = OrderedDict()
        self._lock = threading.Lock()

    @cached_property
    def clearance(self) -> F64:
        """Distance [H, W] m from each cell's centre to the nearest obstacle cell's centre."""
        return build_clearance(self.grid)

    @cached_property
    def regions(self) -> NDArray[np.int32]:
        """Connected region [H, W] of each cell: −1 blocked, else 0, 1, … from the largest down."""
        return label_regions(self.inflated)

    @cached_property
    def region_areas(self) -> F64:
        """Area [R] m² of each region, largest first."""
        counts = np.bincount(self.regions[self.regions >= 0])
        return (counts * self.grid.resolution**2).astype(np.float64)

    @cached_property
    def _geodesic_map(self) -> GeodesicMap:
        return GeodesicMap(self.inflated)

    def is_free(self, x: float, y: float) -> bool:
        """Whether the agent's centre may be at (x, y) m."""
        return math.isfinite(x) and math.isfinite(y) and self.inflated.is_free(x, y)

    def region_of(self, x: float, y: float) -> int:
        """Region of a point (x, y) m: 0 the largest, 1, …; −1 when blocked or outside."""
        if not self.is_free(x, y):
            return -1
        row, col = self.inflated.cell_of(x, y)
        return int(self.regions[row, col])

    def regions_of(self, goal: tuple[float, float] | GoalSet) -> frozenset[int]:
        """Regions in which a goal, or some place of a set, is walkable; empty when none is."""
        if not isinstance(goal, GoalSet):
            found = {self.region_of(*goal)}
        elif goal.areas:
            found = {int(r) for r in np.unique(self.regions[find_area(self.inflated, goal)])}
        else:
            found = {self.region_of(*point) for point in goal.points}
        return frozenset(found - {-1})

    def move(self, x0: float, y0: float, x1: float, y1: float) -> tuple[float, float, bool]:
        """Move from (x0, y0) towards (x1, y1) m: (x, y, hit); see `trace_move`.

        Raises:
            PlanError: a coordinate is not finite.
        """
        if not math.isfinite(x0 + y0 + x1 + y1):
            raise PlanError(f"move from ({x0}, {y0}) to ({x1}, {y1}) is not finite")
        return trace_points(*self._frame, x0, y0, x1, y1)

    def slide(self, x0: float, y0: float, x1: float, y1: float) -> tuple[float, float, bool]:
        """The same for a body that goes on along the wall where it is cut; see `gn0.maps.slide`.

        Raises:
            PlanError: a coordinate is not finite.
        """
        if not math.isfinite(x0 + y0 + x1 + y1):
            raise PlanError(f"move from ({x0}, {y0}) to ({x1}, {y1}) is not finite")
        return slide_points(*self._frame, x0, y0, x1, y1)

    def nearest_free(
        self,
        x: float,
        y: float,
        within: int | None = None,
        *,
        in_sight: bool = False,
        reach: float = math.inf,
    ) -> tuple[float, float] | None:
        """The point itself if free, else the centre of the nearest free cell, or None.

        Args:
            x: world x [m].
            y: world y [m].
            within: only cells of this region.
            in_sight: the straight line there may start inside an obstacle (the middle of a sofa),
                but must not meet another after leaving it (a wall).
            reach: give up beyond this distance [m].
        """
        if self.is_free(x, y) and (within is None or self.region_of(x, y) == within):
            return float(x), float(y)
        cell = find_nearest_cell(
            self.inflated,
            x,
            y,
            allowed=(self.inflated.cells == FREE) if within is None else self.regions == within,
            solid=self.grid.blocked if in_sight else None,
            reach=reach,
        )
        return None if cell is None else self.inflated.centre_of(*cell)

    def geodesic(self, goal: tuple[float, float] | GoalSet, *, keep: bool = True) -> GeodesicField:
        """The any-angle distance field of a goal (x, y) m or of a set; the latest are cached.

        Args:
            goal: what counts.
            keep: put a field that is built now among those.

        Raises:
            PlanError: the goal is not in a free cell; of a set, no place is.
        """
        key = goal if isinstance(goal, GoalSet) else (float(goal[0]), float(goal[1]))
        with self._lock:
            field = self._fields.get(key)
            if field is not None:
                self._fields.move_to_end(key)
                return field
        field = self._geodesic_map.build_field(key)
        if not keep:
            return field
        with self._lock:
            self._fields[key] = field
            while len(self._fields) > FIELDS_KEPT:
                self._fields.popitem(last=False)
        return field

    def plan(self, start: tuple[float, float], goal: tuple[float, float] | GoalSet) -> F64:
        """A shortest polyline [N, 2] m from start to goal that the agent can drive.

        Raises:
            PlanError: start or goal is not free, or no path joins them.
        """
        return self.geodesic(goal).path(float(start[0]), float(start[1]))
