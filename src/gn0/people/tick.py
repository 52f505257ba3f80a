"""One tick of the people of one episode, as kernels: `tick_people`, which batches call as well.

See `gn0.people.crowd` for what it does, and `gn0.people.reach` for the columns of the state.
"""

# mypy: disable-error-code="no-untyped-def"

from __future__ import annotations

import math

from gn0.jit import njit_borrowing
from gn0.people.detour import (
    choose_side,
    go_round,
)
from gn0.people.reach import (
    ALIGNED,
    ARRIVED,
    BACK_LEFT,
    BLOCKED_BY,
    CLAIM,
    CLAIM0,
    CLIP,
    CLIP_SINCE,
    CLOSE,
    COMFORT,
    DIRECTION,
    FX,
    FY,
    HOLD,
    HOLD_LEFT,
    HX,
    HY,
    LEAVE,
    LENT_LEFT,
    MODE,
    MOVED,
    NOBODY,
    ON_PATH,
    PIECE,
    PIVOT_COS,
    PIVOT_LAG,
    ROUND,
    ROUND_TICKS,
    SETTLE,
    SIDE,
    SIGHT,
    SPEED,
    STILL,
    TURN_SINCE,
    WAIT,
    WALK,
    WALKED,
    WAY,
    X0,
    Y0,
    X,
    Y,
    cap_speed,
    find_near,
    piece_at,
    place_at,
    room_ahead,
    share_allowed,
    turn_to,
)
from gn0.people.route import ACCELERATION, BRAKE, SCRIPT


@njit_borrowing(forceinline=True)
def tick_people(real, whole, route, walls, routes, wall_arrays, pace, agent, radius, e):
    """Everybody's next tick in episode `e`, in place; rows without a route stay as they are."""
    count = real.shape[1]
    for p in range(count):
        real[e, p, X0] = real[e, p, X]
        real[e, p, Y0] = real[e, p, Y]
        whole[e, p, CLAIM0] = whole[e, p, CLAIM]
    for p in range(count):
        r = route[e, p]
        if r < 0:
            continue
        was = whole[e, p, CLIP]
        hx, hy = real[e, p, HX], real[e, p, HY]
        if routes.table[r, 5] == SCRIPT:
            whole[e, p, BLOCKED_BY] = NOBODY
            if whole[e, p, BACK_LEFT] > 0:
                whole[e, p, BACK_LEFT] -= 1
                if whole[e, p, BACK_LEFT] == 0 and whole[e, p, MODE] == ON_PATH:
                    whole[e, p, DIRECTION] = 1
                elif whole[e, p, BACK_LEFT] == 0:
                    whole[e, p, BACK_LEFT] = 1
            if whole[e, p, LENT_LEFT] > 0:
                whole[e, p, LENT_LEFT] -= 1
                if whole[e, p, LENT_LEFT] == 0:
                    whole[e, p, CLAIM] = routes.table[r, 7]
            if whole[e, p, MODE] == ROUND:
                go_round(real, whole, route, walls, routes, wall_arrays, pace, agent, radius, e, p)
            else:
                _go_on(real, whole, route, walls, routes, wall_arrays, pace, agent, radius, e, p)
            dx, dy = real[e, p, X] - real[e, p, X0], real[e, p, Y] - real[e, p, Y0]
            gone = math.sqrt(dx * dx + dy * dy)
            real[e, p, WALKED] += gone
            limit = MOVED * pace.seconds
            whole[e, p, CLIP] = WALK if gone > limit else STILL
        if whole[e, p, CLIP] != was:
            whole[e, p, CLIP_SINCE] = 0
        else:
            whole[e, p, CLIP_SINCE] += 1
        _place_feet(real, whole, e, p, hx, hy)


@njit_borrowing(forceinline=True)
def _place_feet(real, whole, e, p, hx, hy):
    """Which way feet stand after a tick that began with a heading; decides on nothing but looks."""
    x, y = real[e, p, HX], real[e, p, HY]
    if whole[e, p, CLIP] == WALK:
        if whole[e, p, CLIP_SINCE] >= PIVOT_LAG:
            real[e, p, FX], real[e, p, FY] = x, y
            whole[e, p, TURN_SINCE] = SETTLE
        return
    if x != hx or y != hy:
        if whole[e, p, TURN_SINCE] >= SETTLE // 2:
            real[e, p, FX], real[e, p, FY] = hx, hy
        whole[e, p, TURN_SINCE] = 0
    elif whole[e, p, TURN_SINCE] < SETTLE:
        whole[e, p, TURN_SINCE] += 1
        if whole[e, p, TURN_SINCE] == SETTLE:
            real[e, p, FX], real[e, p, FY] = x, y
    fx, fy = real[e, p, FX], real[e, p, FY]
    for _ in range(4):
        if fx * x + fy * y > PIVOT_COS:
            break
        side = PIVOT_COS if fx * y - fy * x >= 0.0 else -PIVOT_COS
        fx, fy = fx * PIVOT_COS - fy * side, fx * side + fy * PIVOT_COS
        size = math.sqrt(fx * fx + fy * fy)
        fx, fy = fx / size, fy / size
        real[e, p, FX], real[e, p, FY] = fx, fy


