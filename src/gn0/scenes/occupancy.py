"""Occupancy from geometry: what stands in the way of an agent's body, and where the floor is.

A cell is
* occupied when any surface enters it between the band's two heights above the floor;
* unknown when it has no floor below it, lies outside the building, or is a pocket that no agent
  can reach or fit (the hollow of a wall, of a cupboard, of a pillar);
* free otherwise.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from gn0.errors import SceneError
from gn0.geometry import F64
from gn0.maps.grid import FREE, OCCUPIED, UNKNOWN, OccupancyGrid
from gn0.scenes.mesh import SceneMesh
from gn0.scenes.rasterise import mark_faces

BAND = (0.10, 1.50)  # m above the floor: the agent's body
RESOLUTION = 0.05  # m
CELLS_MAX = 64_000_000  # 400 m x 400 m at 5 cm; more means a wrong unit
_NUDGE = 1e-5  # m: a solid that ends on a cell border must not fill the next cell
_UPRIGHT = 0.7  # |n_z| of a surface one can stand on (45°)


def find_floor(mesh: SceneMesh) -> float:
    """Height [m] of the floor: the lowest level that carries a large share of the flat surface.

    Levels are 2 cm bins of area-weighted flat faces; the lowest with at least a third of the
    largest level's area is the floor, its area-weighted mean height the answer.

    Raises:
        SceneError: the mesh has no flat surface.
    """
    up, areas = mesh.normals()[:, 2], mesh.areas()
    flat = up > 0.95
    if areas[flat].sum() < 0.2 * areas[up < -0.95].sum():  # wound the other way round
        flat = np.abs(up) > 0.95
    if not flat.any() or areas[flat].sum() <= 0:
        raise SceneError(
            "the geometry has no level surface that could be a floor",
            remedy="check the up axis of the meshes",
        )
    z = mesh.corners()[flat][:, :, 2].mean(axis=1)
    weight = areas[flat]
    bins = np.floor(z / 0.02).astype(np.int64)
    levels, inverse = np.unique(bins, return_inverse=True)
    area = np.bincount(inverse, weight)
    area = area + np.where(np.diff(levels, append=levels[-1] + 9) == 1, np.append(area[1:], 0), 0)
    pick = levels[np.flatnonzero(area >= area.max() / 3)[0]]
    near = (bins >= pick) & (bins <= pick + 1)
    return float(np.average(z[near], weights=weight[near]))


def build_occupancy(
    mesh: SceneMesh,
    *,
    resolution: float = RESOLUTION,
    band: tuple[float, float] = BAND,
    floor_z: float = 0.0,
    bounds: tuple[float, float, float, float] | None = None,
    floor: SceneMesh | str | None = None,
    margin: int = 4,
    pocket_area: float = 1.0,
    pocket_radius: float = 0.35,
) -> OccupancyGrid:
    """The occupancy grid of a mesh for an agent whose body fills `band` above the floor.

    Args:
        mesh: everything solid, world frame, metres.
        resolution: cell size [m].
        band: (low, high) [m] above `floor_z`; a surface inside it blocks the cell.
        floor_z: height of the floor [m].
        bounds: (x_min, y_min, x_max, y_max) [m] to cover; by default all that is in the band or is
            floor, plus `margin` cells.
        floor: surfaces to stand on; `mesh` itself by default, "everywhere" for a ground plane.
        margin: cells added on each side when `bounds` is not given.
        pocket_area: a free patch smaller than this [m²] is unknown.
        pocket_radius: a free patch in which no disc of this radius [m] fits is unknown.

    Raises:
        SceneError: a setting is out of range, the mesh is not finite, or the extent is absurd.
    """
    low, high = float(band[0]), float(band[1])
    if not (math.isfinite(low) and math.isfinite(high) and 0 <= low < high):
        raise SceneError(
            f"height band {low} to {high} m is empty or below the floor",
            remedy="give two heights above the floor, the lower first, e.g. 0.10 1.50",
        )
    if not (math.isfinite(resolution) and 0.005 <= resolution <= 1.0):
        raise SceneError(f"resolution {resolution} m is not in 0.005..1", remedy="use e.g. 0.05")
    if not np.isfinite(mesh.vertices).all():
        raise SceneError("the mesh has vertices that are not finite", remedy="repair the mesh")
    solid = _nudged(mesh)
    in_band = _touches(solid, floor_z + low, floor_z + high)
    ground = _floor_corners(
        mesh if floor is None or isinstance(floor, str) else floor, floor_z, low
    )
    if bounds is None:
        bounds = _bounds(solid[in_band], ground, resolution, margin)
    origin, shape = _frame(bounds, resolution)
    frame = {"origin": origin, "resolution": resolution, "shape": shape}
    occupied = mark_faces(solid[in_band], band=(floor_z + low, floor_z + high), **frame)  # type: ignore[arg-type]
    if floor == "everywhere":
        supported = np.ones(shape, bool)
    else:
        supported = mark_faces(ground, band=(-np.inf, np.inf), **frame)  # type: ignore[arg-type]
    inside = _inside(supported & ~occupied, resolution, pocket_area, pocket_radius)
    cells = np.full(shape, UNKNOWN, np.uint8)
    cells[inside] = FREE
    cells[occupied] = OCCUPIED
    return OccupancyGrid(cells=cells, resolution=float(resolution), origin=origin)


def _nudged(mesh: SceneMesh) -> F64:
    """Face corners [F, 3, 3] m, each face a hair's breadth behind its own surface."""
    return mesh.corners() - _NUDGE * mesh.normals()[:, None, :]


