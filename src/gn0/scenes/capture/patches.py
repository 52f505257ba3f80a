"""Level patches of a capture: tops of tables and seats, undersides of lintels."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from gn0.geometry import F64
from gn0.scenes.capture.gravity import SurfaceSample

CELLS = 52  # over the height of the storey: 5 cm where that is 2.6 m
TOPS = (0.10, 0.45)  # of the storey's height: 0.26 m to 1.17 m
_LEVEL = 0.95  # |n · up|
_BINS = 340  # over the height of the storey: 7.6 mm
_LEAST = 20  # cells
_MOST = 400  # patches, the largest first
_HEIGHTS = 120  # heights looked at, the commonest first
_GRID = 40_000_000


@dataclass(frozen=True, eq=False)
class LevelSample:
    """A surface sample in level axes: floor at 0, walls along x and y, units of the file.

    Attributes:
        points: [N, 3].
        normals: [N, 3], signs without meaning.
        flat: whether a normal can be trusted [N].
        weight: surface that each stands for [N].
        storey: height of the storey.
    """

    points: F64
    normals: F64
    flat: NDArray[np.bool_]
    weight: F64
    storey: float

    @property
    def cell(self) -> float:
        """Side of the cells in which patches are looked for."""
        return self.storey / CELLS


@dataclass(frozen=True)
class Patch:
    """A level patch, in units of the file.

    Attributes:
        height: over the floor.
        area: area of its cells.
        low, high: corners (x, y) of its box.
        mass: surface in it, as the sample weighs it.
    """

    height: float
    area: float
    low: tuple[float, float]
    high: tuple[float, float]
    mass: float


def level_sample(sample: SurfaceSample, rotation: F64, floor: float, storey: float) -> LevelSample:
    """A sample turned upright; what lies far over or under the storey is left out."""
    points = sample.points @ rotation.T
    points[:, 2] -= floor
    near = (points[:, 2] > -0.2 * storey) & (points[:, 2] < 1.3 * storey)
    return LevelSample(
        points[near], sample.normals[near] @ rotation.T, sample.flat[near], sample.weight[near],
        storey,
    )  # fmt: skip


def find_patches(sample: LevelSample, band: tuple[float, float]) -> tuple[Patch, ...]:
    """Level patches within a band of heights, given as shares of the storey's height."""
    z = sample.points[:, 2]
    low, high = (share * sample.storey for share in band)
    facing = sample.flat & (np.abs(sample.normals[:, 2]) > _LEVEL) & (z > low) & (z < high)
    if facing.sum() < _LEAST:
        return ()
    points, weight = sample.points[facing], sample.weight[facing]
    cell = sample.cell
    key = np.floor(points[:, :2] / cell).astype(np.int64)
    corner = key.min(axis=0)
    key -= corner
    shape = (int(key[:, 0].max()) + 1, int(key[:, 1].max()) + 1)
    if shape[0] * shape[1] > _GRID:
        return ()
    bins = np.floor((points[:, 2] - low) / (sample.storey / _BINS)).astype(np.int64)
    mass = np.bincount(bins, minlength=int(bins.max()) + 4).astype(np.float64)
    found: list[Patch] = []
    for _ in range(_HEIGHTS):
        wide = np.convolve(mass, np.ones(3), "same")
        best = int(np.argmax(wide))
        if wide[best] < _LEAST:
            break
        near = np.flatnonzero(np.abs(bins - best) <= 1)
        found += _patches_at(points[near], weight[near], key[near], cell, corner)
        mass[max(best - 1, 0) : best + 2] = 0
    found.sort(key=lambda patch: (-patch.area, patch.low))
    return tuple(found[:_MOST])


def _patches_at(
    points: F64, weight: F64, key: NDArray[np.int64], cell: float, corner: NDArray[np.int64]
) -> list[Patch]:
    """Patches of points that lie at one height."""
    first = key.min(axis=0)
    rows, cols = (int(v) + 1 for v in (key - first).max(axis=0))
    seen = np.zeros((rows + 4, cols + 4), bool)
    at = key - first + 2
    seen[at[:, 0], at[:, 1]] = True
    closed = ndimage.binary_closing(seen) | seen
    labels, count = ndimage.label(closed)
    sizes = np.bincount(labels.ravel(), minlength=count + 1)
    own = labels[at[:, 0], at[:, 1]]
    order = np.argsort(own, kind="stable")
    ends = np.searchsorted(own[order], np.arange(count + 2))
    spans = ndimage.find_objects(labels)
    out = []
    for label in range(1, count + 1):
        if sizes[label] < _LEAST:
            continue
        mine = order[ends[label] : ends[label + 1]]
        span = spans[label - 1]
        corners = (
            np.array([[s.start, s.stop] for s in span]) - 2 + (first + corner)[:, None]
        ) * cell
        out.append(
            Patch(
                height=float(np.median(points[mine, 2])),
                area=float(sizes[label]) * cell**2,
                low=(float(corners[0, 0]), float(corners[1, 0])),
                high=(float(corners[0, 1]), float(corners[1, 1])),
                mass=float(weight[mine].sum()),
            )
        )
    return out
