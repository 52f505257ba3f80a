"""Which ground of a capture lies within walls: seen from there, most directions end at a wall."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from gn0.geometry import F64

INSIDE = 0.80  # of the directions end at a wall: inside; beside a façade half of them do
OUTSIDE = 0.65  # less: outside; in between one cannot say (a yard's corner, a glazed room)
LEAST_WALL = 4.0  # m of wall cells: fewer enclose nothing
LEAST_ROOM = 1.0  # m² within walls: less is a niche
_DIRECTIONS = [
    (dr, dc)
    for dr in range(-2, 3)
    for dc in range(-2, 3)
    if max(abs(dr), abs(dc)) == 2 and (dr % 2 or dc % 2 or 0 in (dr, dc) or abs(dr) == abs(dc))
]


def enclosed_share(wall: NDArray[np.bool_]) -> F64:
    """Share of sixteen directions in which a ray from each cell [rows, columns] meets a wall."""
    # two cells thick, so that no ray of steps by two passes between
    thick = ndimage.binary_dilation(wall, structure=np.ones((3, 3)))
    count = np.zeros(wall.shape, np.int64)
    for dr, dc in _DIRECTIONS:
        if dr % 2 == 0 and dc % 2 == 0:
            dr, dc = dr // 2, dc // 2
        count += _meets(thick, dr, dc)
    return np.asarray(count / len(_DIRECTIONS))


def _meets(wall: NDArray[np.bool_], dr: int, dc: int) -> NDArray[np.bool_]:
    """Cells from which steps by (dr, dc) come upon a wall."""
    if dr == 0:
        return _meets(wall.T, dc, 0).T
    ahead = wall[::-1] if dr > 0 else wall
    out = ahead.copy()
    step, columns = abs(dr), wall.shape[1]
    for r in range(step, len(out)):
        before = out[r - step]
        if dc > 0:
            out[r, : columns - dc] |= before[dc:]
        elif dc < 0:
            out[r, -dc:] |= before[:dc]
        else:
            out[r] |= before
    return out[::-1] if dr > 0 else out


def find_inside(
    wall: NDArray[np.bool_], open_: NDArray[np.bool_], resolution: float
) -> tuple[NDArray[np.bool_], NDArray[np.bool_]] | None:
    """Open cells within walls, and open cells outside them; None where nothing is enclosed.

    Args:
        wall: cells that hold matter over the height of a head [rows, columns].
        open_: cells with floor and nothing in the way.
        resolution: side of a cell [m].
    """
    if wall.sum() * resolution < LEAST_WALL:
        return None
    share = enclosed_share(wall)
    inside = open_ & (share >= INSIDE)
    if inside.sum() * resolution**2 < LEAST_ROOM:
        return None
    return inside, open_ & (share < OUTSIDE)
