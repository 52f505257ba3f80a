"""Where people can walk: the map inflated for them, and paths checked and rounded on it."""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import lru_cache
from itertools import pairwise, product

import numpy as np
from numpy.typing import NDArray

from gn0.geometry import F64
from gn0.maps.grid import OccupancyGrid
from gn0.maps.navigation import NavigationMap
from gn0.people.person import WALL_DISTANCE

_ROUNDING = 0.35  # m of each side of a bend that a curve replaces, at most
_PIECES = 6  # of such a curve
_TOUCH = 1e-6  # cells: who comes so near to a cell touches it


@lru_cache(maxsize=8)
def people_map(grid: OccupancyGrid, distance: float = WALL_DISTANCE) -> NavigationMap:
    """The map of people, `distance` [m] from walls; the latest are kept."""
    return NavigationMap(grid, distance)


def blocked_at(
    grid: OccupancyGrid, path: Sequence[tuple[float, float]], distance: float = WALL_DISTANCE
) -> tuple[float, float] | None:
    """The first place (x, y) [m] of a path that is nearer than `distance` [m] to a wall, or None.

    Every cell that the path meets or touches is looked at.
    """
    points = np.asarray(path, np.float64).reshape(-1, 2)
    near = people_map(grid, distance).inflated
    dense = cross_cells((points - near.origin) / near.resolution)
    height, width = near.shape
    blocked: NDArray[np.bool_] = np.pad(near.blocked, 1, constant_values=True)
    bad = np.zeros(len(dense), np.bool_)
    for touch in product((-_TOUCH, _TOUCH), repeat=2):
        cells = np.floor(dense + np.array(touch)).astype(np.int64) + 1
        bad |= blocked[cells[:, 1].clip(0, height + 1), cells[:, 0].clip(0, width + 1)]
    if not bad.any():
        return None
    x, y = dense[int(np.argmax(bad))] * near.resolution + near.origin
    return float(x), float(y)


def cross_cells(points: F64) -> F64:
    """A place [M, 2] in each cell that a path [N, 2] meets, its own points among them, in cells."""
    rows = []
    for a, b in pairwise(points):
        step = b - a
        cuts = [np.array([0.0, 1.0])]
        for k in range(2):
            if step[k] != 0.0:
                low, high = sorted((a[k], b[k]))
                cuts.append((np.arange(math.ceil(low), math.floor(high) + 1) - a[k]) / step[k])
        at = np.unique(np.clip(np.concatenate(cuts), 0.0, 1.0))
        middle = 0.5 * (at[1:] + at[:-1])
        rows.append(a + step * np.sort(np.concatenate([at[:-1], middle]))[:, None])
    return np.concatenate([*rows, points[-1:]]) if rows else points


def round_path(grid: OccupancyGrid, points: F64) -> F64:
    """The path [N, 2] m with its bends rounded, wherever walls leave room for that."""
    if len(points) < 3:
        return points
    out = [points[0]]
    for k in range(1, len(points) - 1):
        a, b, c = out[-1], points[k], points[k + 1]
        before, after = float(np.hypot(*(b - a))), float(np.hypot(*(c - b)))
        if min(before, after) < 1e-9:
            continue
        u, w = (b - a) / before, (c - b) / after
        if float(u @ w) > 0.9998:
            out.append(b)
            continue
        room = min(_ROUNDING, before, 0.5 * after)
        for size in (room, 0.5 * room):
            p, q = b - size * u, b + size * w
            t = np.linspace(0.0, 1.0, _PIECES + 1)[:, None]
            curve = (1 - t) ** 2 * p + 2 * t * (1 - t) * b + t**2 * q
            if blocked_at(grid, curve.tolist()) is None:
                out.extend(curve)
                break
        else:
            out.append(b)
    out.append(points[-1])
    kept = [out[0]]
    for point in out[1:]:
        if float(np.hypot(*(point - kept[-1]))) > 1e-4:
            kept.append(point)
    return np.array(kept)
