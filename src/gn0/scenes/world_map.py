"""A world's own lidar map, laid over what its meshes say: its offset, and whether it fits."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy import fft, ndimage

from gn0.errors import Gn0Error
from gn0.geometry import F64
from gn0.maps.grid import FREE, OCCUPIED, OccupancyGrid
from gn0.maps.ros import load_ros_map

LIDAR_BAND = (0.15, 0.30)  # m above the floor: where the lidars of small robots look
NEAR = 0.15  # m: a wall this near to a map's wall is the same
FITS = 0.6  # of the map's walls: below, it shows another place
_MAPS_MAX = 8
_SIDE_MAX = 2048  # cells: larger maps are laid over in coarser ones
_TURN_GAIN = 0.05  # what a turn must gain over no turn


@dataclass(frozen=True)
class MapFit:
    """How a map lies over a world: turn it about its frame's origin, then shift it.

    Attributes:
        dx, dy: shift [m].
        turns: quarter turns counter-clockwise.
        share: share of the map's occupied cells that then lie within 15 cm of ours.
        plain: the same share for the map as it is.
    """

    dx: float
    dy: float
    turns: int
    share: float
    plain: float

    @property
    def fits(self) -> bool:
        """Whether the map shows this world."""
        return self.share >= FITS

    def told(self) -> str:
        """The fit in words."""
        if not self.fits:
            return f"shows another place: at best {self.share:.0%} of its walls meet ours"
        turn = f", turned by {90 * self.turns}°" if self.turns else ""
        off = math.hypot(self.dx, self.dy)
        how = "agrees" if off < 0.1 and not self.turns else "must be moved to agree"
        return (
            f"{how}: offset ({self.dx:+.2f}, {self.dy:+.2f}) m{turn}, {self.share:.0%} of its "
            f"walls within {100 * NEAR:.0f} cm of ours ({self.plain:.0%} as it is)"
        )


def find_maps(root: Path) -> list[Path]:
    """The ROS map files that lie with a world: in `maps/` or `map/`, at most eight."""
    found = []
    for pattern in ("maps/*.yaml", "maps/*/*.yaml", "map/*.yaml", "*.yaml"):
        for path in sorted(root.glob(pattern)):
            if path.is_file() and path.resolve().is_relative_to(root.resolve()):
                found.append(path)
    return found[:_MAPS_MAX]


def register_maps(root: Path, ours: OccupancyGrid) -> Iterator[tuple[str, MapFit | str]]:
    """Each map with the world: its name, and its fit or why it cannot be read.

    Args:
        root: the world's folder.
        ours: occupancy of the world at a lidar's height.
    """
    for path in find_maps(root):
        name = path.relative_to(root).as_posix()
        try:
            lidar = load_ros_map(path)
        except Gn0Error as error:
            if path.parent != root:  # any YAML may lie beside a world
                yield name, error.what
            continue
        if (lidar.cells == OCCUPIED).any() and (ours.cells == OCCUPIED).any():
            yield name, register_map(lidar, ours)


def register_map(lidar: OccupancyGrid, ours: OccupancyGrid) -> MapFit:
    """The shift and quarter turn that lay a map's walls best on ours.

    Every shift is tried at once, by correlating where walls are (Fourier shift theorem).
    """
    walls = lidar.centres_of(np.argwhere(lidar.cells == OCCUPIED))
    mine = ours.centres_of(np.argwhere(_in_sight(ours)))
    both = np.ptp(np.concatenate([walls, mine]), axis=0).max() + np.ptp(walls, axis=0).max()
    size = max(lidar.resolution, ours.resolution, 2 * both / _SIDE_MAX)
    plain = _share(walls, mine, size)
    best = MapFit(0.0, 0.0, 0, plain, plain)
    for turns in range(4):
        turned = walls @ _turn(turns).T
        dx, dy = _best_shift(turned, mine, size)
        share = _share(turned + np.array((dx, dy)), mine, size)
        gain = _TURN_GAIN if turns and not best.turns else 0.0
        if share > best.share + gain:
            best = MapFit(dx, dy, turns, share, plain)
    return best


def _in_sight(grid: OccupancyGrid) -> NDArray[np.bool_]:
    """Occupied cells that a lidar could see: those beside free ones."""
    free = ndimage.binary_dilation(grid.cells == FREE, np.ones((3, 3)))
    seen = (grid.cells == OCCUPIED) & free
    return seen if seen.any() else grid.cells == OCCUPIED


def _turn(turns: int) -> F64:
    c, s = ((1, 0), (0, 1), (-1, 0), (0, -1))[turns % 4]
    return np.array([[c, -s], [s, c]], np.float64)


def _best_shift(walls: F64, mine: F64, size: float) -> tuple[float, float]:
    a0, b0 = walls.min(axis=0), mine.min(axis=0)
    a, b = _picture(walls - a0, size), _picture(mine - b0, size)
    shape = [fft.next_fast_len(m + n - 1, real=True) for m, n in zip(a.shape, b.shape, strict=True)]
    spectrum = fft.rfft2(b, shape) * np.conj(fft.rfft2(a, shape))
    score = fft.irfft2(spectrum, shape)
    row, col = np.unravel_index(int(np.argmax(score)), score.shape)
    r = row - shape[0] if row >= b.shape[0] else row
    c = col - shape[1] if col >= b.shape[1] else col
    dx, dy = b0 - a0 + np.array((c, r)) * size
    return round(float(dx), 3), round(float(dy), 3)


def _picture(xy: F64, size: float) -> F64:
    """Walls as a soft picture [row y, column x]: half a cell more or less is no miss."""
    rc = np.floor(xy[:, ::-1] / size + 0.5).astype(np.int64) + 3
    out = np.zeros(tuple(rc.max(axis=0) + 4))
    out[rc[:, 0], rc[:, 1]] = 1.0
    return np.asarray(ndimage.gaussian_filter(out, 1.0))


def _share(walls: F64, mine: F64, size: float) -> float:
    """Share of wall points within `NEAR` of ours."""
    from scipy.spatial import cKDTree

    reach = max(NEAR, size)
    distance, _ = cKDTree(mine).query(walls, distance_upper_bound=reach + 1e-9)
    return float(np.isfinite(distance).mean())
