"""What a person of an episode is doing, by columns, and what is in its reach, as kernels."""

# mypy: disable-error-code="no-untyped-def"

from __future__ import annotations

import math
from typing import NamedTuple

from gn0.jit import njit_borrowing
from gn0.people.route import BRAKE

# float64 columns: place, place a tick ago [m]; unit vector of heading; speed [m/s]; way along the
# path from its start [m]; distance walked since the episode began [m], which is the gait's phase;
# what is left of the stop in progress [s]; unit vector of the way that feet stand, which is another
# than the heading while one turns on the spot
X, Y, X0, Y0, HX, HY, SPEED, WAY, WALKED, HOLD_LEFT, FX, FY = range(12)
REALS = 12
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
PRESSED = 13  # ticks that it has stood on its right of way
CLAIM = 14  # its right of way: its own, or while it yields that of whom it yields to
CLAIM0 = 15  # the same a tick ago, which others read
LENT_LEFT = 16  # ticks that a claim is still lent to it
TURN_SINCE = 17  # ticks since who stands turned; feet that stand another way step after it
WHOLES = 18

ON_PATH, ROUND, ARRIVED = 0, 1, 2
STILL, WALK = 0, 1
NOBODY, AGENT = -2, -1

COMFORT = 0.10  # m that one stays away from who stands in one's way
SAFE_GAP = 1e-3  # m of every gap that nobody uses
SIGHT = 2.5  # m: others beyond are not looked at
SAMPLE = 0.25  # m between the places of the way ahead that are looked at
ALIGNED = 0.9  # cosine between heading and way from which one walks
SIDEWAYS = 0.5  # the same of who goes round
ROUND_SPEED = 0.6  # m/s at most, going round
ROUND_SECONDS = 4.1  # s of going round, at which one turns back
ROUND_MOST = 6.1  # s of it, at which one does though nobody is in the way any more
NO_WAY_SECONDS = 0.6  # s without any way on, at which one turns back
PRESS_SECONDS = 1  # s that one stands on one's right of way before one turns back as well
FIRM = 1 << 40  # claim of those who cannot move: the agent, and who stands or sits
ENOUGH = 0.4  # m of gap that others pass through
LEAVE = 0.5  # m more that one stays away from who has the right of way
STEADY = 0.15  # m of gap that it is worth not to turn, making room
RIVAL = 0.45  # m between two bodies, from which they dispute a way
BACK_SECONDS = 5  # s of walking back before one turns again
PIVOT_COS = 0.7071067811865476  # of 45 degrees, after which both feet have stepped once
PIVOT_LAG = 4  # ticks of walking until feet are those of the walk
SETTLE = 8  # ticks in which feet step after a body that has stopped turning
ROOM = 0.06  # m that one keeps from others while one goes round
SQUEEZE = 0.01  # m that one keeps from others who has tried both ways
HOME = 0.3  # m from the path, from where one walks straight back to it
SHUFFLE = 0.1  # m that one goes sideways without turning
CLOSE = 1e-4  # m
MOVED = 0.05  # m/s: slower is standing
# cosines and sines of 0, 20, 40, 60, 80, 100, 120 degrees
ROUND_COS20 = (1.0, 0.9396926207859084, 0.766044443118978, 0.5, 0.17364817766693033,
        -0.17364817766693033, -0.5)  # fmt: skip
ROUND_SIN20 = (0.0, 0.3420201433256687, 0.6427876096865393, 0.8660254037844386, 0.984807753012208,
        0.984807753012208, 0.8660254037844386)  # fmt: skip
TURNS = (0, 1, -1, 2, -2, 3, 4, 5, 6, -3, -4, -5, -6)  # of these, to the side and back
FEW_TURNS = 9  # of them that are tried at first
# the same of 0, 30, … 180 degrees
ROUND_COS = (1.0, 0.8660254037844386, 0.5, 0.0, -0.5, -0.8660254037844386, -1.0)
ROUND_SIN = (0.0, 0.5, 0.8660254037844386, 1.0, 0.8660254037844386, 0.5, 0.0)


class Pace(NamedTuple):
    """How long a decision holds, and a tick is.

    Attributes:
        seconds: that a decision holds [s].
        cos, sin: of the most that a body turns in them.
        rate: decisions a second.
        parts: that the way on a path is reckoned in, a thirtieth of a second or less each, so that
            where people come to does not hang on how long ticks are.
        cuts: ticks that the move of a decision is cut into; 1 in every simulator.
    """

    seconds: float
    cos: float
    sin: float
    rate: int
    parts: int
    cuts: int = 1


@njit_borrowing(forceinline=True)
def turn_to(real, pace, e, p, tx, ty, seconds):
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


@njit_borrowing(forceinline=True)
def cap_speed(v, after, room, dt):
    """Fastest speed after a tick that still brakes to `after` [m/s] within `room` [m]."""
    half = 0.5 * BRAKE * dt
    inside = half * half + after * after + 2.0 * BRAKE * room - BRAKE * dt * v
    return max(math.sqrt(inside) - half, 0.0) if inside > 0.0 else 0.0


