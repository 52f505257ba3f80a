"""How much matter each voxel holds: the extinction field of a cloud.

A Gaussian adds opacity · exp(−d²/2) to a voxel, d its least Mahalanobis distance within the voxel.
A voxel is solid where 1 − exp(−sum) exceeds one half: where half the light would be lost. Two
things differ from the usual rule (nearest point to the mean, tails to three sigma):

* The least distance is exact. A large slanted disc misses voxels whose point nearest to its mean
  lies off its plane, and walls of a capture are rarely along the axes.
* A Gaussian ends where half of its density is left, which is where one sees it end. Tails of many
  discs along one edge would add up to matter beyond it, and close the cells before a cupboard.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gn0.errors import SceneError
from gn0.gaussians.cloud import GaussianCloud
from gn0.geometry import F32, F64, rotation_from_quaternion
from gn0.jit import njit

FAINTEST = 0.05  # opacity below this is fog
LARGEST = 1.0  # m: a standard deviation above this is sky or fog
SOLID = math.log(2.0)  # sum at which 1 − exp(−sum) is one half
VOXELS_MAX = 160_000_000
_REACH = 2.0  # standard deviations
EDGE = math.sqrt(2 * math.log(2.0))  # standard deviations: where half of the density is left
_THINNEST = 5e-4  # m
_FAR = EDGE * LARGEST  # m: nothing reaches farther


@dataclass(frozen=True, eq=False)
class VoxelFrame:
    """Boxes in space: `field[layer, row, col]`.

    Attributes:
        origin: outer corner (x, y, z) [m].
        size: size of a voxel (x, y, z) [m].
        shape: (layers, rows, columns).
    """

    origin: tuple[float, float, float]
    size: tuple[float, float, float]
    shape: tuple[int, int, int]


def solid_enough(cloud: GaussianCloud) -> NDArray[np.bool_]:
    """Gaussians [N] that are matter: not faint, not huge, finite."""
    return np.asarray(
        (cloud.opacities >= FAINTEST)
        & (cloud.scales.max(axis=1) <= LARGEST)
        & np.isfinite(cloud.means).all(axis=1)
    )


def measure_extinction(cloud: GaussianCloud, frame: VoxelFrame) -> F32:
    """Extinction [layers, rows, columns] of a cloud.

    Args:
        cloud: the Gaussians, metres.
        frame: the voxels.

    Raises:
        SceneError: too many voxels.
    """
    count = math.prod(frame.shape)
    if count > VOXELS_MAX:
        raise SceneError(
            f"the capture spans {frame.shape[2]} x {frame.shape[1]} x {frame.shape[0]} voxels, "
            f"more than the {VOXELS_MAX:,} allowed",
            remedy="check its scale (--scale), or use coarser cells (--resolution)",
        )
    low = np.asarray(frame.origin)
    high = low + np.asarray(frame.size) * np.asarray(frame.shape[::-1])
    keep = solid_enough(cloud)
    keep &= ((cloud.means >= low - _FAR) & (cloud.means <= high + _FAR)).all(axis=1)
    index = np.flatnonzero(keep)
    field = np.zeros(frame.shape, np.float32)
    for start in range(0, len(index), 262_144):
        part = index[start : start + 262_144]
        precision, reach = _shapes(cloud.quats[part], cloud.scales[part])
        _accumulate(
            field, cloud.means[part].astype(np.float64), precision, reach,
            cloud.opacities[part].astype(np.float64), low, np.asarray(frame.size),
        )  # fmt: skip
    return field


def _shapes(quats: F32, scales: F32) -> tuple[F64, F64]:
    """Precision matrices [N, 6] (xx, yy, zz, xy, xz, yz) and half sizes of their boxes [N, 3]."""
    r = rotation_from_quaternion(quats)
    s = np.maximum(scales.astype(np.float64), _THINNEST)
    p = np.einsum("nij,nj,nkj->nik", r, s**-2.0, r)
    packed = np.stack(
        [p[:, 0, 0], p[:, 1, 1], p[:, 2, 2], p[:, 0, 1], p[:, 0, 2], p[:, 1, 2]], axis=1
    )
    return packed, EDGE * np.sqrt(np.einsum("nij,nj->ni", r * r, s**2))


@njit(error_model="numpy")
def _accumulate(field, means, precision, reach, opacity, origin, size):  # type: ignore[no-untyped-def]
    """Add Gaussians to the field, in order: the same bytes whatever the machine."""
    nz, ny, nx = field.shape
    for g in range(len(means)):
        mx, my, mz = means[g, 0], means[g, 1], means[g, 2]
        i0 = max(math.floor((mx - reach[g, 0] - origin[0]) / size[0]), 0)
        i1 = min(math.floor((mx + reach[g, 0] - origin[0]) / size[0]), nx - 1)
        j0 = max(math.floor((my - reach[g, 1] - origin[1]) / size[1]), 0)
        j1 = min(math.floor((my + reach[g, 1] - origin[1]) / size[1]), ny - 1)
        k0 = max(math.floor((mz - reach[g, 2] - origin[2]) / size[2]), 0)
        k1 = min(math.floor((mz + reach[g, 2] - origin[2]) / size[2]), nz - 1)
        pxx, pyy, pzz = precision[g, 0], precision[g, 1], precision[g, 2]
        pxy, pxz, pyz = precision[g, 3], precision[g, 4], precision[g, 5]
        for k in range(k0, k1 + 1):
            lz = origin[2] + k * size[2] - mz
            hz = lz + size[2]
            for j in range(j0, j1 + 1):
                ly = origin[1] + j * size[1] - my
                hy = ly + size[1]
                for i in range(i0, i1 + 1):
                    lx = origin[0] + i * size[0] - mx
                    hx = lx + size[0]
                    d = _least(pxx, pyy, pzz, pxy, pxz, pyz, lx, hx, ly, hy, lz, hz)
                    if d < EDGE * EDGE:
                        field[k, j, i] += np.float32(opacity[g] * math.exp(-0.5 * d))


@njit(inline="always", error_model="numpy")
def _least(pxx, pyy, pzz, pxy, pxz, pyz, lx, hx, ly, hy, lz, hz):  # type: ignore[no-untyped-def]
    """Least xᵀ P x over a box.

    Outside the box, the least value lies on a side that faces the centre: each of these is a
    problem in two variables, and its border one in a single variable.
    """
    best = np.inf
    if lx > 0.0:
        best = _least_on_side(lx, pxx, pyy, pzz, pxy, pxz, pyz, ly, hy, lz, hz)
    elif hx < 0.0:
        best = _least_on_side(hx, pxx, pyy, pzz, pxy, pxz, pyz, ly, hy, lz, hz)
    if ly > 0.0:
        best = min(best, _least_on_side(ly, pyy, pxx, pzz, pxy, pyz, pxz, lx, hx, lz, hz))
    elif hy < 0.0:
        best = min(best, _least_on_side(hy, pyy, pxx, pzz, pxy, pyz, pxz, lx, hx, lz, hz))
    if lz > 0.0:
        best = min(best, _least_on_side(lz, pzz, pxx, pyy, pxz, pyz, pxy, lx, hx, ly, hy))
    elif hz < 0.0:
        best = min(best, _least_on_side(hz, pzz, pxx, pyy, pxz, pyz, pxy, lx, hx, ly, hy))
    return 0.0 if best == np.inf else best


@njit(inline="always", error_model="numpy")
def _least_on_side(a, paa, puu, pvv, pau, pav, puv, lu, hu, lv, hv):  # type: ignore[no-untyped-def]
    """Least value where one coordinate is `a`, the others within (lu, hu) x (lv, hv)."""
    # stationary point of paa a² + puu u² + pvv v² + 2 pau a u + 2 pav a v + 2 puv u v
    det = puu * pvv - puv * puv
    u = a * (puv * pav - pvv * pau) / det
    v = a * (puv * pau - puu * pav) / det
    if lu <= u <= hu and lv <= v <= hv:
        return paa * a * a + u * (puu * u + 2 * (pau * a + puv * v)) + v * (pvv * v + 2 * pav * a)
    best = np.inf
    if u < lu or u > hu:
        s = lu if u < lu else hu
        t = min(max(-(pav * a + puv * s) / pvv, lv), hv)
        best = paa * a * a + s * (puu * s + 2 * (pau * a + puv * t)) + t * (pvv * t + 2 * pav * a)
    if v < lv or v > hv:
        t = lv if v < lv else hv
        s = min(max(-(pau * a + puv * t) / puu, lu), hu)
        value = paa * a * a + s * (puu * s + 2 * (pau * a + puv * t))
        best = min(best, value + t * (pvv * t + 2 * pav * a))
    return best
