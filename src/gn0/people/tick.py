"""One tick of the people of one episode, as kernels: `tick_people`, which batches call as well.

Columns of the state are named here. See `gn0.people.crowd` for what it does.
"""
# mypy: disable-error-code="no-untyped-def"

from __future__ import annotations

import math
from typing import NamedTuple

from gn0.jit import njit
from gn0.people.route import ACCELERATION, BRAKE, SCRIPT

# float64 columns: place, place a tick ago [m]; unit vector of heading; speed [m/s]; way along the
# path from its start [m]; distance walked since the episode began [m], which is the gait's phase;
# what is left of the stop in progress [s]
X, Y, X0, Y0, HX, HY, SPEED, WAY, WALKED, HOLD_LEFT = range(10)
REALS = 10
# int64 columns
MODE = 0  # ON_PATH, ROUND or ARRIVED
PIECE = 1  # of the path, counted from its first point
DIRECTION = 2  # 1 out, −1 back
HOLD = 3  # stops made so far
WAIT = 4  # ticks that it has waited for somebody
SIDE = 5  # on which it goes round: 1 left, −1 right, 0 not chosen
ROUND_TICKS = 6  # that it has been going round
BACK_LEFT = 7  # ticks until who turned back turns again
CLIP = 8  # STILL or WALK
CLIP_SINCE = 9  # ticks since it was something else
BLOCKED_BY = 10  # row of the person who was in its way in the last tick, AGENT or NOBODY
TURNED = 11  # times that it turned back for want of a way round
ASIDE_LEFT = 12  # ticks that it still makes room, having found no way either way
WHOLES = 13

ON_PATH, ROUND, ARRIVED = 0, 1, 2
STILL, WALK = 0, 1
NOBODY, AGENT = -2, -1

_COMFORT = 0.10  # m that one stays away from who stands in one's way
_SAFE = 1e-3  # m of every gap that nobody uses
_SIGHT = 2.5  # m: others beyond are not looked at
_SAMPLE = 0.25  # m between the places of the way ahead that are looked at
_ALIGNED = 0.9  # cosine between heading and way from which one walks
_SIDEWAYS = 0.5  # the same of who goes round
_ROUND_SPEED = 0.6  # m/s at most, going round
_ROUND_SECONDS = 4  # s of going round before one turns back
_NO_WAY_SECONDS = 0.5  # s without any way on before one turns back
_BACK_SECONDS = 5  # s of walking back before one turns again
_ROOM = 0.06  # m that one keeps from others while one goes round
_HOME = 0.3  # m from the path, from where one walks straight back to it
_SHUFFLE = 0.1  # m that one goes sideways without turning
_ARRIVED = 1e-4  # m
_MOVED = 0.05  # m/s: slower is standing
# cosines and sines of 0, 20, 40, 60, 80, 100, 120 degrees
_COS = (1.0, 0.9396926207859084, 0.766044443118978, 0.5, 0.17364817766693033,
        -0.17364817766693033, -0.5)  # fmt: skip
_SIN = (0.0, 0.3420201433256687, 0.6427876096865393, 0.8660254037844386, 0.984807753012208,
        0.984807753012208, 0.8660254037844386)  # fmt: skip
_TURNS = (0, 1, -1, 2, -2, 3, 4, 5, 6)  # of these, to the side and back; the straightest first
# the same of 0, 30, … 180 degrees
_ROUND_COS = (1.0, 0.8660254037844386, 0.5, 0.0, -0.5, -0.8660254037844386, -1.0)
_ROUND_SIN = (0.0, 0.5, 0.8660254037844386, 1.0, 0.8660254037844386, 0.5, 0.0)


class Pace(NamedTuple):
    """How long a tick is.

    Attributes:
        seconds: its length [s].
        cos, sin: of the most that a body turns in it.
        rate: ticks a second.
        parts: that the way on a path is reckoned in, a thirtieth of a second or less each, so that
            where people come to does not hang on how long ticks are.
    """

    seconds: float
    cos: float
    sin: float
    rate: int
    parts: int


