"""The best next steps of a follower that knows where everybody will be: a search a second ahead.

Sequences of actions are grown step by step, those that end in one place and heading are merged, and
the best are kept (a beam). A step is worth 1 where the person is near and in view; it costs a
little to be off the preferred distance, off the reference, and off the axis. What a sequence leaves
to walk, to where the agent should be at the end, counts against it from its first step on.
"""

from __future__ import annotations

import math

import numpy as np

from gn0.geometry import F64, Pose2D
from gn0.jit import njit
from gn0.maps.distance import GeodesicField
from gn0.maps.grid import OccupancyGrid
from gn0.maps.ray import trace_points
from gn0.missions.episode import AgentSpec
from gn0.paper import FORWARD, LEFT, RIGHT
from gn0.sim.state import Action

BEAM = 96  # sequences kept after each step
SAME = 0.02  # m: places nearer than this are one
NEAR, FAR = 0.8, 2.9  # m: a person nearer fills the picture, one farther is not followed
SURE = 0.06  # m: of the room, how much may be lacking where a step gains some
SHOULDER = 0.20  # m off the line of sight: somebody nearer to it hides the person
HALF_VIEW = math.radians(37.0)  # of the axis: the person is well in view
OFF_DISTANCE, OFF_REFERENCE, OFF_AXIS = 0.15, 0.05, 0.05  # worth lost a metre, a metre, half a view
WAY_LEFT, WAY_FAR, SLACK = 1.0, 5.0, 0.75  # worth lost a metre that is left to walk; beyond slack
CUT_OFF = 1000.0  # m


def search_steps(
    navigation: OccupancyGrid,
    sight: OccupancyGrid,
    onward: GeodesicField,
    pose: Pose2D,
    crowd: F64,
    references: F64,
    agent: AgentSpec,
    *,
    distance: float,
    room: float,
    barred: bool = False,
) -> Action:
    """The first of the best sequence of as many actions as there are references.

    Args:
        navigation: the map, inflated for the agent: no step is cut short by it.
        sight: what the person is hidden behind.
        onward: how far it is to where the agent should be after the last step.
        pose: of the agent.
        crowd: [K, 2, P, 2] m where everybody will be half way through each step and at its end: the
            person to follow by its track, the same as it has walked till now, then all others.
        references: [K, 2] m where the agent should be after each step.
        agent: the body.
        distance: preferred one [m].
        room: distance of the centres of the agent and of anybody [m] below which it takes no step
            that does not gain some; 0.06 m less, and it takes none at all.
        barred: the first action is no FORWARD: it was just cut short there.
    """
    frames = [
        (grid.blocked, float(grid.origin[0]), float(grid.origin[1]), float(grid.resolution))
        for grid in (navigation, sight)
    ]
    first = _search(
        *frames[0], onward.label, onward.roots, *frames[1], pose.x, pose.y, pose.yaw,
        np.ascontiguousarray(crowd, np.float64), np.ascontiguousarray(references, np.float64),
        agent.forward_step, math.radians(agent.turn_degrees), distance, room,
        barred,
    )  # fmt: skip
    return Action(int(first))


@njit
def _is_hidden(crowd, x, y):  # type: ignore[no-untyped-def]
    """Whether somebody stands between a place and the person."""
    dx, dy = crowd[1, 0, 0] - x, crowd[1, 0, 1] - y
    square = max(dx * dx + dy * dy, 1e-9)
    for p in range(2, crowd.shape[1]):
        ex, ey = crowd[1, p, 0] - x, crowd[1, p, 1] - y
        part = (ex * dx + ey * dy) / square
        if 0.0 < part < 1.0 and abs(ex * dy - ey * dx) < SHOULDER * math.sqrt(square):
            return True
    return False


@njit
def _worth(blocked, ox, oy, res, x, y, yaw, crowd, rx, ry, distance):  # type: ignore[no-untyped-def]
    """What it is worth to be at a place, people and the reference being where they are."""
    px, py = crowd[1, 0, 0], crowd[1, 0, 1]
    dx, dy = px - x, py - y
    away = math.sqrt(dx * dx + dy * dy)
    off = abs((math.atan2(dy, dx) - yaw + math.pi) % (2 * math.pi) - math.pi)
    value = -OFF_DISTANCE * min(abs(away - distance), 3.0)
    value -= OFF_REFERENCE * min(math.sqrt((rx - x) ** 2 + (ry - y) ** 2), 3.0)
    value -= OFF_AXIS * min(off / HALF_VIEW, 4.0)
    shown = NEAR <= away <= FAR and off <= HALF_VIEW
    if shown and not trace_points(blocked, ox, oy, res, px, py, x, y)[2]:
        value += 0.0 if _is_hidden(crowd, x, y) else 1.0
    return value


