"""A shaded mesh as disc Gaussians, without optimisation.

Each chart is cut into tiles, each tile into a brick grid of cells of its own spacing. A cell
becomes one flat Gaussian whose centre and covariance are those of the part of the cell that the
surface really fills: thin legs get long thin discs, edges pull their discs inwards. A disc's
standard deviation is 0.65 of its spacing where the cell is full (holes appear below 0.5, blur
above 0.8).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gn0.errors import SceneError
from gn0.gaussians.cloud import SH_C0, GaussianCloud
from gn0.geometry import F32, F64, quaternion_from_rotation
from gn0.jit import njit, prange
from gn0.progress import Progress, no_progress
from gn0.scenes.charts import Charts, build_charts
from gn0.scenes.mesh import SceneMesh
from gn0.scenes.shading import Shader

SIGMA = 0.65  # standard deviation of a full cell's disc, in spacings
THICKNESS = 0.001  # of a disc, one standard deviation [m]
OPACITY = 0.995
_FINE = 4  # subsamples across a cell
_PICKS = 4  # of them shaded
_TILE = 0.75  # largest tile of a chart [m]
_DETAIL_LEAST = 0.28  # plain paint is sampled 3.6 times coarser than a full texture


@dataclass(frozen=True, eq=False)
class _Tiles:
    """Rectangles of charts with a brick grid of cells each."""

    chart: NDArray[np.int64]  # [T]
    lower: F64  # [T, 2] m
    size: F64  # [T, 2] m
    cells: NDArray[np.int64]  # [T, 2] cells along u and v


def build_surfels(
    mesh: SceneMesh,
    shader: Shader,
    *,
    count: int,
    detail: NDArray[np.floating] | None = None,
    seed: int = 0,
    label_of_instance: NDArray[np.integer] | None = None,
    progress: Progress = no_progress,
) -> GaussianCloud:
    """Cover a mesh with at most `count` disc Gaussians that look like `shader`.

    Args:
        mesh: the surfaces.
        shader: appearance of the surfaces.
        count: the number of Gaussians to spend; the result has at most this many, unless the mesh
            has more separate pieces than that.
        detail: how finely each face is sampled [F]: 1 full texture, 0 plain paint.
        seed: varies nothing but the choice of the points that are shaded.
        label_of_instance: label of each mesh instance [I]; the instance number itself by default.
        progress: progress sink.

    Raises:
        SceneError: the mesh has no area.
    """
    progress("surfels", 0, 3)
    charts = build_charts(mesh)
    if not len(charts):
        raise SceneError("the mesh has no surface to cover", remedy="check its scale and faces")
    weight = np.ones(len(mesh)) if detail is None else np.asarray(detail, np.float64)
    areas = mesh.areas()[charts.faces]
    owner = np.repeat(np.arange(len(charts)), np.diff(charts.start))
    fineness = np.bincount(owner, weight[charts.faces] * areas, len(charts)) / charts.area
    fineness = np.maximum(np.clip(fineness, 0.0, 1.0), _DETAIL_LEAST)
    target = count
    while True:
        tiles = _plan_tiles(charts, fineness, target)
        cells = _fill_tiles(charts, mesh, tiles, seed)
        if len(cells.face) <= count or target < count // 8:
            break
        target = int(target * 0.98 * count / len(cells.face))
    progress("surfels", 1, 3)
    albedo, irradiance, colour, normal = _shade_cells(shader, cells)
    progress("surfels", 2, 3)
    scales, quats = _shape_discs(cells, charts)
    instance = mesh.instance[cells.face]
    label = instance
    if label_of_instance is not None:
        label = np.where(instance >= 0, np.asarray(label_of_instance)[instance], -1)
    return GaussianCloud(
        means=cells.point.astype(np.float32),
        quats=quats,
        scales=scales,
        opacities=np.full(len(cells.face), OPACITY, np.float32),
        sh=((colour - np.float32(0.5)) / np.float32(SH_C0))[:, None, :],
        label=label.astype(np.int32),
        albedo=albedo,
        irradiance=irradiance,
        normal=normal,
    )


def _plan_tiles(charts: Charts, fineness: F64, count: int) -> _Tiles:
    """Tiles whose cells number about `count`, at a spacing of base / fineness."""
    extent = np.maximum(charts.upper - charts.lower, 1e-4)
    splits = np.maximum(1, np.ceil(extent / _TILE)).astype(np.int64)
    per_chart = splits[:, 0] * splits[:, 1]
    chart = np.repeat(np.arange(len(charts)), per_chart)
    local = np.arange(len(chart)) - np.repeat(np.cumsum(per_chart) - per_chart, per_chart)
    column, row = local % splits[chart, 0], local // splits[chart, 0]
    size = extent[chart] / splits[chart]
    lower = charts.lower[chart] + np.stack([column, row], 1) * size
    cover = np.minimum(1.0, charts.area / (extent[:, 0] * extent[:, 1]))[chart]

    def cells_at(base: float) -> NDArray[np.int64]:
        spacing = base / fineness[chart]
        return np.maximum(1, np.round(size / spacing[:, None])).astype(np.int64)

    low, high = 1e-4, 10.0
    for _ in range(50):
        base = np.sqrt(low * high)
        grid = cells_at(base)
        # a brick grid has half a cell more a row on average; clipped cells add along outlines
        total = ((grid[:, 0] + 0.5 * (grid[:, 0] > 3)) * grid[:, 1] * cover).sum()
        low, high = (base, high) if total > count else (low, base)
    return _Tiles(chart=chart, lower=lower, size=size, cells=cells_at(high))


@dataclass(frozen=True, eq=False)
class _Cells:
    """Cells that hold some surface."""

    chart: NDArray[np.int32]
    face: NDArray[np.int32]
    point: F64  # [N, 3] m
    spread: F64  # [N, 3] covariance (uu, uv, vv) of the filled part, chart coordinates [m²]
    pick_face: NDArray[np.int32]  # [N, _PICKS]
    pick_bary: F32  # [N, _PICKS, 2] weights of the second and third corner


def _fill_tiles(charts: Charts, mesh: SceneMesh, tiles: _Tiles, seed: int) -> _Cells:
    nu, nv = tiles.cells.T
    brick = (nu > 3) & (nv > 1)
    per_tile = nu * nv + np.where(brick, nv // 2, 0)
    offset = np.concatenate([[0], np.cumsum(per_tile)])
    total = int(offset[-1])
    face = np.full(total, -1, np.int32)
    mean = np.empty((total, 2))
    spread = np.empty((total, 3))
    pick_face = np.empty((total, _PICKS), np.int32)
    pick_bary = np.empty((total, _PICKS, 2), np.float32)
    _fill_kernel(
        tiles.chart, tiles.lower, tiles.size, tiles.cells, brick, offset,
        charts.start, charts.faces, charts.corners, np.uint32(seed & 0xFFFFFFFF),
        face, mean, spread, pick_face, pick_bary,
    )  # fmt: skip
    chart = np.repeat(tiles.chart, per_tile)
    missed = np.setdiff1d(np.arange(len(charts)), np.unique(chart[face >= 0]))
    keep = np.flatnonzero(face >= 0)
    parts = [chart[keep], face[keep], mean[keep], spread[keep], pick_face[keep], pick_bary[keep]]
    if len(missed):  # slivers that no subsample met: one disc each, from their bounds
        middle = (charts.lower[missed] + charts.upper[missed]) / 2
        extent = charts.upper[missed] - charts.lower[missed]
        one = charts.faces[charts.start[missed]]
        extra = [
            missed,
            one,
            middle,
            np.stack([extent[:, 0] ** 2 / 12, 0 * extent[:, 0], extent[:, 1] ** 2 / 12], 1),
            np.repeat(one[:, None], _PICKS, 1),
            np.full((len(missed), _PICKS, 2), 1 / 3, np.float32),
        ]
        parts = [np.concatenate([a, b]) for a, b in zip(parts, extra, strict=True)]
    c, f, m, s, pf, pb = parts
    u, v, n = (charts.axes[c, k] for k in range(3))
    flat = charts.origin[c] + m[:, :1] * u + m[:, 1:] * v
    corner = mesh.vertices[mesh.faces[f, 0]]
    face_normal = mesh.normals()[f]
    tilt = np.maximum((face_normal * n).sum(1), 0.2)
    lift = ((corner - flat) * face_normal).sum(1) / tilt  # along the chart's normal to the face
    point = flat + lift[:, None] * n
    return _Cells(
        chart=c.astype(np.int32),
        face=f.astype(np.int32),
        point=point,
        spread=s,
        pick_face=pf.astype(np.int32),
        pick_bary=pb,
    )


@njit
def _mix(h):
    """Integer hash (lowbias32, C. Wellons)."""
    h = np.uint32(h)
    h ^= h >> np.uint32(16)
    h = np.uint32(h * np.uint32(0x7FEB352D))
    h ^= h >> np.uint32(15)
    h = np.uint32(h * np.uint32(0x846CA68B))
    h ^= h >> np.uint32(16)
    return h


@njit(parallel=True, error_model="numpy")
def _fill_kernel(
    tile_chart, tile_lower, tile_size, tile_cells, brick, offset,
    start, faces, corners, seed,
    face, mean, spread, pick_face, pick_bary,
):  # fmt: skip
    """Moments of the filled part of every cell; face −1 where a cell is (nearly) empty."""
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
                    for p in range(_PICKS):
                        slot = (
                            p * filled
                            + int((turn >> np.uint32(8 * p)) & np.uint32(255)) * filled // 256
                        ) // _PICKS
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


def _shade_cells(shader: Shader, cells: _Cells) -> tuple[F32, F32, F32, F32]:
    """Mean appearance of each cell's shaded points, in bounded chunks."""
    n = len(cells.face)
    out = [np.empty((n, 3), np.float32) for _ in range(4)]
    for lo in range(0, n, 65536):
        hi = min(n, lo + 65536)
        vw = cells.pick_bary[lo:hi].reshape(-1, 2)
        bary = np.concatenate([1 - vw.sum(1, keepdims=True), vw], 1)
        sample = shader.shade(cells.pick_face[lo:hi].reshape(-1), bary)
        parts = (sample.albedo, sample.irradiance, sample.colour, sample.normal)
        for target, part in zip(out, parts, strict=True):
            target[lo:hi] = part.reshape(-1, _PICKS, 3).mean(axis=1)
    normal = out[3]
    normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-9)
    return out[0], out[1], out[2], normal


def _shape_discs(cells: _Cells, charts: Charts) -> tuple[F32, F32]:
    """Scales [N, 3] and quaternions [N, 4] of discs whose third axis is the chart's normal."""
    a, b, d = cells.spread.T
    half, root = (a + d) / 2, np.sqrt(((a - d) / 2) ** 2 + b * b)
    large, small = half + root, np.maximum(half - root, 1e-10)
    angle = 0.5 * np.arctan2(2 * b, a - d)
    widen = SIGMA * np.sqrt(12.0)  # a full cell of spacing s has standard deviation s / √12
    scales = np.stack(
        [
            np.maximum(np.sqrt(large) * widen, THICKNESS),
            np.maximum(np.sqrt(small) * widen, THICKNESS),
            np.full(len(a), THICKNESS),
        ],
        1,
    )
    u, v, n = (charts.axes[cells.chart, k] for k in range(3))
    c, s = np.cos(angle)[:, None], np.sin(angle)[:, None]
    rotation = np.stack([c * u + s * v, c * v - s * u, n], 2)
    return scales.astype(np.float32), quaternion_from_rotation(rotation).astype(np.float32)
