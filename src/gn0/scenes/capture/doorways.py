"""Doorways of a capture, open and closed: a lintel's underside, wall over it, and what is below.

Sizes are shares of the storey's height, so the unit need not be known. Only walls along the two
main headings are looked at.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass

import numpy as np

from gn0.geometry import F64
from gn0.scenes.capture.patches import LevelSample, Patch, find_patches

HEADS = (0.55, 0.92)  # of the storey's height: where lintels are
WIDE = (0.21, 0.80)  # of the storey's height: 0.55 m to 2.1 m where that is 2.6 m
DEEP = (0.019, 0.20)  # 0.05 m to 0.5 m: as thick as walls
_LINTEL = 0.25  # of one face of wall: so much at least is seen over the head
_OPEN = 0.12  # of one face of a leaf: less in the way, and the door is open
_CLOSED = 0.45  # more, and it is closed; between the two is somebody's furniture
_LEAF = 0.04  # of the storey's height: how thick a leaf is at most (0.10 m)


@dataclass(frozen=True)
class Doorway:
    """A way through a wall with a lintel over it, in the file's units and level axes.

    Attributes:
        head: height of the lintel's underside over the floor.
        low, high: corners (x, y) of the way within the wall.
        axis: 0 or 1, the axis along the wall.
        leaf: (low, high) across the wall between which a closed leaf lies; None when open.
    """

    head: float
    low: tuple[float, float]
    high: tuple[float, float]
    axis: int
    leaf: tuple[float, float] | None

    @property
    def width(self) -> float:
        """Along the wall."""
        return self.high[self.axis] - self.low[self.axis]


def find_doorways(sample: LevelSample) -> tuple[Doorway, ...]:
    """Doorways with a free way or a leaf in them."""
    found: list[Doorway] = []
    for patch in find_patches(sample, HEADS):
        door = _read_doorway(sample, patch)
        # the two strips of lintel on either side of a leaf are one door
        if door is not None and not any(_same(door, other) for other in found):
            found.append(door)
    return tuple(found)


def _same(a: Doorway, b: Doorway) -> bool:
    near = 0.25 * max(a.width, b.width)
    return all(a.low[k] - near < b.high[k] and b.low[k] - near < a.high[k] for k in (0, 1))


def _read_doorway(sample: LevelSample, patch: Patch) -> Doorway | None:
    h = sample.storey
    size = np.subtract(patch.high, patch.low)
    along = int(np.argmax(size))
    across = 1 - along
    if not (
        WIDE[0] * h <= size[along] <= WIDE[1] * h and DEEP[0] * h <= size[across] <= DEEP[1] * h
    ):
        return None
    cell = sample.cell
    p, w = sample.points, sample.weight
    # half a cell is kept off the jambs, two are given on each side for the faces of the wall
    inside = (p[:, along] > patch.low[along] + 1.5 * cell) & (
        p[:, along] < patch.high[along] - 1.5 * cell
    )
    inside &= (p[:, across] > patch.low[across] - 2.5 * cell) & (
        p[:, across] < patch.high[across] + 2.5 * cell
    )
    near = np.flatnonzero(inside)
    z, across_at = p[near, 2], p[near, across]
    steep = sample.flat[near] & (np.abs(sample.normals[near, across]) > 0.8)
    dense = patch.mass / patch.area  # surface as the sample weighs it, a unit of area
    wide = float(size[along]) - 3 * cell
    over = steep & (z > patch.height + 0.03 * h) & (z < 0.97 * h)
    room = max(0.97 * h - patch.height - 0.03 * h, 0.02 * h)
    if float(w[near][over].sum()) < _LINTEL * wide * room * dense:
        return None
    band = (0.06 * h, 0.95 * patch.height)
    under = (z > band[0]) & (z < band[1])
    face = wide * (band[1] - band[0]) * dense
    share = float(w[near][under].sum()) / face
    if share <= _OPEN:
        return Doorway(patch.height, patch.low, patch.high, along, None)
    leaf = _leaf(across_at[under & steep], z[under & steep], w[near][under & steep], h, face, band)
    if leaf is None:
        return None
    low, high = list(patch.low), list(patch.high)
    low[across], high[across] = min(low[across], leaf[0]), max(high[across], leaf[1])
    return Doorway(patch.height, (low[0], low[1]), (high[0], high[1]), along, leaf)


def _leaf(
    across: F64, z: F64, weight: F64, storey: float, face: float, band: tuple[float, float]
) -> tuple[float, float] | None:
    """Where a thin leaf lies that fills the way from foot to head; None without one."""
    if len(across) < 10:
        return None
    order = np.argsort(across)
    total = np.cumsum(weight[order])
    starts = np.searchsorted(across[order], across[order] - _LEAF * storey)
    within = total - np.where(starts > 0, total[starts - 1], 0.0)
    best = int(np.argmax(within))
    high = float(across[order][best])
    low = float(across[order][starts[best]])
    mine = (across >= low) & (across <= high)
    # the same plane from foot to head: a window has a parapet in another, a shelf has none
    parts = np.linspace(band[0], band[1], 5)
    for a, b in itertools.pairwise(parts):
        part = mine & (z >= a) & (z < b)
        if float(weight[part].sum()) < _CLOSED * face / 4:
            return None
    return low, high
