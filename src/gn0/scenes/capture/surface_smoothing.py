"""Noisy surfaces thinned: every disc moves along its normal onto its neighbours' plane.

Only the map is drawn from the moved discs. A wall whose points stray by a few millimetres would
otherwise close the whole row of cells before it.
"""

from __future__ import annotations

import numpy as np

from gn0.gaussians.cloud import GaussianCloud
from gn0.geometry import F32
from gn0.jit import njit, prange
from gn0.scenes.capture.disc_facing import disc_normals

RADIUS = 0.08  # m: neighbours
PASSES = 2
LEAST_NOISE = 0.002  # m: less is not worth the time
MOST_NOISE = 0.02  # m: more, and two sides of a board would become one
_FAINT = 0.05


def smooth_surfaces(cloud: GaussianCloud, noise: float) -> F32:
    """Centres [N, 3] m with each flat disc on the plane of the discs round it.

    The offset along a disc's normal is the mean of its neighbours', weighted by nearness, by
    agreement of the normals and by nearness to the plane, so that another surface has no say.

    Args:
        cloud: the Gaussians, metres.
        noise: standard deviation [m] of points about their surface.
    """
    normal, flat = disc_normals(cloud)
    index = np.flatnonzero(flat & (cloud.opacities >= _FAINT))
    if noise < LEAST_NOISE or not len(index):
        return cloud.means
    means = cloud.means.astype(np.float64)
    normals = np.ascontiguousarray(normal[index])
    weight = cloud.opacities[index].astype(np.float64)
    for _ in range(PASSES):
        points = means[index]
        key = np.floor((points - points.min(axis=0)) / RADIUS).astype(np.int64) + 1
        ny, nz = (int(v) + 2 for v in key.max(axis=0)[1:])
        cell = (key[:, 0] * ny + key[:, 1]) * nz + key[:, 2]
        order = np.argsort(cell, kind="stable")
        cells, first = np.unique(cell[order], return_index=True)
        offset = _offsets(
            points[order], normals[order], weight[order], cell[order], cells,
            np.append(first, len(order)), ny, nz, RADIUS, 2.5 * min(noise, MOST_NOISE),
        )  # fmt: skip
        means[index[order]] += offset[:, None] * normals[order]
    return means.astype(np.float32)


@njit(parallel=True, error_model="numpy")
def _offsets(points, normals, weight, key, cells, first, ny, nz, radius, width):  # type: ignore[no-untyped-def]
    """Offset of each point to its neighbours' plane along its normal [N] m."""
    out = np.zeros(len(points))
    for i in prange(len(points)):
        px, py, pz = points[i, 0], points[i, 1], points[i, 2]
        ax, ay, az = normals[i, 0], normals[i, 1], normals[i, 2]
        total, pull = 1e-12, 0.0
        for di in range(-1, 2):
            for dj in range(-1, 2):
                # cells along z follow each other in the key: one search for three of them
                low = key[i] + (di * ny + dj) * nz - 1
                c = np.searchsorted(cells, low)
                while c < len(cells) and cells[c] <= low + 2:
                    for n in range(first[c], first[c + 1]):
                        dx, dy, dz = points[n, 0] - px, points[n, 1] - py, points[n, 2] - pz
                        near = 1.0 - (dx * dx + dy * dy + dz * dz) / (radius * radius)
                        if near <= 0.0:
                            continue
                        agree = ax * normals[n, 0] + ay * normals[n, 1] + az * normals[n, 2]
                        agree *= agree
                        if agree < 0.8:
                            continue
                        h = (dx * ax + dy * ay + dz * az) / width
                        w = weight[n] * near * agree * np.exp(-0.5 * h * h)
                        total += w
                        pull += w * h
                    c += 1
        out[i] = pull / total * width
    return out