@njit_borrowing(forceinline=True)
def _hold(real, whole, routes, pace, e, p, r, seconds):
    """Stand at a stop for so long, or begin to; the seconds that are left after it."""
    last = routes.table[r, 3]
    while seconds > 0.0:
        hold = routes.table[r, 2] + whole[e, p, HOLD]
        if real[e, p, HOLD_LEFT] <= 0.0:
            if hold >= last or real[e, p, WAY] < routes.holds[hold, 0] - CLOSE:
                break
            real[e, p, HOLD_LEFT] = routes.holds[hold, 1]
        use = min(real[e, p, HOLD_LEFT], seconds)
        turn_to(real, pace, e, p, routes.holds[hold, 2], routes.holds[hold, 3], use)
        real[e, p, HOLD_LEFT] -= use
        seconds -= use
        if real[e, p, HOLD_LEFT] <= 1e-9:
            real[e, p, HOLD_LEFT] = 0.0
            whole[e, p, HOLD] += 1
        if seconds < 1e-9:
            seconds = 0.0
    return seconds


@njit_borrowing(forceinline=True)
def _advance(real, whole, routes, pace, e, p, r, dt, ahead):
    """Walk, turn or stand on the path for a part of a tick, `ahead` [m] of it being free.

    Ways, speed and heading change; the place on the plane is the caller's. Returns the way gone.
    """
    sign, way, v = whole[e, p, DIRECTION], real[e, p, WAY], real[e, p, SPEED]
    length, first = routes.lines[r, 1], routes.table[r, 0]
    hold, last_hold = routes.table[r, 2] + whole[e, p, HOLD], routes.table[r, 3]
    # who came here backwards, over the seam of a loop, is past these
    while sign > 0 and hold < last_hold and routes.holds[hold, 0] < way - 0.01:
        whole[e, p, HOLD] += 1
        hold += 1
    holds = sign > 0 and hold < last_hold
    if real[e, p, HOLD_LEFT] > 0.0 or (holds and way >= routes.holds[hold, 0] - CLOSE and v < 0.09):
        real[e, p, SPEED] = v = 0.0
        dt = _hold(real, whole, routes, pace, e, p, r, dt)
        if dt <= 0.0:
            return 0.0
        hold = routes.table[r, 2] + whole[e, p, HOLD]
        holds = hold < last_hold
    if sign > 0 and way >= length:
        if routes.table[r, 4] == 2:
            way, whole[e, p, PIECE], whole[e, p, HOLD] = way - length, 0, 0
            hold = routes.table[r, 2]
            holds = hold < last_hold
        elif routes.table[r, 4] == 1:
            whole[e, p, DIRECTION] = sign = -1
            holds = False
        else:
            whole[e, p, MODE] = ARRIVED
            real[e, p, SPEED] = 0.0
            return 0.0
    elif sign < 0 and way <= 0.0 and routes.table[r, 4] == 1:
        whole[e, p, DIRECTION] = sign = 1
        whole[e, p, HOLD] = 0
        hold = routes.table[r, 2]
        holds = hold < last_hold
    elif sign < 0 and way <= 0.0 and routes.table[r, 4] == 2:
        way, whole[e, p, PIECE] = way + length, routes.table[r, 1] - first - 2
    elif sign < 0 and way <= 0.0:  # turned back to the very start
        whole[e, p, DIRECTION], whole[e, p, BACK_LEFT] = 1, 0
        real[e, p, SPEED] = 0.0
        return 0.0
    piece = piece_at(routes, r, way, whole[e, p, PIECE])
    if sign < 0 and piece > 0 and way <= routes.points[first + piece, 4]:
        piece -= 1  # at a point that one walks away from backwards
    tx, ty = sign * routes.points[first + piece, 2], sign * routes.points[first + piece, 3]
    before = real[e, p, HX] * tx + real[e, p, HY] * ty
    aligned = turn_to(real, pace, e, p, tx, ty, dt)
    want = routes.lines[r, 0] if aligned >= ALIGNED else 0.0
    if before < ALIGNED <= aligned:  # who comes to face its way goes for what is left of the time
        dt = dt * ((aligned - ALIGNED) / (aligned - before))
    # bends: the next points
    k = piece + 1 if sign > 0 else piece
    points = routes.table[r, 1] - first
    while 0 <= k < points:
        room = sign * (routes.points[first + k, 4] - way)
        if room > 0.0:
            limit = routes.points[first + k, 5] if sign > 0 else routes.points[first + k, 6]
            if 0.5 * (v + limit) * dt < room:  # limits there are such that all later ones are kept
                want = min(want, cap_speed(v, limit, room, dt))
                break
            want = min(want, limit)  # passed by then
        k += sign
    end = length if sign > 0 else 0.0
    if holds:
        end = routes.holds[hold, 0]
    stands = holds or routes.table[r, 4] != 2
    left = max(sign * (end - way), 0.0)
    if stands:
        want = min(want, cap_speed(v, 0.0, left, dt))
    if ahead < SIGHT:
        want = min(want, cap_speed(v, 0.0, max(ahead - COMFORT, 0.0), dt))
    now = min(want, v + ACCELERATION * dt * 0.875)
    now = max(now, v - ACCELERATION * dt, 0.0)
    step = 0.5 * (v + now) * dt
    there, spare = way + sign * step, 0.0
    if stands and step >= left - CLOSE:
        step, there, now = left, end, max(v - ACCELERATION * dt, 0.0)
        if v + now > 0.0:
            spare = max(dt - 2.0 * step / (v + now), 0.0)
    elif sign > 0 and there > length:  # around a loop again
        there, whole[e, p, HOLD], piece = there - length, 0, 0
    elif there < 0.0:
        there, piece = there + length, routes.table[r, 1] - first - 2
    real[e, p, WAY], real[e, p, SPEED] = there, now
    whole[e, p, PIECE] = after = piece_at(routes, r, there, piece)
    if spare > 0.0 and now <= 0.0 and there == end:
        if holds:
            _hold(real, whole, routes, pace, e, p, r, spare)
        elif routes.table[r, 4] == 1:
            turn_to(real, pace, e, p, -tx, -ty, spare)
    elif after != piece and now > 0.0:
        tx = sign * routes.points[first + after, 2]
        ty = sign * routes.points[first + after, 3]
        if real[e, p, HX] * tx + real[e, p, HY] * ty < ALIGNED:
            # a sharp bend: turn for what is left of the time after it
            bend = sign * (there - routes.points[first + (after if sign > 0 else after + 1), 4])
            turn_to(real, pace, e, p, tx, ty, min(max(bend, 0.0) / now, dt))
    return step


