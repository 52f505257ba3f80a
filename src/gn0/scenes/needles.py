"""Splats that reach beyond what they show, found from the splats alone."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from gn0.gaussians.cloud import GaussianCloud
from gn0.geometry import F64, rotation_from_quaternion
from gn0.maps.grid import FREE, OccupancyGrid
from gn0.scenes.reach import FARTHEST, SIGMA_MOST

_NEAR = 0.20  # of the place before a splat's end lies another, in sheets of coarse splats, too [m]
_SEEN = 3.0  # sheets are coarser in proportion to how much farther off than this one stands [m]
_TALL = 2.0  # eyes are nowhere higher above the floor [m]
_MOST = 200_000  # splats looked at, the longest first


@dataclass(frozen=True, eq=False)
class Needles:
    """Splats that break a rule; a splat may break both.

    Attributes:
        long: splats whose largest standard deviation exceeds `SIGMA_MOST`, the longest first.
        bare: splats that end where nothing else is shown, the longest first.
    """

    long: NDArray[np.int64]
    bare: NDArray[np.int64]


def find_needles(cloud: GaussianCloud, grid: OccupancyGrid | None = None) -> Needles:
    """The splats of a cloud that reach too far.

    A surface of splats goes on where a splat ends: near the place on its long axis that is
    `FARTHEST` short of its end, two standard deviations out, lies the centre of another. Where
    none does, the splat stands out into the open or into the next room. Where that place is
    nearer than `FARTHEST` to its own centre, that cannot be told.

    What nobody comes near is shown by fewer splats, such as the sky over a yard, and nobody sees
    its gaps: farther than `_SEEN` from wherever one may stand, "near" grows with the distance.

    Args:
        cloud: the splats.
        grid: where one may stand; without it, every splat counts as seen closely.
    """
    scales = cloud.scales.astype(np.float64)
    order = np.argsort(-scales.max(axis=1), kind="stable")
    size = scales[order].max(axis=1)
    long = order[: np.searchsorted(-size, -SIGMA_MOST)]
    some = order[: np.searchsorted(-size, -FARTHEST)][:_MOST]
    if not len(some):
        return Needles(long, np.empty(0, np.int64))
    longest = scales[some].argmax(axis=1)
    reach = 2.0 * scales[some, longest] - FARTHEST
    axis = rotation_from_quaternion(cloud.quats[some])[np.arange(len(some)), :, longest]
    width = np.sort(scales[some], axis=1)[:, 1]
    tree = cKDTree(cloud.means)
    bare = np.zeros(len(some), bool)
    for side in (1.0, -1.0):
        end = cloud.means[some] + (side * reach)[:, None] * axis
        distance, found = tree.query(end, k=2)
        # the splat itself does not count
        nearest = np.where(found[:, 0] == some, distance[:, 1], distance[:, 0])
        near = np.full(len(some), _NEAR)
        gap = np.flatnonzero(nearest > near + 2.0 * width)
        near[gap] *= np.maximum(1.0, _sight(end[gap], grid) / _SEEN)
        bare |= nearest > near + 2.0 * width
    return Needles(long, some[bare])


def _sight(points: F64, grid: OccupancyGrid | None) -> F64:
    """From how near places [N, 3] can be looked at [N] m, walls or not."""
    free = np.empty((0, 2), np.int64) if grid is None else np.argwhere(grid.cells == FREE)
    if grid is None or not len(free) or not len(points):
        return np.zeros(len(points))
    aside = cKDTree(grid.centres_of(free)).query(points[:, :2])[0]
    height = points[:, 2]
    return np.hypot(aside, np.maximum(0.0, np.maximum(height - _TALL, -height)))
