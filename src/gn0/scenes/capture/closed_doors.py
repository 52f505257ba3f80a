"""Doors that were closed when a capture was made: found, named, and opened when told.

A closed door is a leaf within a wall: over its head both faces of the wall are seen, below it one
is missing and a thin upright panel stands between them. A cupboard before a wall has its panel in
front of the faces, a window a parapet below. Only walls along the two main headings are looked at.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gn0.gaussians.cloud import GaussianCloud
from gn0.geometry import F64
from gn0.scenes.capture.floor import find_wall_yaw
from gn0.scenes.capture.gravity import SurfaceSample, sample_surface, weighted_quantile
from gn0.scenes.capture.patches import LevelSample, Patch, find_patches
from gn0.scenes.capture.scale import USUAL_CEILING, VOTERS

HEADS = (1.90, 2.30)  # m
WIDE = (0.55, 1.9)  # m
THICK = (0.05, 0.45)  # m: of walls
_IN_WALL = 0.012  # m from a face: nearer is the face itself
_THIN = 0.10  # m: a leaf with its mouldings
_FILLED = 0.55  # of the cells of a leaf or face that hold any of it
_BARE = 0.30  # of a face: less, and it is missing
_CELL = 0.06  # m
_HANDLES = (0.75, 1.30, 0.09)  # m: from and to which height, and how far they stand out
_MOULDING = 0.02  # m that a leaf's own frame stands out of the wall
_MARGIN = 0.008  # m left at the head
_GAP = 0.032  # m from the outermost splats of a leaf to its jambs, both sides together
_SILL = 0.015  # m: what is lower is floor


@dataclass(frozen=True)
class ClosedDoor:
    """A closed door of a scene.

    Attributes:
        centre: (x, y) [m] of its middle.
        along: unit vector (x, y) along the wall.
        width: [m].
        head: height of its top [m].
        faces: of the wall across `along` turned left, from the centre [m].
        leads: whether the floor was seen on both sides.
    """

    centre: tuple[float, float]
    along: tuple[float, float]
    width: float
    head: float
    faces: tuple[float, float]
    leads: bool

    @property
    def words(self) -> str:
        """As a user reads it."""
        x, y = self.centre
        out = "" if self.leads else ", no floor seen behind it"
        return f"({x:.2f}, {y:.2f}) {self.width:.2f} x {self.head:.2f} m{out}"


def find_closed_doors(
    cloud: GaussianCloud, ceiling: float | None, *, ground: bool = False
) -> tuple[ClosedDoor, ...]:
    """Closed doors of a capture in the scene's frame.

    Args:
        cloud: the Gaussians, metres, floor at z = 0.
        ceiling: its height [m], where known.
        ground: the floor is assumed to be everywhere, seen or not.
    """
    surface = sample_surface(cloud, VOTERS)
    yaw, walls = find_wall_yaw(surface, np.array([0.0, 0.0, 1.0]))
    if walls < 0.3:
        return ()
    c, s = math.cos(yaw), math.sin(yaw)
    turn = np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]])
    storey = max(ceiling or USUAL_CEILING, HEADS[1] + 0.1)
    sample = _turned(surface, turn, storey)
    found: list[ClosedDoor] = []
    for patch in find_patches(sample, (HEADS[0] / storey, HEADS[1] / storey)):
        door = _read(sample, patch, turn, ground)
        if door is not None and not any(_near(door, other) for other in found):
            found.append(door)
    return tuple(sorted(found, key=lambda door: door.centre))


def open_doors(cloud: GaussianCloud, doors: tuple[ClosedDoor, ...]) -> NDArray[np.bool_]:
    """Splats [N] that stay when the leaves and handles of doors are taken out.

    What lies in the opening between the faces of the wall goes, and on either side what stands out
    by as little as a moulding, at the height of the handle by as much as one.
    """
    keep = np.ones(len(cloud), bool)
    points = cloud.means.astype(np.float64)
    z = points[:, 2]
    for door in doors:
        along = np.array(door.along)
        away = points[:, :2] - np.array(door.centre)
        u, v = away @ along, away @ np.array([-along[1], along[0]])
        beside = np.maximum(door.faces[0] - v, v - door.faces[1])
        gone = (np.abs(u) < door.width / 2) & (z > _SILL) & (z < door.head - _MARGIN)
        handle = (z > _HANDLES[0]) & (z < _HANDLES[1]) & (beside < _HANDLES[2])
        keep &= ~(gone & ((beside < _MOULDING) | handle))
    return keep


def _turned(surface: SurfaceSample, turn: F64, storey: float) -> LevelSample:
    near = (surface.points[:, 2] > -0.3) & (surface.points[:, 2] < storey + 0.3)
    return LevelSample(
        surface.points[near] @ turn.T, surface.normals[near] @ turn.T, surface.flat[near],
        surface.weight[near], storey,
    )  # fmt: skip


def _near(a: ClosedDoor, b: ClosedDoor) -> bool:
    return math.dist(a.centre, b.centre) < 0.4 * max(a.width, b.width)


def _read(sample: LevelSample, patch: Patch, turn: F64, ground: bool) -> ClosedDoor | None:
    """The closed door under a level patch, or None."""
    size = np.subtract(patch.high, patch.low)
    k = int(np.argmax(size))
    q = 1 - k
    if not (WIDE[0] <= size[k] <= WIDE[1] and size[q] <= THICK[1] + 0.1):
        return None
    p, head = sample.points, patch.height
    # cells end beyond the patch: a cell is kept off either end
    ends = (patch.low[k] + sample.cell, patch.high[k] - sample.cell)
    near = (p[:, k] > ends[0]) & (p[:, k] < ends[1])
    near &= (p[:, q] > patch.low[q] - 0.6) & (p[:, q] < patch.high[q] + 0.6)
    index = np.flatnonzero(near)
    u, v, z = p[index, k], p[index, q], p[index, 2]
    steep = sample.flat[index] & (np.abs(sample.normals[index, q]) > 0.8)
    beside = (v > patch.low[q] - 0.12) & (v < patch.high[q] + 0.12)
    over = steep & beside & (z > head + 0.09) & (z < sample.storey - 0.05)
    if over.sum() < 10:
        return None
    w = sample.weight[index]
    low, high = weighted_quantile(v[over], w[over], (0.04, 0.96))
    if not THICK[0] <= high - low <= THICK[1]:
        return None
    under = steep & (z > 0.08) & (z < head - 0.06)
    wide, tall = ends[1] - ends[0], head - 0.14

    def filled(mine: NDArray[np.bool_]) -> float:
        """Share of the cells of the opening's front in which any of these points lie."""
        rows, cols = max(1, round(tall / _CELL)), max(1, round(wide / _CELL))
        r = np.clip(((z[mine] - 0.08) / tall * rows).astype(np.int64), 0, rows - 1)
        c = np.clip(((u[mine] - ends[0]) / wide * cols).astype(np.int64), 0, cols - 1)
        return len(np.unique(r * cols + c)) / (rows * cols)

    inner = under & (v > low + _IN_WALL) & (v < high - _IN_WALL)
    if inner.sum() < 10 or filled(inner) < _FILLED:
        return None
    a, b = weighted_quantile(v[inner], w[inner], (0.1, 0.9))
    if b - a > _THIN:
        return None
    faces = [filled(under & (np.abs(v - face) <= _IN_WALL)) for face in (low, high)]
    if min(faces) > _BARE:
        return None
    sides = [_floor_share(u, v, z, ends, low - 0.5, low - 0.05)]
    sides.append(_floor_share(u, v, z, ends, high + 0.05, high + 0.5))
    # the leaf itself says how wide it is; the patch ends with a cell
    near = (p[:, k] > patch.low[k] - sample.cell) & (p[:, k] < patch.high[k] + sample.cell)
    reach = near & sample.flat
    reach &= (np.abs(sample.normals[:, q]) > 0.8) & (p[:, 2] > 0.08) & (p[:, 2] < head - 0.06)
    reach &= (p[:, q] > low + _IN_WALL) & (p[:, q] < high - _IN_WALL)
    first, last = weighted_quantile(p[reach, k], sample.weight[reach], (0.01, 0.99))
    spare = 0.02 * (last - first) / 0.98 / 2 + _GAP / 2
    first, last = first - spare, last + spare
    middle = np.array([0.0, 0.0])
    middle[k], middle[q] = (first + last) / 2, (low + high) / 2
    along = np.array([1.0, 0.0]) if k == 0 else np.array([0.0, 1.0])
    half = (high - low) / 2
    back = turn[:2, :2].T
    x, y = back @ middle
    dx, dy = back @ along
    return ClosedDoor(
        centre=(round(float(x), 4), round(float(y), 4)),
        along=(float(dx), float(dy)),
        width=round(float(last - first), 3),
        head=round(float(head), 3),
        faces=(-float(half), float(half)),
        leads=ground or min(sides) >= 0.4,
    )


def _floor_share(
    u: F64, v: F64, z: F64, ends: tuple[float, float], low: float, high: float
) -> float:
    """Share of the ground before a door on which floor is seen."""
    mine = (np.abs(z) < 0.06) & (v > low) & (v < high)
    rows, cols = max(1, round((ends[1] - ends[0]) / 0.1)), 4
    r = np.clip(((u[mine] - ends[0]) / (ends[1] - ends[0]) * rows).astype(np.int64), 0, rows - 1)
    c = np.clip(((v[mine] - low) / (high - low) * cols).astype(np.int64), 0, cols - 1)
    return len(np.unique(r * cols + c)) / (rows * cols)
