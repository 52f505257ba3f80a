"""Light samples on surfaces, and the smooth field between them.

A lumel is a point with a normal and a radius. The field at a surface point is the mean of the
lumels near it that face the same way and lie in the same plane: curved furniture is lit smoothly
whatever its triangles, and light does not leak through walls or between shelves. (The idea of
Ward's irradiance cache, SIGGRAPH 1988, with fixed radii.)
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gn0.geometry import F32, F64
from gn0.jit import njit, prange
from gn0.scenes.charts import Charts
from gn0.scenes.mesh import SceneMesh
from gn0.scenes.rays import RayCaster
from gn0.scenes.tiles import fill_tiles, plan_tiles_at

_PLANE = 0.035  # how far out of a lumel's plane it still counts [m]
_MAX_CELLS = 4_000_000


@dataclass(frozen=True, eq=False)
class Lumels:
    """L lumels, sorted by the cell of a regular grid.

    Attributes:
        point, normal: [L, 3] float32 m.
        face, bary: where each lies on the mesh, [L] and [L, 3].
        area: surface that each stands for [L] m².
        radius: reach of a lumel [m].
        origin: corner of the search grid [3] m.
        shape: cells of the search grid [3].
        across: cells along one radius.
        first: first lumel of each cell, and the end [cells + 1].
        two_sided: whether a lumel speaks for both sides of its surface.
    """

    point: F32
    normal: F32
    face: NDArray[np.int32]
    bary: F32
    area: F32
    radius: float
    origin: F64
    shape: NDArray[np.int64]
    first: NDArray[np.int64]
    two_sided: bool = False
    across: int = 1

    def __len__(self) -> int:
        return len(self.point)

    def lookup(self, values: F32, point: F32, normal: F32) -> F32:
        """The field of `values` [L, C] at surface points [M, 3] with normals [M, 3]."""
        return _lookup(
            self.point, self.normal, self.radius, self.across, self.origin, self.shape,
            self.first, self.two_sided, np.ascontiguousarray(values, np.float32),
            np.ascontiguousarray(point, np.float32), np.ascontiguousarray(normal, np.float32),
        )  # fmt: skip

    def nearest(self, point: F32, normal: F32) -> NDArray[np.int32]:
        """The lumel that speaks most for each surface point [M]; −1 where none is near."""
        return _nearest(
            self.point, self.normal, self.radius, self.across, self.origin, self.shape,
            self.first, self.two_sided, np.ascontiguousarray(point, np.float32),
            np.ascontiguousarray(normal, np.float32),
        )  # fmt: skip


def build_lumels(
    mesh: SceneMesh,
    charts: Charts,
    spacing: float,
    *,
    two_sided: bool = False,
    across: int = 1,
    caster: RayCaster | None = None,
) -> Lumels:
    """Lumels about `spacing` [m] apart; small faces share theirs with their neighbours.

    They are sorted by cells of which `across` lie along their radius: with two, fewer are looked
    at in vain, and sums are made in another order.

    Surfaces that lie under another one (a lid under a lid, a floor under a rug) get none, lest
    they lend their darkness to what lies on them. `caster`, of the same mesh, saves building it.
    """
    tiles = plan_tiles_at(charts, spacing, brick=False)
    cells = fill_tiles(charts, mesh, tiles, seed=0)
    normals = mesh.normals()[cells.face]
    if not two_sided:
        caster = caster or RayCaster(mesh)
        shown = ~caster.occluded(cells.point + 2e-4 * normals, normals, t_max=_PLANE)
        if shown.any():
            cells, normals = cells.select(shown), normals[shown]
    # many small charts: one lumel for each (position, direction) bin, at the largest cell
    bin_size = 0.6 * spacing
    place = np.floor(cells.point / bin_size).astype(np.int64)
    way = np.round(normals * 1.4).astype(np.int64)
    keys = np.concatenate([place - place.min(axis=0), way + 2], 1)
    spans = keys.max(axis=0) + 1
    flat = np.zeros(len(keys), np.int64)
    for k in range(6):
        flat = flat * spans[k] + keys[:, k]
    size = 12.0 * np.sqrt(np.maximum(cells.spread[:, 0] * cells.spread[:, 2], 1e-12))
    order = np.lexsort((np.arange(len(flat)), -size, flat))
    lead = np.concatenate([[True], flat[order][1:] != flat[order][:-1]])
    group = np.cumsum(lead) - 1
    keep = order[lead]
    area = np.bincount(group, size[order])
    radius = 2.0 * spacing
    points = cells.point[keep]
    origin = points.min(axis=0) - 1e-3
    extent = points.max(axis=0) + 1e-3 - origin
    cell = radius / across
    while np.prod(np.floor(extent / cell) + 1) > _MAX_CELLS:
        cell *= 1.25
    shape = (np.floor(extent / cell) + 1).astype(np.int64)
    at = np.floor((points - origin) / cell).astype(np.int64)
    index = (at[:, 0] * shape[1] + at[:, 1]) * shape[2] + at[:, 2]
    order = np.argsort(index, kind="stable")
    keep = keep[order]
    corners = mesh.corners()[cells.face[keep]]
    return Lumels(
        point=np.ascontiguousarray(cells.point[keep], np.float32),
        normal=np.ascontiguousarray(normals[keep], np.float32),
        face=cells.face[keep],
        bary=_barycentric(corners, cells.point[keep]),
        area=area[order].astype(np.float32),
        radius=float(cell * across),
        origin=origin,
        shape=shape,
        first=np.searchsorted(index[order], np.arange(int(np.prod(shape)) + 1)).astype(np.int64),
        two_sided=two_sided,
        across=across,
    )


def _barycentric(corners: F64, point: F64) -> F32:
    """Weights [M, 3] of points in their triangles' planes, clipped to the triangle."""
    e, f, p = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0], point - corners[:, 0]
    ee, ef, ff = (e * e).sum(1), (e * f).sum(1), (f * f).sum(1)
    pe, pf = (p * e).sum(1), (p * f).sum(1)
    det = np.maximum(ee * ff - ef * ef, 1e-20)
    v, w = (pe * ff - pf * ef) / det, (pf * ee - pe * ef) / det
    bary = np.clip(np.stack([1 - v - w, v, w], 1), 0.0, 1.0)
    return (bary / bary.sum(1, keepdims=True)).astype(np.float32)


