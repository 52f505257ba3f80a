"""Poses by themselves: what people stand and clothes are tried in."""

from __future__ import annotations

import numpy as np

from gn0.avatars.skeleton import INDEX, JOINT_COUNT
from gn0.geometry import F64


def standing_pose() -> F64:
    """Axis-angle [55, 3] rad of somebody who stands with the arms lowered."""
    pose = np.zeros((JOINT_COUNT, 3))
    for side, sign in (("left", 1.0), ("right", -1.0)):
        pose[INDEX[f"{side}_shoulder"]] = (0.0, 0.10 * sign, -1.18 * sign)
        pose[INDEX[f"{side}_elbow"]] = (0.0, -0.25 * sign, 0.0)
    return pose


def trial_poses() -> tuple[F64, F64, F64]:
    """Standing, a long stride, seated [55, 3] rad: what clothes are tried in."""
    stride, seat = standing_pose(), standing_pose()
    for side, hip, knee in (("left", -0.5, 0.2), ("right", 0.4, 0.6)):
        stride[INDEX[f"{side}_hip"], 0], stride[INDEX[f"{side}_knee"], 0] = hip, knee
        seat[INDEX[f"{side}_hip"], 0], seat[INDEX[f"{side}_knee"], 0] = -1.5, 1.5
    return standing_pose(), stride, seat


def stride_pose() -> F64:
    """Axis-angle [55, 3] of somebody in mid-stride, arms down."""
    pose = np.zeros((JOINT_COUNT, 3))
    pose[INDEX["left_shoulder"], 2], pose[INDEX["right_shoulder"], 2] = -1.1, 1.1
    pose[INDEX["left_hip"], 0], pose[INDEX["right_hip"], 0] = -0.4, 0.3
    pose[INDEX["right_knee"], 0] = 0.5
    return pose
