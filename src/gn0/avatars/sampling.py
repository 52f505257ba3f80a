"""Points spread evenly over sheets: each at least a distance from the next, none left out.

Dart throwing over more candidates than fit, in a hashed grid; then each point moves to the middle
of the candidates that are nearest to it (Lloyd 1982), so that holes are small. The candidates come
from one named stream, so the same sheet gives the same points on every machine.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from gn0.geometry import F64
from gn0.jit import njit

_PER_PLACE = 12  # candidates for each point that would fit
_FILL = 0.70  # points a square of the least distance, when no more fit
_ROUNDS = 3  # of moving points to the middles of their cells
_SIDE = 0.3  # cosine of normals from which candidates are on the same side of a thin part
_TRUST = 0.5  # in the shape of a cell, which a dozen candidates tell; the rest in a round one


@dataclass(frozen=True, eq=False)
class SheetPoints:
    """Points on triangles.

    Attributes:
        triangle: [N] int64.
        bary: weights of the triangle's corners [N, 3].
        spacing: mean distance of neighbours [N] m.
        cell: second moments of the place of each that is nearer to it than to others [N, 3, 3] m²;
            None where points are not evenly spread.
    """

    triangle: NDArray[np.int64]
    bary: F64
    spacing: F64
    cell: F64 | None = None

    def select(self, mask: NDArray[np.bool_] | NDArray[np.integer]) -> SheetPoints:
        """The points at `mask`."""
        cell = None if self.cell is None else self.cell[mask]
        return SheetPoints(self.triangle[mask], self.bary[mask], self.spacing[mask], cell)

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
    there: Callable[[SheetPoints], NDArray[np.bool_]] | None = None,
) -> SheetPoints:
    """Points over triangles, `spacing` [T] m apart in each.

    Args:
        vertices: [V, 3] m.
        triangles: [T, 3].
        spacing: mean distance of neighbours in each triangle [T] m.
        stream: where candidates are drawn.
        even: no two too close; otherwise as many at random, which overlapping strands need.
        there: which points the sheet has; all without it. Cells end where the sheet does.
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
    points = SheetPoints(triangle, bary, spacing[triangle])
    if there is not None:
        points = points.select(there(points))
    if not even:
        return points
    place = np.ascontiguousarray(points.blend(vertices, triangles))
    normal = np.cross(p[:, 1] - p[:, 0], p[:, 2] - p[:, 0])
    normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-30)
    normal = np.ascontiguousarray(normal[points.triangle])
    least = points.spacing * np.sqrt(_FILL)
    keep = _throw(place, least)
    if not len(keep):
        return replace(points.select(keep), cell=np.empty((0, 3, 3)))
    cell, low, size = _grid(place, least)
    owner = np.empty(len(place), np.int64)
    for _ in range(_ROUNDS):
        _own(place, normal, keep, low, cell, size, owner)
        keep = _middles(place, owner, keep)
    _own(place, normal, keep, low, cell, size, owner)
    return replace(points.select(keep), cell=_moments(place, owner, keep, points.spacing[keep]))


def _grid(points: F64, least: F64) -> tuple[float, F64, NDArray[np.int64]]:
    """Side, lower corner and size of a grid whose cells are no smaller than any distance."""
    cell = float(least.max())
    low = points.min(axis=0)
    return cell, low, np.floor((points.max(axis=0) - low) / cell).astype(np.int64) + 1


def _middles(place: F64, owner: NDArray[np.int64], keep: NDArray[np.int64]) -> NDArray[np.int64]:
    """Of each point the candidate in its cell that is nearest to the middle of the cell."""
    count = np.maximum(np.bincount(owner, minlength=len(keep)), 1)
    middle = np.stack(
        [np.bincount(owner, column, minlength=len(keep)) / count for column in place.T], axis=1
    )
    away = ((place - middle[owner]) ** 2).sum(axis=1)
    order = np.lexsort((away, owner))
    first = np.unique(owner[order], return_index=True)
    moved = keep.copy()
    moved[first[0]] = order[first[1]]
    return moved


def _moments(place: F64, owner: NDArray[np.int64], keep: NDArray[np.int64], spacing: F64) -> F64:
    """Second moments [N, 3, 3] of cells, half of them those of a square of a side of `spacing`."""
    away = place - place[keep][owner]
    count = np.maximum(np.bincount(owner, minlength=len(keep)), 1)
    round_one = spacing**2 / 12.0
    moments = np.empty((len(keep), 3, 3))
    for i in range(3):
        for j in range(3):
            own = np.bincount(owner, away[:, i] * away[:, j], minlength=len(keep)) / count
            moments[:, i, j] = _TRUST * own + (1.0 - _TRUST) * round_one * (i == j)
    return moments


def _throw(points: F64, least: F64) -> NDArray[np.int64]:
    """Which points are kept, in order: none closer to an earlier one than both ask on average."""
    if not len(points):
        return np.zeros(0, np.int64)
    cell, low, size = _grid(points, least)
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


@njit
def _own(place, normal, keep, low, cell, size, owner):  # type: ignore[no-untyped-def]
    """Number of the nearest kept point of each candidate, of those on its side if there is one."""
    head = np.full(size[0] * size[1] * size[2], -1, np.int64)
    after = np.empty(len(keep), np.int64)
    for k in range(len(keep)):
        x, y, z = place[keep[k]]
        i = min(int((x - low[0]) / cell), size[0] - 1)
        j = min(int((y - low[1]) / cell), size[1] - 1)
        h = (i * size[1] + j) * size[2] + min(int((z - low[2]) / cell), size[2] - 1)
        after[k] = head[h]
        head[h] = k
    for n in range(len(place)):
        x, y, z = place[n]
        i = min(int((x - low[0]) / cell), size[0] - 1)
        j = min(int((y - low[1]) / cell), size[1] - 1)
        m = min(int((z - low[2]) / cell), size[2] - 1)
        best, least, any_best, any_least = -1, np.inf, 0, np.inf
        for a in range(max(i - 1, 0), min(i + 2, size[0])):
            for b in range(max(j - 1, 0), min(j + 2, size[1])):
                for c in range(max(m - 1, 0), min(m + 2, size[2])):
                    k = head[(a * size[1] + b) * size[2] + c]
                    while k >= 0:
                        q = keep[k]
                        d = (place[q, 0] - x) ** 2 + (place[q, 1] - y) ** 2 + (place[q, 2] - z) ** 2
                        if d < any_least:
                            any_least, any_best = d, k
                        same = (
                            normal[q, 0] * normal[n, 0]
                            + normal[q, 1] * normal[n, 1]
                            + normal[q, 2] * normal[n, 2]
                        )
                        if d < least and same > _SIDE:
                            least, best = d, k
                        k = after[k]
        owner[n] = best if best >= 0 else any_best