@njit
def tick_people(real, whole, route, walls, routes, wall_arrays, pace, agent, radius, e):
    """Everybody's next tick in episode `e`, in place; rows without a route stay as they are."""
    count = real.shape[1]
    for p in range(count):
        real[e, p, X0] = real[e, p, X]
        real[e, p, Y0] = real[e, p, Y]
    for p in range(count):
        r = route[e, p]
        if r < 0:
            continue
        was = whole[e, p, CLIP]
        if routes.table[r, 5] == SCRIPT:
            whole[e, p, BLOCKED_BY] = NOBODY
            if whole[e, p, BACK_LEFT] > 0:
                whole[e, p, BACK_LEFT] -= 1
                if whole[e, p, BACK_LEFT] == 0 and whole[e, p, MODE] == ON_PATH:
                    whole[e, p, DIRECTION] = 1
                elif whole[e, p, BACK_LEFT] == 0:
                    whole[e, p, BACK_LEFT] = 1
            if whole[e, p, MODE] == ROUND:
                _go_round(real, whole, route, walls, routes, wall_arrays, pace, agent, radius, e, p)
            else:
                _go_on(real, whole, route, walls, routes, wall_arrays, pace, agent, radius, e, p)
            dx, dy = real[e, p, X] - real[e, p, X0], real[e, p, Y] - real[e, p, Y0]
            gone = math.sqrt(dx * dx + dy * dy)
            real[e, p, WALKED] += gone
            limit = _MOVED * pace.seconds
            whole[e, p, CLIP] = WALK if gone > limit else STILL
        if whole[e, p, CLIP] != was:
            whole[e, p, CLIP_SINCE] = 0
        else:
            whole[e, p, CLIP_SINCE] += 1


@njit
def _turn(real, pace, e, p, tx, ty, seconds):
    """Turn towards a unit vector, by as much as a body may; the cosine that is left."""
    hx, hy = real[e, p, HX], real[e, p, HY]
    if hx == tx and hy == ty:
        return 1.0
    cosine = hx * tx + hy * ty
    cos, sin = pace.cos, pace.sin
    if seconds < pace.seconds:  # so much of the arc of a tick, along its chord
        share = seconds / pace.seconds
        cos, sin = 1.0 - share + share * cos, share * sin
        size = math.sqrt(cos * cos + sin * sin)
        cos, sin = cos / size, sin / size
    if cosine >= cos:
        real[e, p, HX], real[e, p, HY] = tx, ty
        return 1.0
    if hx * ty - hy * tx < 0.0:
        sin = -sin
    nx, ny = hx * cos - hy * sin, hx * sin + hy * cos
    size = math.sqrt(nx * nx + ny * ny)
    nx, ny = nx / size, ny / size
    real[e, p, HX], real[e, p, HY] = nx, ny
    return nx * tx + ny * ty


@njit
def _hold(real, whole, routes, pace, e, p, r, seconds):
    """Stand at a stop for so long, or begin to; the seconds that are left after it."""
    last = routes.table[r, 3]
    while seconds > 0.0:
        hold = routes.table[r, 2] + whole[e, p, HOLD]
        if real[e, p, HOLD_LEFT] <= 0.0:
            if hold >= last or real[e, p, WAY] < routes.holds[hold, 0] - _ARRIVED:
                break
            real[e, p, HOLD_LEFT] = routes.holds[hold, 1]
        use = min(real[e, p, HOLD_LEFT], seconds)
        _turn(real, pace, e, p, routes.holds[hold, 2], routes.holds[hold, 3], use)
        real[e, p, HOLD_LEFT] -= use
        seconds -= use
        if real[e, p, HOLD_LEFT] <= 1e-9:
            real[e, p, HOLD_LEFT] = 0.0
            whole[e, p, HOLD] += 1
        if seconds < 1e-9:
            seconds = 0.0
    return seconds