@njit_borrowing(forceinline=True)
def share_allowed(real, route, agent, radius, e, p, nx, ny, near):
    """Share of the step to (nx, ny) that half of every gap allows, 1 all; and who allows least."""
    x, y = real[e, p, X0], real[e, p, Y0]
    sx, sy = nx - x, ny - y
    share, who = 1.0, NOBODY
    for j in range(near[0], near[1]):
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
        seen = reach + 0.5
        if square > seen * seen:
            continue
        along = sx * dx + sy * dy
        if along <= 0.0:
            continue
        apart = math.sqrt(square)
        if apart <= 0.0:
            return 0.0, j
        gap = apart - reach - SAFE_GAP
        along = along / apart
        half = 0.5 * gap
        if along > half:
            part = half / along if half > 0.0 else 0.0
            if part < share:
                share, who = part, j
    return share, who


@njit_borrowing(forceinline=True)
def find_near(real, route, agent, radius, e, p, gap):
    """Rows from the first to after the last whose bodies are nearer than `gap` [m]; −1 the agent.

    Whoever is between these rows is looked at as well: it costs time and changes nothing. Two
    equal rows are nobody.
    """
    x, y = real[e, p, X0], real[e, p, Y0]
    first, end = real.shape[1], -1
    if agent[e, 2] >= 0.0:
        dx, dy, reach = agent[e, 0] - x, agent[e, 1] - y, radius + agent[e, 2] + gap
        if dx * dx + dy * dy < reach * reach:
            first, end = -1, 0
    reach = 2.0 * radius + gap
    for j in range(real.shape[1]):
        dx, dy = real[e, j, X0] - x, real[e, j, Y0] - y
        if dx * dx + dy * dy < reach * reach and j != p and route[e, j] >= 0:
            first, end = min(first, j), j + 1
    return (first, end) if end >= 0 else (0, 0)


@njit_borrowing(forceinline=True)
def piece_at(routes, r, way, piece):
    """The piece of a path that a way is on."""
    first, last = routes.table[r, 0], routes.table[r, 1] - 2
    k = first + piece
    while k < last and way >= routes.points[k + 1, 4]:
        k += 1
    while k > first and way < routes.points[k, 4]:
        k -= 1
    return k - first


@njit_borrowing(forceinline=True)
def place_at(routes, r, way, piece):
    """(x, y) of a way along a path, the piece that it is on, and its tangent."""
    k = routes.table[r, 0] + piece_at(routes, r, way, piece)
    left = way - routes.points[k, 4]
    tx, ty = routes.points[k, 2], routes.points[k, 3]
    return (
        routes.points[k, 0] + tx * left,
        routes.points[k, 1] + ty * left,
        k - routes.table[r, 0],
        tx,
        ty,
    )


@njit_borrowing(forceinline=True)
def room_ahead(real, route, routes, agent, radius, e, p, way, piece, sign, reach, near):
    """Way [m] until somebody, on the path from `way` on, at most `reach`; and who it is."""
    r = route[e, p]
    length = routes.lines[r, 1]
    gone = 0.0
    while gone < reach and near[0] < near[1]:
        at = way + sign * gone
        if at > length:
            if routes.table[r, 4] != 2:
                break
            at -= length
            piece = 0
        elif at < 0.0:
            if routes.table[r, 4] != 2:
                break
            at += length
            piece = routes.table[r, 1] - routes.table[r, 0] - 2
        x, y, piece, tx, ty = place_at(routes, r, at, piece)
        tx, ty = sign * tx, sign * ty
        best, who = reach, NOBODY
        for j in range(near[0], near[1]):
            if j == p:
                continue
            if j < 0:
                if agent[e, 2] < 0.0:
                    continue
                dx, dy, body = agent[e, 0] - x, agent[e, 1] - y, radius + agent[e, 2] + 0.02
            else:
                if route[e, j] < 0:
                    continue
                dx, dy, body = real[e, j, X0] - x, real[e, j, Y0] - y, 2.0 * radius + 0.02
            along = dx * tx + dy * ty
            aside = dx * ty - dy * tx
            under = body * body - aside * aside
            if along <= 0.0 or under <= 0.0:
                continue
            room = along - math.sqrt(under)
            if room < SAMPLE:  # of this sample's own; what is farther, later ones find
                found = gone + max(room, 0.0)
                if found < best:
                    best, who = found, j
        if who != NOBODY:
            return best, who
        gone += SAMPLE
    return reach, NOBODY


@njit_borrowing
def is_free(walls, wall_arrays, e, x, y):
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


@njit_borrowing
def gap_at(real, route, agent, radius, e, p, x, y, near):
    """Least gap [m] to anybody of the rows `near` from a place."""
    least = SIGHT
    for j in range(near[0], near[1]):
        if j == p:
            continue
        if j < 0:
            if agent[e, 2] < 0.0:
                continue
            dx, dy, body = agent[e, 0] - x, agent[e, 1] - y, radius + agent[e, 2]
        else:
            if route[e, j] < 0:
                continue
            dx, dy, body = real[e, j, X0] - x, real[e, j, Y0] - y, 2.0 * radius
        square = dx * dx + dy * dy
        if square < (least + body) * (least + body):
            least = math.sqrt(square) - body
    return least
