"""How strong a scene's lamps and windows are, found from the light on its surfaces.

Splats that are brighter than the light on them show a source, but the film has cut off how bright
it is. Their strength is what explains the irradiance of all other splats best, once the light that
surfaces send each other is taken off: a linear problem with few unknowns that are not below 0.
(As in inverse lighting, Marschner and Greenberg, CIC 1997.)
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from gn0.avatars.light_voxels import LightVoxels, march_ray
from gn0.gaussians.cloud import GaussianCloud
from gn0.geometry import F64
from gn0.jit import njit, prange

_LEAST, _TIMES = 0.3, 1.5  # of exposed light beyond what is reflected, that a source sends
_PIECE = 0.3  # of a source that is one point of it [m]
_PART = 1.6  # a source is no larger than this [m]: a long window's ends may differ
_MOST = 400  # sources
_SAMPLES = 6000  # places on surfaces that judge their strength
_RAYS = 256
_CLEAR = 0.09  # how far from a surface light is gathered [m]
_NEAR = 0.15  # nothing is nearer to a source than this [m]
_FRAME = 0.15  # what is nearer to a source than this does not stop its light [m]


@dataclass(frozen=True, eq=False)
class LightSources:
    """K sources of several points each.

    Attributes:
        point, normal: where they shine from, and to which side [Q, 3].
        area: surface of each point [Q] m².
        source: the source of each point [Q].
        strength: linear exposed radiance of each source [K, 3].
        sky: of what lies outside the box [3].
    """

    point: F64
    normal: F64
    area: F64
    source: NDArray[np.int64]
    strength: F64
    sky: F64

    def reach(self, points: F64, normals: F64, voxels: LightVoxels) -> F64:
        """Irradiance / π at points [P, 3] on normals [P, M, 3], of strength 1 [P, M, K]."""
        out = np.zeros((*normals.shape[:2], len(self.strength)))
        _reach(
            np.ascontiguousarray(points), np.ascontiguousarray(normals), self.point, self.normal,
            self.area, self.source, voxels.origin, voxels.cell, voxels.number, out,
        )  # fmt: skip
        return out


def find_glow(cloud: GaussianCloud, exposed: F64, reflected: F64) -> NDArray[np.bool_]:
    """Splats [N] that send out more light than falls on them."""
    more = (exposed - reflected).max(axis=1)
    glows: NDArray[np.bool_] = (more > _LEAST) & (more > _TIMES * reflected.max(axis=1))
    return glows & (cloud.opacities > 0.1)


def find_sources(cloud: GaussianCloud, glows: NDArray[np.bool_], box: F64) -> LightSources:
    """Sources of splats that glow, within a box [2, 3] m; their strength is not known yet."""
    from scipy import ndimage  # here, so that who shows nobody does not load it

    rows = np.flatnonzero(glows & ((cloud.means > box[0]) & (cloud.means < box[1])).all(axis=1))
    empty = np.zeros((0, 3))
    none = LightSources(empty, empty, np.zeros(0), np.zeros(0, np.int64), empty, np.zeros(3))
    if not len(rows) or cloud.normal is None:
        return none
    means, normals = cloud.means[rows].astype(np.float64), cloud.normal[rows].astype(np.float64)
    sizes = np.sort(cloud.scales[rows].astype(np.float64), axis=1)
    area = 2 * np.pi * sizes[:, 1] * sizes[:, 2] * cloud.opacities[rows]
    # neighbours on one grid hang together; what is large is cut up on a coarser one
    at = np.floor((means - box[0]) / _PIECE).astype(np.int64)
    shape = tuple(at.max(axis=0) + 1)
    full = np.zeros(shape, bool)
    full[tuple(at.T)] = True
    together = ndimage.label(full, np.ones((3, 3, 3)))[0][tuple(at.T)]
    coarse = np.floor((means - box[0]) / _PART).astype(np.int64)
    facing = np.argmax(np.concatenate([-normals, normals], axis=1), axis=1)
    source = np.unique(np.column_stack([together, coarse]), axis=0, return_inverse=True)[1].ravel()
    total = np.bincount(source, area)
    kept = np.argsort(-total, kind="stable")[:_MOST]
    renumber = np.full(len(total), -1)
    renumber[np.sort(kept)] = np.arange(len(kept))
    source = renumber[source]
    here = source >= 0
    means, normals, area, at = means[here], normals[here], area[here], at[here]
    keys = np.column_stack([source[here], at, facing[here]])
    unique, piece = np.unique(keys, axis=0, return_inverse=True)
    piece = piece.ravel()
    weight = np.bincount(piece, area).astype(np.float64)

    def mean(values: F64) -> F64:
        return np.stack([np.bincount(piece, area * v) for v in values.T], axis=1) / weight[:, None]

    turned = mean(normals)
    turned /= np.maximum(np.linalg.norm(turned, axis=1, keepdims=True), 1e-9)
    return replace(
        none,
        point=mean(means),
        normal=turned,
        area=weight,
        source=unique[:, 0],
        strength=np.zeros((len(kept), 3)),
    )


def judge_sources(
    sources: LightSources, cloud: GaussianCloud, glows: NDArray[np.bool_], voxels: LightVoxels
) -> LightSources:
    """The same sources with the strengths that explain the irradiance of the other splats."""
    from scipy.optimize import nnls

    assert cloud.irradiance is not None and cloud.normal is not None
    low, high = voxels.origin, voxels.origin + voxels.cell * np.array(voxels.number.shape)
    inside = ((cloud.means > low) & (cloud.means < high)).all(axis=1)
    rows = np.flatnonzero(~glows & inside & (cloud.opacities > 0.3))
    rows = rows[:: max(1, len(rows) // _SAMPLES)]
    normals = cloud.normal[rows].astype(np.float64)
    points = cloud.means[rows] + _CLEAR * normals
    at = np.floor((points - voxels.origin) / voxels.cell).astype(np.int64)
    at = np.clip(at, 0, np.array(voxels.number.shape) - 1)
    free = voxels.number[tuple(at.T)] < 0
    rows, points, normals = rows[free], points[free], normals[free]
    known = cloud.irradiance[rows].astype(np.float64)
    bounced, outside = voxels.gather(points, normals, _RAYS)
    share = np.concatenate(
        [sources.reach(points, normals[:, None], voxels)[:, 0], outside.astype(np.float64)], axis=1
    )
    found = np.zeros((share.shape[1], 3))
    for channel in range(3):
        missing = np.maximum(known[:, channel] - bounced[:, 0, channel], 0.0)
        found[:, channel] = nnls(share, missing)[0]
    return replace(sources, strength=found[:-1], sky=found[-1])


@njit(parallel=True, error_model="numpy")
def _reach(points, normals, shine, side, area, source, origin, cell, number, out):  # type: ignore[no-untyped-def]
    for p in prange(len(points)):
        for q in range(len(shine)):
            dx, dy, dz = (
                shine[q, 0] - points[p, 0],
                shine[q, 1] - points[p, 1],
                shine[q, 2] - points[p, 2],
            )
            square = dx * dx + dy * dy + dz * dz
            far = np.sqrt(square)
            if far < 1e-6:
                continue
            dx, dy, dz = dx / far, dy / far, dz / far
            shown = -(dx * side[q, 0] + dy * side[q, 1] + dz * side[q, 2])
            if shown <= 0.0:
                continue
            seen = shown * area[q] / (np.pi * max(square, _NEAR * _NEAR))
            if seen < 1e-6:
                continue
            stop = far - _FRAME
            if (
                stop > 0.0
                and march_ray(
                    points[p, 0], points[p, 1], points[p, 2], dx, dy, dz, stop, origin, cell, number
                )
                >= 0
            ):
                continue
            for m in range(normals.shape[1]):
                cosine = dx * normals[p, m, 0] + dy * normals[p, m, 1] + dz * normals[p, m, 2]
                if cosine > 0.0:
                    out[p, m, source[q]] += seen * cosine
