"""A scene's splats as coarse cells that stop rays and send light back, side by side."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gn0.gaussians.cloud import GaussianCloud
from gn0.geometry import F32, F64, rotation_from_quaternion
from gn0.jit import njit, prange

CELL = 0.06  # of the cells [m]
_CELLS_MOST = 24_000_000
_SOLID = 0.2  # surface in a cell that stops a ray, in squares of a cell
_WIDE = 4  # a splat is spread over at most so many cells along each side
_EVERYWHERE = 6  # sides of a cell: -x, +x, -y, +y, -z, +z


@dataclass(frozen=True, eq=False)
class LightVoxels:
    """Cells of a box of a scene; those that stop rays have numbers.

    Attributes:
        origin: corner of the box [3] m.
        cell: size of a cell [m].
        number: of each cell [X, Y, Z], -1 where it is open.
        weight: surface of each numbered cell that faces each side [S, 6].
        radiance: mean light that it sends to that side [S, 6, 3].
    """

    origin: F64
    cell: float
    number: NDArray[np.int32]
    weight: F32
    radiance: F32

    def gather(self, points: F64, normals: F64 | None, rays: int) -> tuple[F32, F32]:
        """Light that meets points [P, 3], and the share of it that comes from outside the box.

        With normals [P, 3]: irradiance / π [P, 1, 3] and open share [P, 1]. Without: the light
        from each of `rays` directions round them, those of `spread_directions`, [P, rays, 3] and
        [P, rays].
        """
        every = np.empty((0, 3)) if normals is None else np.ascontiguousarray(normals)
        width = rays if normals is None else 1
        out = np.zeros((len(points), width, 3), np.float32)
        outside = np.zeros((len(points), width), np.float32)
        _gather(
            np.ascontiguousarray(points), every, spread_directions(rays), self.origin, self.cell,
            self.number, self.weight, self.radiance, out, outside,
        )  # fmt: skip
        return out, outside


def spread_directions(count: int) -> F64:
    """Unit vectors [count, 3], evenly over the sphere by a golden spiral."""
    k = np.arange(count)
    z = 1.0 - (2 * k + 1) / count
    turn, r = k * 2.399963229728653, np.sqrt(1.0 - z * z)
    return np.stack([r * np.cos(turn), r * np.sin(turn), z], axis=1)


def fill_voxels(
    cloud: GaussianCloud, radiance: F32, stops: NDArray[np.bool_], box: F64
) -> LightVoxels:
    """Cells of a box [2, 3] m from splats that send out `radiance` [N, 3].

    Args:
        cloud: the splats; without normals, each sends light to all sides.
        radiance: linear light of each.
        stops: which of them stop rays; the others are left out [N].
        box: lower and upper corner [m].
    """
    extent = np.maximum(box[1] - box[0], CELL)
    cell = max(CELL, float(np.cbrt(np.prod(extent) / _CELLS_MOST)))
    shape = np.ceil(extent / cell).astype(np.int64) + 1
    keep = stops & ((cloud.means > box[0]) & (cloud.means < box[1])).all(axis=1)
    owner, place = _spread_points(cloud, np.flatnonzero(keep), cell)
    at = np.floor((place - box[0]) / cell).astype(np.int64)
    inside = ((at >= 0) & (at < shape)).all(axis=1)
    owner, at = owner[inside], at[inside]
    parts = np.bincount(owner, minlength=len(cloud))
    sizes = np.sort(cloud.scales.astype(np.float64), axis=1)
    area = np.minimum(2 * np.pi * sizes[:, 1] * sizes[:, 2], cell * cell * np.maximum(parts, 1))
    share = (area * cloud.opacities / np.maximum(parts, 1))[owner]
    flat = np.ravel_multi_index(tuple(at.T), tuple(shape))
    total = np.bincount(flat, share, int(np.prod(shape)))
    solid = np.flatnonzero(total >= _SOLID * cell * cell)
    number = np.full(int(np.prod(shape)), -1, np.int32)
    number[solid] = np.arange(len(solid))
    here = number[flat] >= 0
    row, owner, share = number[flat][here], owner[here], share[here]
    weight = np.zeros((len(solid), _EVERYWHERE))
    sent = np.zeros((len(solid), _EVERYWHERE, 3))
    for side in range(_EVERYWHERE):
        facing = np.full(len(row), 1 / 3)
        if cloud.normal is not None:
            along = cloud.normal[owner, side // 2] * (1.0 if side % 2 else -1.0)
            facing = np.maximum(along, 0.0) ** 2
        part = share * facing
        weight[:, side] = np.bincount(row, part, len(solid))
        for channel in range(3):
            sent[:, side, channel] = np.bincount(row, part * radiance[owner, channel], len(solid))
    sent /= np.maximum(weight, 1e-12)[:, :, None]
    return LightVoxels(
        np.asarray(box[0], np.float64), cell, number.reshape(tuple(shape)),
        weight.astype(np.float32), sent.astype(np.float32),
    )  # fmt: skip


def _spread_points(
    cloud: GaussianCloud, rows: NDArray[np.int64], cell: float
) -> tuple[NDArray[np.int64], F64]:
    """Points on the splats of some rows, closer than cells: of which splat, and where [M, 3]."""
    owner, place = [], []
    order = np.argsort(cloud.scales[rows], axis=1)
    for many in range(1, _WIDE + 1):
        wide = np.take_along_axis(cloud.scales[rows], order, axis=1)[:, 2]
        wanted = np.clip(np.ceil(3.0 * wide / cell), 1, _WIDE)
        some = rows[wanted == many]
        axes = order[wanted == many]
        if not len(some):
            continue
        turn = rotation_from_quaternion(cloud.quats[some])
        steps = (np.arange(many) + 0.5) / many * 3.0 - 1.5
        each = np.arange(len(some))
        first = turn[each, :, axes[:, 2]] * cloud.scales[some, axes[:, 2]][:, None]
        second = turn[each, :, axes[:, 1]] * cloud.scales[some, axes[:, 1]][:, None]
        for a in steps:
            for b in steps:
                owner.append(some)
                place.append(cloud.means[some] + a * first + b * second)
    if not owner:
        return np.zeros(0, np.int64), np.zeros((0, 3))
    return np.concatenate(owner), np.concatenate(place).astype(np.float64)


@njit(error_model="numpy")
def march_ray(x, y, z, dx, dy, dz, t_max, origin, cell, number):  # type: ignore[no-untyped-def]
    """Number of the first solid cell along a ray after the one it starts in.

    -1 if there is none before `t_max` [m], -2 if it left the box (Amanatides and Woo, 1987).
    """
    px, py, pz = (x - origin[0]) / cell, (y - origin[1]) / cell, (z - origin[2]) / cell
    i, j, k = int(np.floor(px)), int(np.floor(py)), int(np.floor(pz))
    sx, sy, sz = (1 if dx > 0 else -1), (1 if dy > 0 else -1), (1 if dz > 0 else -1)
    wx, wy, wz = cell / max(abs(dx), 1e-12), cell / max(abs(dy), 1e-12), cell / max(abs(dz), 1e-12)
    tx = (i + 1 - px if dx > 0 else px - i) * wx
    ty = (j + 1 - py if dy > 0 else py - j) * wy
    tz = (k + 1 - pz if dz > 0 else pz - k) * wz
    while True:
        if tx <= ty and tx <= tz:
            t, i, tx = tx, i + sx, tx + wx
        elif ty <= tz:
            t, j, ty = ty, j + sy, ty + wy
        else:
            t, k, tz = tz, k + sz, tz + wz
        if t > t_max:
            return -1
        if not (0 <= i < number.shape[0] and 0 <= j < number.shape[1] and 0 <= k < number.shape[2]):
            return -2
        if number[i, j, k] >= 0:
            return number[i, j, k]


@njit(parallel=True, error_model="numpy")
def _gather(points, normals, ways, origin, cell, number, weight, radiance, out, outside):  # type: ignore[no-untyped-def]
    hemisphere = len(normals) > 0
    for p in prange(len(points)):
        total = 0.0
        red = green = blue = away = 0.0
        for r in range(len(ways)):
            dx, dy, dz = ways[r, 0], ways[r, 1], ways[r, 2]
            cosine = 1.0
            if hemisphere:
                cosine = dx * normals[p, 0] + dy * normals[p, 1] + dz * normals[p, 2]
                if cosine <= 0.0:
                    continue
            total += cosine
            hit = march_ray(
                points[p, 0], points[p, 1], points[p, 2], dx, dy, dz, 1e9, origin, cell, number
            )
            a = b = c = 0.0
            left = 1.0 if hit < 0 else 0.0
            if hit >= 0:
                side_x, side_y, side_z = (
                    (0 if dx > 0 else 1),
                    (2 if dy > 0 else 3),
                    (4 if dz > 0 else 5),
                )
                u = weight[hit, side_x] * dx * dx
                v = weight[hit, side_y] * dy * dy
                w = weight[hit, side_z] * dz * dz
                s = u + v + w
                if s > 0.0:
                    a = (
                        u * radiance[hit, side_x, 0]
                        + v * radiance[hit, side_y, 0]
                        + w * radiance[hit, side_z, 0]
                    ) / s
                    b = (
                        u * radiance[hit, side_x, 1]
                        + v * radiance[hit, side_y, 1]
                        + w * radiance[hit, side_z, 1]
                    ) / s
                    c = (
                        u * radiance[hit, side_x, 2]
                        + v * radiance[hit, side_y, 2]
                        + w * radiance[hit, side_z, 2]
                    ) / s
            if hemisphere:
                red += cosine * a
                green += cosine * b
                blue += cosine * c
                away += cosine * left
            else:
                out[p, r, 0], out[p, r, 1], out[p, r, 2] = a, b, c
                outside[p, r] = left
        if hemisphere:
            total = max(total, 1e-12)
            out[p, 0, 0], out[p, 0, 1], out[p, 0, 2] = red / total, green / total, blue / total
            outside[p, 0] = away / total
