"""Round whoever stands in the way, as kernels: beside the path, on the freer side, and back."""

# mypy: disable-error-code="no-untyped-def"

from __future__ import annotations

import math

from gn0.jit import njit_borrowing
from gn0.people.reach import (
    AGENT,
    ASIDE_LEFT,
    BACK_LEFT,
    BACK_SECONDS,
    BLOCKED_BY,
    CLAIM,
    CLAIM0,
    DIRECTION,
    ENOUGH,
    FEW_TURNS,
    FIRM,
    HOLD,
    HOME,
    HX,
    HY,
    LEAVE,
    LENT_LEFT,
    MODE,
    NO_WAY_SECONDS,
    NOBODY,
    ON_PATH,
    PIECE,
    PRESS_SECONDS,
    PRESSED,
    RIVAL,
    ROOM,
    ROUND_COS,
    ROUND_COS20,
    ROUND_MOST,
    ROUND_SECONDS,
    ROUND_SIN,
    ROUND_SIN20,
    ROUND_SPEED,
    ROUND_TICKS,
    SHUFFLE,
    SIDE,
    SIDEWAYS,
    SPEED,
    SQUEEZE,
    STEADY,
    TURNED,
    TURNS,
    WAIT,
    WAY,
    X0,
    Y0,
    X,
    Y,
    find_near,
    gap_at,
    is_free,
    place_at,
    room_ahead,
    share_allowed,
    turn_to,
)
from gn0.people.route import ACCELERATION, SCRIPT


@njit_borrowing
def choose_side(real, route, walls, wall_arrays, agent, radius, e, p, tx, ty):
    """The side with more free places beside the way ahead: 1 left, −1 right; right of equals."""
    x, y = real[e, p, X], real[e, p, Y]
    near = find_near(real, route, agent, radius, e, p, 1.2 + ROOM)
    best, side = -1, -1
    for s in (-1, 1):
        free = 0
        for a in range(1, 4):
            for b in range(0, 4):
                qx = x + tx * 0.3 * b - s * ty * 0.25 * a
                qy = y + ty * 0.3 * b + s * tx * 0.25 * a
                if not is_free(walls, wall_arrays, e, qx, qy):
                    break
                if gap_at(real, route, agent, radius, e, p, qx, qy, near) > ROOM:
                    free += 1
        if free > best:
            best, side = free, s
    return side


@njit_borrowing
def nearest_way(routes, r, way, piece, sign, x, y):
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


@njit_borrowing
def clear_line(walls, wall_arrays, e, x, y, u, v):
    """Whether five places of a short line are free of walls."""
    for k in range(1, 6):
        if not is_free(walls, wall_arrays, e, x + (u - x) * (0.2 * k), y + (v - y) * (0.2 * k)):
            return False
    return True