@njit
def _way_left(label, roots, ox, oy, res, x, y):  # type: ignore[no-untyped-def]
    """What it costs to have a way left to walk; more beyond some slack."""
    u, v = (x - ox) / res, (y - oy) / res
    left = CUT_OFF
    if 0 <= u < label.shape[1] and 0 <= v < label.shape[0]:
        root = label[int(v), int(u)]
        if root >= 0:
            dx, dy = u - roots[root, 0], v - roots[root, 1]
            left = max(roots[root, 2] + math.sqrt(dx * dx + dy * dy), 0.0) * res
    return WAY_LEFT * left + WAY_FAR * max(left - SLACK, 0.0)


@njit
def _is_cut(blocked, ox, oy, res, x0, y0, x1, y1):  # type: ignore[no-untyped-def]
    """Whether a step meets something, walked at once or in two ticks."""
    x, y = 0.5 * (x0 + x1), 0.5 * (y0 + y1)
    if trace_points(blocked, ox, oy, res, x0, y0, x1, y1)[2]:
        return True
    if trace_points(blocked, ox, oy, res, x0, y0, x, y)[2]:
        return True
    return trace_points(blocked, ox, oy, res, x, y, x1, y1)[2]


@njit
def _is_room(crowd, x0, y0, x1, y1, room):  # type: ignore[no-untyped-def]
    """Whether a step keeps its distance from everybody half way and at its end, or gains some."""
    for part in range(2):
        x, y = (0.5 * (x0 + x1), 0.5 * (y0 + y1)) if part == 0 else (x1, y1)
        for p in range(crowd.shape[1]):
            dx, dy = crowd[part, p, 0] - x, crowd[part, p, 1] - y
            now = dx * dx + dy * dy
            if now < (room - SURE) ** 2:
                return False
            if now < room * room:
                bx, by = crowd[part, p, 0] - x0, crowd[part, p, 1] - y0
                if now <= bx * bx + by * by:
                    return False
    return True


@njit
def _search(  # type: ignore[no-untyped-def]
    blocked, ox, oy, res, label, roots, hidden, hx, hy, hres, x, y, yaw, crowd, refs, step, turn,
    distance, room, barred,
):  # fmt: skip
    n = 1
    xs, ys = np.full(1, x), np.full(1, y)
    turns, firsts = np.zeros(1, np.int64), np.full(1, -1)
    totals = np.zeros(1)
    for k in range(len(refs)):
        nx, ny = np.empty(4 * n), np.empty(4 * n)
        nt, nf = np.empty(4 * n, np.int64), np.empty(4 * n, np.int64)
        nv, nl = np.empty(4 * n), np.empty(4 * n)
        m = 0
        for i in range(n):
            for action in range(4):
                x1, y1, t = xs[i], ys[i], turns[i]
                if action == FORWARD:
                    heading = yaw + t * turn
                    x1, y1 = x1 + step * math.cos(heading), y1 + step * math.sin(heading)
                    if k == 0 and barred:
                        continue
                    if _is_cut(blocked, ox, oy, res, xs[i], ys[i], x1, y1):
                        continue
                    if not _is_room(crowd[k], xs[i], ys[i], x1, y1, room):
                        continue
                elif action == LEFT:
                    t += 1
                elif action == RIGHT:
                    t -= 1
                nx[m], ny[m], nt[m] = x1, y1, t
                nf[m] = action if k == 0 else firsts[i]
                nv[m] = totals[i] + _worth(
                    hidden, hx, hy, hres, x1, y1, yaw + t * turn, crowd[k],
                    refs[k, 0], refs[k, 1], distance,
                )  # fmt: skip
                nl[m] = nv[m] - _way_left(label, roots, ox, oy, res, x1, y1)
                m += 1
        order = np.argsort(-nl[:m], kind="mergesort")
        kept = np.empty(min(m, BEAM), np.int64)
        n = 0
        for j in order:
            if n == len(kept):
                break
            twin = False
            for q in range(n):
                o = kept[q]
                if nt[o] == nt[j] and abs(nx[o] - nx[j]) < SAME and abs(ny[o] - ny[j]) < SAME:
                    twin = True
                    break
            if not twin:
                kept[n] = j
                n += 1
        kept = kept[:n]
        xs, ys, turns, firsts, totals = nx[kept], ny[kept], nt[kept], nf[kept], nv[kept]
    return firsts[0]