@njit_borrowing
def _cruise(real, whole, routes, pace, e, p, r):
    """A tick straight on at full speed, where nothing else is to be done; whether it was."""
    v = real[e, p, SPEED]
    if v != routes.lines[r, 0] or real[e, p, HOLD_LEFT] > 0.0:
        return False
    sign, way, k = whole[e, p, DIRECTION], real[e, p, WAY], routes.table[r, 0] + whole[e, p, PIECE]
    tx, ty = sign * routes.points[k, 2], sign * routes.points[k, 3]
    if real[e, p, HX] != tx or real[e, p, HY] != ty:
        return False
    step = v * pace.seconds
    room = routes.points[k + 1, 4] - way if sign > 0 else way - routes.points[k, 4]
    limit = routes.points[k + 1, 5] if sign > 0 else routes.points[k, 6]
    if room <= step or limit * limit + 2.0 * BRAKE * (room - step) < v * v:
        return False
    hold = routes.table[r, 2] + whole[e, p, HOLD]
    if sign > 0 and hold < routes.table[r, 3]:
        room = routes.holds[hold, 0] - way
        if room <= step or 2.0 * BRAKE * (room - step) < v * v:
            return False
    real[e, p, WAY] = way = way + sign * step
    left = way - routes.points[k, 4]
    real[e, p, X] = routes.points[k, 0] + routes.points[k, 2] * left
    real[e, p, Y] = routes.points[k, 1] + routes.points[k, 3] * left
    whole[e, p, WAIT], whole[e, p, BLOCKED_BY] = 0, NOBODY
    return True


