"""Kernels of ways: straight lines that are clear, bends off their corners, points at equal arcs."""

from __future__ import annotations

import math

import numpy as np

from gn0.jit import njit
from gn0.maps.ray import is_blocked

FAR_POINTS = 256  # points of a way that are looked at; the first metres never need as many
GOOD, UNREACHABLE, UNSEEN = 0, 1, 2  # how a state fared in `sample_ways`


@njit
def is_clear(blocked, origin_x, origin_y, resolution, x0, y0, x1, y1):  # type: ignore[no-untyped-def]
    """Whether no point of a straight line lies in a blocked cell.

    Stricter than a move of the simulator, whose Bresenham line may leave out a cell that the
    straight line just touches: a waypoint may be anywhere on its line.
    """
    u, v = (x0 - origin_x) / resolution, (y0 - origin_y) / resolution
    du, dv = (x1 - origin_x) / resolution - u, (y1 - origin_y) / resolution - v
    col, row = math.floor(u), math.floor(v)
    last_col, last_row = math.floor(u + du), math.floor(v + dv)
    if is_blocked(blocked, row, col) or is_blocked(blocked, last_row, last_col):
        return False
    right, up = (1 if du > 0 else -1), (1 if dv > 0 else -1)
    per_col = abs(1.0 / du) if du != 0 else np.inf
    per_row = abs(1.0 / dv) if dv != 0 else np.inf
    next_col = ((col + 1 - u) if du > 0 else (u - col)) * per_col if du != 0 else np.inf
    next_row = ((row + 1 - v) if dv > 0 else (v - row)) * per_row if dv != 0 else np.inf
    for _ in range(abs(last_col - col) + abs(last_row - row) + 2):
        if col == last_col and row == last_row:
            return True
        if abs(next_col - next_row) < 1e-9:  # through a corner: all that meet there
            if is_blocked(blocked, row, col + right) or is_blocked(blocked, row + up, col):
                return False
            col, row = col + right, row + up
            next_col, next_row = next_col + per_col, next_row + per_row
        elif next_col < next_row:
            col += right
            next_col += per_col
        else:
            row += up
            next_row += per_row
        if is_blocked(blocked, row, col):
            return False
    return True


@njit
def shorten_way(blocked, origin_x, origin_y, resolution, points):  # type: ignore[no-untyped-def]
    """Indices [M] of the points that a way keeps: from each the farthest that is in clear sight."""
    kept = np.empty(len(points), np.int64)
    kept[0] = 0
    count, here = 1, 0
    while here < len(points) - 1:
        there = len(points) - 1
        while there > here + 1 and not is_clear(
            blocked, origin_x, origin_y, resolution,
            points[here, 0], points[here, 1], points[there, 0], points[there, 1],
        ):  # fmt: skip
            there -= 1
        kept[count] = there
        count += 1
        here = there
    return kept[:count]


@njit
def free_corners(blocked, origin_x, origin_y, resolution, roots, goals):  # type: ignore[no-untyped-def]
    """Where an agent passes each bend of a geodesic field [R, 2] m: the free cell beside it.

    Exactly one of the four cells round a convex corner is blocked; the one opposite is taken. The
    first rows are the goals; NaN stands for the inside of an area.
    """
    out = np.empty((len(roots), 2))
    for r in range(len(roots)):
        if r < len(goals):
            out[r, 0], out[r, 1] = goals[r, 0], goals[r, 1]
            continue
        if roots[r, 2] == -np.inf:
            out[r, 0] = out[r, 1] = np.nan
            continue
        u, v = round(roots[r, 0]), round(roots[r, 1])
        row, col = v, u
        for k in range(4):
            i, j = v - 1 + k // 2, u - 1 + k % 2
            if is_blocked(blocked, i, j):
                row, col = v - k // 2, u - k % 2
                break
        out[r, 0] = origin_x + (col + 0.5) * resolution
        out[r, 1] = origin_y + (row + 0.5) * resolution
    return out


@njit
def blocked_legs(blocked, origin_x, origin_y, resolution, places, parents):  # type: ignore[no-untyped-def]
    """Which bends [R] cannot be left straight for the next one."""
    out = np.zeros(len(places), np.bool_)
    for r in range(1, len(places)):
        p = parents[r]
        if p >= 0:
            out[r] = not is_clear(
                blocked, origin_x, origin_y, resolution,
                places[r, 0], places[r, 1], places[p, 0], places[p, 1],
            )  # fmt: skip
    return out


