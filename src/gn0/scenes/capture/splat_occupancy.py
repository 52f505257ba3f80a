"""Where one can walk in a capture whose floor is level at z = 0, from its Gaussians alone."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from gn0.errors import SceneError
from gn0.gaussians.cloud import GaussianCloud
from gn0.geometry import F32
from gn0.maps.grid import FREE, OCCUPIED, UNKNOWN, OccupancyGrid
from gn0.progress import Progress, no_progress
from gn0.scenes.capture.disc_facing import disc_normals
from gn0.scenes.capture.enclosure import find_inside
from gn0.scenes.capture.extinction import SOLID, VoxelFrame, measure_extinction, solid_enough
from gn0.scenes.capture.surface_smoothing import smooth_surfaces

COMPONENT = 30  # voxels: smaller clumps float
FLOOR_DEPTH = 0.15  # m below z = 0 that still count as floor
HOLE = 0.30  # m: holes in the floor up to twice this wide are taken for scanning gaps
WALL_TOP = 1.85  # m: what reaches this is taken for a wall (or a wardrobe)
NECK = 0.10  # m: half the width of the narrowest way that the flood takes
GROUND_MARGIN = 2.0  # m of assumed ground round what was captured
SEED_CLEARANCE = 0.25  # m: the seed's region must let a disc of this radius pass
_ABOVE = 0.50  # m above the band that voxels reach, so that what hangs down is held by something
_MARGIN = 4  # cells round the matter
_LEVEL = 0.7  # |n_z| of a surface one can stand on (45°)


@dataclass(frozen=True, eq=False)
class CaptureOccupancy:
    """The map of a capture and how it came about.

    Attributes:
        grid: free where the seed's open floor reaches, occupied where matter is, else unknown.
        seed: (x, y) [m] from which the floor was flooded.
        left_out: open floor [m²] that the seed does not reach.
        outside: open floor [m²] outside the walls, reached or not; 0 where nothing is enclosed.
        open_floor: all open floor [m²].
        seed_outside: whether the seed lies outside walls that enclose something.
        solid: voxels that hold matter, small clumps removed [layers, rows, columns].
        frame: frame of the voxels.
        floating: voxels removed as small clumps.
    """

    grid: OccupancyGrid
    seed: tuple[float, float]
    left_out: float
    outside: float
    open_floor: float
    seed_outside: bool
    solid: NDArray[np.bool_]
    frame: VoxelFrame
    floating: int


def build_capture_occupancy(
    cloud: GaussianCloud,
    *,
    resolution: float,
    band: tuple[float, float],
    noise: float = 0.0,
    seed: tuple[float, float] | None = None,
    ground: bool = False,
    progress: Progress = no_progress,
) -> CaptureOccupancy:
    """Occupancy of an agent's body band.

    Args:
        cloud: the Gaussians, metres, +z up, floor at z = 0.
        resolution: cell size [m].
        band: (low, high) [m] above the floor: what blocks.
        noise: standard deviation [m] of the points of a surface about it, as the floor shows it.
        seed: (x, y) [m] on open floor; by default the roomiest place of the largest open region.
        ground: the floor is assumed to be everywhere, seen or not.
        progress: progress sink.

    Raises:
        SceneError: there is nothing to stand on, or the seed is not on open floor.
    """
    progress("finding what is solid", 0, 3)
    cloud = replace(cloud, means=smooth_surfaces(cloud, noise))
    progress("finding what is solid", 1, 3)
    frame = voxel_frame(cloud, resolution, band, margin=GROUND_MARGIN if ground else 0.0)
    dense = measure_extinction(cloud, frame) > SOLID
    progress("finding what is solid", 2, 3)
    solid = drop_small(dense, COMPONENT)
    first = round((band[0] - frame.origin[2]) / frame.size[2])
    last = first + round((band[1] - band[0]) / frame.size[2])
    occupied = solid[first:last].any(axis=0)
    floor = np.ones_like(occupied) if ground else find_floor_cells(cloud, frame, band[0])
    open_ = np.asarray(floor & ~occupied)
    grid = OccupancyGrid(
        cells=np.where(occupied, OCCUPIED, UNKNOWN).astype(np.uint8),
        resolution=resolution,
        origin=(frame.origin[0], frame.origin[1]),
    )
    head = np.asarray(solid[round((WALL_TOP - frame.origin[2]) / frame.size[2]) - 1 :].any(axis=0))
    progress("finding what is solid", 3, 3)
    found = find_inside(head, open_, resolution)
    # nobody scans a flat from its garden: the flood starts within walls where there are any
    place = _seed_cell(grid, open_, seed, within=open_ if found is None else found[0])
    reached = flood(open_, place, resolution)
    cells = grid.cells.copy()
    cells[reached] = FREE
    return CaptureOccupancy(
        grid=grid.with_cells(cells),
        seed=grid.centre_of(*place) if seed is None else (float(seed[0]), float(seed[1])),
        left_out=float(_roomy(open_ & ~reached, resolution).sum()) * resolution**2,
        outside=0.0 if found is None else float(found[1].sum()) * resolution**2,
        open_floor=float(open_.sum()) * resolution**2,
        seed_outside=found is not None and bool(found[1][place]),
        solid=solid,
        frame=frame,
        floating=int(dense.sum() - solid.sum()),
    )


def find_floor_cells(
    cloud: GaussianCloud, frame: VoxelFrame, below_band: float
) -> NDArray[np.bool_]:
    """Cells [rows, columns] with a level surface between `FLOOR_DEPTH` under z = 0 and the band.

    Gaps that a disc of radius `HOLE` cannot enter are taken for scanning gaps and closed.
    """
    normal, flat = disc_normals(cloud)
    level = ~flat | (np.abs(normal[:, 2]) >= _LEVEL)
    near = np.abs(cloud.means[:, 2] + 0.5 * (FLOOR_DEPTH - below_band)) <= 1.0
    slab = VoxelFrame(
        origin=(frame.origin[0], frame.origin[1], -FLOOR_DEPTH),
        size=(frame.size[0], frame.size[1], FLOOR_DEPTH + below_band),
        shape=(1, *frame.shape[1:]),
    )
    seen = measure_extinction(cloud.select(np.flatnonzero(level & near)), slab)[0] > SOLID
    return _close_holes(seen, round(HOLE / frame.size[0]))


def flood(open_: NDArray[np.bool_], place: tuple[int, int], resolution: float) -> NDArray[np.bool_]:
    """Open cells that hang together with a place by ways at least 2 · `NECK` wide.

    Narrower leaks, where a scan shows a wall with a slit, do not let the hollow behind it in.
    Nothing is lost to an agent wider than that: corners are given back.
    """
    reach = NECK / resolution
    clearance = ndimage.distance_transform_edt(np.pad(open_, 1))[1:-1, 1:-1]
    labels, _ = ndimage.label(clearance > reach)
    if not labels[place]:
        labels, _ = ndimage.label(open_)
        return np.asarray(labels == labels[place])
    core = labels == labels[place]
    near = open_ & (ndimage.distance_transform_edt(~core) <= reach + 1.0)
    labels, _ = ndimage.label(near)
    return np.asarray(labels == labels[place])


def voxel_frame(
    cloud: GaussianCloud, resolution: float, band: tuple[float, float], *, margin: float = 0.0
) -> VoxelFrame:
    """Voxels over the capture: cells of the map by layers that end exactly at the band's ends."""
    low, high = main_extent(cloud)
    rim = _MARGIN + round(margin / resolution)
    x0, y0 = (math.floor(v / resolution + 1e-6) - rim for v in low[:2])
    x1, y1 = (math.ceil(v / resolution - 1e-6) + rim for v in high[:2])
    layers = max(1, round((band[1] - band[0]) / resolution))
    height = (band[1] - band[0]) / layers
    below = math.ceil((band[0] + FLOOR_DEPTH) / height - 1e-9)
    above = math.ceil(_ABOVE / height)
    return VoxelFrame(
        origin=(round(x0 * resolution, 9), round(y0 * resolution, 9), band[0] - below * height),
        size=(resolution, resolution, height),
        shape=(below + layers + above, max(y1 - y0, 1), max(x1 - x0, 1)),
    )


