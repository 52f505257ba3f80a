"""The field expert: the next six actions from any state, by the distance field alone.

Of all headings that turning on the spot leads through, the one is taken from which a step comes
nearest to the goal, a turn costing a little. Nothing is searched, so it is quick, and it can be
done on a GPU (`sim/kernels/expert.cu`, the same bits). Steps are whole ones under the simulator's
own rule of motion, except in a nook that no two whole steps lead out of.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from gn0.errors import PlanError
from gn0.geometry import F32, F64
from gn0.maps.bends import find_bends, frame_of
from gn0.maps.distance import GeodesicField
from gn0.maps.field_kernels import follow_field, label_field_states
from gn0.paper import ACTIONS_AHEAD, POINTS, SPACING

STOP_DISTANCE = 0.25  # m on foot
ROUNDING = 1e-3  # m within the limit, so that no rounding in a metric can put a STOP outside it
I8 = NDArray[np.int8]


class FieldLabels(NamedTuple):
    """What the field expert says of N states.

    Attributes:
        actions: [N, 6] int8, STOP from the end on.
        waypoints: [N, 13, 2] float32 m in the agents' frames, x forward and y left.
        valid: [N] int8, how many waypoints are not repetitions.
        distance: [N] float64 m to the goal on foot.
    """

    actions: I8
    waypoints: F32
    valid: I8
    distance: F64


def stop_places(field: GeodesicField) -> F64:
    """The places [K, 2] m beside which the expert stops; none of an area, which it enters."""
    return field.goals if field.inside is None else np.empty((0, 2))


def label_field(
    field: GeodesicField,
    places: NDArray[np.floating],
    headings: F64,
    turns: NDArray[np.integer],
    which: NDArray[np.integer],
    *,
    near: float,
    step: float,
    sliding: bool = False,
) -> FieldLabels:
    """Labels of states by the field expert.

    Args:
        field: distances to the goal on the agent's inflated grid.
        places: [N, 2] x, y [m].
        headings: [M, circle, 3] yaw [rad], its cosine and sine after each number of turns.
        turns: [N] turns that each has made in its row of headings.
        which: [N] its row.
        near: STOP within this distance of the goal [m], on foot and in a straight line.
        step: length of FORWARD [m].
        sliding: whether the body goes on along a wall.

    Raises:
        PlanError: a place is blocked, off the map, not finite, or cut off from the goal; names the
            row.
    """
    at = np.ascontiguousarray(places, np.float64).reshape(-1, 2)
    _check_places(field, at)
    bends = find_bends(field)
    count = len(at)
    out = FieldLabels(
        np.zeros((count, ACTIONS_AHEAD), np.int8),
        np.zeros((count, POINTS, 2), np.float32),
        np.zeros(count, np.int8),
        np.zeros(count),
    )
    label_field_states(
        frame_of(field.grid), (field.label, field.roots, stop_places(field)),
        (field.parents, bends.places, bends.via_start, bends.vias),
        np.ascontiguousarray(headings, np.float64), float(step), bool(sliding), float(near),
        SPACING, at, np.ascontiguousarray(turns, np.int64), np.ascontiguousarray(which, np.int64),
        out.actions, out.waypoints, out.valid, out.distance,
    )  # fmt: skip
    return out


def walk_field(
    field: GeodesicField,
    place: tuple[float, float],
    headings: F64,
    *,
    near: float,
    step: float,
    sliding: bool = False,
) -> I8:
    """The actions [T] of the field expert from a place to its STOP, which is left out.

    Args:
        field: see `label_field`.
        place: x, y [m].
        headings: [circle, 3] yaw [rad], cosine and sine after each number of turns from here.
        near: STOP within this distance of the goal [m], on foot and in a straight line.
        step: length of FORWARD [m].
        sliding: whether the body goes on along a wall.

    Raises:
        PlanError: the place is blocked or cut off, or the walk does not end.
    """
    _check_places(field, np.array([place], np.float64))
    away = field.distance_at(*place)
    limit = 200 + int(20 * away / step)  # far more than any walk that gets there
    out = np.zeros(limit, np.int8)
    _, count = follow_field(
        frame_of(field.grid), (field.label, field.roots, stop_places(field)),
        np.ascontiguousarray(headings, np.float64), float(step), bool(sliding), float(near),
        float(place[0]), float(place[1]), 0, out,
    )  # fmt: skip
    if count == limit:
        raise PlanError(
            f"the field leads from ({place[0]:g}, {place[1]:g}) m to no stop in {limit} actions",
            remedy="label with variant exact",
        )
    return out[:count].copy()


def _check_places(field: GeodesicField, places: F64) -> None:
    lost = np.flatnonzero(~np.isfinite(field.distance(np.nan_to_num(places, nan=np.inf))))
    if len(lost):
        x, y = places[lost[0]]
        raise PlanError(
            f"no path from ({x:g}, {y:g}) m to the goal {field.goal}",
            where=f"state {int(lost[0])}",
            remedy="label states that are walkable and in the goal's region",
        )