@njit
def _cap(v, after, room, dt):
    """Fastest speed after a tick that still brakes to `after` [m/s] within `room` [m]."""
    half = 0.5 * BRAKE * dt
    inside = half * half + after * after + 2.0 * BRAKE * room - BRAKE * dt * v
    return max(math.sqrt(inside) - half, 0.0) if inside > 0.0 else 0.0


@njit
def _allowed(real, route, agent, radius, e, p, nx, ny):
    """Share of the step to (nx, ny) that half of every gap allows, 1 all; and who allows least."""
    x, y = real[e, p, X0], real[e, p, Y0]
    sx, sy = nx - x, ny - y
    share, who = 1.0, NOBODY
    for j in range(-1, real.shape[1]):
        if j == p:
            continue
        if j < 0:
            if agent[e, 2] < 0.0:
                continue
            dx, dy, reach = agent[e, 0] - x, agent[e, 1] - y, radius + agent[e, 2]
        else:
            if route[e, j] < 0:
                continue
            dx, dy, reach = real[e, j, X0] - x, real[e, j, Y0] - y, 2.0 * radius
        square = dx * dx + dy * dy
        near = reach + 0.5
        if square > near * near:
            continue
        along = sx * dx + sy * dy
        if along <= 0.0:
            continue
        apart = math.sqrt(square)
        if apart <= 0.0:
            return 0.0, j
        gap = apart - reach - _SAFE
        along = along / apart
        half = 0.5 * gap
        if along > half:
            part = half / along if half > 0.0 else 0.0
            if part < share:
                share, who = part, j
    return share, who


@njit
def _crowded(real, route, agent, e, p, reach):
    """Whether anybody's middle is nearer than `reach` [m]."""
    x, y = real[e, p, X0], real[e, p, Y0]
    if agent[e, 2] >= 0.0:
        dx, dy = agent[e, 0] - x, agent[e, 1] - y
        if dx * dx + dy * dy < reach * reach:
            return True
    for j in range(real.shape[1]):
        if j != p and route[e, j] >= 0:
            dx, dy = real[e, j, X0] - x, real[e, j, Y0] - y
            if dx * dx + dy * dy < reach * reach:
                return True
    return False


@njit
def _piece(routes, r, way, piece):
    """The piece of a path that a way is on."""
    first, last = routes.table[r, 0], routes.table[r, 1] - 2
    k = first + piece
    while k < last and way >= routes.points[k + 1, 4]:
        k += 1
    while k > first and way < routes.points[k, 4]:
        k -= 1
    return k - first


@njit
def _at(routes, r, way, piece):
    """(x, y) of a way along a path, the piece that it is on, and its tangent."""
    k = routes.table[r, 0] + _piece(routes, r, way, piece)
    left = way - routes.points[k, 4]
    tx, ty = routes.points[k, 2], routes.points[k, 3]
    return (
        routes.points[k, 0] + tx * left,
        routes.points[k, 1] + ty * left,
        k - routes.table[r, 0],
        tx,
        ty,
    )


