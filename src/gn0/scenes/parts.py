"""Small things that can move: clouds in a frame of their own, for instances.

Discs lie on surfaces and know their normals, so that a colour gain can shade them.
"""

from __future__ import annotations

import numpy as np

from gn0.errors import SceneError
from gn0.gaussians.cloud import SH_C0, GaussianCloud
from gn0.geometry import F64, quaternion_from_rotation

Colour = tuple[float, float, float]
_FLAT = 0.1  # thickness of a disc over its radius
_OVERLAP = 0.6  # radius (one standard deviation) over the distance of discs


def build_ball(
    radius: float = 0.15,
    colours: tuple[Colour, Colour] = ((0.85, 0.2, 0.15), (0.95, 0.9, 0.85)),
    spacing: float = 0.008,
) -> GaussianCloud:
    """A ball round the origin, striped so that its rolling shows.

    Args:
        radius: [m].
        colours: colours of its stripes, 0..1.
        spacing: distance of discs [m].

    Raises:
        SceneError: sizes without meaning.
    """
    _check(radius, spacing)
    count = max(int(4 * np.pi * radius**2 / spacing**2), 64)
    k = np.arange(count) + 0.5
    z = 1.0 - 2.0 * k / count  # a spiral from pole to pole: even on the sphere
    turn = np.pi * (1.0 + 5.0**0.5) * k
    flat = np.sqrt(1.0 - z**2)
    normals = np.stack([flat * np.cos(turn), flat * np.sin(turn), z], axis=1)
    stripe = (np.floor(np.arctan2(normals[:, 1], normals[:, 0]) * 3 / np.pi) % 2).astype(int)
    return _lay(normals * radius, normals, np.array(colours)[stripe], spacing)


def build_box(
    size: Colour = (0.4, 0.4, 0.4), colour: Colour = (0.65, 0.5, 0.3), spacing: float = 0.012
) -> GaussianCloud:
    """A box that stands on z = 0 round the z axis; `size` along x, y, z [m].

    Raises:
        SceneError: sizes without meaning.
    """
    _check(*size, spacing)
    return _box(np.array(size), np.array([0.0, 0.0, size[2] / 2]), colour, spacing)


def build_leaf(
    width: float = 0.8,
    height: float = 2.0,
    thickness: float = 0.04,
    colour: Colour = (0.8, 0.78, 0.72),
    spacing: float = 0.012,
) -> GaussianCloud:
    """The leaf of a door: hinged on the z axis, it reaches along x; sizes in m.

    Raises:
        SceneError: sizes without meaning.
    """
    _check(width, height, thickness, spacing)
    size = np.array([width, thickness, height])
    return _box(size, np.array([width / 2, 0.0, height / 2]), colour, spacing)


def _check(*sizes: float) -> None:
    if not all(np.isfinite(size) and 0 < size <= 100 for size in sizes):
        raise SceneError(f"sizes are {sizes}", remedy="give metres, more than 0")


def _box(size: F64, centre: F64, colour: Colour, spacing: float) -> GaussianCloud:
    points, normals = [], []
    for axis in range(3):
        across = [other for other in range(3) if other != axis]
        steps = [max(round(size[other] / spacing), 1) for other in across]
        grid = np.stack(
            np.meshgrid(*((np.arange(n) + 0.5) / n - 0.5 for n in steps), indexing="ij"), axis=-1
        ).reshape(-1, 2)
        for side in (-1.0, 1.0):
            face = np.zeros((len(grid), 3))
            face[:, across] = grid * size[across]
            face[:, axis] = side * size[axis] / 2
            normal = np.zeros((len(grid), 3))
            normal[:, axis] = side
            points.append(face + centre)
            normals.append(normal)
    every = np.concatenate(points)
    colours = np.broadcast_to(np.array(colour), every.shape)
    return _lay(every, np.concatenate(normals), colours, spacing)


def _lay(points: F64, normals: F64, colours: F64, spacing: float) -> GaussianCloud:
    """Discs at points [N, 3], facing along unit normals [N, 3]."""
    count = len(points)
    helper = np.where(np.abs(normals[:, 2:]) < 0.9, [[0.0, 0.0, 1.0]], [[1.0, 0.0, 0.0]])
    across = np.cross(helper, normals)
    across /= np.linalg.norm(across, axis=1, keepdims=True)
    frames = np.stack([across, np.cross(normals, across), normals], axis=2)  # columns
    radius = _OVERLAP * spacing
    return GaussianCloud(
        means=points.astype(np.float32),
        quats=quaternion_from_rotation(frames).astype(np.float32),
        scales=np.tile(np.array([radius, radius, _FLAT * radius], np.float32), (count, 1)),
        opacities=np.full(count, 0.95, np.float32),
        sh=((colours - 0.5) / SH_C0).astype(np.float32)[:, None, :],
        normal=normals.astype(np.float32),
    )
