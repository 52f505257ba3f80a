"""States of the action lattice: exact keys, their expansion and their merging.

A position is eight integers over the 24th roots of unity (see `gn0.maps.lattice`). Each is biased
into six bits of one key, with heading and last action above them, so equal keys are equal states
and a FORWARD is one addition.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from gn0.jit import njit
from gn0.maps.ray import trace_points

HEADINGS = 24
LONGEST_HORIZON = 16  # coefficients must stay within six bits
BUMP_RADIUS = 0.05  # m round a place where a FORWARD was cut short against expectation

BITS = 6
HALF = 1 << (BITS - 1)
HEADING_AT = 8 * BITS
LAST_AT = HEADING_AT + 5


def _root_powers() -> NDArray[np.int64]:
    """ζ^k over the basis 1, ζ, …, ζ⁷: [24, 8]."""
    powers = np.zeros((HEADINGS, 8), np.int64)
    powers[0, 0] = 1
    for k in range(1, HEADINGS):
        powers[k, 1:] = powers[k - 1, :-1]
        carry = powers[k - 1, -1]  # ζ⁸ = ζ⁴ − 1
        powers[k, 4] += carry
        powers[k, 0] -= carry
    return powers


ROOT_POWERS = _root_powers()
# a state's key holds its eight integers, biased, then heading and last action; a FORWARD adds this
_FORWARD_KEY = (ROOT_POWERS << (BITS * np.arange(8))).sum(axis=1)
ORIGIN_KEY = int((HALF << (BITS * np.arange(8, dtype=np.int64))).sum())
_BASIS_X = np.cos(np.arange(8) * (2 * math.pi / HEADINGS))
_BASIS_Y = np.sin(np.arange(8) * (2 * math.pi / HEADINGS))


@njit
def project(points, arcs, first, last, x, y):  # type: ignore[no-untyped-def]
    """Nearest point of the legs first … last−1 of a polyline: its arc [m] and its distance [m]."""
    best = np.inf
    arc = 0.0
    for i in range(first, last):
        ax, ay = points[i, 0], points[i, 1]
        dx, dy = points[i + 1, 0] - ax, points[i + 1, 1] - ay
        length = arcs[i + 1] - arcs[i]
        t = ((x - ax) * dx + (y - ay) * dy) / (length * length)
        t = min(max(t, 0.0), 1.0)
        ex, ey = x - ax - t * dx, y - ay - t * dy
        squared = ex * ex + ey * ey
        if squared < best:
            best = squared
            arc = arcs[i] + t * length
    return arc, math.sqrt(best)


@njit
def point_at(points, arcs, arc):  # type: ignore[no-untyped-def]
    """The point (x, y) of a polyline at an arc length [m]."""
    i = min(max(np.searchsorted(arcs, arc) - 1, 0), len(arcs) - 2)
    t = (arc - arcs[i]) / (arcs[i + 1] - arcs[i])
    t = min(max(t, 0.0), 1.0)
    return (
        points[i, 0] + t * (points[i + 1, 0] - points[i, 0]),
        points[i, 1] + t * (points[i + 1, 1] - points[i, 1]),
    )


@njit
def place_states(keys, x0, y0, cos0, sin0, step):  # type: ignore[no-untyped-def]
    """Positions [N, 2] m of states: p0 + step · R(θ0) · z."""
    out = np.empty((len(keys), 2))
    for i in range(len(keys)):
        zx, zy = 0.0, 0.0
        for j in range(8):
            coefficient = ((keys[i] >> (BITS * j)) & (2 * HALF - 1)) - HALF
            zx += coefficient * _BASIS_X[j]
            zy += coefficient * _BASIS_Y[j]
        out[i, 0] = x0 + step * (cos0 * zx - sin0 * zy)
        out[i, 1] = y0 + step * (sin0 * zx + cos0 * zy)
    return out


@njit
def expand_states(keys, done, stride):  # type: ignore[no-untyped-def]
    """Children of a layer: keys, parents, actions; a finished state is its own only child."""
    n = len(keys)
    child = np.empty(3 * n, np.int64)
    parent = np.empty(3 * n, np.int32)
    action = np.empty(3 * n, np.int8)
    count = 0
    low = (1 << HEADING_AT) - 1
    for i in range(n):
        key = keys[i]
        if done[i]:
            child[count], parent[count], action[count] = key, i, 0
            count += 1
            continue
        heading = (key >> HEADING_AT) & 31
        last = key >> LAST_AT
        place = key & low
        for a in (1, 2, 3):
            if last + a == 5:  # LEFT after RIGHT or RIGHT after LEFT
                continue
            if a == 1:
                place_after = place + _FORWARD_KEY[heading]
                after = heading
            else:
                place_after = place
                after = (heading + (stride if a == 2 else HEADINGS - stride)) % HEADINGS
            child[count] = place_after | (after << HEADING_AT) | (a << LAST_AT)
            parent[count], action[count] = i, a
            count += 1
    return child[:count], parent[:count], action[:count]


@njit
def check_moves(blocked, ox, oy, resolution, before, after, parent, action):  # type: ignore[no-untyped-def]
    """Which children [M] the map allows: each FORWARD is traced as the simulator does."""
    free = np.ones(len(action), np.bool_)
    for i in range(len(action)):
        if action[i] == 1:
            p = parent[i]
            free[i] = not trace_points(
                blocked, ox, oy, resolution, before[p, 0], before[p, 1], after[i, 0], after[i, 1]
            )[2]
    return free


@njit
def shun_bumps(free, before, after, parent, action, bumps):  # type: ignore[no-untyped-def]
    """Bar each FORWARD that passes within `BUMP_RADIUS` of a place where the agent was stopped."""
    for i in range(len(action)):
        if action[i] != 1 or not free[i]:
            continue
        ax, ay = before[parent[i], 0], before[parent[i], 1]
        dx, dy = after[i, 0] - ax, after[i, 1] - ay
        length = dx * dx + dy * dy
        for k in range(len(bumps)):
            t = ((bumps[k, 0] - ax) * dx + (bumps[k, 1] - ay) * dy) / length
            t = min(max(t, 0.0), 1.0)
            ex, ey = bumps[k, 0] - ax - t * dx, bumps[k, 1] - ay - t * dy
            if ex * ex + ey * ey < BUMP_RADIUS * BUMP_RADIUS:
                free[i] = False
                break


@njit
def merge_states(  # type: ignore[no-untyped-def]
    child, parent, action, places, free, cost, arc, away, points, arcs, window, end_radius, weights
):
    """Charge each free child and keep the cheapest of equal states, the first among equals."""
    n = len(child)
    size = 16
    while size < 2 * n + 2:
        size *= 2
    table = np.full(size, -1, np.int32)
    out = np.empty(n, np.int32)
    new_cost = np.empty(n)
    new_arc = np.empty(n)
    new_away = np.empty(n)
    done = np.zeros(n, np.bool_)
    count = 0
    for i in range(n):
        if not free[i]:
            continue
        p = parent[i]
        a = action[i]
        if a == 0:
            total, s, d, finished = cost[p], arc[p], away[p], True
        else:
            if a == 1:
                s, d = project(points, arcs, window[0], window[1], places[i, 0], places[i, 1])
            else:
                s, d = arc[p], away[p]
            total = cost[p] + weights[0] + (weights[1] if a != 1 else 0.0)
            excess = d - weights[3]
            if excess > 0:
                total += weights[2] * excess * excess
            if s < arc[p]:
                total += weights[4] * (s - arc[p]) * (s - arc[p])
            ex, ey = places[i, 0] - points[-1, 0], places[i, 1] - points[-1, 1]
            finished = a == 1 and ex * ex + ey * ey <= end_radius * end_radius
        key = child[i]
        slot = ((key * 2654435761) ^ (key >> 29)) & (size - 1)
        while table[slot] >= 0 and child[out[table[slot]]] != key:
            slot = (slot + 1) & (size - 1)
        k = table[slot]
        if k < 0:
            k = count
            table[slot] = k
            count += 1
        elif total >= new_cost[k]:
            continue
        out[k], new_cost[k], new_arc[k], new_away[k], done[k] = i, total, s, d, finished
    return out[:count], new_cost[:count], new_arc[:count], new_away[:count], done[:count]


@njit
def end_costs(keys, places, cost, arc, done, points, arcs, yaw0, turn, ahead, weights):  # type: ignore[no-untyped-def]
    """Costs [N] with what is left to do: remaining path, and turns to face along it."""
    out = cost.copy()
    for i in range(len(keys)):
        if done[i]:
            continue
        tx, ty = point_at(points, arcs, arc[i] + ahead)
        heading = yaw0 + ((keys[i] >> HEADING_AT) & 31) * (2 * math.pi / HEADINGS)
        error = math.atan2(ty - places[i, 1], tx - places[i, 0]) - heading
        error = abs(error - 2 * math.pi * round(error / (2 * math.pi)))
        out[i] += weights[5] * (arcs[-1] - arc[i])
        out[i] += weights[6] * max(0.0, error - turn / 2) / turn
    return out
