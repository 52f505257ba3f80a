"""Kernels of the field expert: what to do next, by the distance field and one step ahead.

`sim/kernels/expert.cu` does the same operation by operation, so both give the same bits. Cosines
and sines come from tables made with Python's own `math`.
"""

from __future__ import annotations

import math

import numpy as np

from gn0.jit import njit
from gn0.maps.ray import is_blocked, trace_points
from gn0.maps.slide import slide_points
from gn0.maps.way_kernels import FAR_POINTS, gather_bends, is_clear, spread_points
from gn0.paper import FORWARD, LEFT, RIGHT

TURN_PRICE = 0.48  # steps that turning a full circle costs: 0.005 m for 15 degrees before 0.25 m
GAIN = 0.16  # steps that a step must come nearer to the goal, or it counts as none
GAIN_TWO = 0.48  # two steps together; more than turning half a circle costs and twice GAIN
AHEAD, ENTERED = 4, 64  # steps that must lead on from where a step ends; places looked at for it
WALK = 8  # steps after which a step back must have paid
LITTLE = 0.004  # the same of steps that may be cut short
CUT, STRAY = 4.0, 16.0  # steps that it costs to be cut short, and to come no nearer


@njit(inline="always")
def _turns_of(j):  # type: ignore[no-untyped-def]
    """Turns, left positive, to the j-th heading to be looked at: 0, 1, −1, 2, −2 and so on."""
    return (j + 1) // 2 if j % 2 else -(j // 2)


@njit
def look_around(ground, field, near, x, y):  # type: ignore[no-untyped-def]
    """Geodesic distance [m] of a free point, and whether the expert stops there.

    It does near the goal on foot and in a straight line, in sight of it; of an area, inside.
    """
    blocked, origin_x, origin_y, resolution = ground
    label, roots, goals = field
    u, v = (x - origin_x) / resolution, (y - origin_y) / resolution
    root = label[int(v), int(u)]
    if root < 0:
        return np.inf, False
    dx, dy = u - roots[root, 0], v - roots[root, 1]
    away = max(roots[root, 2] + math.sqrt(dx * dx + dy * dy), 0.0) * resolution
    if roots[root, 2] == -np.inf:
        return away, True
    if away <= near:
        for g in range(len(goals)):
            dx, dy = x - goals[g, 0], y - goals[g, 1]
            if math.sqrt(dx * dx + dy * dy) <= near:
                _, _, hit = trace_points(
                    blocked, origin_x, origin_y, resolution, x, y, goals[g, 0], goals[g, 1]
                )
                if not hit:
                    return away, True
    return away, False


@njit
def _move(ground, slides, x, y, x1, y1):  # type: ignore[no-untyped-def]
    """The simulator's own move."""
    blocked, origin_x, origin_y, resolution = ground
    if slides:
        return slide_points(blocked, origin_x, origin_y, resolution, x, y, x1, y1)
    return trace_points(blocked, origin_x, origin_y, resolution, x, y, x1, y1)


@njit
def _try_step(ground, field, headings, step, near, x, y, k):  # type: ignore[no-untyped-def]
    """Where a whole step along heading k leads, and what is left from there [m].

    What is left is inf where the step is cut short, and less than nothing where the expert stops.
    """
    x1, y1 = x + step * headings[k, 1], y + step * headings[k, 2]
    _, _, hit = _move(ground, False, x, y, x1, y1)
    if hit:
        return x1, y1, np.inf
    away, there = look_around(ground, field, near, x1, y1)
    return x1, y1, -step if there else away


@njit
def _goes_on(ground, field, headings, step, near, x, y, turn, left, stack):  # type: ignore[no-untyped-def]
    """Whether whole steps, each of them nearer to the goal, lead on from a place: `AHEAD` of them.

    `left` [m] is what is left there. Straight on is tried first, and `ENTERED` places at most.
    `stack` [AHEAD, 5] is room to work in.
    """
    circle = len(headings)
    if left < 0.0:
        return True
    depth, entered = 0, 1
    stack[0, 0], stack[0, 1], stack[0, 2], stack[0, 3], stack[0, 4] = x, y, turn, left, 0
    while depth >= 0:
        x, y, left = stack[depth, 0], stack[depth, 1], stack[depth, 3]
        turn, j = int(stack[depth, 2]), int(stack[depth, 4])
        if j == circle:
            depth -= 1
            continue
        stack[depth, 4] = j + 1
        k = (turn + _turns_of(j) + circle) % circle
        x1, y1, after = _try_step(ground, field, headings, step, near, x, y, k)
        if after > left - GAIN * step:
            continue
        if after < 0.0 or depth == AHEAD - 1:
            return True
        if entered == ENTERED:
            return False
        entered += 1
        depth += 1
        stack[depth, 0], stack[depth, 1], stack[depth, 2] = x1, y1, k
        stack[depth, 3], stack[depth, 4] = after, 0
    return False