@njit(inline="always")
def _weight(point, normal, i, px, py, pz, nx, ny, nz, reach, two_sided):  # type: ignore[no-untyped-def]
    """How much lumel i says about a point; 0 for none."""
    dx, dy, dz = px - point[i, 0], py - point[i, 1], pz - point[i, 2]
    square = dx * dx + dy * dy + dz * dz
    if square > 1.00001 * reach * reach:  # most of them, and a division takes long
        return 0.0
    facing = nx * normal[i, 0] + ny * normal[i, 1] + nz * normal[i, 2]
    if two_sided:
        facing = abs(facing)
    if facing < 0.15:
        return 0.0
    d2 = square / (reach * reach)
    if d2 >= 1.0:
        return 0.0
    off = abs(dx * normal[i, 0] + dy * normal[i, 1] + dz * normal[i, 2])
    off = max(off, abs(dx * nx + dy * ny + dz * nz)) / _PLANE
    near = 1.0 - d2
    gate = 1.0 / (1.0 + off * off * off * off)
    return near * near * facing * facing * facing * gate * gate + 1e-9 * near


@njit(inline="always")
def _reached(x, y, z, ix, iy, cell, reach, top):  # type: ignore[no-untyped-def]
    """First cell and end of those of a column that a sphere round a point reaches into."""
    dx = max(max(ix * cell - x, x - (ix + 1) * cell), 0.0)
    dy = max(max(iy * cell - y, y - (iy + 1) * cell), 0.0)
    left = 1.00001 * reach * reach - dx * dx - dy * dy  # rounded up: none is lost
    if left <= 0.0:
        return 0, 0
    far = np.sqrt(left)
    return max(0, int(np.floor((z - far) / cell))), min(top, int(np.floor((z + far) / cell)) + 1)


