"""The level surfaces over a capture's floor, and which of them are ceilings.

A ceiling is told by what it does, not by how much of all surface it is: it lies over most of the
columns in which anything stands, the floor is seen under it, and walls reach up to it. Ground round
a building, a storey above and the sky behind its windows change none of the three.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from gn0.geometry import F64
from gn0.scenes.capture.floor import FloorPlane, find_wall_yaw
from gn0.scenes.capture.gravity import SurfaceSample, plane_axes, weighted_quantile

LEAST_COVER = 0.20  # of the built columns: less is a table, a shelf, a bed
STOREY_COVER = 0.5  # the same, where walls go on above it
_NEAR = 0.30  # of the widest level's cover: what covers less is no ceiling beside it
_FLOORED = 0.40  # of a ceiling's columns in which the floor is seen; under a plinth it is not
_REACHED = 0.30  # upright surface below a ceiling over that near the floor
_WALLS = 0.40  # of the upright surface along two directions: less is no building
_LOWEST = 0.06  # of the height of all: lower is a carpet or a doorstep
_BINS = 250  # heights looked at
_COLUMNS = 12  # columns over the height of all
_MOST = 12  # levels looked at
_LEAST_MASS = 0.02  # of the level surface over the floor


@dataclass(frozen=True)
class Level:
    """A level surface over the floor, in the file's units.

    Attributes:
        height: over the floor.
        cover: share of the built columns that it covers.
    """

    height: float
    cover: float


@dataclass(frozen=True)
class Storey:
    """What closes a storey above.

    Attributes:
        ceilings: of its rooms, the widest first.
        next_floor: the level over the ceilings' own columns, the floor of a storey above; None
            without one.
        wall_top: height at which walls end, where no ceiling is seen; None when they do not.
    """

    ceilings: tuple[Level, ...] = ()
    next_floor: Level | None = None
    wall_top: float | None = None

    @property
    def ceiling(self) -> float | None:
        """Height of the widest ceiling in the file's units."""
        return self.ceilings[0].height if self.ceilings else None

    @property
    def height(self) -> float | None:
        """Of the storey: its ceiling, else the top of its walls."""
        return self.wall_top if self.ceiling is None else self.ceiling


def find_storey(sample: SurfaceSample, floor: FloorPlane) -> Storey:
    """Ceilings and the storey above, or where the walls end."""
    up = np.asarray(floor.up)
    height = sample.points @ up - floor.height
    rise = max(4 * floor.noise, sample.size / 1000)
    above = height > rise
    if sample.weight[above].sum() < 0.02:
        return Storey()
    span = weighted_quantile(height[above], sample.weight[above], (0.98,))[0]
    if not span > 2 * rise:
        return Storey()
    a, b = plane_axes(up)
    cell = span / _COLUMNS
    i, j = (np.floor(sample.points @ axis / cell).astype(np.int64) for axis in (a, b))
    i, j = i - i.min(), j - j.min()
    shape = (int(i.max()) + 1, int(j.max()) + 1)
    column = np.asarray(i * shape[1] + j)
    facing = sample.flat & (np.abs(sample.normals @ up) > 0.9)
    upright = sample.flat & (np.abs(sample.normals @ up) < 0.3)
    columns = _Columns(column, shape, height, facing, span, rise)
    levels = _find_levels(sample, columns)
    walls = find_wall_yaw(sample, up)[1]
    strong = _strong(sample, columns, levels, upright, walls)
    if not strong:
        top = _wall_top(height, upright, sample.weight, span) if walls >= _WALLS else None
        return Storey(wall_top=top)
    ceilings: list[Level] = []
    covered = np.zeros(columns.count, bool)
    following: Level | None = None
    for level, mine in strong:
        new = float((mine & ~covered).sum() / max(mine.sum(), 1))
        if not ceilings or (new > 0.5 and level.height <= 1.5 * ceilings[0].height):
            ceilings.append(level)
            covered |= mine
        elif new <= 0.5 and following is None and level.height <= 1.6 * ceilings[0].height:
            following = level
    ceilings.sort(key=lambda level: -level.cover)
    return Storey(tuple(ceilings), following)


