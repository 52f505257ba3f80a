"""The path ahead of a state: points at equal arc lengths along the shortest drivable path.

Of one geodesic field every way is a chain of the same bends, so the bends are moved off their
obstacles once a field, and what is left a state is a walk down the chain: the path that
`GeodesicField.path` gives, for hundreds of thousands of states a second. One rule is stricter: no
point of it lies in a blocked cell, where a move of the simulator may touch a cell's corner.
"""

from __future__ import annotations

import threading
from typing import NamedTuple
from weakref import WeakKeyDictionary

import numpy as np
from numpy.typing import NDArray

from gn0.data.label_kernels import (
    UNREACHABLE,
    UNSEEN,
    blocked_legs,
    free_corners,
    sample_ways,
    shorten_way,
    spread_line,
)
from gn0.errors import PlanError
from gn0.geometry import F32, F64
from gn0.maps.astar import PlannerAstar
from gn0.maps.distance import GeodesicField
from gn0.maps.grid import OccupancyGrid
from gn0.paper import POINTS, SPACING


class _Bends(NamedTuple):
    """A field's bends as an agent passes them: places [R, 2] m, and detours between them."""

    places: F64
    via_start: NDArray[np.int64]
    vias: F64


_lock = threading.Lock()
_bends_of: WeakKeyDictionary[GeodesicField, _Bends] = WeakKeyDictionary()
_planner_of: WeakKeyDictionary[OccupancyGrid, PlannerAstar] = WeakKeyDictionary()


def _frame(grid: OccupancyGrid) -> tuple[NDArray[np.bool_], float, float, float]:
    x, y = grid.origin
    return grid.blocked, float(x), float(y), float(grid.resolution)


def _detour(grid: OccupancyGrid, start: F64, end: F64) -> F64:
    """Points [N, 2] m of a drivable way between two free points, ends included; locked outside."""
    planner = _planner_of.get(grid)
    if planner is None:
        planner = _planner_of[grid] = PlannerAstar(grid)
    cells = planner.plan(grid.cell_of(*start), grid.cell_of(*end)).cells
    return _shorten(grid, np.vstack([start, grid.centres_of(cells)[1:-1], end]))


def _shorten(grid: OccupancyGrid, points: F64) -> F64:
    kept: NDArray[np.int64] = shorten_way(*_frame(grid), np.ascontiguousarray(points))
    out: F64 = points[kept]
    return out


def _find_bends(field: GeodesicField) -> _Bends:
    with _lock:
        found = _bends_of.get(field)
        if found is not None:
            return found
        frame = _frame(field.grid)
        places = free_corners(*frame, field.roots, field.goals)
        vias = [np.empty((0, 2))]
        counts = np.zeros(len(places) + 1, np.int64)
        for r in np.flatnonzero(blocked_legs(*frame, places, field.parents)).tolist():
            way = _detour(field.grid, places[r], places[int(field.parents[r])])[1:-1]
            counts[r + 1] = len(way)
            vias.append(way)
        found = _bends_of[field] = _Bends(places, np.cumsum(counts), np.concatenate(vias))
        return found


def sample_way_points(
    field: GeodesicField, poses: NDArray[np.floating], points: int = POINTS
) -> tuple[F32, NDArray[np.int8]]:
    """The way ahead of each pose, at 0.25 m of arc length, in the agent's frame.

    Point 0 is the agent itself. Where the way ends before the last point, the goal is the next
    point, a shorter step away, and is repeated (paper, prompts: "pad with last if short").

    Args:
        field: distances to the goal on the agent's inflated grid.
        poses: [N, 3] x, y [m], yaw [rad], world frame.
        points: how many, the agent's own place counted.

    Returns:
        (waypoints float32 [N, points, 2] m, x forward and y left; valid int8 [N], how many of
        them are not repetitions, at least 1).

    Raises:
        PlanError: a pose is blocked, off the map, not finite, or cut off from the goal; names the
            row.
    """
    p = np.ascontiguousarray(poses, np.float64).reshape(-1, 3)
    finite: NDArray[np.bool_] = np.asarray(np.isfinite(p).all(axis=1))
    out = np.zeros((len(p), points, 2))
    valid = np.zeros(len(p), np.int8)
    status = np.zeros(len(p), np.int8)
    bends = _find_bends(field)
    frame = _frame(field.grid)
    sample_ways(
        np.where(finite[:, None], p, np.inf), *frame, field.label, field.parents, bends.places,
        bends.via_start, bends.vias, SPACING, out, valid, status,
    )  # fmt: skip
    lost = np.flatnonzero(np.logical_or(status == UNREACHABLE, ~finite))
    if len(lost):
        raise PlanError(
            f"no path from ({p[lost[0], 0]:g}, {p[lost[0], 1]:g}) m to the goal {field.goal}",
            where=f"state {int(lost[0])}",
            remedy="label states that are walkable and in the goal's region",
        )
    for i in np.flatnonzero(status == UNSEEN).tolist():
        way = _winding_way(field, bends, p[i, :2])
        valid[i] = spread_line(way, *frame, SPACING, p[i], out[i])
    return out.astype(np.float32), valid


def find_way(field: GeodesicField, place: NDArray[np.floating]) -> F64:
    """The shortest drivable way [N, 2] m from a place to a field's goal, both included.

    Raises:
        PlanError: the place is blocked, off the map, or cut off from the goal.
    """
    at = np.asarray(place, np.float64)
    sample_way_points(field, np.array([[at[0], at[1], 0.0]]), 1)  # refuses what cannot be reached
    return _shorten(field.grid, _winding_way(field, _find_bends(field), at))


def _winding_way(field: GeodesicField, bends: _Bends, place: F64) -> F64:
    """The way [N, 2] m from a place that does not quite see its first bend."""
    grid = field.grid
    row, col = grid.cell_of(float(place[0]), float(place[1]))
    root = int(field.label[row, col])
    with _lock:
        parts = [_detour(grid, place, bends.places[root])]
    while field.parents[root] >= 0:
        parts.append(bends.vias[bends.via_start[root] : bends.via_start[root + 1]])
        root = int(field.parents[root])
        parts.append(bends.places[root][None])
    return np.ascontiguousarray(np.concatenate(parts))
