"""Light for imported worlds: their textures carry none, and their roofs are often left off.

The world's own point and spot lights become warm lamps, its windows daylight; rooms left without a
lamp get one at the ceiling. Light is then baked as for generated scenes.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from gn0.gaussians.film import encode_srgb
from gn0.geometry import F32
from gn0.maps.grid import OccupancyGrid
from gn0.progress import Progress, no_progress
from gn0.scenes.bake import BakeSettings, bake_light
from gn0.scenes.mesh import SceneMesh, join_meshes
from gn0.scenes.procedural.draft import Lamp
from gn0.scenes.rays import RayCaster
from gn0.scenes.rooms import RoomMap
from gn0.scenes.scene import SceneObject
from gn0.scenes.sdf import SdfLight
from gn0.scenes.shading import Shader, SurfaceSample
from gn0.scenes.textures import Paint, TextureAlbedo
from gn0.scenes.tone import BakedShader, choose_exposure
from gn0.scenes.world_mesh import WorldMeshes
from gn0.seeds import random_stream

_ALBEDO_MAX = 0.75  # white paint; textures drawn at 1.0 would never lose light
_WARM = np.array((1.0, 0.80, 0.58))
_DAY = np.array((0.92, 1.0, 1.12))
_LAMP_POWER = 3.2  # radiance × area [m²] of a lamp whose SDF colour is white, per m of height²
_DAYLIGHT = 5.0  # radiance of a window
_WINDOW_GLOW = 1.0  # radiance of the pane as seen, times its texture
_PASSING = {"window", "lamp", "chandelier", "curtain", "light"}  # do not stop light


class ShaderFlat:
    """Textures as they are: irradiance 1 everywhere."""

    def __init__(self, mesh: SceneMesh, albedo: TextureAlbedo) -> None:
        self._albedo = albedo
        self._normals = mesh.normals().astype(np.float32)

    def shade(self, face: NDArray[np.integer], bary: NDArray[np.floating]) -> SurfaceSample:
        """Appearance at face index [M] and barycentric coordinates [M, 3]."""
        albedo = self._albedo.albedo(face, bary)
        return SurfaceSample(
            albedo=albedo,
            irradiance=np.ones_like(albedo),
            colour=encode_srgb(albedo),
            normal=self._normals[face],
        )


@dataclass(frozen=True, eq=False)
class WorldSurface:
    """Albedo from textures; window panes and lampshades glow."""

    albedo: TextureAlbedo
    glow: F32  # [F] radiance per unit of texture

    def reflect(
        self, face: NDArray[np.integer], bary: NDArray[np.floating]
    ) -> tuple[NDArray[np.floating], NDArray[np.floating]]:
        """Linear albedo [M, 3] and emitted radiance [M, 3]."""
        colour = self.albedo.albedo(face, bary)
        return np.minimum(colour, np.float32(_ALBEDO_MAX)), colour * self.glow[face][:, None]


def close_ceiling(meshes: WorldMeshes, rooms: RoomMap, grid: OccupancyGrid) -> WorldMeshes:
    """The meshes with a plain ceiling over rooms that are open to the sky, where walls end.

    Robots do not look up, so makers of worlds leave roofs off; light and views need one.
    """
    inside = rooms.label >= 0
    cells = np.argwhere(inside)
    if not len(cells):
        return meshes
    caster = RayCaster(meshes.visual)
    xy = grid.centres_of(cells[:: max(1, len(cells) // 2000)])
    up = np.tile((0.0, 0.0, 1.0), (len(xy), 1))
    open_above = ~caster.occluded(np.column_stack([xy, np.full(len(xy), 1.9)]), up)
    if open_above.mean() < 0.5:
        return meshes
    height = _wall_top(caster, xy[:: max(1, len(xy) // 200)], meshes)
    over_walls = ndimage.binary_fill_holes(
        ndimage.binary_dilation(inside, iterations=max(1, round(0.25 / grid.resolution)))
    )
    panel = level_plate(over_walls, grid, height, len(meshes.paints))
    return replace(
        meshes,
        visual=join_meshes([meshes.visual, panel]),
        paints=[*meshes.paints, Paint((0.78, 0.77, 0.74))],
        notes=[*meshes.notes, "the roof was open; a plain ceiling is added"],
    )


def drop_outside(meshes: WorldMeshes, seed: int) -> WorldMeshes:
    """The meshes without the building's outer faces: those from which every ray escapes."""
    mesh = meshes.visual
    caster = RayCaster(mesh)
    normal = mesh.normals()
    middle = mesh.corners().mean(axis=1) + 1e-3 * normal
    rays = random_stream(seed, "world", "outside").normal(size=(12, 3))
    rays /= np.linalg.norm(rays, axis=1, keepdims=True)
    shell = np.flatnonzero(mesh.instance < 0)
    free = np.ones(len(shell), bool)
    for ray in rays:
        side = np.sign(normal[shell] @ ray)[:, None]
        free &= ~caster.occluded(middle[shell], np.where(side == 0, 1, side) * ray)
    keep = np.ones(len(mesh), bool)
    keep[shell[free]] = False
    return replace(meshes, visual=mesh.select(keep))


