"""The way ahead as it was walked: points of it at equal arc lengths."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from gn0.geometry import F32, F64
from gn0.paper import POINTS, SPACING

_SAME = 1e-6  # shares of a spacing by which a way may end before a point that still counts


def walked_way(poses: F64, end: tuple[float, float]) -> tuple[F32, NDArray[np.int8]]:
    """The next 3 m of a walk from each of its states, as `Labels.waypoints` tells them.

    Args:
        poses: [T, 3] x, y [m] and yaw [rad].
        end: where the walk ended [m].

    Returns:
        Points [T, 13, 2] m in the agent's frame, the last repeated where the walk ends, and how
        many are no repetitions [T].
    """
    line = np.vstack([poses[:, :2], end])
    along = np.r_[0.0, np.cumsum(np.hypot(*np.diff(line, axis=0).T))]
    rest = along[-1] - along[:-1]
    ahead = along[:-1, None] + np.minimum(SPACING * np.arange(POINTS), rest[:, None])
    offset = np.stack([np.interp(ahead, along, line[:, axis]) for axis in (0, 1)], axis=-1)
    offset -= poses[:, None, :2]
    cos, sin = np.cos(poses[:, 2, None]), np.sin(poses[:, 2, None])
    dx, dy = offset[..., 0], offset[..., 1]
    waypoints = np.stack([cos * dx + sin * dy, cos * dy - sin * dx], axis=-1)
    valid = 1 + np.ceil(rest / SPACING - _SAME)
    return waypoints.astype(np.float32), np.clip(valid, 1, POINTS).astype(np.int8)
