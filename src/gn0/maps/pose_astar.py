"""A* over poses: the actions themselves are the edges, so the plan is what the agent will do.

A grid path has to be followed, and following costs length at every corner. This search expands
FORWARD, LEFT and RIGHT from the agent's exact pose, with the simulator's own collision rule, so
its plan replays without error. Poses that share a sub-cell and a heading are merged, the cheapest
kept (as in hybrid A*, Dolgov et al. 2010, with exact positions instead of a motion model).

The cost is travelled length plus a small price for a turn. The heuristic is the geodesic distance
to the goal, which understates it: `weight` bounds how far from the best plan one may end.
"""

from __future__ import annotations

import heapq
import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from gn0.errors import PlanError
from gn0.jit import njit
from gn0.maps.distance import GeodesicField
from gn0.maps.ray import trace_points
from gn0.paper import FORWARD_STEP

SUBCELLS = 2  # merging bins along a cell's edge, unless told otherwise
NODES = 3_000_000  # poses looked at before the weight is raised
WEIGHTS = (1.01, 1.05, 1.2, 2.0, 10.0)


@njit
def _gap(a, b):  # type: ignore[no-untyped-def]
    """Angle [rad] between two directions, 0..π."""
    return abs((a - b + math.pi) % (2.0 * math.pi) - math.pi)


@njit
def _bends(roots, parents):  # type: ignore[no-untyped-def]
    """Direction [R] rad of the leg that leaves each root, and the bending [R] rad after it."""
    onward = np.zeros(len(roots))
    bending = np.zeros(len(roots))
    for root in np.argsort(roots[:, 2]):  # parents before children
        parent = parents[root]
        if parent < 0:
            continue
        onward[root] = math.atan2(
            roots[parent, 1] - roots[root, 1], roots[parent, 0] - roots[root, 0]
        )
        if parents[parent] >= 0:
            bending[root] = bending[parent] + _gap(onward[root], onward[parent])
    return onward, bending


@njit
def _way_on(label, roots, u, v, near):  # type: ignore[no-untyped-def]
    """What lies ahead of a place (u, v) in cells, whichever way one faces there.

    The root that the place sees, the geodesic distance [cells] to the goal, whether the root is
    near, and the bearing of the root [rad] where it is not.
    """
    root = label[math.floor(v), math.floor(u)]
    if root < 0:
        return root, math.inf, False, 0.0
    dx, dy = roots[root, 0] - u, roots[root, 1] - v
    distance = math.hypot(dx, dy)
    if distance <= near:
        return root, roots[root, 2] + distance, True, 0.0
    return root, roots[root, 2] + distance, False, math.atan2(dy, dx)


@njit
def _turning_left(root, parents, close, bearing, onward, bending, yaw):  # type: ignore[no-untyped-def]
    """The turning [rad] that is left to the goal from a place when facing `yaw`."""
    if parents[root] < 0:
        return 0.0 if close else _gap(bearing, yaw)
    if close:  # a bend this close may be cut: only the next leg counts
        return _gap(onward[root], yaw) + bending[root]
    return _gap(bearing, yaw) + _gap(onward[root], bearing) + bending[root]


@njit
def _slot_of(keys, key):  # type: ignore[no-untyped-def]
    """Slot of a key in an open-addressed table: its own, or the empty one (−1) it would take."""
    mask = len(keys) - 1
    slot = ((key * 2654435761) >> 7) & mask
    while keys[slot] != -1 and keys[slot] != key:
        slot = (slot + 1) & mask
    return slot


@njit
def _grown(keys, costs):  # type: ignore[no-untyped-def]
    bigger = np.full(2 * len(keys), -1, np.int64)
    moved = np.empty(2 * len(keys))
    for i in range(len(keys)):
        if keys[i] != -1:
            slot = _slot_of(bigger, keys[i])
            bigger[slot] = keys[i]
            moved[slot] = costs[i]
    return bigger, moved


