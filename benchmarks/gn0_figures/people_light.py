"""The light on a grey person, traced: what the gains of `gn0.avatars.light` are judged by."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.ndimage import distance_transform_edt

from gn0.gaussians.cloud import GaussianCloud
from gn0.geometry import F64
from gn0.maps.grid import OccupancyGrid
from gn0.scenes.occupancy import build_occupancy
from gn0.scenes.procedural.draft import Lamp, SceneDraft
from gn0.scenes.procedural.finish import cover_outlined, floor_area, light_draft
from gn0.scenes.procedural.kinds import KINDS, KindName
from gn0.scenes.procedural.surface import ProceduralSurface
from gn0.scenes.rays import RayCaster
from gn0.scenes.tone import BakedShader
from gn0.seeds import random_stream

HEIGHTS = (0.5, 1.1, 1.5)  # of the places on a person where light is traced [m]
CLEAR = 0.35  # of a person to walls and furniture [m]
DENSITY = 3000.0  # splats a m² of floor
_RAYS = 96  # of bounced light
_SIDE = 3  # rays along each side of a lamp


@dataclass(frozen=True, eq=False)
class LitScene:
    """A generated scene whose light can be traced.

    Attributes:
        draft: its mesh and lamps.
        shader: its baked light and exposure.
        cloud: its splats.
        grid: its free cells.
    """

    draft: SceneDraft
    shader: BakedShader
    cloud: GaussianCloud
    grid: OccupancyGrid


def light_scene(kind: KindName, seed: int, density: float = DENSITY) -> LitScene:
    """The small scene of a kind and seed, in draft light, of splats a m² of floor."""
    draft = KINDS[kind].draft(seed, size="small", style=None)
    shader = light_draft(draft, quality="draft", seed=seed)
    assert isinstance(shader, BakedShader)
    count = int(density * floor_area(draft))
    cloud, _ = cover_outlined(draft, shader, count, quality="draft", seed=seed)
    return LitScene(draft, shader, cloud, build_occupancy(draft.mesh))


def draw_places(grid: OccupancyGrid, count: int, seed: int) -> F64:
    """Random places [count, 2] m where somebody may stand."""
    away = distance_transform_edt(~grid.blocked) * grid.resolution
    cells = np.argwhere(away > CLEAR)
    chosen = random_stream(seed, "grey people").choice(len(cells), count, replace=False)
    return grid.centres_of(cells[chosen])


def trace_light(scene: LitScene, places: F64, normals: F64, seed: int) -> F64:
    """Exposed irradiance / π on grey people [P, M, 3]: mean over `HEIGHTS`, for normals [M, 3]."""
    points = np.array([(x, y, h) for x, y in places for h in HEIGHTS])
    point = np.repeat(points, len(normals), axis=0)
    normal = np.tile(normals, (len(points), 1))
    light = trace_bounced(scene, point, normal, seed) + trace_direct(scene, point, normal, seed)
    light *= scene.shader.tone.exposure(point)
    return light.reshape(len(places), len(HEIGHTS), len(normals), 3).mean(axis=1)


def trace_bounced(scene: LitScene, point: F64, normal: F64, seed: int) -> F64:
    """What surfaces send back to points [N, 3]: irradiance / π [N, 3] by cosine-weighted rays."""
    mesh = scene.draft.mesh
    caster, facing = RayCaster(mesh), mesh.normals()
    stream = random_stream(seed, "bounced")
    total = np.zeros((len(point), 3))
    for _ in range(_RAYS):
        way = stream.normal(size=(len(point), 3))
        way = normal + way / np.linalg.norm(way, axis=1, keepdims=True)  # cosine-weighted
        face, _, uv = caster.cast(point, way)
        front = (face >= 0) & ((way * facing[face]).sum(axis=1) < 0)
        hit = np.flatnonzero(front)
        weight = uv[hit].astype(np.float64)
        bary = np.concatenate([1 - weight.sum(axis=1, keepdims=True), weight], axis=1)
        at = np.einsum("nk,nka->na", bary, mesh.vertices[mesh.faces[face[hit]]])
        albedo, _ = scene.shader.surface.reflect(face[hit], bary)
        light = scene.shader.light.irradiance(
            at.astype(np.float32), facing[face[hit]].astype(np.float32)
        )
        total[hit] += albedo * light
    return total / _RAYS


def trace_direct(scene: LitScene, point: F64, normal: F64, seed: int) -> F64:
    """What comes straight from lamps, windows and the sun: irradiance / π [N, 3]."""
    mesh = scene.draft.mesh
    caster = RayCaster(mesh.select(ProceduralSurface(mesh, scene.draft.materials).opaque()))
    stream = random_stream(seed, "direct")
    total = np.zeros((len(point), 3))
    for lamp in scene.draft.lamps:
        total += np.array(lamp.colour) * _lamp_share(lamp, caster, point, normal, stream)[:, None]
    sun = scene.draft.sun
    if sun is not None:
        way = -np.asarray(sun.direction) / np.linalg.norm(sun.direction)
        cosine = np.maximum(normal @ way, 0.0)
        lit = np.flatnonzero(cosine > 0)
        free = ~caster.occluded(point[lit], np.tile(way, (len(lit), 1)))
        total[lit] += (cosine[lit] * free / np.pi)[:, None] * np.array(sun.colour)
    return total


def _lamp_share(
    lamp: Lamp, caster: RayCaster, point: F64, normal: F64, stream: np.random.Generator
) -> F64:
    """Irradiance / π of a lamp of radiance 1 [N]."""
    centre, half = np.array(lamp.centre), np.array(lamp.size) / 2
    out = np.asarray(lamp.direction) / np.linalg.norm(lamp.direction)
    ball = lamp.shape == "sphere"
    area = np.pi * half[0] ** 2 if ball else 4.0 * half[0] * half[1]
    away = ((centre - point) ** 2).sum(axis=1)
    near = np.flatnonzero(area / np.maximum(away, 0.04) * max(lamp.colour) > 2e-3)
    share = np.zeros(len(point))
    first = np.cross((0.0, 0.0, 1.0), out) if abs(out[2]) < 0.9 else np.array((1.0, 0.0, 0.0))
    first = first / np.linalg.norm(first)
    second = np.cross(out, first)
    for i in range(_SIDE):
        for j in range(_SIDE):
            s, t = (np.array([[i], [j]]) + stream.random((2, len(near)))) / _SIDE * 2 - 1
            if ball:  # the disc that it shows to each point
                to = centre - point[near]
                to /= np.linalg.norm(to, axis=1, keepdims=True)
                u = np.cross(to, (0.3, -0.5, 0.8))
                u /= np.linalg.norm(u, axis=1, keepdims=True)
                at = centre + 0.886 * half[0] * (s[:, None] * u + t[:, None] * np.cross(to, u))
            else:
                at = centre + (s * half[0])[:, None] * first + (t * half[1])[:, None] * second
            way = at - point[near]
            far = np.linalg.norm(way, axis=1)
            way /= far[:, None]
            meets = (way * normal[near]).sum(axis=1)
            leaves = np.ones(len(near)) if ball else -(way @ out)
            good = np.flatnonzero((meets > 0) & (leaves > 0))
            stop = far[good] - (0.5 * half[0] + 0.01 if ball else 0.012)
            free = ~caster.occluded(point[near[good]], way[good], np.maximum(stop, 1e-3))
            seen = meets[good] * leaves[good] / np.maximum(far[good] ** 2, 0.01) * free
            share[near[good]] += seen * area / (np.pi * _SIDE**2)
    return share
