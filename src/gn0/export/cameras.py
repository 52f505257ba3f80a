"""Camera matrices in the frames of third-party formats.

Ours: world z up, cameras in OpenCV axes (x right, y down, z forward). Poses are x, y [m], yaw [rad]
of the agent on the floor; a camera stands `height` above it and looks up by `pitch`.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from typing import Any

import numpy as np

from gn0.geometry import F64
from gn0.missions.episode import AgentSpec
from gn0.sim.presets import CameraPreset


def intrinsics(preset: CameraPreset) -> F64:
    """K [3, 3] of the colour picture as it is given out [px]."""
    width, height = preset.picture_size
    sx, sy = width / preset.rgb.width, height / preset.rgb.height
    c = preset.rgb
    return np.array([[c.fx * sx, 0, c.cx * sx], [0, c.fy * sy, c.cy * sy], [0, 0, 1]])


def camera_height(preset: CameraPreset, own: CameraPreset, agent: AgentSpec) -> float:
    """Height of the eye [m]: the agent's in the dataset's own pictures, else the preset's."""
    return agent.camera_height if preset == own else preset.agent.camera_height


def cos_sin(angles: Iterable[float]) -> tuple[F64, F64]:
    """Cosines and sines [N], the same on every machine: numpy's own depend on the processor."""
    values = [float(angle) for angle in angles]
    return np.array([math.cos(v) for v in values]), np.array([math.sin(v) for v in values])


def camera_poses(poses: F64, height: float, pitch: float) -> F64:
    """Camera-to-world matrices [N, 4, 4], OpenCV axes, of agent poses [N, 3]."""
    c, s = cos_sin(poses[:, 2])
    p, q = math.cos(pitch), math.sin(pitch)
    right, down = (s, -c, 0.0), (c * q, s * q, -p)
    return _matrices(poses, height, (right, down, (c * p, s * p, q)))


def _matrices(poses: F64, height: float, axes: tuple[tuple[Any, Any, Any], ...]) -> F64:
    found = np.zeros((len(poses), 4, 4))
    for column, axis in enumerate(axes):
        for row, values in enumerate(axis):
            found[:, row, column] = values
    found[:, :2, 3], found[:, 2, 3], found[:, 3, 3] = poses[:, :2], height, 1.0
    return found + 0.0  # no -0.0


def to_start_frame(poses: F64, height: float, pitch: float) -> F64:
    """Camera-to-start-frame matrices [N, 4, 4], OpenCV axes.

    The frame is on the floor under the first pose: x forward, y left, z up.
    """
    x, y, yaw = map(float, poses[0])
    c, s = math.cos(yaw), math.sin(yaw)
    dx, dy = poses[:, 0] - x, poses[:, 1] - y
    local = np.column_stack([c * dx + s * dy, c * dy - s * dx, poses[:, 2] - yaw])
    return camera_poses(local, height, pitch)


def from_start_frame(matrices: F64, start: F64) -> F64:
    """Agent poses [N, 3] of camera-to-start-frame matrices, given the pose of the start [3]."""
    x, y, yaw = map(float, start)
    c, s = math.cos(yaw), math.sin(yaw)
    ahead, left = matrices[:, 0, 3], matrices[:, 1, 3]
    turn = np.arctan2(matrices[:, 1, 2], matrices[:, 0, 2]) + yaw
    return np.column_stack([x + c * ahead - s * left, y + s * ahead + c * left, turn])


def mount(height: float, pitch: float) -> F64:
    """Camera-to-base matrix [4, 4] of NavDP.

    Blender's camera (x right, y up, z back) on a base of x right, y forward, z up.
    """
    c, s = math.cos(pitch), math.sin(pitch)
    found = np.eye(4)
    found[:3, :3] = np.column_stack([(1, 0, 0), (0, -s, c), (0, -c, -s)])
    found[2, 3] = height
    return found + 0.0


def mounted_poses(poses: F64, height: float, pitch: float) -> F64:
    """Camera-to-world matrices [N, 4, 4] of NavDP: Blender's camera axes, world z up."""
    c, s = cos_sin(poses[:, 2])
    p, q = math.cos(pitch), math.sin(pitch)
    return _matrices(poses, height, ((s, -c, 0.0), (-c * q, -s * q, p), (-c * p, -s * p, -q)))


def from_mounted(matrices: F64, extrinsic: F64) -> F64:
    """Agent poses [N, 3] of NavDP's camera matrices and mount."""
    forward = matrices[:, :3, :3] @ extrinsic[:3, :3].T[:, 1]
    return np.column_stack([matrices[:, :2, 3], np.arctan2(forward[:, 1], forward[:, 0])])


def project(points: F64, matrix: F64, k: F64) -> tuple[F64, F64]:
    """Pixels [N, 2] (x, y) and depths [N] m of world points [N, 3], by a camera-to-world matrix."""
    local = (points - matrix[:3, 3]) @ matrix[:3, :3]
    depth = local[:, 2]
    safe = np.where(np.abs(depth) > 1e-9, depth, 1e-9)
    return (local[:, :2] / safe[:, None]) @ k[:2, :2] + k[:2, 2], depth
