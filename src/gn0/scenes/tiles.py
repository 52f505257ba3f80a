"""Charts cut into tiles, tiles into cells, and the part of each cell that the surface fills."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gn0.geometry import F32, F64
from gn0.jit import njit, prange
from gn0.scenes.charts import Charts
from gn0.scenes.mesh import SceneMesh

PICKS = 4  # points of each cell that are shaded
_FINE = 4  # subsamples across a cell
_TILE = 0.75  # largest tile of a chart [m]


@dataclass(frozen=True, eq=False)
class Tiles:
    """Rectangles of charts with a brick grid of cells each."""

    chart: NDArray[np.int64]  # [T]
    lower: F64  # [T, 2] m
    size: F64  # [T, 2] m
    cells: NDArray[np.int64]  # [T, 2] cells along u and v
    brick: bool = True  # odd rows are shifted by half a cell

    @property
    def spacing(self) -> F64:
        """The longer side of each tile's cells [T] m."""
        return np.asarray((self.size / self.cells).max(axis=1), np.float64)


def _splits(charts: Charts) -> tuple[F64, NDArray[np.int64]]:
    """Size [C, 2] m of each chart, and how many tiles lie along its axes [C, 2]."""
    extent = np.maximum(charts.upper - charts.lower, 1e-4)
    return extent, np.maximum(1, np.ceil(extent / _TILE)).astype(np.int64)


def _cut(charts: Charts) -> tuple[NDArray[np.int64], F64, F64, F64]:
    """Tiles of all charts: chart [T], lower corner and size [T, 2] m, and covered share [T]."""
    extent, splits = _splits(charts)
    per_chart = splits[:, 0] * splits[:, 1]
    chart = np.repeat(np.arange(len(charts)), per_chart)
    local = np.arange(len(chart)) - np.repeat(np.cumsum(per_chart) - per_chart, per_chart)
    column, row = local % splits[chart, 0], local // splits[chart, 0]
    size = extent[chart] / splits[chart]
    lower = charts.lower[chart] + np.stack([column, row], 1) * size
    cover = np.minimum(1.0, charts.area / (extent[:, 0] * extent[:, 1]))[chart]
    return chart, lower, size, cover


def plan_tiles_at(charts: Charts, spacing: float, *, brick: bool = True) -> Tiles:
    """Tiles with cells of one spacing [m] everywhere."""
    chart, lower, size, _ = _cut(charts)
    cells = np.maximum(1, np.round(size / spacing)).astype(np.int64)
    return Tiles(chart=chart, lower=lower, size=size, cells=cells, brick=brick)


def plan_tiles(charts: Charts, count: int, fineness: F64 | None = None) -> Tiles:
    """Tiles whose cells number about `count`, at a spacing of base / fineness [T]."""
    chart, lower, size, cover = _cut(charts)
    fine = np.ones(len(chart)) if fineness is None else fineness

    def cells_at(base: float) -> NDArray[np.int64]:
        return np.maximum(1, np.round(size * (fine / base)[:, None])).astype(np.int64)

    low, high = 1e-4, 10.0
    for _ in range(50):
        base = float(np.sqrt(low * high))
        grid = cells_at(base)
        # a brick grid has half a cell more a row on average; clipped cells add along outlines
        total = ((grid[:, 0] + 0.5 * (grid[:, 0] > 3)) * grid[:, 1] * cover).sum()
        low, high = (base, high) if total > count else (low, base)
    return Tiles(chart=chart, lower=lower, size=size, cells=cells_at(high))


@dataclass(frozen=True, eq=False)
class Cells:
    """Cells that hold some surface."""

    tile: NDArray[np.int32]
    chart: NDArray[np.int32]
    face: NDArray[np.int32]
    point: F64  # [N, 3] m
    spread: F64  # [N, 3] covariance (uu, uv, vv) of the filled part, chart coordinates [m²]
    pick_face: NDArray[np.int32]  # [N, PICKS]
    pick_bary: F32  # [N, PICKS, 2] weights of the second and third corner

    def select(self, mask: NDArray[np.bool_] | NDArray[np.integer] | slice) -> Cells:
        """The cells at `mask` (mask, indices or slice)."""
        return Cells(**{name: value[mask] for name, value in vars(self).items()})


