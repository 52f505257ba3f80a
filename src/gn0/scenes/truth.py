"""The ray-traced picture of a shaded mesh: what surfels are judged by."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from gn0.geometry import F32
from gn0.scenes.mesh import SceneMesh
from gn0.scenes.rays import RayCaster
from gn0.scenes.shading import Shader


def render_truth(
    mesh: SceneMesh,
    shader: Shader,
    intrinsics: NDArray[np.floating],
    view: NDArray[np.floating],
    size: tuple[int, int],
    *,
    samples: int = 4,
    caster: RayCaster | None = None,
    background: tuple[float, float, float] = (0.0, 0.0, 0.0),
) -> tuple[F32, F32]:
    """One pinhole picture by ray casting, `samples` × `samples` rays a pixel on a regular grid.

    Args:
        mesh: the surfaces.
        shader: their appearance; display colours are averaged over the pixel.
        intrinsics: camera matrix K [3, 3], pixels; pixel centres at half-integers.
        view: world-to-camera [4, 4], OpenCV axes.
        size: (width, height) [pixels].
        samples: rays along each side of a pixel.
        caster: a ray caster of the same mesh, to save building it again.
        background: display colour where nothing is hit.

    Returns:
        rgb [H, W, 3] in 0..1, and depth [H, W]: camera z [m] along the ray nearest the pixel's
        centre, +inf where nothing is hit.
    """
    width, height = size
    caster = caster or RayCaster(mesh)
    view = np.asarray(view, np.float64)
    rotation = view[:3, :3]
    eye = -rotation.T @ view[:3, 3]
    K = np.asarray(intrinsics, np.float64)
    rgb = np.zeros((height, width, 3), np.float64)
    depth = np.full((height, width), np.inf, np.float32)
    middle = (samples // 2, samples // 2)
    columns = np.arange(width)
    band = max(1, 200_000 // width)
    for top in range(0, height, band):
        rows = np.arange(top, min(height, top + band))
        for j in range(samples):
            for i in range(samples):
                x = (columns[None, :] + (i + 0.5) / samples - K[0, 2]) / K[0, 0]
                y = (rows[:, None] + (j + 0.5) / samples - K[1, 2]) / K[1, 1]
                x, y = np.broadcast_arrays(x, y)
                ray = np.stack([x, y, np.ones_like(x)], -1).reshape(-1, 3) @ rotation
                origin = np.broadcast_to(eye, ray.shape)
                face, t, uv = caster.cast(origin, ray)
                hit = np.flatnonzero(face >= 0)
                colour = np.broadcast_to(np.array(background), ray.shape).copy()
                if len(hit):
                    vw = uv[hit].astype(np.float64)
                    bary = np.concatenate([1 - vw.sum(1, keepdims=True), vw], 1)
                    colour[hit] = shader.shade(face[hit], bary).colour
                shape = (len(rows), width)
                rgb[rows] += colour.reshape(*shape, 3) / samples**2
                if (i, j) == middle:
                    depth[rows] = t.reshape(shape)
    return rgb.astype(np.float32), depth


def trace_picture(
    mesh: SceneMesh,
    shader: Shader,
    intrinsics: NDArray[np.floating],
    size: tuple[int, int],
    view: NDArray[np.floating],
    rng: np.random.Generator,
    *,
    caster: RayCaster | None = None,
) -> NDArray[np.uint8]:
    """One pinhole picture with a single ray at a random place of each pixel.

    Its mean over `rng` is `render_truth`; a fit to many such pictures needs no more.

    Args:
        mesh: the surfaces.
        shader: their appearance.
        intrinsics: camera matrix K [3, 3], pixels.
        size: (width, height) [pixels].
        view: world-to-camera [4, 4], OpenCV axes.
        rng: places the rays.
        caster: a ray caster of the same mesh, to save building it again.

    Returns:
        display colours [H, W, 3], black where nothing is hit.
    """
    width, height = size
    caster = caster or RayCaster(mesh)
    view = np.asarray(view, np.float64)
    K = np.asarray(intrinsics, np.float64)
    x = (np.arange(width)[None, :] + rng.random((height, width)) - K[0, 2]) / K[0, 0]
    y = (np.arange(height)[:, None] + rng.random((height, width)) - K[1, 2]) / K[1, 1]
    ray = np.stack([x, y, np.ones_like(x)], -1).reshape(-1, 3) @ view[:3, :3]
    eye = -view[:3, :3].T @ view[:3, 3]
    face, _, uv = caster.cast(np.broadcast_to(eye, ray.shape), ray)
    hit = np.flatnonzero(face >= 0)
    vw = uv[hit].astype(np.float64)
    bary = np.concatenate([1 - vw.sum(1, keepdims=True), vw], 1)
    colour = np.zeros((width * height, 3), np.float32)
    colour[hit] = shader.shade(face[hit], bary).colour
    return (np.clip(colour, 0, 1) * 255 + 0.5).astype(np.uint8).reshape(height, width, 3)
