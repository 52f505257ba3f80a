"""Ticks finer than the clock by which people decide: moves in parts, as kernels.

People look, choose and yield once in a tenth of a second, however fine ticks are: a decision is a
move of that long (`gn0.people.tick`), begun at a moment that all ticks share. Finer ticks cut the
move into equal parts and let go of what is left of it where the agent, which moves in between, is
in the way. No part brings two people nearer than their moves do: each uses its half of the gap.
"""

# mypy: disable-error-code="no-untyped-def"

from __future__ import annotations

import math

from gn0.jit import njit, njit_borrowing
from gn0.people.reach import (
    AGENT,
    BLOCKED_BY,
    CLIP,
    CLIP_SINCE,
    DIRECTION,
    HX,
    HY,
    MODE,
    ROUND,
    ROUND_TICKS,
    SAFE_GAP,
    SIDE,
    SPEED,
    STILL,
    WAIT,
    WALKED,
    WAY,
    X0,
    Y0,
    X,
    Y,
    is_free,
)
from gn0.people.route import SCRIPT

# columns of a move that ticks cut: parts of it that are over, 0 at a moment of decision; where it
# ends [m], the unit vector of the heading there, and the distance walked by then [m]
PART, TO_X, TO_Y, TO_HX, TO_HY, TO_WALKED = range(6)
PLANS = 6
MOVED_BY = [X, Y, HX, HY, WALKED]  # what a part of a move changes, in the order of its ends


@njit
def do_parts(real, whole, route, walls, routes, wall_arrays, cuts, plan, agent, radius):
    """Do the next of `cuts` parts of everybody's move, in place; who stays has none."""
    for e in range(real.shape[0]):
        for p in range(real.shape[1]):
            left = cuts - plan[e, p, PART]
            real[e, p, X0], real[e, p, Y0] = real[e, p, X], real[e, p, Y]
            r = route[e, p]
            if r >= 0 and routes.table[r, 5] == SCRIPT:
                if _agent_is_in_the_way(real, plan, agent, radius, left, e, p):
                    _stop_short(real, whole, routes, plan, e, p, r)
                else:
                    _go_a_part(real, walls, wall_arrays, plan, left, e, p)
            plan[e, p, PART] = plan[e, p, PART] + 1.0 if left > 1.0 else 0.0


@njit_borrowing
def _go_a_part(real, walls, wall_arrays, plan, left, e, p):
    """Do one of the parts that are `left` of a move."""
    if left <= 1.0:
        real[e, p, X], real[e, p, Y] = plan[e, p, TO_X], plan[e, p, TO_Y]
        real[e, p, HX], real[e, p, HY] = plan[e, p, TO_HX], plan[e, p, TO_HY]
        real[e, p, WALKED] = plan[e, p, TO_WALKED]
        return
    x = real[e, p, X] + (plan[e, p, TO_X] - real[e, p, X]) / left
    y = real[e, p, Y] + (plan[e, p, TO_Y] - real[e, p, Y]) / left
    hx = real[e, p, HX] + (plan[e, p, TO_HX] - real[e, p, HX]) / left
    hy = real[e, p, HY] + (plan[e, p, TO_HY] - real[e, p, HY]) / left
    size = math.sqrt(hx * hx + hy * hy)  # a move turns by nine degrees at most
    real[e, p, HX], real[e, p, HY] = hx / size, hy / size
    if is_free(walls, wall_arrays, e, x, y):  # between two free places a corner may be cut
        real[e, p, X], real[e, p, Y] = x, y
        real[e, p, WALKED] += (plan[e, p, TO_WALKED] - real[e, p, WALKED]) / left


@njit_borrowing
def _agent_is_in_the_way(real, plan, agent, radius, left, e, p):
    """Whether the next part of a move would come nearer to the agent than it may."""
    if agent[e, 2] < 0.0:
        return False
    x, y = real[e, p, X], real[e, p, Y]
    dx, dy = agent[e, 0] - x, agent[e, 1] - y
    sx, sy = (plan[e, p, TO_X] - x) / left, (plan[e, p, TO_Y] - y) / left
    if sx * dx + sy * dy <= 0.0:
        return False
    ox, oy = dx - sx, dy - sy
    reach = radius + agent[e, 2] + SAFE_GAP
    return ox * ox + oy * oy < reach * reach


@njit_borrowing
def _stop_short(real, whole, routes, plan, e, p, r):
    """Let go of what is left of a move: stand, and come back to one's path as one goes round."""
    dx, dy = plan[e, p, TO_X] - real[e, p, X], plan[e, p, TO_Y] - real[e, p, Y]
    plan[e, p, TO_X], plan[e, p, TO_Y] = real[e, p, X], real[e, p, Y]
    plan[e, p, TO_HX], plan[e, p, TO_HY] = real[e, p, HX], real[e, p, HY]
    plan[e, p, TO_WALKED] = real[e, p, WALKED]
    real[e, p, SPEED] = 0.0
    whole[e, p, BLOCKED_BY] = AGENT
    if whole[e, p, CLIP] != STILL:
        whole[e, p, CLIP], whole[e, p, CLIP_SINCE] = STILL, 0
    if whole[e, p, MODE] != ROUND:  # its way along the path was that of the whole move
        back = whole[e, p, DIRECTION] * math.sqrt(dx * dx + dy * dy)
        real[e, p, WAY] = min(max(real[e, p, WAY] - back, 0.0), routes.lines[r, 1])
        whole[e, p, MODE], whole[e, p, ROUND_TICKS], whole[e, p, WAIT] = ROUND, 0, 0
        whole[e, p, SIDE] = -1