def fill_tiles(charts: Charts, mesh: SceneMesh, tiles: Tiles, seed: int) -> Cells:
    """Every cell that holds some surface.

    Faces too thin for the subsamples of a cell, such as bevels, are cells of their own, cut to
    about the spacing of their tile: a strip round a hall must not become one disc as long.
    """
    nu, nv = tiles.cells.T
    brick = (nu > 3) & (nv > 1) & tiles.brick
    per_tile = nu * nv + np.where(brick, nv // 2, 0)
    offset = np.concatenate([[0], np.cumsum(per_tile)])
    total = int(offset[-1])
    face = np.full(total, -1, np.int32)
    mean = np.empty((total, 2))
    spread = np.empty((total, 3))
    pick_face = np.empty((total, PICKS), np.int32)
    pick_bary = np.empty((total, PICKS, 2), np.float32)
    met = np.zeros(len(charts.faces), np.bool_)
    _fill_kernel(
        tiles.chart, tiles.lower, tiles.size, tiles.cells, brick, offset,
        charts.start, charts.faces, charts.corners, np.uint32(seed & 0xFFFFFFFF),
        face, mean, spread, pick_face, pick_bary, met,
    )  # fmt: skip
    tile = np.repeat(np.arange(len(tiles.chart)), per_tile)
    keep = np.flatnonzero(face >= 0)
    parts: list[Any] = [
        tile[keep],
        tiles.chart[tile[keep]],
        face[keep],
        mean[keep],
        spread[keep],
        pick_face[keep],
        pick_bary[keep],
    ]
    extra = _fill_slivers(charts, tiles, brick, offset, face, met)
    if len(extra[0]):
        parts = [np.concatenate([a, b]) for a, b in zip(parts, extra, strict=True)]
    tile, c, f, m, s, pf, pb = parts
    u, v, n = (charts.axes[c, k] for k in range(3))
    flat = charts.origin[c] + m[:, :1] * u + m[:, 1:] * v
    corner = mesh.vertices[mesh.faces[f, 0]]
    face_normal = mesh.normals()[f]
    tilt = np.maximum((face_normal * n).sum(1), 0.2)
    lift = ((corner - flat) * face_normal).sum(1) / tilt  # along the chart's normal to the face
    point = flat + lift[:, None] * n
    return Cells(
        tile=tile.astype(np.int32),
        chart=c.astype(np.int32),
        face=f.astype(np.int32),
        point=point,
        spread=s,
        pick_face=pf.astype(np.int32),
        pick_bary=pb,
    )


def _fill_slivers(
    charts: Charts,
    tiles: Tiles,
    brick: NDArray[np.bool_],
    offset: NDArray[np.int64],
    face: NDArray[np.int32],
    met: NDArray[np.bool_],
) -> list[Any]:
    """What the subsamples missed, as the fields of `Cells` (points in chart coordinates).

    That is all faces of charts without a filled cell, and longer faces that no subsample met
    where the cells round them are empty, too.
    """
    owner = np.repeat(np.arange(len(charts)), np.diff(charts.start))
    tile_filled = np.add.reduceat(face >= 0, offset[:-1]) > 0
    missed = np.bincount(tiles.chart, tile_filled, len(charts)) == 0
    first = np.searchsorted(tiles.chart, np.arange(len(charts)))
    extent, splits = _splits(charts)

    g = np.flatnonzero(missed[owner] | ~met)
    tile, middle, longest = _look_at(
        charts.corners[g], owner[g], missed, charts.lower, extent, splits, first, tiles.spacing
    )
    g = g[missed[owner[g]] | (longest >= 0)]
    corner = np.broadcast_to(np.eye(3), (len(g), 3, 3))  # weights of the face's corners
    done: list[tuple[NDArray[Any], ...]] = []
    while len(g):
        point = corner @ charts.corners[g]
        tile, middle, longest = _look_at(
            point, owner[g], missed, charts.lower, extent, splits, first, tiles.spacing
        )
        short, long = longest < 0, longest >= 0
        done.append((g[short], corner[short], point[short], tile[short], middle[short]))
        # halve the longest edge of the rest
        g, corner, k = g[long], corner[long], longest[long]
        row = np.arange(len(g))
        half = (corner[row, k] + corner[row, (k + 1) % 3]) / 2
        one, other = corner.copy(), corner.copy()
        one[row, k], other[row, (k + 1) % 3] = half, half
        g, corner = np.concatenate([g, g]), np.concatenate([one, other])
    if not done:
        return [np.empty(0, np.int64)]
    g, corner, point, tile, middle = (np.concatenate(part) for part in zip(*done, strict=True))
    cell = _cell_at(
        tile, middle, tiles.lower, tiles.size, tiles.cells, np.asarray(brick, np.bool_), offset
    )
    keep = np.flatnonzero(missed[owner[g]] | (face[cell] < 0))
    keep = keep[np.argsort(g[keep], kind="stable")]
    g, corner, tile, middle = g[keep], corner[keep], tile[keep], middle[keep]
    d = point[keep] - middle[:, None]  # a triangle's covariance is a twelfth of its corners' sum
    picks = np.concatenate(
        [corner.mean(1, keepdims=True), (corner + corner.mean(1)[:, None]) / 2], 1
    )
    one_face = charts.faces[g]
    return [
        tile,
        owner[g],
        one_face,
        middle,
        np.stack([(d[..., i] * d[..., j]).sum(1) / 12 for i, j in ((0, 0), (0, 1), (1, 1))], 1),
        np.repeat(one_face[:, None], PICKS, 1),
        picks[:, :PICKS, 1:].astype(np.float32),
    ]


@njit(error_model="numpy")
def _look_at(point, owner, missed, lower, extent, splits, first, spacing):  # type: ignore[no-untyped-def]
    """Of triangles [N, 3, 2] of charts: tile and middle of each, and its longest edge.

    The edge is −1 where none is longer than the spacing of the tile.
    """
    n = len(point)
    tile, longest = np.empty(n, np.int64), np.empty(n, np.int64)
    middle = np.empty((n, 2))
    for i in range(n):
        c = owner[i]
        place = np.int64(0)
        for axis in range(2):
            m = (point[i, 0, axis] + point[i, 1, axis] + point[i, 2, axis]) / 3.0
            middle[i, axis] = m
            at = int((m - lower[c, axis]) / extent[c, axis] * splits[c, axis])
            at = min(max(at, 0), splits[c, axis] - 1)
            place += at if axis == 0 else at * splits[c, 0]
        # the first tile stands for a chart of which nothing was met
        tile[i] = first[c] + (0 if missed[c] else place)
        best = spacing[tile[i]]
        longest[i] = -1
        for k in range(3):
            dx = point[i, (k + 1) % 3, 0] - point[i, k, 0]
            dy = point[i, (k + 1) % 3, 1] - point[i, k, 1]
            edge = np.sqrt(dx * dx + dy * dy)
            if edge > best:
                best, longest[i] = edge, k
    return tile, middle, longest


@njit(error_model="numpy")
def _cell_at(tile, point, lower, size, cells, brick, offset):  # type: ignore[no-untyped-def]
    """The cell of tile [N] that a point [N, 2] lies in."""
    out = np.empty(len(tile), np.int64)
    for i in range(len(tile)):
        t = tile[i]
        nu, nv = cells[t, 0], cells[t, 1]
        row = int((point[i, 1] - lower[t, 1]) / size[t, 1] * nv)
        row = min(max(row, 0), nv - 1)
        shift = 1 if brick[t] and row % 2 == 1 else 0
        column = int((point[i, 0] - lower[t, 0]) / size[t, 0] * nu + 0.5 * shift)
        column = min(max(column, 0), nu - 1 + shift)
        out[i] = offset[t] + row * nu + column + (row // 2 if brick[t] else 0)
    return out


@njit
def _mix(h):  # type: ignore[no-untyped-def]
    """Integer hash (lowbias32, C. Wellons)."""
    h = np.uint32(h)
    h ^= h >> np.uint32(16)
    h = np.uint32(h * np.uint32(0x7FEB352D))
    h ^= h >> np.uint32(15)
    h = np.uint32(h * np.uint32(0x846CA68B))
    h ^= h >> np.uint32(16)
    return h


@njit(parallel=True, error_model="numpy")
def _fill_kernel(  # type: ignore[no-untyped-def]
    tile_chart, tile_lower, tile_size, tile_cells, brick, offset,
    start, faces, corners, seed,
    face, mean, spread, pick_face, pick_bary, met,
):  # fmt: skip
    """Moments of the filled part of every cell; face −1 where a cell is (nearly) empty.

    `met` tells which faces, in the order of `faces`, any subsample lies on.
    """
    for t in prange(len(tile_chart)):
        c = tile_chart[t]
        nu, nv = tile_cells[t, 0], tile_cells[t, 1]
        wide, tall = nu * _FINE, nv * _FINE
        du, dv = tile_size[t, 0] / wide, tile_size[t, 1] / tall
        u0, v0 = tile_lower[t, 0], tile_lower[t, 1]
        buffer = np.full((tall, wide), -1, np.int32)
        for g in range(start[c], start[c + 1]):
            ax, ay = (corners[g, 0, 0] - u0) / du - 0.5, (corners[g, 0, 1] - v0) / dv - 0.5
            bx, by = (corners[g, 1, 0] - u0) / du - 0.5, (corners[g, 1, 1] - v0) / dv - 0.5
            cx, cy = (corners[g, 2, 0] - u0) / du - 0.5, (corners[g, 2, 1] - v0) / dv - 0.5
            x_lo = max(0, int(np.ceil(min(ax, bx, cx) - 1e-9)))
            x_hi = min(wide - 1, int(np.floor(max(ax, bx, cx) + 1e-9)))
            y_lo = max(0, int(np.ceil(min(ay, by, cy) - 1e-9)))
            y_hi = min(tall - 1, int(np.floor(max(ay, by, cy) + 1e-9)))
            det = (bx - ax) * (cy - ay) - (by - ay) * (cx - ax)
            if x_lo > x_hi or y_lo > y_hi or abs(det) < 1e-14:
                continue
            for y in range(y_lo, y_hi + 1):
                for x in range(x_lo, x_hi + 1):
                    v = ((x - ax) * (cy - ay) - (y - ay) * (cx - ax)) / det
                    w = ((bx - ax) * (y - ay) - (by - ay) * (x - ax)) / det
                    if v >= -1e-6 and w >= -1e-6 and v + w <= 1.000001:
                        buffer[y, x] = g
                        met[g] = True
        spots = np.empty((_FINE * _FINE, 2), np.int64)
        cell = offset[t]
        for j in range(nv):
            shift = _FINE // 2 if (brick[t] and j % 2 == 1) else 0
            for i in range(nu + (1 if shift else 0)):
                filled = 0
                su = sv = suu = suv = svv = 0.0
                for y in range(j * _FINE, (j + 1) * _FINE):
                    for x in range(i * _FINE - shift, (i + 1) * _FINE - shift):
                        if x < 0 or x >= wide or buffer[y, x] < 0:
                            continue
                        spots[filled, 0] = x
                        spots[filled, 1] = y
                        filled += 1
                        su += x
                        sv += y
                        suu += x * x
                        suv += x * y
                        svv += y * y
                if filled >= 2 or (filled == 1 and nu * nv <= 4):
                    mu, mv = su / filled, sv / filled
                    mean[cell, 0] = u0 + (mu + 0.5) * du
                    mean[cell, 1] = v0 + (mv + 0.5) * dv
                    spread[cell, 0] = (suu / filled - mu * mu + 1.0 / 12.0) * du * du
                    spread[cell, 1] = (suv / filled - mu * mv) * du * dv
                    spread[cell, 2] = (svv / filled - mv * mv + 1.0 / 12.0) * dv * dv
                    near, best = 0, 1e30
                    for k in range(filled):
                        d = (spots[k, 0] - mu) ** 2 + (spots[k, 1] - mv) ** 2
                        if d < best:
                            near, best = k, d
                    face[cell] = faces[buffer[spots[near, 1], spots[near, 0]]]
                    turn = _mix(np.uint32(cell) ^ seed)
                    for p in range(PICKS):
                        slot = (
                            p * filled
                            + int((turn >> np.uint32(8 * p)) & np.uint32(255)) * filled // 256
                        ) // PICKS
                        x, y = spots[slot, 0], spots[slot, 1]
                        g = buffer[y, x]
                        px, py = u0 + (x + 0.5) * du, v0 + (y + 0.5) * dv
                        ax, ay = corners[g, 0, 0], corners[g, 0, 1]
                        ex, ey = corners[g, 1, 0] - ax, corners[g, 1, 1] - ay
                        fx, fy = corners[g, 2, 0] - ax, corners[g, 2, 1] - ay
                        det = ex * fy - ey * fx
                        bv = ((px - ax) * fy - (py - ay) * fx) / det
                        bw = (ex * (py - ay) - ey * (px - ax)) / det
                        pick_face[cell, p] = faces[g]
                        pick_bary[cell, p, 0] = min(max(bv, 0.0), 1.0)
                        pick_bary[cell, p, 1] = min(max(bw, 0.0), 1.0 - min(max(bv, 0.0), 1.0))
                cell += 1