@njit
def _room_ahead(real, route, routes, agent, radius, e, p, way, piece, sign, reach):
    """Way [m] until somebody, on the path from `way` on, at most `reach`; and who it is."""
    r = route[e, p]
    length = routes.lines[r, 1]
    gone = 0.0
    while gone < reach:
        at = way + sign * gone
        if at > length:
            if routes.table[r, 4] != 2:
                break
            at -= length
            piece = 0
        elif at < 0.0:
            break
        x, y, piece, tx, ty = _at(routes, r, at, piece)
        tx, ty = sign * tx, sign * ty
        best, who = reach, NOBODY
        for j in range(-1, real.shape[1]):
            if j == p:
                continue
            if j < 0:
                if agent[e, 2] < 0.0:
                    continue
                dx, dy, near = agent[e, 0] - x, agent[e, 1] - y, radius + agent[e, 2] + 0.02
            else:
                if route[e, j] < 0:
                    continue
                dx, dy, near = real[e, j, X0] - x, real[e, j, Y0] - y, 2.0 * radius + 0.02
            along = dx * tx + dy * ty
            aside = dx * ty - dy * tx
            under = near * near - aside * aside
            if along <= 0.0 or under <= 0.0:
                continue
            room = along - math.sqrt(under)
            if room < _SAMPLE:  # of this sample's own; what is farther, later ones find
                found = gone + max(room, 0.0)
                if found < best:
                    best, who = found, j
        if who != NOBODY:
            return best, who
        gone += _SAMPLE
    return reach, NOBODY


@njit
def _free(walls, wall_arrays, e, x, y):
    """Whether a person's centre may be there, as far as walls go."""
    w = walls[e]
    if w < 0:
        return True
    size = wall_arrays.frame[w, 2]
    col = math.floor((x - wall_arrays.frame[w, 0]) / size)
    row = math.floor((y - wall_arrays.frame[w, 1]) / size)
    begin, rows, cols = wall_arrays.shape[w, 0], wall_arrays.shape[w, 1], wall_arrays.shape[w, 2]
    if row < 0 or col < 0 or row >= rows or col >= cols:
        return False
    return not wall_arrays.blocked[begin + int(row) * cols + int(col)]


@njit
def _advance(real, whole, routes, pace, e, p, r, dt, ahead):
    """Walk, turn or stand on the path for a part of a tick, `ahead` [m] of it being free.

    Ways, speed and heading change; the place on the plane is the caller's. Returns the way gone.
    """
    sign, way, v = whole[e, p, DIRECTION], real[e, p, WAY], real[e, p, SPEED]
    length, first = routes.lines[r, 1], routes.table[r, 0]
    hold, last_hold = routes.table[r, 2] + whole[e, p, HOLD], routes.table[r, 3]
    holds = sign > 0 and hold < last_hold
    if real[e, p, HOLD_LEFT] > 0.0 or (
        holds and way >= routes.holds[hold, 0] - _ARRIVED and v < 0.09
    ):
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
    elif sign < 0 and way <= 0.0:  # turned back to the very start: wait there
        real[e, p, SPEED] = 0.0
        return 0.0
    piece = _piece(routes, r, way, whole[e, p, PIECE])
    if sign < 0 and piece > 0 and way <= routes.points[first + piece, 4]:
        piece -= 1  # at a point that one walks away from backwards
    tx, ty = sign * routes.points[first + piece, 2], sign * routes.points[first + piece, 3]
    before = real[e, p, HX] * tx + real[e, p, HY] * ty
    aligned = _turn(real, pace, e, p, tx, ty, dt)
    want = routes.lines[r, 0] if aligned >= _ALIGNED else 0.0
    if before < _ALIGNED <= aligned:  # who comes to face its way goes for what is left of the time
        dt = dt * ((aligned - _ALIGNED) / (aligned - before))
    # bends: the next points
    k = piece + 1 if sign > 0 else piece
    points = routes.table[r, 1] - first
    while 0 <= k < points:
        room = sign * (routes.points[first + k, 4] - way)
        if room > 0.0:
            limit = routes.points[first + k, 5] if sign > 0 else routes.points[first + k, 6]
            if 0.5 * (v + limit) * dt < room:  # limits there are such that all later ones are kept
                want = min(want, _cap(v, limit, room, dt))
                break
            want = min(want, limit)  # passed by then
        k += sign
    end = length if sign > 0 else 0.0
    if holds:
        end = routes.holds[hold, 0]
    stands = holds or sign < 0 or routes.table[r, 4] != 2
    left = max(sign * (end - way), 0.0)
    if stands:
        want = min(want, _cap(v, 0.0, left, dt))
    if ahead < _SIGHT:
        want = min(want, _cap(v, 0.0, max(ahead - _COMFORT, 0.0), dt))
    now = min(want, v + ACCELERATION * dt * 0.875)
    now = max(now, v - ACCELERATION * dt, 0.0)
    step = 0.5 * (v + now) * dt
    there, spare = way + sign * step, 0.0
    if stands and step >= left - _ARRIVED:
        step, there, now = left, end, max(v - ACCELERATION * dt, 0.0)
        if v + now > 0.0:
            spare = max(dt - 2.0 * step / (v + now), 0.0)
    elif sign > 0 and there > length:  # around a loop again
        there, whole[e, p, HOLD], piece = there - length, 0, 0
    real[e, p, WAY], real[e, p, SPEED] = there, now
    whole[e, p, PIECE] = after = _piece(routes, r, there, piece)
    if spare > 0.0 and now <= 0.0 and there == end:
        if holds:
            _hold(real, whole, routes, pace, e, p, r, spare)
        elif routes.table[r, 4] == 1:
            _turn(real, pace, e, p, -tx, -ty, spare)
    elif after != piece and now > 0.0:
        tx = sign * routes.points[first + after, 2]
        ty = sign * routes.points[first + after, 3]
        if real[e, p, HX] * tx + real[e, p, HY] * ty < _ALIGNED:
            # a sharp bend: turn for what is left of the time after it
            bend = sign * (there - routes.points[first + (after if sign > 0 else after + 1), 4])
            _turn(real, pace, e, p, tx, ty, min(max(bend, 0.0) / now, dt))
    return step