def main_extent(cloud: GaussianCloud) -> tuple[F32, F32]:
    """Lowest and highest corner [3] m of what was captured, without its far background.

    The box of the middle 98 % on each axis, a quarter larger on each side, cut to what is there.
    """
    points = cloud.means[solid_enough(cloud)]
    if not len(points):
        raise SceneError(
            "no splat of the capture is solid: all are faint, huge or not finite",
            remedy="check the scale, or export the splats again",
        )
    low, high = np.quantile(points, (0.01, 0.99), axis=0)
    spare = 0.25 * (high - low) + 0.25
    return (
        np.maximum(points.min(axis=0), low - spare),
        np.minimum(points.max(axis=0), high + spare),
    )


def drop_small(dense: NDArray[np.bool_], least: int) -> NDArray[np.bool_]:
    """Voxels of clumps (26-connected) of at least so many voxels."""
    labels, count = ndimage.label(dense, structure=np.ones((3, 3, 3)))
    size = np.bincount(labels.ravel(), minlength=count + 1)
    keep = size >= least
    keep[0] = False
    return np.asarray(keep[labels])


def _close_holes(floor: NDArray[np.bool_], reach: int) -> NDArray[np.bool_]:
    """The floor with gaps of up to twice `reach` cells closed."""
    if reach < 1 or not floor.any():
        return floor
    near = ndimage.distance_transform_edt(~np.pad(floor, reach)) <= reach
    closed = ndimage.distance_transform_edt(near) > reach
    return np.asarray(floor | closed[reach:-reach, reach:-reach])