@njit_borrowing
def make_room(real, whole, route, walls, wall_arrays, pace, agent, radius, e, p, mx, my):
    """A tick away from everybody, where there is room; (mx, my) on the path is kept in sight."""
    x, y, v, dt = real[e, p, X0], real[e, p, Y0], real[e, p, SPEED], pace.seconds
    now = min(v + ACCELERATION * dt * 0.875, 0.5)
    step = 0.5 * (v + now) * dt
    hx, hy = real[e, p, HX], real[e, p, HY]
    near = find_near(real, route, agent, radius, e, p, 1.2)
    here = gap_at(real, route, agent, radius, e, p, x, y, near) + 0.01
    if here > ENOUGH:
        whole[e, p, ASIDE_LEFT], real[e, p, SPEED] = 0, 0.0
        return
    sees = clear_line(walls, wall_arrays, e, x, y, mx, my)
    best, bx, by = -1e30, 0.0, 0.0
    for turn in range(-5, 7):  # twelve directions of the plane
        cos, sin = ROUND_COS[abs(turn)], ROUND_SIN[abs(turn)]
        if turn < 0:
            sin = -sin
        free = True
        ux, uy = cos, sin
        for part in (0.1, 0.2):
            if not is_free(walls, wall_arrays, e, x + ux * part, y + uy * part):
                free = False
                break
        if free and is_free(walls, wall_arrays, e, x + ux * step, y + uy * step):
            clear = gap_at(real, route, agent, radius, e, p, x + ux * 0.2, y + uy * 0.2, near)
            score = clear + STEADY * (ux * hx + uy * hy)
            if clear <= here or score <= best:
                continue
            sx, sy = x + ux * SHUFFLE, y + uy * SHUFFLE
            share, _ = share_allowed(real, route, agent, radius, e, p, sx, sy, near)
            if share >= 1.0:
                qx, qy = x + ux * 0.2, y + uy * 0.2
                if not sees or clear_line(walls, wall_arrays, e, qx, qy, mx, my):
                    best, bx, by = score, ux, uy
    real[e, p, SPEED] = 0.0
    if bx == 0.0 and by == 0.0:
        whole[e, p, ASIDE_LEFT] = 0
        return
    if turn_to(real, pace, e, p, bx, by, pace.seconds) < SIDEWAYS:
        return
    nx, ny = x + bx * step, y + by * step
    share, _ = share_allowed(real, route, agent, radius, e, p, nx, ny, near)
    if share >= 1.0:
        real[e, p, X], real[e, p, Y], real[e, p, SPEED] = nx, ny, now
        whole[e, p, ASIDE_LEFT] -= 1
    else:
        whole[e, p, ASIDE_LEFT] = 0


@njit_borrowing
def come_home(whole, routes, r, way, piece, e, p):
    """Be on the path again; stops that were passed are left out."""
    whole[e, p, MODE], whole[e, p, PIECE], whole[e, p, WAIT] = ON_PATH, piece, 0
    whole[e, p, PRESSED] = 0
    first, last = routes.table[r, 2], routes.table[r, 3]
    while first + whole[e, p, HOLD] < last and routes.holds[first + whole[e, p, HOLD], 0] < way:
        whole[e, p, HOLD] += 1


@njit_borrowing
def claim_ahead(real, whole, route, routes, agent, radius, e, p):
    """The highest claim of anybody who disputes the way ahead, a tick ago; 0 where nobody does."""
    x, y, hx, hy = real[e, p, X0], real[e, p, Y0], real[e, p, HX], real[e, p, HY]
    most = 0
    for j in range(-1, real.shape[1]):
        if j == p:
            continue
        if j < 0:
            if agent[e, 2] < 0.0:
                continue
            dx, dy, reach = agent[e, 0] - x, agent[e, 1] - y, radius + agent[e, 2] + RIVAL
        else:
            if route[e, j] < 0:
                continue
            dx, dy, reach = real[e, j, X0] - x, real[e, j, Y0] - y, 2.0 * radius + RIVAL
        if dx * hx + dy * hy <= 0.0 or dx * dx + dy * dy > reach * reach:
            continue
        if j < 0 or routes.table[route[e, j], 5] != SCRIPT:
            most = 2 * FIRM
        else:
            most = max(most, whole[e, j, CLAIM0])
    return most