@njit
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


@njit
def _go_on(real, whole, route, walls, routes, wall_arrays, pace, agent, radius, e, p):
    """A tick on the path."""
    r = route[e, p]
    sign, way, piece = whole[e, p, DIRECTION], real[e, p, WAY], whole[e, p, PIECE]
    held, hold_left, mode = whole[e, p, HOLD], real[e, p, HOLD_LEFT], whole[e, p, MODE]
    v = real[e, p, SPEED]
    ahead, blocker = _SIGHT, NOBODY
    reach = min(0.5 + v * v / (2.0 * BRAKE) + 0.25, _SIGHT - 0.01)
    near = (
        mode == ON_PATH
        and hold_left <= 0.0
        and _crowded(real, route, agent, e, p, reach + 2.0 * radius + 0.1)
    )
    if near:
        ahead, blocker = _room_ahead(
            real, route, routes, agent, radius, e, p, way, piece, sign, reach
        )
        if blocker == NOBODY:
            ahead = _SIGHT
    gone = 0.0
    if not near and v > 0.0 and _cruise(real, whole, routes, pace, e, p, r):
        return
    for _ in range(pace.parts):
        if whole[e, p, MODE] == ARRIVED:
            break
        gone += _advance(
            real, whole, routes, pace, e, p, r, pace.seconds / pace.parts,
            ahead - gone if ahead < _SIGHT else ahead,
        )  # fmt: skip
    x, y, _, tx, ty = _at(routes, r, real[e, p, WAY], whole[e, p, PIECE])
    if near and gone > 0.0:
        share, who = _allowed(real, route, agent, radius, e, p, x, y)
        if share < 1.0:  # less of the way, as if the tick had brought no more
            blocker = who
            gone = gone * share * 0.999
            there = way + sign * gone
            if there > routes.lines[r, 1] or whole[e, p, DIRECTION] != sign:
                gone, there = 0.0, way
            x, y, after, tx, ty = _at(routes, r, there, piece)
            share, who = _allowed(real, route, agent, radius, e, p, x, y)
            if share < 1.0:
                gone, there = 0.0, way
                x, y, after, tx, ty = _at(routes, r, way, piece)
            whole[e, p, DIRECTION], whole[e, p, HOLD], whole[e, p, MODE] = sign, held, mode
            real[e, p, HOLD_LEFT], whole[e, p, PIECE] = hold_left, after
            real[e, p, WAY], real[e, p, SPEED] = there, gone / pace.seconds
    if gone > 0.0:
        real[e, p, X], real[e, p, Y] = x, y
    whole[e, p, BLOCKED_BY] = blocker
    if blocker != NOBODY and gone < _MOVED * pace.seconds:
        whole[e, p, WAIT] += 1
        if whole[e, p, WAIT] > routes.table[r, 6]:
            whole[e, p, MODE], whole[e, p, ROUND_TICKS], whole[e, p, WAIT] = ROUND, 0, 0
            whole[e, p, SIDE] = _choose_side(
                real, route, walls, wall_arrays, agent, radius, e, p, sign * tx, sign * ty
            )
            real[e, p, SPEED] = 0.0
    else:
        whole[e, p, WAIT] = 0