@njit
def _look_one_ahead(  # type: ignore[no-untyped-def]
    ground, field, headings, step, near, x, y, turn, most, any_end, costs, stack
):
    """The cheapest whole step to a place with `most` [m] or less left from which it goes on.

    Returns its cost [m], inf where there is none, and the number of its heading. With `any_end`
    it need not go on there. `costs` [circle] and `stack` are room to work in.
    """
    circle = len(headings)
    price = TURN_PRICE * step / circle
    for j in range(circle):
        turns = _turns_of(j)
        k = (turn + turns + circle) % circle
        _, _, left = _try_step(ground, field, headings, step, near, x, y, k)
        costs[j] = left + price * abs(turns) if left <= most else np.inf
    while True:
        chosen = np.argmin(costs)
        cost = costs[chosen]
        if cost == np.inf or any_end:
            return cost, chosen
        k = (turn + _turns_of(chosen) + circle) % circle
        x1, y1, left = _try_step(ground, field, headings, step, near, x, y, k)
        if _goes_on(ground, field, headings, step, near, x1, y1, k, left, stack):
            return cost, chosen
        costs[chosen] = np.inf


@njit
def _look_two_ahead(ground, field, headings, step, near, x, y, turn, here, costs, stack):  # type: ignore[no-untyped-def]
    """Cost [m] and number of the best heading for one whole step, or else for two.

    The first of two may lead away from the goal. The cost is inf where neither will do.
    """
    circle = len(headings)
    price = TURN_PRICE * step / circle
    most = here - GAIN * step
    best, chosen = _look_one_ahead(
        ground, field, headings, step, near, x, y, turn, most, False, costs, stack
    )
    if best < np.inf:
        return best, chosen
    most = here - GAIN_TWO * step
    for j in range(circle):
        turns = _turns_of(j)
        k = (turn + turns + circle) % circle
        x1, y1, left = _try_step(ground, field, headings, step, near, x, y, k)
        if left == np.inf:
            continue
        cost, _ = _look_one_ahead(
            ground, field, headings, step, near, x1, y1, k, most, False, costs, stack
        )
        cost += price * abs(turns)
        if cost < best:
            best, chosen = cost, j
    return best, chosen


@njit
def _try_walk(ground, field, headings, step, near, x, y, turn, here, costs, stack):  # type: ignore[no-untyped-def]
    """Metres to the goal by way of a first step, whole, and what is done from there on.

    As far as `WALK` steps lead nearer than `here` [m]; inf where they do not.
    """
    circle = len(headings)
    x, y, left = _try_step(ground, field, headings, step, near, x, y, turn)
    for count in range(1, WALK):
        if left == np.inf:
            break
        if count > 1 and left <= here - GAIN * step:
            return left + count * step
        cost, chosen = _look_two_ahead(
            ground, field, headings, step, near, x, y, turn, left, costs, stack
        )
        if cost == np.inf:
            break
        turn = (turn + _turns_of(chosen) + circle) % circle
        x, y, left = _try_step(ground, field, headings, step, near, x, y, turn)
    return np.inf


@njit
def choose_turns(ground, field, headings, step, slides, near, x, y, turn, here):  # type: ignore[no-untyped-def]
    """Turns, left positive, before the next FORWARD of an expert that is `here` [m] from the goal.

    What is chosen depends on the heading through the price of turns alone, so turning there never
    changes it. Each choice leads nearer to the goal within a few steps, so no place is met again.
    """
    circle = len(headings)
    price = TURN_PRICE * step / circle
    costs, stack = np.empty(circle), np.empty((AHEAD, 5))
    best, chosen = _look_two_ahead(
        ground, field, headings, step, near, x, y, turn, here, costs, stack
    )
    if best < np.inf:
        return _turns_of(chosen)
    for j in range(circle):  # back, and at it again
        turns = _turns_of(j)
        k = (turn + turns + circle) % circle
        cost = _try_walk(ground, field, headings, step, near, x, y, k, here, costs, stack)
        cost += price * abs(turns)
        if cost < best:
            best, chosen = cost, j
    if best < np.inf:
        return _turns_of(chosen)
    most = here - GAIN * step
    best, chosen = _look_one_ahead(  # into a nook, if need be
        ground, field, headings, step, near, x, y, turn, most, True, costs, stack
    )
    if best < np.inf:
        return _turns_of(chosen)
    for j in range(circle):  # out of a nook, cut short or not
        turns = _turns_of(j)
        k = (turn + turns + circle) % circle
        x1, y1, hit = _move(
            ground, slides, x, y, x + step * headings[k, 1], y + step * headings[k, 2]
        )
        if x1 == x and y1 == y:
            continue
        away, there = look_around(ground, field, near, x1, y1)
        cost = (-step if there else away) + price * abs(turns)
        if hit:
            cost += CUT * step
        if not there and away > here - LITTLE * step:
            cost += STRAY * step
        if cost < best:
            best, chosen = cost, j
    return _turns_of(chosen)


