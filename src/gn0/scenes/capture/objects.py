"""Things on the floor of a capture, by shape alone: clumps of voxels and how large they are.

Nobody has said what they are. A category such as "table-like object" states a shape, and every
label is marked as heuristic.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from gn0.maps.grid import FREE, OCCUPIED, OccupancyGrid
from gn0.scenes.boxes import upright_box
from gn0.scenes.capture.extinction import VoxelFrame
from gn0.scenes.capture.splat_occupancy import WALL_TOP, CaptureOccupancy
from gn0.scenes.rooms import RoomMap, assign_rooms, build_rooms
from gn0.scenes.scene import SceneObject

STEP = 0.20  # m: neighbouring cells of one thing differ by less in height
LEAST_AREA = 0.03  # m²
LEAST_SIDE = 0.25  # m, longest
MOST_AREA = 12.0  # m²
WALLS_LEAST = 4.0  # m of wall cells: fewer make no rooms
_SHARE = 0.30  # of upright surface along two headings: less is no building


@dataclass(frozen=True, eq=False)
class CaptureLabels:
    """Heuristic objects and rooms."""

    objects: tuple[SceneObject, ...]
    rooms: RoomMap


def find_things(
    occupancy: CaptureOccupancy, band: tuple[float, float], walls: float
) -> CaptureLabels:
    """Objects and, where there are walls, rooms.

    Args:
        occupancy: the capture's map and voxels.
        band: of the agent's body [m].
        walls: share of the upright surface along two headings at right angles.
    """
    grid = occupancy.grid
    heights, filled = _heights(occupancy.solid, occupancy.frame, band[0])
    wall = heights >= WALL_TOP - occupancy.frame.size[2]
    things = _clumps(grid, heights, filled, wall)
    rooms = RoomMap((), np.full(grid.shape, -1, np.int32))
    if wall.sum() * grid.resolution >= WALLS_LEAST and walls >= _SHARE:
        shell = OccupancyGrid(
            np.where(wall, OCCUPIED, FREE).astype(np.uint8), grid.resolution, grid.origin
        )
        inside = _indoors(grid, wall)
        rooms = build_rooms(shell, inside, things)
        things = assign_rooms(things, rooms, grid)
    return CaptureLabels(things, rooms)


def _heights(
    solid: NDArray[np.bool_], frame: VoxelFrame, low: float
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Top [m] of what stands on each cell, 0 for bare floor, and how full it is below the top."""
    layers = frame.shape[0]
    first = round((low - frame.origin[2]) / frame.size[2])
    above = solid[first:]
    any_ = above.any(axis=0)
    top = layers - first - np.argmax(above[::-1], axis=0)  # voxels above the band's low end
    heights = np.where(any_, low + top * frame.size[2], 0.0)
    filled = np.where(any_, above.sum(axis=0) / np.maximum(top, 1), 0.0)
    return heights, filled


def _clumps(
    grid: OccupancyGrid,
    heights: NDArray[np.float64],
    filled: NDArray[np.float64],
    wall: NDArray[np.bool_],
) -> tuple[SceneObject, ...]:
    """One object per clump of cells of like height that stands beside walkable ground."""
    cell = grid.resolution
    body = (heights > 0) & ~wall
    labels = _join(heights, body)
    near = ndimage.binary_dilation(grid.cells == FREE, iterations=round(0.3 / cell))
    found: list[tuple[str, NDArray[np.intp], float]] = []
    for index, span in enumerate(ndimage.find_objects(labels), start=1):
        if span is None:
            continue
        mask = labels[span] == index
        area = float(mask.sum()) * cell**2
        if not LEAST_AREA <= area <= MOST_AREA or not near[span][mask].any():
            continue
        cells = np.argwhere(mask) + np.array([span[0].start, span[1].start])
        top = float(np.quantile(heights[span][mask], 0.9))
        found.append((_category(mask, top, filled[span], cell), cells, top))
    objects: list[SceneObject] = []
    counts: dict[str, int] = {}
    for category, cells, top in found:
        centres = grid.centres_of(cells)
        half = cell / 2
        spread = np.concatenate(
            [centres + np.array([dx, dy]) for dx in (-half, half) for dy in (-half, half)]
        )
        points = np.column_stack([spread, np.where(np.arange(len(spread)) % 2, top, 0.0)])
        box = upright_box(points, 0.0)
        if max(box.size[:2]) < LEAST_SIDE:
            continue
        counts[category] = counts.get(category, 0) + 1
        name = category.replace(" ", "-")
        objects.append(SceneObject(id=f"{name}-{counts[category]}", category=category, box=box))
    return tuple(objects)


def _join(heights: NDArray[np.float64], body: NDArray[np.bool_]) -> NDArray[np.int32]:
    """Labels of cells that hang together by steps below `STEP` (8 neighbours)."""
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    h, w = body.shape
    number = np.full((h, w), -1, np.int64)
    number[body] = np.arange(int(body.sum()))
    rows: list[NDArray[np.int64]] = []
    cols: list[NDArray[np.int64]] = []
    for dr, dc in ((0, 1), (1, 0), (1, 1), (1, -1)):
        r = slice(0, h - dr)
        c = slice(0, w - dc) if dc >= 0 else slice(1, w)
        r2 = slice(dr, h)
        c2 = slice(dc, w) if dc >= 0 else slice(0, w - 1)
        joined = body[r, c] & body[r2, c2] & (np.abs(heights[r, c] - heights[r2, c2]) < STEP)
        rows.append(number[r, c][joined])
        cols.append(number[r2, c2][joined])
    count = int(body.sum())
    labels = np.zeros((h, w), np.int32)
    if count:
        a, b = np.concatenate(rows), np.concatenate(cols)
        graph = coo_array((np.ones(len(a), bool), (a, b)), shape=(count, count))
        labels[body] = connected_components(graph, directed=False)[1] + 1
    return labels


def _category(mask: NDArray[np.bool_], top: float, filled: NDArray[np.float64], cell: float) -> str:
    """A shape in words, from the height, the footprint and how open its sides are."""
    sides = sorted(s * cell for s in mask.shape)
    area = float(mask.sum()) * cell**2
    # scans see shells: what tells a table from a chest is whether its sides reach the floor
    rim = mask & ~ndimage.binary_erosion(np.pad(mask, 1))[1:-1, 1:-1]
    hollow = float(filled[rim].mean()) < 0.5
    if top <= 0.35:
        return "low object"
    if top <= 0.75 and sides[0] >= 1.2 and sides[1] >= 1.7:
        return "bed-like object"
    if top <= 0.95 and sides[1] >= 1.3 and sides[0] >= 0.6 and not hollow:
        return "sofa-like object"
    if 0.35 < top <= 1.1 and hollow and area >= 0.15:
        return "table-like object"
    if top <= 1.0 and sides[1] <= 0.9:
        return "seat-sized object"
    if sides[1] <= 0.6:
        return "tall narrow object"
    return "cupboard-like object"


def _indoors(grid: OccupancyGrid, wall: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Cells with floor or furniture, not wall, that hang together with walkable ground."""
    inside = (grid.cells != 2) & ~wall
    labels, _ = ndimage.label(inside)
    reached = np.unique(labels[grid.cells == FREE])
    keep = np.zeros(int(labels.max()) + 1, bool)
    keep[reached] = True
    keep[0] = False
    return np.asarray(keep[labels])