@njit
def _clear(real, route, agent, radius, e, p, x, y):
    """Least gap [m] to anybody from a place."""
    least = _SIGHT
    for j in range(-1, real.shape[1]):
        if j == p:
            continue
        if j < 0:
            if agent[e, 2] < 0.0:
                continue
            dx, dy, near = agent[e, 0] - x, agent[e, 1] - y, radius + agent[e, 2]
        else:
            if route[e, j] < 0:
                continue
            dx, dy, near = real[e, j, X0] - x, real[e, j, Y0] - y, 2.0 * radius
        square = dx * dx + dy * dy
        if square < (least + near) * (least + near):
            least = math.sqrt(square) - near
    return least


@njit
def _choose_side(real, route, walls, wall_arrays, agent, radius, e, p, tx, ty):
    """The side with more free places beside the way ahead: 1 left, −1 right; right of equals."""
    x, y = real[e, p, X], real[e, p, Y]
    best, side = -1, -1
    for s in (-1, 1):
        free = 0
        for a in range(1, 4):
            for b in range(0, 4):
                qx = x + tx * 0.3 * b - s * ty * 0.25 * a
                qy = y + ty * 0.3 * b + s * tx * 0.25 * a
                if not _free(walls, wall_arrays, e, qx, qy):
                    break
                if _clear(real, route, agent, radius, e, p, qx, qy) > _ROOM:
                    free += 1
        if free > best:
            best, side = free, s
    return side


@njit
def _nearest(routes, r, way, piece, sign, x, y):
    """Nearest point of the path to (x, y), from `way` up to 3 m on: its way, distance, piece."""
    first, last = routes.table[r, 0], routes.table[r, 1] - 2
    best, found, where = 1e30, way, piece
    k = first + piece
    gone = 0.0
    while first <= k <= last and gone < 3.0:
        low, high = routes.points[k, 4], routes.points[k + 1, 4]
        if sign > 0:
            low = max(low, way)
        else:
            high = min(high, way)
        tx, ty = routes.points[k, 2], routes.points[k, 3]
        at = routes.points[k, 4] + (x - routes.points[k, 0]) * tx + (y - routes.points[k, 1]) * ty
        at = min(max(at, low), high)
        left = at - routes.points[k, 4]
        dx, dy = routes.points[k, 0] + tx * left - x, routes.points[k, 1] + ty * left - y
        square = dx * dx + dy * dy
        if square < best:
            best, found, where = square, at, k - first
        gone = high - way if sign > 0 else way - low
        k += sign
    return found, math.sqrt(best), where


@njit
def _clear_line(walls, wall_arrays, e, x, y, u, v):
    """Whether five places of a short line are free of walls."""
    for k in range(1, 6):
        if not _free(walls, wall_arrays, e, x + (u - x) * (0.2 * k), y + (v - y) * (0.2 * k)):
            return False
    return True


