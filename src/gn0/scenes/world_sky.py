"""What is seen through the openings of an imported world: sky and distant trees.

A world's walls may have holes where its windows are, its doors may stand open to no garden. Rays
from inside tell where one looks into nothing; there, on a box around the building, hangs a painted
view, as in the panes of generated windows.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from gn0.geometry import F32, F64
from gn0.maps.grid import OccupancyGrid
from gn0.scenes.mesh import SceneMesh, join_meshes
from gn0.scenes.procedural.draft import Material
from gn0.scenes.procedural.panel_patterns import PICTURES
from gn0.scenes.rays import RayCaster
from gn0.scenes.rooms import RoomMap
from gn0.scenes.textures import Paint
from gn0.scenes.world_mesh import WorldMeshes
from gn0.seeds import random_stream

_TILE = 0.25  # m
_AWAY = 0.35  # m: between the building and its view
_BELOW, _ABOVE = 2.0, 2.0  # m: how far the view goes below the floor and above the building
_EYES = (0.5, 1.0, 1.5)  # m: heights to look from
_PLACES, _RAYS = 400, 2000
_WIDE, _HIGH = 8.0, 4.0  # m: size of one picture of the view
_FEET = -0.2  # m: height of the picture's lower edge


def close_openings(
    meshes: WorldMeshes, rooms: RoomMap, grid: OccupancyGrid, seed: int
) -> WorldMeshes:
    """The meshes with a painted view wherever one would look out of a room into nothing."""
    cells = np.argwhere(rooms.label >= 0)
    if not len(cells):
        return meshes
    start, way = _lost_rays(meshes.visual, grid.centres_of(cells), seed)
    if not len(start):
        return meshes
    low = meshes.visual.vertices.min(axis=0) - np.array((_AWAY, _AWAY, _BELOW))
    high = meshes.visual.vertices.max(axis=0) + np.array((_AWAY, _AWAY, _ABOVE))
    panels = []
    side, point = _leave_box(start, way, low, high)
    for axis in range(3):
        for end in (0, 1):
            hit = point[side == 2 * axis + end]
            if len(hit):
                panels.append(_tiles(hit, axis, end, low, high, len(meshes.paints)))
    return replace(
        meshes,
        visual=join_meshes([meshes.visual, *panels]),
        paints=[*meshes.paints, Paint((1.0, 1.0, 1.0), _view_picture(seed))],
        sky_paint=len(meshes.paints),
        notes=[*meshes.notes, "one looked out into nothing; sky is hung behind the openings"],
    )


def _lost_rays(mesh: SceneMesh, xy: NDArray[np.floating], seed: int) -> tuple[F64, F64]:
    """Starts and directions [M, 3] of rays from inside that meet no surface."""
    rng = random_stream(seed, "world", "openings")
    places = xy[rng.choice(len(xy), min(len(xy), _PLACES), replace=False)]
    eyes = np.asarray(_EYES)[rng.integers(0, len(_EYES), len(places))]
    way = rng.normal(size=(len(places), _RAYS, 3)) * (1.0, 1.0, 0.5)
    way /= np.linalg.norm(way, axis=2, keepdims=True)
    start = np.repeat(np.column_stack([places, eyes])[:, None], _RAYS, axis=1).reshape(-1, 3)
    flat = way.reshape(-1, 3)
    lost = ~RayCaster(mesh).occluded(start, flat)
    return start[lost], flat[lost]


def _leave_box(start: F64, way: F64, low: F64, high: F64) -> tuple[NDArray[np.int64], F64]:
    """The side (2 axis + upper end) and the point where each ray leaves a box."""
    safe = np.where(np.abs(way) < 1e-12, 1e-12, way)
    t = np.maximum((low - start) / safe, (high - start) / safe)
    axis = np.argmin(t, axis=1)
    rows = np.arange(len(start))
    point = start + t[rows, axis, None] * way
    return 2 * axis + (way[rows, axis] > 0), point


def _tiles(hit: F64, axis: int, end: int, low: F64, high: F64, paint: int) -> SceneMesh:
    """Squares on one side of the box that cover the points and what lies next to them."""
    across, up = [k for k in range(3) if k != axis]
    shape = tuple(int(np.ceil((high[k] - low[k]) / _TILE)) + 1 for k in (across, up))
    index = np.floor((hit[:, [across, up]] - low[[across, up]]) / _TILE).astype(np.int64)
    index = np.clip(index, 0, np.array(shape) - 1)
    mask = np.zeros(shape, bool)
    mask[index[:, 0], index[:, 1]] = True
    # rays are few: what lies between two of them, and round the last, is seen, too
    mask = ndimage.binary_closing(np.pad(mask, 4), np.ones((3, 3)), iterations=2)[4:-4, 4:-4]
    mask = ndimage.binary_dilation(mask, np.ones((3, 3)))
    a, b = np.nonzero(mask)
    corner = np.stack(
        [np.column_stack([a + i, b + j]) for i, j in ((0, 0), (1, 0), (1, 1), (0, 1))]
    )
    flat = corner.transpose(1, 0, 2).reshape(-1, 2)
    nodes, inverse = np.unique(flat, axis=0, return_inverse=True)
    vertices = np.empty((len(nodes), 3))
    vertices[:, axis] = (low, high)[end][axis]
    vertices[:, across] = low[across] + nodes[:, 0] * _TILE
    vertices[:, up] = low[up] + nodes[:, 1] * _TILE
    quad = inverse.reshape(-1, 4)
    faces = np.concatenate([quad[:, [0, 1, 2]], quad[:, [0, 2, 3]]])
    inward = 1.0 if end == 0 else -1.0
    p = vertices[faces[0]]
    if np.cross(p[1] - p[0], p[2] - p[0])[axis] * inward < 0:
        faces = faces[:, ::-1]
    faces = np.ascontiguousarray(faces, np.int32)
    return SceneMesh(
        vertices=vertices,
        faces=faces,
        uv=_view_uv(vertices, across, axis)[faces],
        material=np.full(len(faces), paint, np.int32),
        instance=np.full(len(faces), -1, np.int32),
    )


def _view_uv(vertices: F64, across: int, axis: int) -> F32:
    """Where in the picture a vertex lies: to and fro along the side, so that no seam shows."""
    u = np.abs((vertices[:, across] / _WIDE) % 2.0 - 1.0)
    if axis == 2:  # the lid and the ground below: the zenith, or grass
        v = np.where(vertices[:, 2] > 0, 0.98, 0.02)
    else:
        v = (vertices[:, 2] - _FEET) / _HIGH
    return np.column_stack([np.clip(u, 0.01, 0.99), np.clip(v, 0.02, 0.98)]).astype(np.float32)


def _view_picture(seed: int) -> F32:
    """The view as linear light [128, 256, 3], row 0 on top: sky, far roofs, trees."""
    h, w = 128, 256
    u, v = np.meshgrid((np.arange(w) + 0.5) / w, 1 - (np.arange(h) + 0.5) / h)
    view = Material(
        name="view", pattern="sky", colour=(0.55, 0.7, 0.95), colour2=(0.25, 0.33, 0.22),
        scale=_WIDE / _HIGH, seed=seed,
    )  # fmt: skip
    picture = PICTURES["sky"](view, u.ravel(), v.ravel(), 1 / w)
    return np.ascontiguousarray(np.clip(picture, 0, 1).reshape(h, w, 3), np.float32)