def _roomy(open_: NDArray[np.bool_], resolution: float) -> NDArray[np.bool_]:
    """Open cells of regions in which a disc of `SEED_CLEARANCE` fits."""
    labels, count = ndimage.label(open_)
    clearance = ndimage.distance_transform_edt(np.pad(open_, 1))[1:-1, 1:-1] * resolution
    widest = np.asarray(ndimage.maximum(clearance, labels, np.arange(count + 1)))
    fits = widest >= SEED_CLEARANCE
    fits[0] = False
    return np.asarray(fits[labels])


def _seed_cell(
    grid: OccupancyGrid,
    open_: NDArray[np.bool_],
    seed: tuple[float, float] | None,
    *,
    within: NDArray[np.bool_],
) -> tuple[int, int]:
    """The cell to flood from: the one given, or the roomiest `within` the largest region there.

    Raises:
        SceneError: no open floor, or the seed given is not on it.
    """
    if not open_.any():
        raise SceneError(
            "the capture has no open floor at the agent's height",
            remedy="give what you know: --scale or --scale-from, --up, --height-band LOW HIGH for "
            "a lower body; --floor HEIGHT assumes a flat floor at that height",
        )
    if seed is not None:
        row, col = grid.cell_of(*seed)
        if not (grid.contains(row, col) and open_[row, col]):
            x0, y0, x1, y1 = grid.bounds
            raise SceneError(
                f"the seed point ({seed[0]:g}, {seed[1]:g}) m is not on open floor",
                remedy=f"give a point of the scene frame (x {x0:.1f}..{x1:.1f}, y {y0:.1f}.."
                f"{y1:.1f} m) on bare floor, or leave --seed-point out",
            )
        return row, col
    clearance = ndimage.distance_transform_edt(np.pad(open_, 1))[1:-1, 1:-1] * grid.resolution
    wide = within & (clearance >= SEED_CLEARANCE)
    labels, count = ndimage.label(wide if wide.any() else within)
    largest = int(np.argmax(np.bincount(labels.ravel(), minlength=count + 1)[1:])) + 1
    best = np.where(labels == largest, clearance, -1.0)
    r, c = np.unravel_index(int(np.argmax(best)), best.shape)
    return int(r), int(c)