@njit
def _search(  # type: ignore[no-untyped-def]
    blocked, origin_x, origin_y, resolution, label, roots, bend_parents, yaws, cosines, sines,
    x0, y0, goals, tolerance, step, turn_cost, weight, subcells, limit,
):  # fmt: skip
    """Actions [T] int8 of the plan, and whether one was found within `limit` poses."""
    headings = len(cosines)
    width = blocked.shape[1]
    capacity = 1 << 14
    xs, ys, costs = np.empty(capacity), np.empty(capacity), np.empty(capacity)
    came_from = np.empty(capacity, np.int32)
    facing = np.empty(capacity, np.int32)
    actions = np.zeros(capacity, np.int8)
    keys, best = np.full(1 << 16, -1, np.int64), np.empty(1 << 16)
    used = 1
    xs[0], ys[0], costs[0], came_from[0], facing[0] = x0, y0, 0.0, -1, 0
    count = 1
    u, v = (x0 - origin_x) / resolution, (y0 - origin_y) / resolution
    onward, bending = _bends(roots, bend_parents)
    near = max(tolerance, 1.5 * step) / resolution
    a_turn = 2.0 * math.pi / headings
    _, left, _, _ = _way_on(label, roots, u, v, near)
    heap = [(weight * max(left * resolution - tolerance, 0.0), 0)]
    bins = width * subcells
    while len(heap) > 0:
        _, node = heapq.heappop(heap)
        x, y, k, g = xs[node], ys[node], facing[node], costs[node]
        u, v = (x - origin_x) / resolution, (y - origin_y) / resolution
        here = _way_on(label, roots, u, v, near)
        left = here[1]
        if left * resolution <= tolerance:
            there = left == -math.inf  # in an area
            for k_goal in range(len(goals)):
                goal_x, goal_y = goals[k_goal, 0], goals[k_goal, 1]
                if there or math.hypot(goal_x - x, goal_y - y) > tolerance:
                    continue
                _, _, hit = trace_points(
                    blocked, origin_x, origin_y, resolution, x, y, goal_x, goal_y
                )
                there = not hit
            if there:
                length = 0
                i = node
                while came_from[i] >= 0:
                    length += 1
                    i = came_from[i]
                plan = np.empty(length, np.int8)
                i = node
                while came_from[i] >= 0:
                    length -= 1
                    plan[length] = actions[i]
                    i = came_from[i]
                return plan, True
        key = (int(v * subcells) * bins + int(u * subcells)) * headings + k
        slot = _slot_of(keys, key)
        if keys[slot] == key and best[slot] < g:
            continue  # a cheaper pose took this place after the push
        before = actions[node]
        for action in (1, 2, 3):
            if action == 1:
                nx, ny = x + step * cosines[k], y + step * sines[k]
                nk, ng = k, g + step
            else:
                if before + action == 5:
                    continue  # LEFT after RIGHT or RIGHT after LEFT undoes itself
                nx, ny = x, y
                nk = k + 1 if action == 2 else k - 1
                nk = nk - headings if nk >= headings else (nk + headings if nk < 0 else nk)
                ng = g + turn_cost
            u, v = (nx - origin_x) / resolution, (ny - origin_y) / resolution
            key = (int(v * subcells) * bins + int(u * subcells)) * headings + nk
            slot = _slot_of(keys, key)
            if keys[slot] == key and best[slot] <= ng + 1e-9:
                continue  # as good a pose is there already: no need to look whether this one is
            if action == 1:
                _, _, hit = trace_points(blocked, origin_x, origin_y, resolution, x, y, nx, ny)
                if hit:
                    continue
            place = _way_on(label, roots, u, v, near) if action == 1 else here
            root, left, close, bearing = place
            if not left < math.inf:
                continue
            turning = _turning_left(root, bend_parents, close, bearing, onward, bending, yaws[nk])
            if keys[slot] != key:
                keys[slot] = key
                used += 1
            best[slot] = ng
            if 2 * used > len(keys):
                keys, best = _grown(keys, best)
            if count == len(xs):
                if count >= limit:
                    return np.empty(0, np.int8), False
                xs, ys = np.concatenate((xs, xs)), np.concatenate((ys, ys))
                costs = np.concatenate((costs, costs))
                came_from = np.concatenate((came_from, came_from))
                facing = np.concatenate((facing, facing))
                actions = np.concatenate((actions, actions))
            xs[count], ys[count], costs[count] = nx, ny, ng
            came_from[count], facing[count], actions[count] = node, nk, action
            ahead = max(left * resolution - tolerance, 0.0)
            ahead += turn_cost * max(turning / a_turn - 1.0, 0.0)
            heapq.heappush(heap, (ng + weight * ahead, count))
            count += 1
    return np.empty(0, np.int8), False


def plan_actions(
    field: GeodesicField,
    start: tuple[float, float],
    yaws: Sequence[float],
    *,
    tolerance: float = 0.25,
    step: float = FORWARD_STEP,
    turn_cost: float = 0.02,
    weight: float = WEIGHTS[0],
    subcells: int = SUBCELLS,
) -> NDArray[np.int8]:
    """A collision-free plan of actions to within `tolerance` of the goal, in line of sight of it.

    Near means near on foot as well: the geodesic distance is within `tolerance`, too. In an area
    the plan ends with the first step inside.

    Args:
        field: distances to the goal on the agent's inflated grid.
        start: (x, y) m, in a free cell.
        yaws: the headings [n] rad that LEFT leads through, the current one first; LEFT from the
            last gives the first again.
        tolerance: distance to the goal at which the plan may end [m].
        step: length of FORWARD [m].
        turn_cost: price of a turn [m of travel]; above 0, so no plan wiggles.
        weight: how much dearer than the cheapest the plan may be, 1 for not at all; what is looked
            at, and so the time, shrinks quickly with it. Raised where no plan is found in time.
        subcells: merging bins along a cell's edge: with fewer more poses count as one.

    Returns:
        int8 [T] of 1 FORWARD, 2 LEFT, 3 RIGHT; empty when the start is near enough.

    Raises:
        PlanError: no plan exists.
    """
    grid = field.grid
    angles = np.array(yaws, np.float64)
    cosines = np.array([math.cos(yaw) for yaw in yaws])  # libm, as the simulator's own
    sines = np.array([math.sin(yaw) for yaw in yaws])
    # of an area only its inside counts; a step may end there half a cell before the rim's centre
    goals = field.goals if field.inside is None else np.empty((0, 2))
    near = float(tolerance) if field.inside is None else float(grid.resolution)
    if math.isfinite(field.distance_at(*start)):
        for bound in (weight, *(w for w in WEIGHTS if w > weight)):
            plan, found = _search(
                grid.blocked, float(grid.origin[0]), float(grid.origin[1]), float(grid.resolution),
                field.label, field.roots, field.parents, angles, cosines, sines,
                float(start[0]), float(start[1]), goals, near, float(step),
                float(turn_cost), float(bound), subcells, NODES,
            )  # fmt: skip
            if found:
                return plan
    raise PlanError(
        f"no plan of actions from {start} to within {tolerance:g} m of {field.goal}",
        remedy="check that both are walkable and in one region",
    )
