"""The paper's tracking objective for actions (Eq. mpc_action), made safe to use.

    a* = argmin over sequences of  Σ γ^k · C(s_{t+k}),  k = 1 … H,

with C the squared distance [m²] of a state's place from the way ahead. Read literally this has a
hole: the way begins under the agent's feet, so turning on the spot for ever costs nothing, and
every FORWARD whose heading is not exactly the way's costs something. The guard: only sequences
that get ahead count. φ(s) is the least number of actions that a state still needs to the end of
the way (metres left over the length of a step, plus turns to face the way); a sequence is
admitted when its last state needs at most `GUARD` actions more than the best last state. Among
the admitted the literal objective decides; among equals fewer turns, then least φ.

The search is exact: sequences that end in one lattice state are merged (`gn0.maps.lattice_states`),
LEFT right after RIGHT and the other way round are left out, and a FORWARD that the simulator would
cut short is barred.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from gn0.data.label_kernels import merge_tracking
from gn0.errors import ConfigError
from gn0.geometry import F64
from gn0.maps.grid import OccupancyGrid
from gn0.maps.lattice_states import (
    HEADING_AT,
    HEADINGS,
    LAST_AT,
    ORIGIN_KEY,
    check_moves,
    expand_states,
    place_states,
)
from gn0.paper import FORWARD, FORWARD_STEP, TURN_DEGREES

GUARD = 1.0  # actions that a plan may lose against the quickest, for the sake of the way
LOOK_AHEAD = 0.5  # m along the way at which a state should look


def actions_left(
    places: F64, yaws: F64, arcs: F64, way: F64, way_arcs: F64, step: float, turn: float
) -> F64:
    """φ [N]: metres left along the way over a step, plus turns to face it 0.5 m ahead.

    Args:
        places: [N, 2] m.
        yaws: [N] rad.
        arcs: [N] m, progress along the way.
        way: [M, 2] m.
        way_arcs: [M] m.
        step: length of FORWARD [m].
        turn: angle of a turn [rad].
    """
    at = np.minimum(arcs + LOOK_AHEAD, way_arcs[-1])
    x, y = np.interp(at, way_arcs, way[:, 0]), np.interp(at, way_arcs, way[:, 1])
    dx, dy = x - places[:, 0], y - places[:, 1]
    error = np.arctan2(dy, dx) - yaws
    error = np.abs((error + math.pi) % (2 * math.pi) - math.pi)
    error[np.hypot(dx, dy) < 1e-6] = 0.0
    return (way_arcs[-1] - arcs) / step + np.maximum(error / turn - 0.5, 0.0)


def plan_tracking(
    grid: OccupancyGrid,
    pose: tuple[float, float, float],
    ahead: NDArray[np.floating],
    *,
    stop_distance: float,
    step: float = FORWARD_STEP,
    turn_degrees: float = TURN_DEGREES,
    horizon: int = 8,
    discount: float = 0.95,
) -> list[int]:
    """The actions that follow the way ahead best; fewer than the horizon where it ends.

    Args:
        grid: the inflated grid.
        pose: x, y [m], yaw [rad].
        ahead: the way [N, 2] m in the agent's frame, beginning at the agent.
        stop_distance: a FORWARD that ends within this distance of the way's end is the last [m].
        step: length of FORWARD [m].
        turn_degrees: 15, or a multiple of it that divides 360.
        horizon: H.
        discount: γ.

    Raises:
        ConfigError: the turn is not on the lattice.
    """
    units = turn_degrees / 15.0
    if units != round(units) or units < 1 or HEADINGS % round(units):
        raise ConfigError(
            f"turns of {turn_degrees}° are not on the lattice of 15°",
            remedy="use label variant exact for this agent",
        )
    x0, y0, yaw = pose
    cosine, sine = math.cos(yaw), math.sin(yaw)
    rotation = np.array([[cosine, sine], [-sine, cosine]])
    way = np.asarray(ahead, np.float64) @ rotation + (x0, y0)
    if len(way) < 2:
        return []
    lengths = np.hypot(*np.diff(way, axis=0).T)
    way = np.ascontiguousarray(way[np.r_[True, lengths > 1e-9]])
    if len(way) < 2:
        return []
    way_arcs = np.r_[0.0, np.cumsum(np.hypot(*np.diff(way, axis=0).T))]
    frame = (grid.blocked, *map(float, grid.origin), float(grid.resolution))
    keys = np.array([ORIGIN_KEY | (FORWARD << LAST_AT)], np.int64)
    places = np.array([[x0, y0]])
    cost, turns = np.zeros(1), np.zeros(1, np.int32)
    done, arcs = np.zeros(1, np.bool_), np.zeros(1)
    history: list[tuple[NDArray[np.int32], NDArray[np.int8]]] = []
    for k in range(1, horizon + 1):
        child, parent, action = expand_states(keys, done, round(units))
        after = place_states(child, x0, y0, cosine, sine, step)
        free = check_moves(*frame, places, after, parent, action)
        kept, cost, turns, arcs, done = merge_tracking(
            child, parent, action, after, free, cost, turns, way, way_arcs, stop_distance,
            discount**k,
        )  # fmt: skip
        keys, places = child[kept], after[kept]
        history.append((parent[kept], action[kept]))
    yaws = (yaw + ((keys >> HEADING_AT) & 31) * (2 * math.pi / HEADINGS)).astype(np.float64)
    turn = math.radians(turn_degrees)
    left = actions_left(places, yaws, arcs, way, way_arcs, step, turn)
    left[done] = 0.0
    admitted = np.flatnonzero(left <= left.min() + GUARD)
    order = np.lexsort((left[admitted], turns[admitted], np.round(cost[admitted], 12)))
    best = int(admitted[order[0]])
    actions = []
    for parent, action in reversed(history):
        if action[best]:
            actions.append(int(action[best]))
        best = int(parent[best])
    return actions[::-1]