@njit_borrowing
def turn_back(real, whole, route, routes, pace, agent, radius, e, p, aside):
    """Yield to a higher claim ahead and walk back with it; who has the highest stays for a time."""
    r, sign = route[e, p], whole[e, p, DIRECTION]
    claim = claim_ahead(real, whole, route, routes, agent, radius, e, p)
    on_way = aside <= HOME
    pressed = whole[e, p, PRESSED]
    if on_way and 0 < claim <= whole[e, p, CLAIM0] and pressed < PRESS_SECONDS * pace.rate:
        whole[e, p, PRESSED] += 1
        return
    if claim > whole[e, p, CLAIM0]:
        # who does not move has no claim to lend: one's own goes before all others then
        whole[e, p, CLAIM] = FIRM + routes.table[r, 7] if claim == 2 * FIRM else claim
        whole[e, p, LENT_LEFT] = BACK_SECONDS * pace.rate + routes.table[r, 6]
    if whole[e, p, WAIT] > 0 and (not on_way or whole[e, p, TURNED] % 2 == 1):
        whole[e, p, ASIDE_LEFT] = routes.table[r, 6]
    whole[e, p, WAIT], whole[e, p, PRESSED] = 0, 0
    whole[e, p, ROUND_TICKS], whole[e, p, SIDE] = 0, -whole[e, p, SIDE]
    whole[e, p, TURNED] += 1
    whole[e, p, BACK_LEFT] = 0
    way = real[e, p, WAY]
    behind = way if sign > 0 else routes.lines[r, 1] - way
    if routes.table[r, 4] != 2 and behind <= (LEAVE if on_way else 0.0):
        whole[e, p, ASIDE_LEFT] = routes.table[r, 6]  # at its end there is no way back
        return
    whole[e, p, DIRECTION] = -sign
    if sign > 0 and routes.table[r, 4] != 1:
        whole[e, p, BACK_LEFT] = BACK_SECONDS * pace.rate + routes.table[r, 6]


