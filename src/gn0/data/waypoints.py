"""The path ahead of a state: points at equal arc lengths along the shortest drivable path.

Of one geodesic field every way is a chain of the same bends, so the bends are moved off their
obstacles once a field, and what is left a state is a walk down the chain: the path that
`GeodesicField.path` gives, for hundreds of thousands of states a second. One rule is stricter: no
point of it lies in a blocked cell, where a move of the simulator may touch a cell's corner.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from gn0.errors import PlanError
from gn0.geometry import F32, F64
from gn0.maps.bends import Bends, find_bends, find_detour, frame_of, shorten
from gn0.maps.distance import GeodesicField
from gn0.maps.way_kernels import UNREACHABLE, UNSEEN, sample_ways, spread_line
from gn0.paper import POINTS, SPACING


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
    bends = find_bends(field)
    frame = frame_of(field.grid)
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
    return shorten(field.grid, _winding_way(field, find_bends(field), at))


def _winding_way(field: GeodesicField, bends: Bends, place: F64) -> F64:
    """The way [N, 2] m from a place that does not quite see its first bend."""
    grid = field.grid
    row, col = grid.cell_of(float(place[0]), float(place[1]))
    root = int(field.label[row, col])
    parts = [find_detour(grid, place, bends.places[root])]
    while field.parents[root] >= 0:
        parts.append(bends.vias[bends.via_start[root] : bends.via_start[root + 1]])
        root = int(field.parents[root])
        parts.append(bends.places[root][None])
    return np.ascontiguousarray(np.concatenate(parts))
