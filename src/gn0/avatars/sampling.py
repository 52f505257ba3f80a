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
    side, low, size = _grid(place, least)
    cells = _sort_cells(place, low, side, size, np.zeros(size.prod(), np.int32))
    owner, rows = np.empty(len(place), np.int64), np.hstack([place, normal])[cells[1]]
    for _ in range(_ROUNDS):
        _own(rows, place, normal, keep, *cells, owner)
        keep = _middles(place, owner, keep)
    _own(rows, place, normal, keep, *cells, owner)
    return replace(points.select(keep), cell=_moments(place, owner, keep, points.spacing[keep]))


def _grid(points: F64, least: F64) -> tuple[float, F64, NDArray[np.int64]]:
    """Side, lower corner and size of a grid whose cells are no smaller than any distance."""
    cell = float(least.max())
    low = np.array([column.min() for column in points.T])
    high = np.array([column.max() for column in points.T])
    return cell, low, np.floor((high - low) / cell).astype(np.int64) + 1


def _moments(place: F64, owner: NDArray[np.int64], keep: NDArray[np.int64], spacing: F64) -> F64:
    """Second moments [N, 3, 3] of cells, half of them those of a square of a side of `spacing`."""
    own = _second_moments(place, owner, keep)
    own[:] = _TRUST * own
    for i in range(3):
        for j in range(3):
            own[:, i, j] += (1.0 - _TRUST) * (spacing**2 / 12.0) * (i == j)
    return own


def _throw(points: F64, least: F64) -> NDArray[np.int64]:
    """Which points are kept, in order: none closer to an earlier one than both ask on average."""
    if not len(points):
        return np.zeros(0, np.int64)
    cell, low, size = _grid(points, least)
    kept = np.empty(len(points), np.int64)
    count = _darts(points, least, low, cell, size, np.zeros(size.prod(), np.int32), kept)
    return kept[:count]


@njit
def _darts(points, least, low, cell, size, head, kept):  # type: ignore[no-untyped-def]
    # heads are one more than what they name: zeros cost nothing where nobody looks
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
                    other = np.int64(head[(a * size[1] + b) * size[2] + c]) - 1
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
            after[n] = np.int64(head[here]) - 1
            head[here] = n + 1
            kept[count] = n
            count += 1
    return count


@njit
def _sort_cells(place, low, side, size, number):  # type: ignore[no-untyped-def]
    """Cells of a grid that hold candidates, and which are around which.

    Returns:
        cell of each candidate [N], candidates by cell [N], where those of a cell begin [C + 1],
        cells around a cell, itself among them, where those begin [C + 1], and middles [C, 3] m.
    """
    cell, there = np.empty(len(place), np.int64), np.empty((len(place), 3), np.int64)
    begin = np.zeros(len(place) + 1, np.int64)
    count = 0
    for n in range(len(place)):
        i = min(int((place[n, 0] - low[0]) / side), size[0] - 1)
        j = min(int((place[n, 1] - low[1]) / side), size[1] - 1)
        k = min(int((place[n, 2] - low[2]) / side), size[2] - 1)
        h = (i * size[1] + j) * size[2] + k
        if number[h] == 0:
            there[count, 0], there[count, 1], there[count, 2] = i, j, k
            count += 1
            number[h] = count
        cell[n] = number[h] - 1
        begin[number[h]] += 1
    for c in range(count):
        begin[c + 1] += begin[c]
    begin = begin[: count + 1]
    filled, order = begin.copy(), np.empty(len(place), np.int64)
    for n in range(len(place)):
        order[filled[cell[n]]] = n
        filled[cell[n]] += 1
    around, first = np.empty(27 * count, np.int64), np.zeros(count + 1, np.int64)
    total = 0
    for c in range(count):
        i, j, k = there[c, 0], there[c, 1], there[c, 2]
        for x in range(max(i - 1, 0), min(i + 2, size[0])):
            for y in range(max(j - 1, 0), min(j + 2, size[1])):
                for z in range(max(k - 1, 0), min(k + 2, size[2])):
                    other = number[(x * size[1] + y) * size[2] + z]
                    if other > 0:
                        around[total] = other - 1
                        total += 1
        first[c + 1] = total
    middle = np.empty((count, 3))
    for c in range(count):
        for x in range(3):
            middle[c, x] = low[x] + (there[c, x] + 0.5) * side
    return cell, order, begin, around, first, middle