@njit(inline="always")
def _farthest(weight, reach):  # type: ignore[no-untyped-def]
    """How far a lumel of at least that weight may lie: none is above near² + 1e-9 near."""
    near = np.sqrt(max(weight - 1e-9, 0.0)) * 0.9999  # and by both factors none is lost
    return min(reach, 1.0001 * reach * np.sqrt(1.0 - near))


@njit(parallel=True, error_model="numpy")
def _lookup(point, normal, reach, across, origin, shape, first, two_sided, values, query, facing):  # type: ignore[no-untyped-def]
    channels = values.shape[1]
    out = np.zeros((len(query), channels), np.float32)
    for q in prange(len(query)):
        px, py, pz = query[q, 0], query[q, 1], query[q, 2]
        nx, ny, nz = facing[q, 0], facing[q, 1], facing[q, 2]
        cell = reach / across
        x, y, z = px - origin[0], py - origin[1], pz - origin[2]
        cx, cy = int(np.floor(x / cell)), int(np.floor(y / cell))
        total = 0.0
        red = green = blue = 0.0
        for ix in range(max(0, cx - across), min(shape[0], cx + across + 1)):
            for iy in range(max(0, cy - across), min(shape[1], cy + across + 1)):
                row = (ix * shape[1] + iy) * shape[2]
                lo, hi = _reached(x, y, z, ix, iy, cell, reach, shape[2])
                if lo >= hi:
                    continue
                for i in range(first[row + lo], first[row + hi]):
                    w = _weight(point, normal, i, px, py, pz, nx, ny, nz, reach, two_sided)
                    if w > 0.0:
                        total += w
                        red += w * values[i, 0]
                        green += w * values[i, 1]
                        blue += w * values[i, 2]
        if total > 0.0:
            out[q, 0], out[q, 1], out[q, 2] = red / total, green / total, blue / total
    return out


@njit(parallel=True, error_model="numpy")
def _nearest(point, normal, reach, across, origin, shape, first, two_sided, query, facing):  # type: ignore[no-untyped-def]
    out = np.full(len(query), -1, np.int32)
    for q in prange(len(query)):
        px, py, pz = query[q, 0], query[q, 1], query[q, 2]
        nx, ny, nz = facing[q, 0], facing[q, 1], facing[q, 2]
        cell = reach / across
        x, y, z = px - origin[0], py - origin[1], pz - origin[2]
        cx, cy = int(np.floor(x / cell)), int(np.floor(y / cell))
        cz = int(np.floor(z / cell))
        # most of those that are within reach are further than one of its own cell may be
        least = 0.0
        if 0 <= cx < shape[0] and 0 <= cy < shape[1] and 0 <= cz < shape[2]:
            row = (cx * shape[1] + cy) * shape[2] + cz
            for i in range(first[row], first[row + 1]):
                w = _weight(point, normal, i, px, py, pz, nx, ny, nz, reach, two_sided)
                least = max(least, w)
        far = _farthest(least, reach)
        best = 0.0
        for ix in range(max(0, cx - across), min(shape[0], cx + across + 1)):
            for iy in range(max(0, cy - across), min(shape[1], cy + across + 1)):
                row = (ix * shape[1] + iy) * shape[2]
                lo, hi = _reached(x, y, z, ix, iy, cell, far, shape[2])
                if lo >= hi:
                    continue
                for i in range(first[row + lo], first[row + hi]):
                    w = _weight(point, normal, i, px, py, pz, nx, ny, nz, reach, two_sided)
                    if w > best:
                        best = w
                        out[q] = i
    return out