@njit
def _come_home(whole, routes, r, way, piece, e, p):
    """Be on the path again; stops that were passed are left out."""
    whole[e, p, MODE], whole[e, p, PIECE], whole[e, p, WAIT] = ON_PATH, piece, 0
    first, last = routes.table[r, 2], routes.table[r, 3]
    while first + whole[e, p, HOLD] < last and routes.holds[first + whole[e, p, HOLD], 0] < way:
        whole[e, p, HOLD] += 1


@njit
def _make_room(real, whole, route, walls, wall_arrays, pace, agent, radius, e, p):
    """A tick away from everybody, wherever there is room."""
    x, y, v, dt = real[e, p, X0], real[e, p, Y0], real[e, p, SPEED], pace.seconds
    now = min(v + ACCELERATION * dt * 0.875, 0.5)
    step = 0.5 * (v + now) * dt
    hx, hy = real[e, p, HX], real[e, p, HY]
    best, bx, by = _clear(real, route, agent, radius, e, p, x, y) + 0.02, 0.0, 0.0
    for turn in range(-6, 7):
        cos, sin = _ROUND_COS[abs(turn)], _ROUND_SIN[abs(turn)]
        if turn < 0:
            sin = -sin
        ux, uy = hx * cos - hy * sin, hx * sin + hy * cos
        free = True
        for part in (0.1, 0.2, 0.3):
            if not _free(walls, wall_arrays, e, x + ux * part, y + uy * part):
                free = False
                break
        if free and _free(walls, wall_arrays, e, x + ux * step, y + uy * step):
            clear = _clear(real, route, agent, radius, e, p, x + ux * 0.3, y + uy * 0.3)
            if clear > best:
                best, bx, by = clear, ux, uy
    real[e, p, SPEED] = 0.0
    if bx == 0.0 and by == 0.0:
        whole[e, p, ASIDE_LEFT] = 0
        return
    if _turn(real, pace, e, p, bx, by, pace.seconds) < _SIDEWAYS:
        return
    nx, ny = x + bx * step, y + by * step
    share, _ = _allowed(real, route, agent, radius, e, p, nx, ny)
    if share >= 1.0:
        real[e, p, X], real[e, p, Y], real[e, p, SPEED] = nx, ny, now
    else:
        whole[e, p, ASIDE_LEFT] = 0


