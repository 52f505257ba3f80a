"""Something for people to sit on in pictures of them: a plain block below the pelvis."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from gn0.avatars.avatar import TO_WORLD, Avatar
from gn0.avatars.motion.legs import measure_build
from gn0.avatars.motion.library import ClipLibrary
from gn0.avatars.motion.standing import FLESH, SEAT
from gn0.avatars.skeleton import INDEX
from gn0.avatars.skinning import pose_joints
from gn0.gaussians.cloud import GaussianCloud, join_clouds
from gn0.geometry import F64
from gn0.scenes.parts import build_box

_SIZE, _BACK = (0.38, 0.46), 0.03  # m along and across; the middle is so far behind the pelvis
SITTING = frozenset({"sit", "sit down", "stand up"})  # categories of motions with a seat
_WOOD = (0.55, 0.47, 0.38)


def seat_person(avatar: Avatar) -> GaussianCloud:
    """A person who sits on a block of the usual height [m], feet on the floor z = 0, facing +x.

    Raises:
        DataError: the body is none that clips are made for.
    """
    build = measure_build(avatar.joints, avatar.points, avatar.weights)
    pose, shift = ClipLibrary(build).pose_at("sit", 0.0)
    _, joints = pose_joints(avatar.joints, pose, shift)
    return join_clouds([avatar.pose(pose, shift), place_seat(joints[0] @ TO_WORLD.T)])


def find_height(avatar: Avatar, pelvis: float) -> float:
    """How high the seat is of whose pelvis is at a height; at least 0.05 [m]."""
    build = measure_build(avatar.joints, avatar.points, avatar.weights)
    over_hips = float(build.joints[0, 1] - build.joints[INDEX["left_hip"], 1])
    return max(pelvis - over_hips - FLESH * build.thigh, 0.05)


def place_seat(pelvis: F64, height: float = SEAT) -> GaussianCloud:
    """The block below a pelvis [3] m of somebody who faces +x, in GN0's axes."""
    block = build_box((*_SIZE, height), _WOOD, 0.02)
    means = block.means + np.array([pelvis[0] - _BACK, pelvis[1], 0.0], np.float32)
    return replace(block, means=means)
