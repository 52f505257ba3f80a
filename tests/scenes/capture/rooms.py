"""Clouds of discs for tests: a furnished room, a statue, a wall, with exact truth."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from gn0.gaussians.cloud import GaussianCloud, join_clouds
from gn0.geometry import quaternion_from_rotation
from gn0.seeds import random_stream

SPACING = 0.035  # m


def rectangle(
    corner: tuple[float, float, float],
    a: tuple[float, float, float],
    b: tuple[float, float, float],
    spacing: float = SPACING,
) -> GaussianCloud:
    """Discs over the rectangle corner + [0, 1] a + [0, 1] b."""
    va, vb = np.array(a, float), np.array(b, float)
    la, lb = np.linalg.norm(va), np.linalg.norm(vb)
    na, nb = max(1, round(la / spacing)), max(1, round(lb / spacing))
    u, v = np.meshgrid((np.arange(na) + 0.5) / na, (np.arange(nb) + 0.5) / nb)
    points = np.array(corner) + u.reshape(-1, 1) * va + v.reshape(-1, 1) * vb
    axes = np.stack([va / la, vb / lb, np.cross(va / la, vb / lb)], axis=1)
    n = len(points)
    size = (0.5 * la / na, 0.5 * lb / nb, 0.001)
    return GaussianCloud(
        means=points.astype(np.float32),
        quats=np.tile(quaternion_from_rotation(axes)[0], (n, 1)).astype(np.float32),
        scales=np.tile(size, (n, 1)).astype(np.float32),
        opacities=np.full(n, 0.95, np.float32),
        sh=np.zeros((n, 1, 3), np.float32),
    )


def box(low: tuple[float, ...], high: tuple[float, ...], *, bottom: bool = True) -> GaussianCloud:
    """The sides of a box, 5 mm inside it."""
    x0, y0, z0 = (v + 0.005 for v in low)
    x1, y1, z1 = (v - 0.005 for v in high)
    w, d, h = x1 - x0, y1 - y0, z1 - z0
    sides = [
        rectangle((x0, y0, z0), (w, 0, 0), (0, 0, h)),
        rectangle((x0, y1, z0), (w, 0, 0), (0, 0, h)),
        rectangle((x0, y0, z0), (0, d, 0), (0, 0, h)),
        rectangle((x1, y0, z0), (0, d, 0), (0, 0, h)),
        rectangle((x0, y0, z1), (w, 0, 0), (0, d, 0)),
    ]
    if bottom:
        sides.append(rectangle((x0, y0, z0), (w, 0, 0), (0, d, 0)))
    return join_clouds(sides)


WIDTH, DEPTH, HEIGHT, DOOR = 7.0, 4.0, 2.6, (1.5, 2.4)  # m; a door in the wall at x = 4.0..4.1
FURNITURE = {
    "bed": ((0.0, 2.4, 0.0), (2.2, 4.0, 0.5)),
    "cupboard": ((5.0, 3.5, 0.0), (6.5, 4.0, 1.4)),
    "chest": ((6.2, 0.0, 0.0), (7.0, 0.8, 0.8)),
}


def two_rooms(*, ceiling: bool = True, height: float = HEIGHT) -> GaussianCloud:
    """Two rooms with a door between them, a bed, a cupboard, a chest and a table on four legs."""
    w, d, h = WIDTH, DEPTH, height
    lie = 0.005  # surfaces lie this far behind what one sees
    parts = [
        rectangle((0, 0, -lie), (w, 0, 0), (0, d, 0)),
        rectangle((0, -lie, 0), (w, 0, 0), (0, 0, h)),
        rectangle((0, d + lie, 0), (w, 0, 0), (0, 0, h)),
        rectangle((-lie, 0, 0), (0, d, 0), (0, 0, h)),
        rectangle((w + lie, 0, 0), (0, d, 0), (0, 0, h)),
        box((4.0, 0, 0), (4.1, DOOR[0], h)),
        box((4.0, DOOR[1], 0), (4.1, d, h)),
        box((4.0, DOOR[0], 2.05), (4.1, DOOR[1], h)),
        *(box(low, high, bottom=False) for low, high in FURNITURE.values()),
        box((1.0, 0.6, 0.70), (2.2, 1.4, 0.75)),
    ]
    for x in (1.0, 2.15):
        for y in (0.6, 1.35):
            parts.append(box((x, y, 0), (x + 0.05, y + 0.05, 0.7)))
    if ceiling:
        parts.append(rectangle((0, 0, h + lie), (w, 0, 0), (0, d, 0)))
    return join_clouds(parts)


def leaf() -> GaussianCloud:
    """A closed leaf with a handle in the doorway of the rooms, in the middle of the wall."""
    low, high = (4.025, DOOR[0], 0.003), (4.075, DOOR[1], 2.05)
    handle = box((3.97, DOOR[0] + 0.05, 1.0), (4.13, DOOR[0] + 0.15, 1.04))
    return join_clouds([box(low, high), handle])


def lawn(margin: float = 9.0, spacing: float = 0.12) -> GaussianCloud:
    """Flat ground round the rooms, as wide as `margin` [m] on every side."""
    w, d, m = WIDTH, DEPTH, margin
    return join_clouds(
        [
            rectangle((-m, -m, -0.005), (w + 2 * m, 0, 0), (0, m, 0), spacing),
            rectangle((-m, d, -0.005), (w + 2 * m, 0, 0), (0, m, 0), spacing),
            rectangle((-m, 0, -0.005), (m, 0, 0), (0, d, 0), spacing),
            rectangle((w, 0, -0.005), (m, 0, 0), (0, d, 0), spacing),
        ]
    )


def truth_cells() -> NDArray[np.bool_]:
    """Free cells [80, 140] of 5 cm over [0, WIDTH] x [0, DEPTH]; under the table is not free."""
    free = np.ones((80, 140), bool)
    solid = [
        *FURNITURE.values(), ((1.0, 0.6, 0), (2.2, 1.4, 0)), ((4.0, 0, 0), (4.1, DOOR[0], 0)),
        ((4.0, DOOR[1], 0), (4.1, DEPTH, 0)),
    ]  # fmt: skip
    for low, high in solid:
        rows = slice(round(low[1] / 0.05), round(high[1] / 0.05))
        free[rows, round(low[0] / 0.05) : round(high[0] / 0.05)] = False
    return free


def noisy(cloud: GaussianCloud, seed: int = 0) -> GaussianCloud:
    """6 mm jitter, opacities ~ Beta(5, 1), 1 % faint floaters."""
    rng = random_stream(seed, "test noise")
    n = len(cloud)
    means = cloud.means + rng.normal(0, 0.006, (n, 3))
    opacities = np.clip(rng.beta(5, 1, n), 0.02, 0.99)
    loose = rng.choice(n, n // 100, replace=False)
    means[loose] = rng.uniform(cloud.means.min(axis=0), cloud.means.max(axis=0), (len(loose), 3))
    opacities[loose] = rng.uniform(0.01, 0.12, len(loose))
    return replace(cloud, means=means.astype(np.float32), opacities=opacities.astype(np.float32))


def ball(radius: float = 1.0, n: int = 4000) -> GaussianCloud:
    """A sphere of small discs: an object with no floor."""
    i = np.arange(n) + 0.5
    z = 1 - 2 * i / n
    azimuth = np.pi * (1 + np.sqrt(5)) * i
    ring = np.sqrt(1 - z * z)
    normal = np.stack([ring * np.cos(azimuth), ring * np.sin(azimuth), z], axis=1)
    side = np.cross(normal, np.where(np.abs(z)[:, None] < 0.9, (0.0, 0.0, 1.0), (1.0, 0.0, 0.0)))
    side /= np.linalg.norm(side, axis=1, keepdims=True)
    axes = np.stack([side, np.cross(normal, side), normal], axis=2)
    return GaussianCloud(
        means=(radius * normal).astype(np.float32),
        quats=quaternion_from_rotation(axes).astype(np.float32),
        scales=np.tile(np.float32([0.02, 0.02, 0.001]) * radius, (n, 1)),
        opacities=np.full(n, 0.95, np.float32),
        sh=np.zeros((n, 1, 3), np.float32),
    )