def _touches(corners: F64, low: float, high: float) -> NDArray[np.bool_]:
    z = corners[:, :, 2]
    return (z.max(axis=1) >= low) & (z.min(axis=1) <= high)


def _floor_corners(mesh: SceneMesh, floor_z: float, low: float) -> F64:
    """Faces one can stand on: level enough, and within a step of the floor."""
    corners = mesh.corners()
    z = corners[:, :, 2] - floor_z
    near = (z.max(axis=1) <= max(low, 0.05)) & (z.min(axis=1) >= -0.15)
    return corners[near & (np.abs(mesh.normals()[:, 2]) >= _UPRIGHT)]


def _bounds(
    solid: F64, ground: F64, resolution: float, margin: int
) -> tuple[float, float, float, float]:
    xy = np.concatenate([solid[:, :, :2].reshape(-1, 2), ground[:, :, :2].reshape(-1, 2)])
    if not len(xy):
        raise SceneError(
            "nothing lies in the height band and there is no floor",
            remedy="check the scale and the floor height of the geometry",
        )
    pad = margin * resolution
    low, high = xy.min(axis=0) - pad, xy.max(axis=0) + pad
    return float(low[0]), float(low[1]), float(high[0]), float(high[1])


def _frame(
    bounds: tuple[float, float, float, float], resolution: float
) -> tuple[tuple[float, float], tuple[int, int]]:
    """Origin and shape of a grid whose cell borders lie on whole multiples of the resolution."""
    x0, y0, x1, y1 = bounds
    if not all(map(math.isfinite, bounds)) or x1 <= x0 or y1 <= y0:
        raise SceneError(f"bounds {bounds} are empty or not finite", remedy="give x_min < x_max")
    col, row = math.floor(x0 / resolution + 1e-6), math.floor(y0 / resolution + 1e-6)
    w = max(math.ceil(x1 / resolution - 1e-6) - col, 1)
    h = max(math.ceil(y1 / resolution - 1e-6) - row, 1)
    if w * h > CELLS_MAX:
        raise SceneError(
            f"the geometry spans {x1 - x0:.0f} x {y1 - y0:.0f} m, too much for {resolution} m",
            remedy="check the unit of the meshes (centimetres read as metres?)",
        )
    return (round(col * resolution, 9), round(row * resolution, 9)), (h, w)


def _inside(
    open_cells: NDArray[np.bool_], resolution: float, pocket_area: float, pocket_radius: float
) -> NDArray[np.bool_]:
    """Open cells that belong to the building: not the outside, and no pockets."""
    from scipy import ndimage  # here, so that a simulator does not load it

    labels, count = ndimage.label(open_cells)
    if not count:
        return open_cells
    rim = np.unique(np.concatenate([labels[0], labels[-1], labels[:, 0], labels[:, -1]]))
    area = np.bincount(labels.ravel(), minlength=count + 1) * resolution**2
    clearance = ndimage.distance_transform_edt(np.pad(open_cells, 1))[1:-1, 1:-1] * resolution
    widest = np.asarray(ndimage.maximum(clearance, labels, np.arange(count + 1)))
    room = (area >= pocket_area) & (widest >= pocket_radius)
    room[0] = False
    indoors = room.copy()
    indoors[rim] = False
    # a scene that is open to its rim (one floor, no walls) has no outside
    keep = indoors if area[indoors].sum() >= 0.05 * area[room].sum() else room
    return keep[labels]
