"""How closely an agent walking through a scene sees each of its surfaces."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from gn0.geometry import F64
from gn0.jit import njit, prange
from gn0.progress import Progress, no_progress, told_parts
from gn0.scenes.charts import Charts
from gn0.scenes.mesh import SceneMesh
from gn0.scenes.rays import STACK, RayCaster, caster_of, closest_hit
from gn0.seeds import random_stream

_EYES = (0.5, 1.6)  # heights of cameras [m]
_CLEARANCE = 0.22  # of a camera to everything round it [m]
_LOOKS = 4  # points of a face that are looked at, each by its own cameras
_PART = 32_768  # faces between two words on progress
LEAST = 0.3  # weight of what no camera sees: maps are drawn from above, too


def weigh_views(
    mesh: SceneMesh,
    *,
    cameras: int = 160,
    sight: float = 8.0,
    seed: int = 0,
    charts: Charts | None = None,
    progress: Progress = no_progress,
) -> F64:
    """Weight of each face for the fineness of its sampling [F], about 1 in the mean.

    Cameras stand at random free places. A face weighs by the cube root of the mean of
    cos / distance² over the cameras that see it: the share of a picture that it fills. (The cube
    root, because that is how the best spacing of surfels depends on the weight of an error.)
    Cameras see `sight` [m] far. Progress is of the looks at a face. With `charts`, of the same
    mesh, whole pieces of surface are looked at and the faces of each weigh the same.
    """
    things = len(mesh if charts is None else charts)
    progress("looking round", 0, _LOOKS * things)
    caster = caster_of(mesh)
    eyes = _free_places(mesh, caster, cameras, seed)
    areas = mesh.areas()
    if not len(eyes):
        return np.ones(len(mesh))
    middle = mesh.corners().mean(axis=1)
    corners = mesh.corners()
    # a large face is judged by several of its points
    rng = random_stream(seed, "exposure")
    share = np.zeros(things)
    normals = mesh.normals()
    for k in range(_LOOKS):
        if charts is None:
            bary = rng.dirichlet((1.0, 1.0, 1.0), things) if k else np.full((things, 3), 1 / 3)
            point, normal = np.einsum("fk,fki->fi", bary, corners) if k else middle, normals
        else:
            face = _pick_faces(charts, areas, rng)
            bary = rng.dirichlet((1.0, 1.0, 1.0), things)
            point, normal = np.einsum("fk,fki->fi", bary, corners[face]), normals[face]
        own = eyes[k::_LOOKS].copy()
        for part in told_parts("looking round", things, _PART, _after(k, things, progress)):
            share[part] += _seen_share(
                point[part], normal[part], own, caster.boxes, caster.links, caster.corners,
                float(sight) ** 2,
            )  # fmt: skip
    if charts is not None:
        of_charts, share = share, np.zeros(len(mesh))
        share[charts.faces] = np.repeat(of_charts, np.diff(charts.start))
    weight = np.cbrt(share / _LOOKS)
    mean = np.average(weight, weights=areas)
    return np.maximum(weight / max(mean, 1e-9), LEAST)


def _pick_faces(charts: Charts, areas: F64, rng: np.random.Generator) -> NDArray[np.int32]:
    """A face of each chart [C], by chance, the large ones more often."""
    end = np.cumsum(areas[charts.faces])
    low = np.concatenate([[0.0], end])[charts.start]
    at = np.searchsorted(end, low[:-1] + rng.random(len(charts)) * np.diff(low), side="right")
    return np.asarray(charts.faces[np.clip(at, charts.start[:-1], charts.start[1:] - 1)])


def _after(looks: int, things: int, progress: Progress) -> Progress:
    """A sink for one look at each face or chart, of all."""
    return lambda stage, done, _: progress(stage, looks * things + done, _LOOKS * things)


def _free_places(mesh: SceneMesh, caster: RayCaster, count: int, seed: int) -> F64:
    """Random points inside the building that a head could be at."""
    rng = random_stream(seed, "eyes")
    lower, upper = mesh.vertices.min(axis=0), mesh.vertices.max(axis=0)
    tries = count * 24
    point = rng.uniform((lower[0], lower[1], _EYES[0]), (upper[0], upper[1], _EYES[1]), (tries, 3))
    angle = np.arange(8) * np.pi / 4
    ring = np.stack([np.cos(angle), np.sin(angle), 0 * angle], 1)
    near = caster.occluded(np.repeat(point, 8, 0), np.tile(ring, (tries, 1)), _CLEARANCE)
    up = np.broadcast_to(np.array([0.0, 0.0, 1.0]), point.shape)
    normals = mesh.normals()
    above, _, _ = caster.cast(point, up)
    below, _, _ = caster.cast(point, -up)
    # free air has a ceiling and a floor that both face it
    inside = (above >= 0) & (below >= 0)
    inside &= (normals[above, 2] < 0) & (normals[below, 2] > 0)
    free = inside & ~near.reshape(-1, 8).any(axis=1)
    return np.ascontiguousarray(point[free][:count])


@njit(parallel=True, error_model="numpy")
def _seen_share(point, normal, eyes, boxes, links, corners, farthest):  # type: ignore[no-untyped-def]
    """Mean of cos / distance² over the eyes that see each point from its front [N]."""
    out = np.zeros(len(point))
    for i in prange(len(point)):
        stack = np.empty(STACK, np.int32)
        nx, ny, nz = normal[i, 0], normal[i, 1], normal[i, 2]
        ox, oy, oz = point[i, 0] + 2e-3 * nx, point[i, 1] + 2e-3 * ny, point[i, 2] + 2e-3 * nz
        for e in range(len(eyes)):
            dx, dy, dz = eyes[e, 0] - ox, eyes[e, 1] - oy, eyes[e, 2] - oz
            d2 = dx * dx + dy * dy + dz * dz
            cosine = dx * nx + dy * ny + dz * nz
            if cosine <= 0.0 or d2 > farthest:
                continue
            hit, _, _, _ = closest_hit(
                boxes, links, corners, ox, oy, oz, dx, dy, dz, 1.0, np.bool_(True), stack
            )
            if hit < 0:
                out[i] += cosine / np.sqrt(d2) / (d2 + 0.3) / len(eyes)
    return out