@njit_borrowing(forceinline=True)
def _go_on(real, whole, route, walls, routes, wall_arrays, pace, agent, radius, e, p):
    """A tick on the path."""
    r = route[e, p]
    sign, way, piece = whole[e, p, DIRECTION], real[e, p, WAY], whole[e, p, PIECE]
    held, hold_left, mode = whole[e, p, HOLD], real[e, p, HOLD_LEFT], whole[e, p, MODE]
    v = real[e, p, SPEED]
    ahead, blocker = SIGHT, NOBODY
    reach = min(0.5 + v * v / (2.0 * BRAKE) + 0.25, SIGHT - 0.01)
    near = (0, 0)
    if mode == ON_PATH and hold_left <= 0.0:
        near = find_near(real, route, agent, radius, e, p, reach + 0.1)
        if near[0] < near[1] == 0 and agent[e, 2] > radius:  # by its middle, as people are
            dx, dy = agent[e, 0] - real[e, p, X0], agent[e, 1] - real[e, p, Y0]
            within = reach + 2.0 * radius + 0.1
            if dx * dx + dy * dy >= within * within:
                near = (0, 0)
    crowded = near[0] < near[1]
    if crowded:
        ahead, blocker = room_ahead(
            real, route, routes, agent, radius, e, p, way, piece, sign, reach, near
        )
        if blocker == NOBODY:
            ahead = SIGHT
        elif blocker >= 0 and whole[e, blocker, CLAIM0] > whole[e, p, CLAIM0]:
            ahead = max(ahead - LEAVE, 0.0)
    gone = 0.0
    # by the same sums as with nobody near, so that only who is in the way changes a bit
    room = ahead - COMFORT - v * pace.seconds
    clear = blocker == NOBODY or (room > 0.0 and 2.0 * BRAKE * room >= v * v)
    if clear and v > 0.0 and _cruise(real, whole, routes, pace, e, p, r):
        share, who = 1.0, NOBODY
        if crowded:
            x, y = real[e, p, X], real[e, p, Y]
            share, who = share_allowed(real, route, agent, radius, e, p, x, y, near)
        if share >= 1.0:
            return
        real[e, p, WAY], real[e, p, X], real[e, p, Y] = way, real[e, p, X0], real[e, p, Y0]
    for _ in range(pace.parts):
        if whole[e, p, MODE] == ARRIVED:
            break
        gone += _advance(
            real, whole, routes, pace, e, p, r, pace.seconds / pace.parts,
            ahead - gone if ahead < SIGHT else ahead,
        )  # fmt: skip
    x, y, _, tx, ty = place_at(routes, r, real[e, p, WAY], whole[e, p, PIECE])
    if crowded and gone > 0.0:
        share, who = share_allowed(real, route, agent, radius, e, p, x, y, near)
        if share < 1.0:  # less of the way, as if the tick had brought no more
            blocker = who
            gone = gone * share * 0.999
            there = way + sign * gone
            if not 0.0 <= there <= routes.lines[r, 1] or whole[e, p, DIRECTION] != sign:
                gone, there = 0.0, way
            x, y, after, tx, ty = place_at(routes, r, there, piece)
            share, who = share_allowed(real, route, agent, radius, e, p, x, y, near)
            if share < 1.0:
                gone, there = 0.0, way
                x, y, after, tx, ty = place_at(routes, r, way, piece)
            if whole[e, p, DIRECTION] == sign:
                whole[e, p, HOLD] = held
            sign, whole[e, p, MODE] = whole[e, p, DIRECTION], mode
            real[e, p, HOLD_LEFT], whole[e, p, PIECE] = hold_left, after
            real[e, p, WAY], real[e, p, SPEED] = there, gone / pace.seconds
    if gone > 0.0:
        real[e, p, X], real[e, p, Y] = x, y
    whole[e, p, BLOCKED_BY] = blocker
    if blocker != NOBODY and gone < MOVED * pace.seconds:
        whole[e, p, WAIT] += 1
        patience = routes.table[r, 6]
        if blocker >= 0 and whole[e, blocker, CLAIM0] > whole[e, p, CLAIM0]:
            patience //= 2
        if whole[e, p, WAIT] > patience:
            whole[e, p, MODE], whole[e, p, ROUND_TICKS], whole[e, p, WAIT] = ROUND, 0, 0
            whole[e, p, SIDE] = choose_side(
                real, route, walls, wall_arrays, agent, radius, e, p, sign * tx, sign * ty
            )
            real[e, p, SPEED] = 0.0
    else:
        whole[e, p, WAIT] = 0
