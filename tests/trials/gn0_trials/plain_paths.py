"""The path filter as the paper states it, line by line and slowly: what the fast one is held to.

It shares no code with `gn0.missions.similarity` or `gn0.missions.generate.judge`.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from gn0.maps.grid import FREE, OccupancyGrid
from gn0.missions.generate.settings import MissionSettings

Points = Sequence[tuple[float, float]]


def plain_frechet(p: Points, q: Points) -> float:
    """Discrete Fréchet distance [m] of two point lists: the whole table (Eiter, Mannila 1994)."""
    table: list[list[float]] = []
    for i, (px, py) in enumerate(p):
        row: list[float] = []
        for j, (qx, qy) in enumerate(q):
            gap = math.sqrt((px - qx) * (px - qx) + (py - qy) * (py - qy))
            if i == 0 and j == 0:
                row.append(gap)
            elif i == 0:
                row.append(max(row[j - 1], gap))
            elif j == 0:
                row.append(max(table[i - 1][0], gap))
            else:
                least = min(table[i - 1][j], table[i - 1][j - 1], row[j - 1])
                row.append(max(least, gap))
        table.append(row)
    return table[-1][-1]


def plain_resample(points: Points, count: int) -> list[tuple[float, float]]:
    """`count` points at equal arc length, both ends included."""
    gaps = [math.dist(a, b) for a, b in itertools.pairwise(points)]
    total = sum(gaps)
    out = [points[0]]
    for k in range(1, count - 1):
        left = total * k / (count - 1)
        for a, b, gap in zip(points, points[1:], gaps, strict=False):
            if left <= gap:
                t = left / gap if gap else 0.0
                out.append((a[0] + (b[0] - a[0]) * t, a[1] + (b[1] - a[1]) * t))
                break
            left -= gap
        else:
            out.append(points[-1])
    return [*out, points[-1]]


def plain_verdict(
    candidate: Points, accepted: Sequence[Points], settings: MissionSettings, slack: float = 1e-9
) -> set[str]:
    """What Algorithm 3 says of a candidate, all accepted paths held against it.

    One verdict; more than one where a distance lies within `slack` [m] of its threshold and the
    resampling's last bits decide.
    """
    if len(candidate) < 2 or not all(math.isfinite(v) for point in candidate for v in point):
        return {"malformed"}
    length = sum(math.dist(a, b) for a, b in itertools.pairwise(candidate))
    if length < settings.minimum_length:
        return {"short"}
    if length > settings.maximum_length:
        return {"long"}
    if math.dist(candidate[0], candidate[-1]) < settings.minimum_displacement:
        return {"trivial"}
    rounded = [(round(x * 1000), round(y * 1000)) for x, y in candidate]
    if any(rounded == [(round(x * 1000), round(y * 1000)) for x, y in path] for path in accepted):
        return {"duplicate"}
    s = settings.similarity
    mine = plain_resample(candidate, s.samples)
    doubtful = False
    for path in accepted:
        if math.dist(mine[0], path[0]) > s.start_radius:
            continue
        if math.dist(mine[-1], path[-1]) > s.goal_radius:
            continue
        gap = plain_frechet(mine, plain_resample(path, s.samples))
        if gap < s.frechet - slack:
            return {"similar"}
        doubtful |= gap < s.frechet + slack
    return {"accepted", "similar"} if doubtful else {"accepted"}


def count_blocked_points(
    grid: OccupancyGrid, points: NDArray[np.floating], step: float = 0.001
) -> int:
    """Points every `step` [m] along a polyline [N, 2] m that lie in a cell that is not free."""
    p = np.asarray(points, np.float64)
    blocked = 0
    for a, b in itertools.pairwise(p):
        parts = max(1, math.ceil(float(np.hypot(*(b - a))) / step))
        line = a + (b - a) * np.linspace(0.0, 1.0, parts + 1)[:, None]
        col = np.floor((line[:, 0] - grid.origin[0]) / grid.resolution).astype(np.int64)
        row = np.floor((line[:, 1] - grid.origin[1]) / grid.resolution).astype(np.int64)
        inside = (row >= 0) & (col >= 0) & (row < grid.shape[0]) & (col < grid.shape[1])
        blocked += int((~inside).sum())
        blocked += int((grid.cells[row[inside], col[inside]] != FREE).sum())
    return blocked