@njit
def _own(  # type: ignore[no-untyped-def]
    rows, place, normal, keep, cell, order, begin, around, first, middle, owner
):
    """Number of the nearest kept point of each candidate, of those on its side if there is one.

    `rows` are places and normals of candidates by cell [N, 6]. Candidates of one cell look at the
    same points, in the order in which those are away from its middle, and stop where no other can
    be nearer.
    """
    head, after = np.full(len(begin) - 1, -1, np.int64), np.empty(len(keep), np.int64)
    for k in range(len(keep)):
        after[k] = head[cell[keep[k]]]
        head[cell[keep[k]]] = k
    near, away = np.empty((len(keep), 6)), np.empty(len(keep))  # of those around a cell
    who = np.empty(len(keep), np.int64)
    for c in range(len(begin) - 1):
        mx, my, mz = middle[c, 0], middle[c, 1], middle[c, 2]
        count = 0
        for at in range(first[c], first[c + 1]):
            k = head[around[at]]
            while k >= 0:
                q = keep[k]
                d = np.sqrt(
                    (place[q, 0] - mx) ** 2 + (place[q, 1] - my) ** 2 + (place[q, 2] - mz) ** 2
                )
                j = count
                while j > 0 and away[j - 1] > d:
                    away[j], who[j] = away[j - 1], who[j - 1]
                    j -= 1
                away[j], who[j] = d, k
                count += 1
                k = after[k]
        if count == 0:  # all have moved away: theirs is whose they were
            continue
        for j in range(count):
            for x in range(3):
                near[j, x] = place[keep[who[j]], x]
                near[j, 3 + x] = normal[keep[who[j]], x]
        for at in range(begin[c], begin[c + 1]):
            x, y, z = rows[at, 0], rows[at, 1], rows[at, 2]
            u, v, w = rows[at, 3], rows[at, 4], rows[at, 5]
            out = np.sqrt((x - mx) ** 2 + (y - my) ** 2 + (z - mz) ** 2) * (1.0 + 1e-9)
            best, least, any_best, any_least, last = -1, np.inf, 0, np.inf, np.inf
            for j in range(count):
                if away[j] > last:
                    break
                d = (near[j, 0] - x) ** 2 + (near[j, 1] - y) ** 2 + (near[j, 2] - z) ** 2
                if d < any_least:
                    any_best, any_least = j, d
                if d < least and near[j, 3] * u + near[j, 4] * v + near[j, 5] * w > _SIDE:
                    best, least = j, d
                    last = out + np.sqrt(d) * (1.0 + 1e-9)
            owner[order[at]] = who[best] if best >= 0 else who[any_best]


@njit
def _middles(place, owner, keep):  # type: ignore[no-untyped-def]
    """Of each point the candidate in its cell that is nearest to the middle of the cell."""
    middle, count = np.zeros((len(keep), 3)), np.zeros(len(keep))
    for n in range(len(place)):
        count[owner[n]] += 1.0
        for x in range(3):
            middle[owner[n], x] += place[n, x]
    moved, least = keep.copy(), np.full(len(keep), np.inf)
    for k in range(len(keep)):
        for x in range(3):
            middle[k, x] /= max(count[k], 1.0)
    for n in range(len(place)):
        k = owner[n]
        away = (
            (place[n, 0] - middle[k, 0]) ** 2
            + (place[n, 1] - middle[k, 1]) ** 2
            + (place[n, 2] - middle[k, 2]) ** 2
        )
        if away < least[k]:
            least[k], moved[k] = away, n
    return moved


@njit
def _second_moments(place, owner, keep):  # type: ignore[no-untyped-def]
    """Means [N, 3, 3] of the products of the ways from a point to the candidates in its cell."""
    sums, count = np.zeros((len(keep), 3, 3)), np.zeros(len(keep))
    for n in range(len(place)):
        k = owner[n]
        count[k] += 1.0
        for i in range(3):
            for j in range(3):
                sums[k, i, j] += (place[n, i] - place[keep[k], i]) * (
                    place[n, j] - place[keep[k], j]
                )
    for k in range(len(keep)):
        for i in range(3):
            for j in range(3):
                sums[k, i, j] /= max(count[k], 1.0)
    return sums
