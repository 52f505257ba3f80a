"""Sliding along walls, for bodies whose own simulator lets them slide (Habitat's `allow_sliding`).

What is left of a cut move is projected on the wall's tangent, at most twice, and is cut itself at
blocked cells: nobody ever enters one. Habitat slides along the edges of a navmesh; here the wall is
a stair of cells, whose tangent is that of the blocked cells around, so the two agree in kind and
not to the centimetre.
"""

from __future__ import annotations

import math

from gn0.jit import njit
from gn0.maps.ray import is_blocked, trace_points

PROJECTIONS = 2
_AROUND = 3  # cells each way that tell how a wall runs
_LEAST = 1e-9  # m of progress that is worth a projection


@njit
def _to_wall(blocked, row, col):  # type: ignore[no-untyped-def]
    """Unit vector (x, y) towards the blocked cells around, near ones first; zero if undecided."""
    nx, ny = 0.0, 0.0
    for dr in range(-_AROUND, _AROUND + 1):
        for dc in range(-_AROUND, _AROUND + 1):
            square = dr * dr + dc * dc
            if 0 < square <= _AROUND * _AROUND and is_blocked(blocked, row + dr, col + dc):
                nx += dc / square
                ny += dr / square
    length = math.sqrt(nx * nx + ny * ny)
    if length < 1e-9:
        return 0.0, 0.0
    return nx / length, ny / length


@njit
def slide_points(blocked, origin_x, origin_y, resolution, x0, y0, x1, y1):  # type: ignore[no-untyped-def]
    """`trace_points`, going on along the wall where the move is cut: (x, y, hit)."""
    x, y, hit = trace_points(blocked, origin_x, origin_y, resolution, x0, y0, x1, y1)
    if not hit:
        return x, y, False
    rx, ry = x1 - x, y1 - y
    for _ in range(PROJECTIONS):
        row = math.floor((y - origin_y) / resolution)
        col = math.floor((x - origin_x) / resolution)
        nx, ny = _to_wall(blocked, row, col)
        into = rx * nx + ry * ny
        tx, ty = rx, ry
        if into > 0.0:
            tx, ty = rx - into * nx, ry - into * ny
        length = math.sqrt(tx * tx + ty * ty)
        best, best_x, best_y, best_hit, end_x, end_y = 0.0, x, y, True, x, y
        # along the tangent; the same one or two cells off the wall, over a stair; bent off it;
        # and along an axis where all of these stand still
        for way in range(6):
            if way >= 4 and best > _LEAST:
                break
            px, py = x, y
            dx, dy = tx, ty
            if way < 4 and length <= _LEAST:
                continue
            if way == 1 or way == 2:
                lift = min(way * resolution, 0.5 * length)
                px, py, _ = trace_points(
                    blocked, origin_x, origin_y, resolution, x, y, x - lift * nx, y - lift * ny
                )
                dx, dy = tx * (1.0 - lift / length), ty * (1.0 - lift / length)
            elif way == 3:
                dx, dy = tx - nx * resolution, ty - ny * resolution
                size = math.sqrt(dx * dx + dy * dy)
                dx, dy = dx * length / size, dy * length / size
            elif way == 4:
                dx, dy = rx, 0.0
            elif way == 5:
                dx, dy = 0.0, ry
            qx, qy, cut = trace_points(
                blocked, origin_x, origin_y, resolution, px, py, px + dx, py + dy
            )
            if way < 4:
                gain = ((qx - x) * tx + (qy - y) * ty) / length
            else:
                gain = math.sqrt((qx - x) * (qx - x) + (qy - y) * (qy - y))
            if gain > best + _LEAST:
                best, best_x, best_y, best_hit = gain, qx, qy, cut
                end_x, end_y = px + dx, py + dy
        if best <= _LEAST:
            break
        x, y = best_x, best_y
        if not best_hit:
            break
        rx, ry = end_x - x, end_y - y
    return x, y, True
