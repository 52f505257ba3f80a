"""The bends of a geodesic field as an agent passes them, off their obstacles' corners.

Of one field every way is a chain of the same bends, so they are moved off once a field.
"""

from __future__ import annotations

import threading
from typing import NamedTuple
from weakref import WeakKeyDictionary

import numpy as np
from numpy.typing import NDArray

from gn0.geometry import F64
from gn0.maps.astar import PlannerAstar
from gn0.maps.distance import GeodesicField
from gn0.maps.grid import OccupancyGrid
from gn0.maps.way_kernels import blocked_legs, free_corners, shorten_way


class Bends(NamedTuple):
    """A field's bends: places [R, 2] m; on the way from r to its parent lie `vias[via_start[r]:…]`.

    The first places are the goals; NaN stands for the inside of an area.
    """

    places: F64
    via_start: NDArray[np.int64]
    vias: F64


_lock = threading.Lock()
_bends_of: WeakKeyDictionary[GeodesicField, Bends] = WeakKeyDictionary()
_planner_of: WeakKeyDictionary[OccupancyGrid, PlannerAstar] = WeakKeyDictionary()


def frame_of(grid: OccupancyGrid) -> tuple[NDArray[np.bool_], float, float, float]:
    """What kernels take of a grid: blocked [H, W], origin x and y [m], resolution [m]."""
    x, y = grid.origin
    return grid.blocked, float(x), float(y), float(grid.resolution)


def find_detour(grid: OccupancyGrid, start: F64, end: F64) -> F64:
    """Points [N, 2] m of a drivable way between two free points, ends included."""
    with _lock:
        return _detour(grid, start, end)


def _detour(grid: OccupancyGrid, start: F64, end: F64) -> F64:
    planner = _planner_of.get(grid)
    if planner is None:
        planner = _planner_of[grid] = PlannerAstar(grid)
    cells = planner.plan(grid.cell_of(*start), grid.cell_of(*end)).cells
    return shorten(grid, np.vstack([start, grid.centres_of(cells)[1:-1], end]))


def shorten(grid: OccupancyGrid, points: F64) -> F64:
    """Those of the points [N, 2] m that a way needs to keep off the obstacles."""
    kept: NDArray[np.int64] = shorten_way(*frame_of(grid), np.ascontiguousarray(points))
    out: F64 = points[kept]
    return out


def find_bends(field: GeodesicField) -> Bends:
    """The bends of a field; found once."""
    with _lock:
        found = _bends_of.get(field)
        if found is not None:
            return found
        frame = frame_of(field.grid)
        places = free_corners(*frame, field.roots, field.goals)
        vias = [np.empty((0, 2))]
        counts = np.zeros(len(places) + 1, np.int64)
        for r in np.flatnonzero(blocked_legs(*frame, places, field.parents)).tolist():
            way = _detour(field.grid, places[r], places[int(field.parents[r])])[1:-1]
            counts[r + 1] = len(way)
            vias.append(way)
        found = _bends_of[field] = Bends(places, np.cumsum(counts), np.concatenate(vias))
        return found