def light_world(
    meshes: WorldMeshes,
    albedo: TextureAlbedo,
    lights: list[SdfLight],
    rooms: RoomMap,
    grid: OccupancyGrid,
    objects: tuple[SceneObject, ...],
    *,
    style: str = "home",
    seed: int = 0,
    progress: Progress = no_progress,
) -> Shader:
    """A shader for the world's visual mesh: "home" is lit, "flat" shows the textures."""
    mesh = meshes.visual
    if style == "flat":
        return ShaderFlat(mesh, albedo)
    kind = np.array([*meshes.categories, ""])[mesh.instance]
    glow = np.where(kind == "window", _WINDOW_GLOW, 0.0) + np.where(kind == "lamp", 0.8, 0.0)
    outside = mesh.material == meshes.sky_paint
    glow[outside] = _WINDOW_GLOW
    surface = WorldSurface(albedo, glow.astype(np.float32))
    top = _ceiling_over(mesh)
    lamps = [
        *_lamps_from_sdf(lights, top),
        *_daylight(objects, rooms, grid),
    ]
    lamps += _lamps_for_dark_rooms(lamps, rooms, grid, top)
    # halls have more wall than homes, and no small shadows on it
    fine = float(np.clip(math.sqrt(mesh.areas().sum() / 300_000), 0.06, 0.20))
    coarse = float(np.clip(2.4 * fine, 0.15, 0.40))
    field = bake_light(
        mesh,
        surface,
        lamps,
        settings=BakeSettings(coarse=coarse, fine=fine, rays=64, samples=9, bounces=4),
        opaque=~np.isin(kind, sorted(_PASSING)) & ~outside,
        seed=seed,
        progress=progress,
    )
    return BakedShader(mesh=mesh, surface=surface, light=field, tone=choose_exposure(field))


def _wall_top(caster: RayCaster, xy: NDArray[np.floating], meshes: WorldMeshes) -> float:
    """The greatest height [m] at which nearly every level ray from the inside meets a wall."""
    around = np.linspace(0, 2 * math.pi, 24, endpoint=False)
    rays = np.tile(np.column_stack([np.cos(around), np.sin(around), 0 * around]), (len(xy), 1))
    highest = min(float(meshes.visual.vertices[:, 2].max()), 12.0)
    for z in np.arange(highest - 0.02, 2.2, -0.05):  # an odd start: not level with window frames
        start = np.repeat(np.column_stack([xy, np.full(len(xy), z)]), len(around), axis=0)
        if caster.occluded(start, rays).mean() >= 0.985:
            return float(z)
    return highest


def level_plate(inside: NDArray[np.bool_], grid: OccupancyGrid, z: float, paint: int) -> SceneMesh:
    """A level plate at height `z` [m] that faces down over the cells inside, in few rectangles."""
    rows = [tuple(np.flatnonzero(np.diff(np.pad(row, 1).astype(np.int8)))) for row in inside]
    size, (x0, y0) = grid.resolution, grid.origin
    corners = []
    start = 0
    for row in range(1, len(rows) + 1):
        if row < len(rows) and rows[row] == rows[start]:
            continue
        for a, b in zip(rows[start][::2], rows[start][1::2], strict=True):
            x, y = x0 + a * size, y0 + start * size
            corners.append((x, y, x0 + b * size, y0 + row * size))
        start = row
    box = np.array(corners)
    vertices = np.stack(
        [box[:, [0, 1]], box[:, [0, 3]], box[:, [2, 3]], box[:, [2, 1]]], axis=1
    ).reshape(-1, 2)
    first = 4 * np.arange(len(box))[:, None]
    faces = np.concatenate([first + np.array((0, 1, 2)), first + np.array((0, 2, 3))]).astype(
        np.int32
    )
    n = len(faces)
    return SceneMesh(
        vertices=np.column_stack([vertices, np.full(len(vertices), z)]),
        faces=faces,
        uv=np.zeros((n, 3, 2), np.float32),
        material=np.full(n, paint, np.int32),
        instance=np.full(n, -1, np.int32),
    )


