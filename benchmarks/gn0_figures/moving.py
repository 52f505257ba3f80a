"""Moving parts for figures and tests: balls of splats, and poses that views can see."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from gn0.gaussians.cloud import GaussianCloud
from gn0.geometry import F64
from gn0.scenes.discs import OPACITY, SIGMA
from gn0.seeds import random_stream
from gn0.testing.renderer_check import random_cloud
from gn0.testing.renderer_parts_check import ball_cloud

# a colour gain: constant, then along x, y and z of the world
GAIN = np.array(
    [[0.8, 0.9, 1.1], [0.3, -0.2, 0.1], [0.1, 0.4, -0.3], [-0.2, 0.1, 0.35]], np.float32
)


def build_ball(
    count: int, seed: int, *, sh_degree: int = 0, radius: float = 0.5, size: float = 0.06
) -> GaussianCloud:
    """Splats of at most `size` m on a sphere; their normals point outwards."""
    cloud = random_cloud(count, seed=seed, sh_degree=sh_degree)
    away = cloud.means / np.maximum(np.linalg.norm(cloud.means, axis=1, keepdims=True), 1e-6)
    scales = np.minimum(cloud.scales, size)
    means = (radius * away).astype(np.float32)
    return replace(cloud, means=means, scales=scales, normal=away.astype(np.float32))


def build_body(count: int, seed: int, *, sh_degree: int = 0) -> GaussianCloud:
    """A closed body of a person's size round the origin, of discs as meshes become: 1.75 m tall.

    Its colours change over the body, not from disc to disc: discs at nearly one depth may swap.
    """
    ball = ball_cloud(count, seed, radius=1.0, sh_degree=sh_degree)
    stream = random_stream(seed, "body")
    sh = np.tile(stream.normal(0, 0.15, (1, ball.sh.shape[1], 3)), (count, 1, 1))
    sh[:, 0] += np.sin(3 * ball.means + stream.uniform(-3, 3, 3))
    half = np.array([0.22, 0.18, 0.875], np.float32)  # m
    width = ball.scales.max(axis=1, keepdims=True)  # 1.6 m² of skin: 0.65 spacings, see discs
    return replace(
        ball,
        means=ball.means * half,
        scales=ball.scales / np.median(width) * np.float32(SIGMA * np.sqrt(1.6 / count)),
        opacities=np.full(count, OPACITY, np.float32),
        sh=sh.astype(np.float32),
    )


def pose_upright(view: F64, forward: float, turn: float) -> F64:
    """Part-to-world [4, 4] of a body that stands on the floor before a level view."""
    c, s = np.cos(turn), np.sin(turn)
    pose = np.eye(4)
    pose[:2, :2] = (c, -s), (s, c)
    pose[:3, 3] = (np.linalg.inv(view) @ (0.0, 0.0, forward, 1.0))[:3]
    pose[2, 3] = 0.875
    return pose


def pose_ahead(view: F64, forward: float, right: float, turn: float) -> F64:
    """Part-to-world [4, 4] of what stands before a view, turned [rad] about a slanted axis."""
    c, s = np.cos(turn), np.sin(turn)
    about_z = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
    slant = np.array([[1.0, 0.0, 0.0], [0.0, 0.8, -0.6], [0.0, 0.6, 0.8]])
    pose = np.eye(4)
    pose[:3, :3] = about_z @ slant
    pose[:3, 3] = (np.linalg.inv(view) @ (right, 0.1, forward, 1.0))[:3]
    return pose
