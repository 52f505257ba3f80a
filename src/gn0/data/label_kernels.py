"""The kernel of the tracking search of label variant `mpc`."""

from __future__ import annotations

import numpy as np

from gn0.jit import njit
from gn0.maps.lattice_states import project


@njit
def merge_tracking(  # type: ignore[no-untyped-def]
    child, parent, action, places, free, cost, turns, points, arcs, end_radius, discount
):
    """Charge each free child γ^k·d² and keep the best of equal states, among equals the calmest.

    Returns kept indices, costs, turns, arcs and whether a state is at the end, [M] each.
    """
    n = len(child)
    size = 16
    while size < 2 * n + 2:
        size *= 2
    table = np.full(size, -1, np.int32)
    out = np.empty(n, np.int32)
    new_cost, new_arc = np.empty(n), np.empty(n)
    new_turns = np.zeros(n, np.int32)
    done = np.zeros(n, np.bool_)
    count = 0
    for i in range(n):
        if not free[i]:
            continue
        p, a = parent[i], action[i]
        s, d = project(points, arcs, 0, len(points) - 1, places[i, 0], places[i, 1])
        total = cost[p] if a == 0 else cost[p] + discount * d * d
        turned = turns[p] + (1 if a > 1 else 0)
        ex, ey = places[i, 0] - points[-1, 0], places[i, 1] - points[-1, 1]
        finished = a == 0 or (a == 1 and ex * ex + ey * ey <= end_radius * end_radius)
        key = child[i]
        slot = ((key * 2654435761) ^ (key >> 29)) & (size - 1)
        while table[slot] >= 0 and child[out[table[slot]]] != key:
            slot = (slot + 1) & (size - 1)
        k = table[slot]
        if k < 0:
            k = count
            table[slot] = k
            count += 1
        elif total > new_cost[k] or (total == new_cost[k] and turned >= new_turns[k]):
            continue
        out[k], new_cost[k], new_turns[k], new_arc[k], done[k] = i, total, turned, s, finished
    return out[:count], new_cost[:count], new_turns[:count], new_arc[:count], done[:count]
