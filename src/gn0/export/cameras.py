"""Matrices of cameras in the frames of other people's formats.

Ours: world z up, cameras in OpenCV axes (x right, y down, z forward). Poses are x, y [m], yaw [rad]
of the agent on the floor; a camera stands `height` above it and looks up by `pitch`.
"""

from __future__ import annotations

import numpy as np

from gn0.geometry import F64, view_from_pose
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


def camera_poses(poses: F64, height: float, pitch: float) -> F64:
    """Camera-to-world matrices [N, 4, 4], OpenCV axes, of agent poses [N, 3]."""
    views = [view_from_pose(x, y, height, yaw, pitch) for x, y, yaw in poses]
    return np.asarray(np.linalg.inv(np.array(views).reshape(-1, 4, 4)), np.float64)


def start_frame(x: float, y: float, yaw: float) -> F64:
    """Frame-to-world matrix [4, 4] of a frame on the floor: x forward, y left, z up."""
    c, s = np.cos(yaw), np.sin(yaw)
    return np.array([[c, -s, 0, x], [s, c, 0, y], [0, 0, 1, 0], [0, 0, 0, 1.0]])


def to_start_frame(poses: F64, height: float, pitch: float) -> F64:
    """Camera-to-start-frame matrices [N, 4, 4]: the frame of the first pose, OpenCV axes."""
    return np.linalg.inv(start_frame(*poses[0])) @ camera_poses(poses, height, pitch)


def from_start_frame(matrices: F64, start: F64) -> F64:
    """Agent poses [N, 3] of camera-to-start-frame matrices, given the pose of the start [3]."""
    world = start_frame(*start) @ matrices
    forward = world[:, :3, 2]
    return np.column_stack([world[:, :2, 3], np.arctan2(forward[:, 1], forward[:, 0])])


# Blender's camera axes (x right, y up, z back) from a base with x right, y forward, z up
def mount(height: float, pitch: float) -> F64:
    """Camera-to-base matrix [4, 4] of NavDP: a base of x right, y forward, z up."""
    c, s = np.cos(pitch), np.sin(pitch)
    found = np.eye(4)
    found[:3, :3] = np.column_stack([(1, 0, 0), (0, -s, c), (0, -c, -s)])
    found[2, 3] = height
    return found


def mounted_poses(poses: F64, height: float, pitch: float) -> F64:
    """Camera-to-world matrices [N, 4, 4] of NavDP: Blender's camera axes, world z up."""
    bases = np.zeros((len(poses), 4, 4))
    c, s = np.cos(poses[:, 2]), np.sin(poses[:, 2])
    bases[:, 0, 0], bases[:, 1, 0] = s, -c  # right
    bases[:, 0, 1], bases[:, 1, 1] = c, s  # forward
    bases[:, 2, 2] = bases[:, 3, 3] = 1.0
    bases[:, :2, 3] = poses[:, :2]
    return bases @ mount(height, pitch)


def from_mounted(matrices: F64, extrinsic: F64) -> F64:
    """Agent poses [N, 3] of NavDP's camera matrices and mount."""
    base = matrices @ np.linalg.inv(extrinsic)
    return np.column_stack([base[:, :2, 3], np.arctan2(base[:, 1, 1], base[:, 0, 1])])


def project(points: F64, matrix: F64, k: F64) -> tuple[F64, F64]:
    """Pixels [N, 2] (x, y) and depths [N] m of world points [N, 3], by a camera-to-world matrix."""
    local = (points - matrix[:3, 3]) @ matrix[:3, :3]
    depth = local[:, 2]
    safe = np.where(np.abs(depth) > 1e-9, depth, 1e-9)
    return (local[:, :2] / safe[:, None]) @ k[:2, :2] + k[:2, 2], depth
