"""Points spread evenly over sheets: each at least a distance from the next, none left out.

Dart throwing over more candidates than fit, in a hashed grid. The candidates come from one named
stream, so the same sheet gives the same points on every machine.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gn0.geometry import F64
from gn0.jit import njit

_PER_PLACE = 12  # candidates for each point that would fit
_FILL = 0.70  # points a square of the least distance, when no more fit


@dataclass(frozen=True, eq=False)
class SheetPoints:
    """Points on triangles.

    Attributes:
        triangle: [N] int64.
        bary: weights of the triangle's corners [N, 3].
        spacing: mean distance of neighbours [N] m.
    """

    triangle: NDArray[np.int64]
    bary: F64
    spacing: F64

    def select(self, mask: NDArray[np.bool_] | NDArray[np.integer]) -> SheetPoints:
        """The points at `mask`."""
        return SheetPoints(self.triangle[mask], self.bary[mask], self.spacing[mask])

    def blend(self, values: F64, triangles: NDArray[np.integer]) -> F64:
        """Values [V, …] of vertices at the points [N, …]."""
        return np.einsum("nk,nk...->n...", self.bary, values[triangles[self.triangle]])


def spread_points(
    vertices: F64,
    triangles: NDArray[np.integer],
    spacing: F64,
    stream: np.random.Generator,
    *,
    even: bool = True,
) -> SheetPoints:
    """Points over triangles, `spacing` [T] m apart in each.

    Args:
        vertices: [V, 3] m.
        triangles: [T, 3].
        spacing: mean distance of neighbours in each triangle [T] m.
        stream: where candidates are drawn.
        even: no two too close; otherwise as many at random, which overlapping strands need.
    """
    p = vertices[triangles]
    areas = np.linalg.norm(np.cross(p[:, 1] - p[:, 0], p[:, 2] - p[:, 0]), axis=1) / 2
    wanted = areas / spacing**2
    total = int(np.ceil(wanted.sum() * (_PER_PLACE if even else 1)))
    # one draw in each equal share of the whole, so that no place has none
    ends = np.cumsum(wanted)
    at = (np.arange(total) + stream.random(total)) / max(total, 1) * ends[-1]
    triangle = np.minimum(np.searchsorted(ends, at, side="right"), len(areas) - 1)
    root, second = np.sqrt(stream.random(total)), stream.random(total)
    bary = np.stack([1 - root, root * (1 - second), root * second], axis=1)
    if even:
        order = stream.permutation(total)
        triangle, bary = triangle[order], bary[order]
        point = np.einsum("nk,nka->na", bary, p[triangle])
        least = spacing[triangle] * np.sqrt(_FILL)
        keep = _throw(np.ascontiguousarray(point), least)
        triangle, bary = triangle[keep], bary[keep]
    return SheetPoints(triangle, bary, spacing[triangle])


def _throw(points: F64, least: F64) -> NDArray[np.int64]:
    """Which points are kept, in order: none closer to an earlier one than both ask on average."""
    if not len(points):
        return np.zeros(0, np.int64)
    cell = float(least.max())
    low = points.min(axis=0)
    size = np.floor((points.max(axis=0) - low) / cell).astype(np.int64) + 1
    kept = np.empty(len(points), np.int64)
    count = _darts(points, least, low, cell, size, kept)
    return kept[:count]


@njit
def _darts(points, least, low, cell, size, kept):  # type: ignore[no-untyped-def]
    head = np.full(size[0] * size[1] * size[2], -1, np.int64)
    after = np.empty(len(points), np.int64)
    count = 0
    for n in range(len(points)):
        x, y, z = points[n]
        i = min(int((x - low[0]) / cell), size[0] - 1)
        j = min(int((y - low[1]) / cell), size[1] - 1)
        k = min(int((z - low[2]) / cell), size[2] - 1)
        free = True
        for a in range(max(i - 1, 0), min(i + 2, size[0])):
            for b in range(max(j - 1, 0), min(j + 2, size[1])):
                for c in range(max(k - 1, 0), min(k + 2, size[2])):
                    other = head[(a * size[1] + b) * size[2] + c]
                    while other >= 0 and free:
                        d = (
                            (points[other, 0] - x) ** 2
                            + (points[other, 1] - y) ** 2
                            + (points[other, 2] - z) ** 2
                        )
                        free = d >= (0.5 * (least[n] + least[other])) ** 2
                        other = after[other]
                    if not free:
                        break
                if not free:
                    break
            if not free:
                break
        if free:
            here = (i * size[1] + j) * size[2] + k
            after[n] = head[here]
            head[here] = n
            kept[count] = n
            count += 1
    return count