@njit
def follow_field(ground, field, headings, step, slides, near, x, y, turn, out):  # type: ignore[no-untyped-def]
    """The next actions of the field expert into `out` [T], STOP from the end on.

    Returns the distance [m] of where it begins, and how many actions come before the STOP.
    """
    circle = len(headings)
    out[:] = 0
    count = 0
    begin, there = look_around(ground, field, near, x, y)
    here = begin
    while not there and here < np.inf and count < len(out):
        turns = choose_turns(ground, field, headings, step, slides, near, x, y, turn, here)
        for _ in range(abs(turns)):
            if count < len(out):
                out[count] = LEFT if turns > 0 else RIGHT
                count += 1
        turn = (turn + turns + circle) % circle
        if count < len(out):
            out[count] = FORWARD
            count += 1
            x1, y1 = x + step * headings[turn, 1], y + step * headings[turn, 2]
            x, y, _ = _move(ground, slides, x, y, x1, y1)
            here, there = look_around(ground, field, near, x, y)
    return begin, count


@njit
def _lower_cell(blocked, label, roots, row, col, away):  # type: ignore[no-untyped-def]
    """The cell beside a cell whose centre is nearest the goal: (row, col, cells to go).

    Itself when no centre that it sees is nearer.
    """
    best, best_row, best_col = away, row, col
    for i in range(-1, 2):
        for j in range(-1, 2):
            if is_blocked(blocked, row + i, col + j) or label[row + i, col + j] < 0:
                continue
            if is_blocked(blocked, row + i, col) or is_blocked(blocked, row, col + j):
                continue
            root = label[row + i, col + j]
            dx, dy = col + j + 0.5 - roots[root, 0], row + i + 0.5 - roots[root, 1]
            left = max(roots[root, 2] + math.sqrt(dx * dx + dy * dy), 0.0)
            if left < best:
                best, best_row, best_col = left, row + i, col + j
    return best_row, best_col, best


@njit
def gather_way(points, ground, field, ways, x, y):  # type: ignore[no-untyped-def]
    """Write the way [K, 2] m from a place to the goal; returns K.

    Where the place does not see its first bend, it goes down the field from cell to cell until
    one does. A way of more than `FAR_POINTS` ends early.
    """
    blocked, origin_x, origin_y, resolution = ground
    label, roots, _ = field
    parents, places, via_start, vias = ways
    col = math.floor((x - origin_x) / resolution)
    row = math.floor((y - origin_y) / resolution)
    points[0, 0], points[0, 1] = x, y
    count, away = 1, np.inf
    while True:
        root = label[row, col]
        if math.isnan(places[root, 0]):  # in the goal's area the way ends here
            return count
        if is_clear(
            blocked, origin_x, origin_y, resolution, points[count - 1, 0], points[count - 1, 1],
            places[root, 0], places[root, 1],
        ):  # fmt: skip
            count, _ = gather_bends(points, count, root, parents, places, via_start, vias)
            return count
        before = away
        if count == 1:  # to the middle of its own cell first
            dx, dy = col + 0.5 - roots[root, 0], row + 0.5 - roots[root, 1]
            away = roots[root, 2] + math.sqrt(dx * dx + dy * dy)
        else:
            row, col, away = _lower_cell(blocked, label, roots, row, col, away)
        if away >= before or count == FAR_POINTS - 1:
            return count
        points[count, 0] = origin_x + (col + 0.5) * resolution
        points[count, 1] = origin_y + (row + 0.5) * resolution
        count += 1


@njit
def label_field_states(  # type: ignore[no-untyped-def]
    ground, field, ways, headings, step, slides, near, spacing, states, turns, which,
    actions, waypoints, valid, distance,
):  # fmt: skip
    """Labels of N states by the field expert.

    Args (arrays): states [N, 2] m in free cells; turns [N] and which [N] of headings [M, circle, 3]
    say which way each looks. Writes actions [N, 6], waypoints [N, 13, 2] m in the agents' frames,
    valid [N], 0 where no way leads to the goal, and distance [N] m.
    """
    points = np.empty((FAR_POINTS, 2))
    spread = np.empty((waypoints.shape[1], 2))
    frame = (ground[1], ground[2], ground[3])
    for i in range(len(states)):
        x, y = states[i, 0], states[i, 1]
        table = headings[which[i]]
        distance[i], _ = follow_field(
            ground, field, table, step, slides, near, x, y, turns[i], actions[i]
        )
        valid[i] = 0
        waypoints[i] = 0.0
        if distance[i] == np.inf:
            continue
        count = gather_way(points, ground, field, ways, x, y)
        heading = (table[turns[i], 1], table[turns[i], 2])
        valid[i] = spread_points(
            points, count, ground[0], frame, spacing, heading, spread, len(spread)
        )
        for k in range(len(spread)):
            waypoints[i, k, 0] = np.float32(spread[k, 0])
            waypoints[i, k, 1] = np.float32(spread[k, 1])