@njit
def _go_round(real, whole, route, walls, routes, wall_arrays, pace, agent, radius, e, p):
    """A tick beside the path, around whoever is on it."""
    r, dt = route[e, p], pace.seconds
    sign, side = whole[e, p, DIRECTION], whole[e, p, SIDE]
    x, y, v = real[e, p, X0], real[e, p, Y0], real[e, p, SPEED]
    length = routes.lines[r, 1]
    whole[e, p, ROUND_TICKS] += 1
    if (
        whole[e, p, ROUND_TICKS] > _ROUND_SECONDS * pace.rate
        or whole[e, p, WAIT] > _NO_WAY_SECONDS * pace.rate
    ):
        if whole[e, p, WAIT] > 0 and whole[e, p, TURNED] % 2 == 1:
            whole[e, p, ASIDE_LEFT] = routes.table[r, 6]
        whole[e, p, WAIT] = 0
        whole[e, p, ROUND_TICKS], whole[e, p, SIDE] = 0, -side
        whole[e, p, DIRECTION] = sign = -sign
        whole[e, p, TURNED] += 1
        whole[e, p, BACK_LEFT] = 0
        if sign < 0 and routes.table[r, 4] != 1:
            whole[e, p, BACK_LEFT] = _BACK_SECONDS * pace.rate + routes.table[r, 6]
        side = -side
    if whole[e, p, ASIDE_LEFT] > 0:
        whole[e, p, ASIDE_LEFT] -= 1
        _make_room(real, whole, route, walls, wall_arrays, pace, agent, radius, e, p)
        return
    way, aside, piece = _nearest(routes, r, real[e, p, WAY], whole[e, p, PIECE], sign, x, y)
    real[e, p, WAY], whole[e, p, PIECE] = way, piece
    fastest = min(_ROUND_SPEED, routes.lines[r, 0])
    now = min(v + ACCELERATION * dt * 0.875, fastest)
    step = 0.5 * (v + now) * dt
    bx, by, best = 0.0, 0.0, -1e30
    if aside <= _HOME:
        _, who = _room_ahead(real, route, routes, agent, radius, e, p, way, piece, sign, 0.6)
        nx, ny, piece, tx, ty = _at(routes, r, way, piece)
        if who == NOBODY and _clear_line(walls, wall_arrays, e, x, y, nx, ny):
            near = aside <= step + 0.005
            ux, uy = 0.0, 0.0
            if not near:
                ux, uy = (nx - x) / aside, (ny - y) / aside
                nx, ny = x + ux * step, y + uy * step
            share, _ = _allowed(real, route, agent, radius, e, p, nx, ny)
            if share >= 1.0 and (near or aside <= _SHUFFLE):
                real[e, p, X], real[e, p, Y] = nx, ny
                real[e, p, SPEED] = aside / dt if near else now
                _turn(real, pace, e, p, sign * tx, sign * ty, pace.seconds)
                if near:
                    _come_home(whole, routes, r, way, piece, e, p)
                return
            if share >= 1.0:
                bx, by, best = ux, uy, 1.0
    carrot = min(max(aside + 0.3, 0.4), 1.2)
    at = min(max(way + sign * carrot, 0.0), length)
    cx, cy, _, _, _ = _at(routes, r, at, piece)
    dx, dy = cx - x, cy - y
    size = math.sqrt(dx * dx + dy * dy)
    if size < 1e-6:
        dx, dy = real[e, p, HX], real[e, p, HY]
    else:
        dx, dy = dx / size, dy / size
    here = _clear(real, route, agent, radius, e, p, x, y)
    for turn in _TURNS:
        if best == 1.0:  # the path itself, near by and free
            break
        if turn >= 0:
            cos, sin = _COS[turn], _SIN[turn] * side
        else:
            cos, sin = _COS[-turn], -_SIN[-turn] * side
        ux, uy = dx * cos - dy * sin, dx * sin + dy * cos
        score = cos + 0.3 * (ux * real[e, p, HX] + uy * real[e, p, HY])
        if score <= best:
            continue
        reach = 0.35 if size > 0.35 else size
        ok = True
        for part in (0.34, 0.67, 1.0):
            qx, qy = x + ux * reach * part, y + uy * reach * part
            if not _free(walls, wall_arrays, e, qx, qy):
                ok = False
                break
            clear = _clear(real, route, agent, radius, e, p, qx, qy)
            if clear < _ROOM and clear < here + 0.2 * reach * part:
                ok = False
                break
        if ok and not _free(walls, wall_arrays, e, x + ux * step, y + uy * step):
            ok = False
        if ok:
            best, bx, by = score, ux, uy
    if best < -1e29:
        whole[e, p, WAIT] += 1
        real[e, p, SPEED] = 0.0
        _turn(real, pace, e, p, dx, dy, pace.seconds)
        return
    if _turn(real, pace, e, p, bx, by, pace.seconds) < _SIDEWAYS:
        real[e, p, SPEED] = 0.0
        return
    nx, ny = x + bx * step, y + by * step
    share, who = _allowed(real, route, agent, radius, e, p, nx, ny)
    if share < 1.0:
        whole[e, p, BLOCKED_BY] = who
        now = 0.0
        whole[e, p, WAIT] += 1
        share = share * 0.999
        nx, ny = x + bx * step * share, y + by * step * share
        if not _free(walls, wall_arrays, e, nx, ny):
            nx, ny = x, y
    real[e, p, X], real[e, p, Y], real[e, p, SPEED] = nx, ny, now