@njit_borrowing
def go_round(real, whole, route, walls, routes, wall_arrays, pace, agent, radius, e, p):
    """A tick beside the path, around whoever is on it."""
    r, dt = route[e, p], pace.seconds
    x, y, v = real[e, p, X0], real[e, p, Y0], real[e, p, SPEED]
    length = routes.lines[r, 1]
    whole[e, p, ROUND_TICKS] += 1
    loops = routes.table[r, 4] == 2
    if loops:  # over the seam
        sign = whole[e, p, DIRECTION]
        if sign > 0 and real[e, p, WAY] >= length:
            real[e, p, WAY], whole[e, p, PIECE], whole[e, p, HOLD] = 0.0, 0, 0
        elif sign < 0 and real[e, p, WAY] <= 0.0:
            real[e, p, WAY] = length
            whole[e, p, PIECE] = routes.table[r, 1] - routes.table[r, 0] - 2
    late = whole[e, p, ROUND_TICKS] >= ROUND_SECONDS * pace.rate
    shut = whole[e, p, WAIT] >= NO_WAY_SECONDS * pace.rate
    if late or shut:
        sign = whole[e, p, DIRECTION]
        way, aside, piece = nearest_way(routes, r, real[e, p, WAY], whole[e, p, PIECE], sign, x, y)
        who = AGENT
        if not shut and whole[e, p, ROUND_TICKS] < ROUND_MOST * pace.rate:
            near = find_near(real, route, agent, radius, e, p, aside + 0.7)  # all who may be there
            _, who = room_ahead(
                real, route, routes, agent, radius, e, p, way, piece, sign, 0.6, near
            )
        if who != NOBODY:  # else they who were in the way are gone
            turn_back(real, whole, route, routes, pace, agent, radius, e, p, aside)
    sign, side = whole[e, p, DIRECTION], whole[e, p, SIDE]
    way, aside, piece = nearest_way(routes, r, real[e, p, WAY], whole[e, p, PIECE], sign, x, y)
    mx, my, _, _, _ = place_at(routes, r, way, piece)
    if whole[e, p, ASIDE_LEFT] > 0:
        make_room(real, whole, route, walls, wall_arrays, pace, agent, radius, e, p, mx, my)
        return
    real[e, p, WAY], whole[e, p, PIECE] = way, piece
    fastest = min(ROUND_SPEED, routes.lines[r, 0])
    now = min(v + ACCELERATION * dt * 0.875, fastest)
    step = 0.5 * (v + now) * dt
    bx, by, best, qx, qy = 0.0, 0.0, -1e30, x, y
    near = find_near(real, route, agent, radius, e, p, 1.0)
    if aside <= HOME:
        _, who = room_ahead(real, route, routes, agent, radius, e, p, way, piece, sign, 0.6, near)
        nx, ny, piece, tx, ty = place_at(routes, r, way, piece)
        if who == NOBODY and clear_line(walls, wall_arrays, e, x, y, nx, ny):
            there = aside <= step + 0.005
            ux, uy = 0.0, 0.0
            if not there:
                ux, uy = (nx - x) / aside, (ny - y) / aside
                nx, ny = x + ux * step, y + uy * step
            share, _ = share_allowed(real, route, agent, radius, e, p, nx, ny, near)
            free = there or is_free(walls, wall_arrays, e, nx, ny)
            if share >= 1.0 and free and (there or aside <= SHUFFLE):
                real[e, p, X], real[e, p, Y] = nx, ny
                real[e, p, SPEED] = aside / dt if there else now
                turn_to(real, pace, e, p, sign * tx, sign * ty, pace.seconds)
                if there:
                    come_home(whole, routes, r, way, piece, e, p)
                return
            if share >= 1.0 and free:
                bx, by, best = ux, uy, 1.0
    carrot = min(max(aside + 0.3, 0.4), 1.2)
    at = way + sign * carrot
    if loops and at > length:
        at -= length
    elif loops and at < 0.0:
        at += length
    at = min(max(at, 0.0), length)
    cx, cy, _, _, _ = place_at(routes, r, at, piece)
    dx, dy = cx - x, cy - y
    size = math.sqrt(dx * dx + dy * dy)
    if size < 1e-6:
        dx, dy = real[e, p, HX], real[e, p, HY]
    else:
        dx, dy = dx / size, dy / size
    here = gap_at(real, route, agent, radius, e, p, x, y, near)
    squeezes = whole[e, p, TURNED] % 4 > 1
    room = SQUEEZE if squeezes else ROOM
    for k in range(len(TURNS) if squeezes else FEW_TURNS):
        turn = TURNS[k]
        if best == 1.0:  # the path itself, near by and free
            break
        if turn >= 0:
            cos, sin = ROUND_COS20[turn], ROUND_SIN20[turn] * side
        else:
            cos, sin = ROUND_COS20[-turn], -ROUND_SIN20[-turn] * side
        ux, uy = dx * cos - dy * sin, dx * sin + dy * cos
        score = cos + 0.3 * (ux * real[e, p, HX] + uy * real[e, p, HY])
        if score <= best:
            continue
        reach = 0.35 if size > 0.35 else size
        qx, qy = x + ux * reach, y + uy * reach
        ok = True
        for part in (1.0, 0.67, 0.34):  # what is in the way mostly is at the end
            ax, ay = x + ux * reach * part, y + uy * reach * part
            if not is_free(walls, wall_arrays, e, ax, ay):
                ok = False
                break
            clear = gap_at(real, route, agent, radius, e, p, ax, ay, near)
            if clear < room and clear < here + 0.2 * reach * part:
                ok = False
                break
        if ok and not is_free(walls, wall_arrays, e, x + ux * step, y + uy * step):
            ok = False
        if ok and not squeezes:  # whence one sees the path, one comes back to it
            ok = clear_line(walls, wall_arrays, e, qx, qy, cx, cy)
            ok = ok or clear_line(walls, wall_arrays, e, qx, qy, mx, my)
        if ok:
            best, bx, by = score, ux, uy
    if best < -1e29:
        whole[e, p, WAIT] += 1  # and stand as one stands: who waits does not turn to and fro
        real[e, p, SPEED] = 0.0
        return
    if turn_to(real, pace, e, p, bx, by, pace.seconds) < SIDEWAYS:
        real[e, p, SPEED] = 0.0
        return
    nx, ny = x + bx * step, y + by * step
    share, who = share_allowed(real, route, agent, radius, e, p, nx, ny, near)
    if share < 1.0:
        whole[e, p, BLOCKED_BY] = who
        now = 0.0
        whole[e, p, WAIT] += 1
        share = share * 0.999
        nx, ny = x + bx * step * share, y + by * step * share
        if not is_free(walls, wall_arrays, e, nx, ny):
            nx, ny = x, y
    real[e, p, X], real[e, p, Y], real[e, p, SPEED] = nx, ny, now
