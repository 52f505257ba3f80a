"""Boxes seen from above, and how far apart they are."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gn0.geometry import F64
from gn0.scenes.scene import ObjectBox

_CORNERS = np.array([(1, 1), (-1, 1), (-1, -1), (1, -1)]) / 2
_LEAST = 1e-3  # m, side of a footprint


@dataclass(frozen=True, eq=False)
class Footprints:
    """The rectangles that boxes stand on.

    Attributes:
        corners: of each [N, 4, 2] m, anticlockwise.
        low: their least coordinates [N, 2] m.
        high: their largest coordinates [N, 2] m.
    """

    corners: F64
    low: F64
    high: F64

    def around(self, index: int, reach: float = 0.0) -> NDArray[np.int64]:
        """Rectangles whose bounds come within `reach` [m] of those of another, itself left out."""
        apart = np.maximum(self.low - self.high[index], self.low[index] - self.high)
        found = np.flatnonzero((apart <= reach).all(axis=1))
        return found[found != index]

    def gaps(self, index: int, others: Sequence[int] | NDArray[np.integer]) -> F64:
        """Distance [K] m of one rectangle to others; 0 where they touch or overlap."""
        one, many = self.corners[index], self.corners[np.asarray(others, np.int64)]
        if not len(many):
            return np.zeros(0)
        away = np.minimum(_nearest(one[None], many), _nearest(many, one[None]))
        return np.where(_overlap(one, many), 0.0, away)


def build_footprints(boxes: Sequence[ObjectBox]) -> Footprints:
    """The footprints of boxes; none is thinner than a millimetre."""
    corners = np.zeros((len(boxes), 4, 2))
    for k, box in enumerate(boxes):
        c, s = np.cos(box.yaw), np.sin(box.yaw)
        half = _CORNERS * np.maximum(box.size[:2], _LEAST)
        corners[k] = half @ np.array([(c, s), (-s, c)]) + box.centre[:2]
    return Footprints(corners, corners.min(axis=1), corners.max(axis=1))


def _nearest(points: F64, rings: F64) -> F64:
    """Least distance [K] of corners [K or 1, 4, 2] to the sides of rectangles, of as many."""
    side = np.roll(rings, -1, axis=1) - rings
    offset = points[:, :, None] - rings[:, None]  # [K, points, sides, 2]
    along = np.einsum("kpsd,ksd->kps", offset, np.broadcast_to(side, (len(offset), 4, 2)))
    t = np.clip(along / (side**2).sum(axis=2)[:, None], 0.0, 1.0)
    away = offset - t[..., None] * side[:, None]
    return np.asarray(np.sqrt((away**2).sum(axis=3)).min(axis=(1, 2)))


def _overlap(one: F64, many: F64) -> NDArray[np.bool_]:
    """Whether rectangles [K, 4, 2] meet one [4, 2]: no side of either parts them."""
    meet = np.ones(len(many), np.bool_)
    ring = np.broadcast_to(one, many.shape)
    for rings in (ring, many):
        for k in range(2):
            axis = rings[:, k + 1] - rings[:, k]
            a, b = (np.einsum("kcd,kd->kc", r, axis) for r in (ring, many))
            meet &= (a.max(axis=1) >= b.min(axis=1)) & (b.max(axis=1) >= a.min(axis=1))
    return meet