@njit
def spread_points(points, count, blocked, frame, spacing, heading, out, slots):  # type: ignore[no-untyped-def]
    """Shorten a way by lines of sight and lay points along it at equal arcs, in the agent's frame.

    The agent is at the first point, and `heading` is the cosine and sine of its yaw. Returns how
    many points there are before the last is repeated.
    """
    cosine, sine = heading
    begin_x, begin_y = points[0, 0], points[0, 1]
    out[0, 0] = out[0, 1] = 0.0
    k, here, arc = 1, 0, 0.0
    last_x, last_y = begin_x, begin_y
    while k < slots and here < count - 1:
        ax, ay = points[here, 0], points[here, 1]
        there = count - 1
        while there > here + 1 and not is_clear(
            blocked, frame[0], frame[1], frame[2], ax, ay, points[there, 0], points[there, 1]
        ):
            there -= 1
        dx, dy = points[there, 0] - ax, points[there, 1] - ay
        length = math.sqrt(dx * dx + dy * dy)
        while k < slots and spacing * k <= arc + length + 1e-9 and length > 0:
            t = min((spacing * k - arc) / length, 1.0)
            x, y = ax + t * dx - begin_x, ay + t * dy - begin_y
            out[k, 0], out[k, 1] = cosine * x + sine * y, -sine * x + cosine * y
            k += 1
        arc += length
        here = there
        last_x, last_y = points[here, 0], points[here, 1]
    if k < slots and arc - spacing * (k - 1) > 1e-6:  # the end itself, a shorter step away
        x, y = last_x - begin_x, last_y - begin_y
        out[k, 0], out[k, 1] = cosine * x + sine * y, -sine * x + cosine * y
        k += 1
    for i in range(k, slots):
        out[i] = out[k - 1]
    return k


@njit
def spread_line(points, blocked, origin_x, origin_y, resolution, spacing, pose, out):  # type: ignore[no-untyped-def]
    """`sample_ways` for one state whose way [N, 2] m is given; returns the number of points."""
    frame = (origin_x, origin_y, resolution)
    heading = (math.cos(pose[2]), math.sin(pose[2]))
    return spread_points(points, len(points), blocked, frame, spacing, heading, out, len(out))


@njit
def gather_bends(points, count, root, parents, places, via_start, vias):  # type: ignore[no-untyped-def]
    """Write the bends from a root to the goal behind `count` points.

    Returns how many points there are then, and whether the goal is among them.
    """
    while True:
        x, y = places[root, 0], places[root, 1]
        if x != points[count - 1, 0] or y != points[count - 1, 1]:
            points[count, 0], points[count, 1] = x, y
            count += 1
        if parents[root] < 0:
            return count, True
        if count == FAR_POINTS:
            return count, False
        for k in range(via_start[root], via_start[root + 1]):
            if count < FAR_POINTS:
                points[count, 0], points[count, 1] = vias[k, 0], vias[k, 1]
                count += 1
        if count == FAR_POINTS:
            return count, False
        root = parents[root]


@njit
def sample_ways(  # type: ignore[no-untyped-def]
    poses, blocked, origin_x, origin_y, resolution, label, parents, places, via_start, vias,
    spacing, out, valid, status,
):  # fmt: skip
    """Points at equal arcs along the shortest drivable way from each pose to a field's goal.

    Args (arrays): poses [N, 3]; the field's label and parents; places [R, 2] m of its bends, and
    for each bend the points `vias[via_start[r]:via_start[r + 1]]` on the way to the next.
    Writes out [N, K, 2] m in each agent's frame, valid [N], status [N].
    """
    height, width = blocked.shape
    points = np.empty((FAR_POINTS, 2))
    frame = (origin_x, origin_y, resolution)
    for i in range(len(poses)):
        x, y = poses[i, 0], poses[i, 1]
        col = math.floor((x - origin_x) / resolution)
        row = math.floor((y - origin_y) / resolution)
        status[i], valid[i] = UNREACHABLE, 0
        if row < 0 or col < 0 or row >= height or col >= width or label[row, col] < 0:
            continue
        r = label[row, col]
        points[0, 0], points[0, 1] = x, y
        count = 1
        if not math.isnan(places[r, 0]):  # in the goal's area the way ends here
            place_x, place_y = places[r, 0], places[r, 1]
            whole = is_clear(blocked, origin_x, origin_y, resolution, x, y, place_x, place_y)
            if whole:
                count, whole = gather_bends(points, count, r, parents, places, via_start, vias)
            if not whole:
                status[i] = UNSEEN
                continue
        heading = (math.cos(poses[i, 2]), math.sin(poses[i, 2]))
        valid[i] = spread_points(
            points, count, blocked, frame, spacing, heading, out[i], out.shape[1]
        )
        status[i] = GOOD