def _ceiling_over(mesh: SceneMesh) -> float:
    """Height [m] of the largest surface that faces down above 1.8 m."""
    z = mesh.corners()[:, :, 2].mean(axis=1)
    down = (mesh.normals()[:, 2] < -0.9) & (z > 1.8) & (mesh.instance < 0)
    if not down.any():
        return float(mesh.vertices[:, 2].max())
    level = np.round(z[down] / 0.05).astype(np.int64)
    heights, inverse = np.unique(level, return_inverse=True)
    return float(heights[np.argmax(np.bincount(inverse, mesh.areas()[down]))] * 0.05)


def _sphere(centre: tuple[float, float, float], power: NDArray[np.floating]) -> Lamp:
    diameter = 0.24
    r, g, b = (float(v) for v in power / (math.pi * diameter**2 / 4))
    return Lamp(centre=centre, size=(diameter, diameter), shape="sphere", colour=(r, g, b))


def _lamps_from_sdf(lights: list[SdfLight], top: float) -> list[Lamp]:
    lamps = []
    for light in lights:
        if light.kind == "directional":
            continue  # the sun does not come through the ceiling; windows carry daylight
        x, y, z = light.position
        z = min(z, top - 0.15)
        power = _LAMP_POWER * (max(z, 1.0) / 2.2) ** 2 * np.asarray(light.colour) * _WARM
        lamps.append(_sphere((x, y, z), power))
    return lamps


def _daylight(objects: tuple[SceneObject, ...], rooms: RoomMap, grid: OccupancyGrid) -> list[Lamp]:
    """One window-shaped lamp just inside each window."""
    lamps = []
    for thing in objects:
        if thing.category != "window" or min(thing.box.size) > 0.6:
            continue
        sx, sy, sz = thing.box.size
        thin_x = sx < sy
        angle = thing.box.yaw + (0.0 if thin_x else math.pi / 2)
        across = np.array((math.cos(angle), math.sin(angle)))
        centre = np.asarray(thing.box.centre)
        deep = (sx if thin_x else sy) / 2
        for sign in (1.0, -1.0):
            probe = centre[:2] + sign * (deep + 0.4) * across
            row, col = grid.cell_of(float(probe[0]), float(probe[1]))
            if grid.contains(row, col) and rooms.label[row, col] >= 0:
                x, y = centre[:2] + sign * (deep + 0.03) * across
                r, g, b = (float(v) for v in _DAYLIGHT * _DAY)
                lamps.append(
                    Lamp(
                        centre=(float(x), float(y), float(centre[2])),
                        size=(0.9 * (sy if thin_x else sx), 0.9 * sz),
                        shape="window",
                        colour=(r, g, b),
                        direction=(float(sign * across[0]), float(sign * across[1]), 0.0),
                    )
                )
                break
    return lamps


def _lamps_for_dark_rooms(
    lamps: list[Lamp], rooms: RoomMap, grid: OccupancyGrid, top: float
) -> list[Lamp]:
    """Ceiling lamps for every 5 m of a room farther than about 3 m from any other lamp."""
    have = [lamp.centre[:2] for lamp in lamps if lamp.shape != "window"]
    added: list[Lamp] = []
    points = grid.centres_of(np.argwhere(rooms.label >= 0))[::29]
    while len(points) and len(added) < 64:
        if have:
            gap = points[:, None, :] - np.asarray(have)[None]
            distance = np.sqrt((gap**2).sum(axis=2)).min(axis=1)
        else:
            middle = points.mean(axis=0)
            distance = 10.0 - np.sqrt(((points - middle) ** 2).sum(axis=1)) * 0.01
        worst = int(np.argmax(distance))
        if distance[worst] < max(3.2, 1.2 * top):
            break
        x, y = (float(v) for v in points[worst])
        # not in the corner that is farthest, but in the middle of what is dark round it
        near = np.hypot(points[:, 0] - x, points[:, 1] - y) < 2.5
        x, y = (float(v) for v in points[near].mean(axis=0))
        r, g, b = (float(v) for v in 14.0 * (top / 2.6) ** 2 * _WARM)
        added.append(
            Lamp(centre=(x, y, top - 0.03), size=(0.45, 0.45), shape="rectangle", colour=(r, g, b))
        )
        have.append((x, y))
        have.append((float(points[worst][0]), float(points[worst][1])))
    return added
