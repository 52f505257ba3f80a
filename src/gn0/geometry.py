"""Poses, rotations and frames: the only place that knows axes.

World: right-handed, metres, +z up, floor at z = 0; yaw in radians, counter-clockwise, 0 along +x.
Cameras: OpenCV axes (x right, y down, z forward); a view matrix maps world to camera.
Quaternions are (w, x, y, z).
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

F32 = NDArray[np.float32]
F64 = NDArray[np.float64]
U8 = NDArray[np.uint8]


class Pose2D(NamedTuple):
    """A pose on the floor: x, y [m], yaw [rad, −π..π)."""

    x: float
    y: float
    yaw: float

    def is_finite(self) -> bool:
        """Whether all three values are finite."""
        return math.isfinite(self.x) and math.isfinite(self.y) and math.isfinite(self.yaw)


def wrap_angle(angle: float) -> float:
    """Wrap an angle [rad] to −π..π (π itself maps to −π); paper Sec. 'Action Space'."""
    if -math.pi <= angle < math.pi:
        return angle  # exact for values already in range
    wrapped = (angle + math.pi) % (2.0 * math.pi) - math.pi
    return wrapped if wrapped < math.pi else -math.pi


def rotation_from_quaternion(quats: NDArray[np.floating]) -> F64:
    """Rotation matrices [N, 3, 3] of unit quaternions (w, x, y, z) [N, 4]."""
    q = np.asarray(quats, np.float64).reshape(-1, 4)
    w, x, y, z = q.T
    return np.stack(
        [
            *(1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)),
            *(2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)),
            *(2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)),
        ],
        axis=1,
    ).reshape(-1, 3, 3)


def quaternion_from_rotation(rotations: NDArray[np.floating]) -> F64:
    """Unit quaternions (w, x, y, z) [N, 4], w ≥ 0, of rotation matrices [N, 3, 3]."""
    m = np.asarray(rotations, np.float64).reshape(-1, 3, 3)
    d0, d1, d2 = m[:, 0, 0], m[:, 1, 1], m[:, 2, 2]
    # four candidates, each exact where its own leading term is the largest (Shepperd 1978)
    t = np.stack([1 + d0 + d1 + d2, 1 + d0 - d1 - d2, 1 - d0 + d1 - d2, 1 - d0 - d1 + d2], 1)
    best = np.argmax(t, axis=1)
    a, b, c = m[:, 2, 1] - m[:, 1, 2], m[:, 0, 2] - m[:, 2, 0], m[:, 1, 0] - m[:, 0, 1]
    p, q, r = m[:, 1, 0] + m[:, 0, 1], m[:, 2, 0] + m[:, 0, 2], m[:, 2, 1] + m[:, 1, 2]
    candidates = np.stack(
        [
            np.stack([t[:, 0], a, b, c], 1),
            np.stack([a, t[:, 1], p, q], 1),
            np.stack([b, p, t[:, 2], r], 1),
            np.stack([c, q, r, t[:, 3]], 1),
        ],
        axis=1,
    )
    quats = candidates[np.arange(len(m)), best]
    quats /= np.linalg.norm(quats, axis=1, keepdims=True)
    return np.where(quats[:, :1] < 0, -quats, quats)


def view_from_pose(x: float, y: float, z: float, yaw: float, pitch: float = 0.0) -> F64:
    """World-to-camera matrix [4, 4] of a camera at (x, y, z) [m].

    Looks along `yaw` [rad]; positive `pitch` [rad] looks up. OpenCV axes, no roll.
    """
    cy, sy, cp, sp = math.cos(yaw), math.sin(yaw), math.cos(pitch), math.sin(pitch)
    forward = (cy * cp, sy * cp, sp)
    right = (sy, -cy, 0.0)
    down = (cy * sp, sy * sp, -cp)  # forward × right
    view = np.eye(4)
    view[:3, :3] = (right, down, forward)
    view[:3, 3] = -view[:3, :3] @ np.array((x, y, z), np.float64)
    return view


def view_from_above(x: float, y: float, height: float) -> F64:
    """World-to-camera matrix [4, 4] looking straight down from `height` [m].

    The picture's right is world +x and its top is world +y: a map with north up.
    """
    view = np.eye(4)
    view[:3, :3] = ((1.0, 0.0, 0.0), (0.0, -1.0, 0.0), (0.0, 0.0, -1.0))
    view[:3, 3] = -view[:3, :3] @ np.array((x, y, height), np.float64)
    return view


def world_to_agent(pose: Pose2D, x: float, y: float) -> tuple[float, float]:
    """A world point in the agent's frame: (forward, left) [m]."""
    dx, dy = x - pose.x, y - pose.y
    c, s = math.cos(pose.yaw), math.sin(pose.yaw)
    return c * dx + s * dy, -s * dx + c * dy


def agent_to_world(pose: Pose2D, forward: float, left: float) -> tuple[float, float]:
    """A point of the agent's frame (forward, left) [m] in the world."""
    c, s = math.cos(pose.yaw), math.sin(pose.yaw)
    return pose.x + c * forward - s * left, pose.y + s * forward + c * left


def polyline_length(points: NDArray[np.floating]) -> float:
    """Length [m] of a polyline [N, 2] or [N, 3]; 0 for fewer than two points."""
    p = np.asarray(points, np.float64)
    if len(p) < 2:
        return 0.0
    return float(np.sqrt((np.diff(p, axis=0) ** 2).sum(axis=1)).sum())