class _Columns:
    """Which points lie in which column of space."""

    def __init__(
        self,
        column: NDArray[np.int64],
        shape: tuple[int, int],
        height: F64,
        facing: NDArray[np.bool_],
        span: float,
        rise: float,
    ) -> None:
        self.column, self.height, self.facing, self.span = column, height, facing, span
        self.shape, self.count = shape, shape[0] * shape[1]
        self.built = self.holding(height > max(_LOWEST * span, rise))
        self.floored = self.holding(np.abs(height) <= rise)

    def holding(self, points: NDArray[np.bool_]) -> NDArray[np.bool_]:
        """Columns [count] that hold any of the points."""
        found = np.zeros(self.count, bool)
        found[self.column[points]] = True
        return found

    def heart(self, mine: NDArray[np.bool_]) -> NDArray[np.bool_]:
        """Columns that others of the same surface surround; all of them where none is."""
        inner = ndimage.binary_erosion(mine.reshape(self.shape), np.ones((3, 3))).reshape(-1)
        return inner if inner.any() else mine


def _find_levels(sample: SurfaceSample, columns: _Columns) -> list[tuple[Level, NDArray[np.bool_]]]:
    """The heights at which most level surface lies, the lowest first, with their columns."""
    step = columns.span / _BINS
    high = columns.facing & (columns.height > _LOWEST * columns.span)
    high &= columns.height < 3 * columns.span
    if not high.any():
        return []
    bins = np.floor(columns.height[high] / step).astype(np.int64)
    mass = np.bincount(bins, sample.weight[high], int(bins.max()) + 4)
    total = float(mass.sum())
    found: list[tuple[Level, NDArray[np.bool_]]] = []
    built = max(int(columns.built.sum()), 1)
    for _ in range(_MOST):
        wide = np.convolve(mass, np.ones(5), "same")
        best = int(np.argmax(wide))
        if wide[best] < _LEAST_MASS * total:
            break
        near = high & (np.abs(columns.height - (best + 0.5) * step) <= 2.5 * step)
        at = weighted_quantile(columns.height[near], sample.weight[near], (0.5,))[0]
        mine = columns.holding(near) & columns.built
        found.append((Level(at, round(float(mine.sum()) / built, 3)), mine))
        mass[max(best - 4, 0) : best + 5] = 0
    return sorted(found, key=lambda level: level[0].height)


def _strong(
    sample: SurfaceSample,
    columns: _Columns,
    levels: list[tuple[Level, NDArray[np.bool_]]],
    upright: NDArray[np.bool_],
    walls: float,
) -> list[tuple[Level, NDArray[np.bool_]]]:
    """Levels that may be ceilings, or floors of a storey above."""

    def density(low: float, high: float) -> float:
        part = upright & (columns.height >= low) & (columns.height < high)
        return float(sample.weight[part].sum()) / (high - low)

    kept = []
    for level, mine in levels:
        h = level.height
        if level.cover < LEAST_COVER:
            continue
        heart = columns.heart(mine)  # round a plinth the floor is seen beside its rim
        if (heart & columns.floored).sum() < _FLOORED * heart.sum():
            continue
        lower = density(0.15 * h, 0.5 * h)
        if density(0.7 * h, 0.95 * h) < _REACHED * lower:
            continue
        # walls that go on above: the ceiling of a lower storey, or a level of furniture
        open_above = density(1.2 * h, 1.6 * h) <= _REACHED * lower
        if not open_above and level.cover < STOREY_COVER:
            continue
        # without walls at right angles: a round room, or the plinth of a statue
        if walls < _WALLS and not (open_above and level.cover >= STOREY_COVER):
            continue
        kept.append((level, mine))
    widest = max((level.cover for level, _ in kept), default=0.0)
    return [(level, mine) for level, mine in kept if level.cover >= _NEAR * widest]


def _wall_top(height: F64, upright: NDArray[np.bool_], weight: F64, span: float) -> float | None:
    """The height at which the upright surface ends at once, as walls without a ceiling do."""
    step = span / 60
    wall = upright & (height > 0)
    if weight[wall].sum() < 0.15:
        return None
    bins = np.floor(height[wall] / step).astype(np.int64)
    mass = np.bincount(bins[bins < 180], weight[wall][bins < 180], 184)
    lower = float(np.median(mass[3:40]))
    strong = np.flatnonzero(mass >= 0.4 * lower)
    if not lower > 0 or not len(strong):
        return None
    top = int(strong[-1]) + 1
    if top < 20 or mass[top + 1 :].sum() > 0.02 * mass.sum():
        return None
    near = wall & (height <= (top + 1) * step)
    return weighted_quantile(height[near], weight[near], (0.998,))[0]
