"""What a pose does to joints and to the splats that hang on them, in compiled code.

Sums run in the order in which they are written, without fused multiply-add: the same bits on any
machine, for one pose as for many, and in a cloud as in packed rows.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from gn0.avatars.body import check_pose
from gn0.avatars.motion.turns import unit_quat
from gn0.avatars.skeleton import JOINT_COUNT, PARENTS
from gn0.errors import DataError
from gn0.geometry import F64
from gn0.jit import njit, prange

_PARENTS = np.array(PARENTS, np.int64)
_SMALL = 1e-6  # rad


class Posture(NamedTuple):
    """What a pose does to each joint.

    Attributes:
        transforms: from rest to GN0's axes [55, 3, 4] m.
        turns: their rotations (w, x, y, z), w ≥ 0 [55, 4].
        joints: where they are, in the body's axes [55, 3] m.
    """

    transforms: F64
    turns: F64
    joints: F64


def place_joints(
    rest: NDArray[np.floating],
    pose: NDArray[np.floating],
    shift: NDArray[np.floating] | None = None,
) -> Posture:
    """The joints of a body in a pose.

    Args:
        rest: its joints at rest [55, 3] m.
        pose: axis-angle of each joint in its parent's axes [55, 3] rad.
        shift: added after the pose, in the body's axes [3] m.

    Raises:
        DataError: the pose has another number of joints, or a number is not finite.
    """
    moved = np.zeros(3) if shift is None else np.ascontiguousarray(shift, np.float64)
    found = np.empty((JOINT_COUNT, 19))
    angles = np.ascontiguousarray(check_pose(pose))
    if not place_body(np.ascontiguousarray(rest, np.float64), angles, moved, found):
        raise DataError("a pose is not finite", where="pose")
    return Posture(
        np.ascontiguousarray(found[:, :12]).reshape(JOINT_COUNT, 3, 4),
        np.ascontiguousarray(found[:, 12:16]),
        found[:, 16:],
    )


def place_all(rests: F64, poses: F64, shifts: F64) -> Posture:
    """The joints of many bodies in a pose each, to the bit those of `place_joints`.

    Args:
        rests: their joints at rest [P, 55, 3] m.
        poses: angles [P, 55, 3] rad, checked.
        shifts: [P, 3] m.

    Returns:
        Arrays of `Posture`, those of each body first.

    Raises:
        DataError: a pose is not finite.
    """
    found = np.empty((len(poses), JOINT_COUNT, 19))
    fine = np.empty(len(poses), np.bool_)
    given = (np.ascontiguousarray(one, np.float64) for one in (rests, poses, shifts))
    _place_all(*given, found, fine)
    if not fine.all():
        raise DataError("a pose is not finite", where=f"pose {int(np.flatnonzero(~fine)[0])}")
    count = len(poses)
    transforms = np.ascontiguousarray(found[..., :12]).reshape(count, JOINT_COUNT, 3, 4)
    return Posture(transforms, np.ascontiguousarray(found[..., 12:16]), found[..., 16:])


@njit(parallel=True)
def _place_all(rests, poses, shifts, found, fine):  # type: ignore[no-untyped-def]
    for n in prange(poses.shape[0]):
        fine[n] = place_body(rests[n], poses[n], shifts[n], found[n])


@njit
def place_body(rest, pose, shift, found):  # type: ignore[no-untyped-def]
    """Fill rows of `found` [55, 19]: transform, turn, place; False if a number is not finite.

    Of joints at rest [55, 3] m, a pose [55, 3] rad and a shift [3] m; see `Posture`.
    """
    fine = True
    turned, placed = np.empty((JOINT_COUNT, 3, 3)), np.empty((JOINT_COUNT, 3))
    local = np.empty((3, 3))
    for j in range(JOINT_COUNT):
        _turn(pose[j, 0], pose[j, 1], pose[j, 2], local)
        parent = _PARENTS[j]
        if parent < 0:
            for a in range(3):  # by loops: Numba compiles the assignment of an array for seconds
                placed[j, a] = rest[j, a]
                for b in range(3):
                    turned[j, a, b] = local[a, b]
        else:
            up = turned[parent]
            for a in range(3):
                for b in range(3):
                    turned[j, a, b] = (
                        up[a, 0] * local[0, b] + up[a, 1] * local[1, b] + up[a, 2] * local[2, b]
                    )
                placed[j, a] = placed[parent, a] + (
                    up[a, 0] * (rest[j, 0] - rest[parent, 0])
                    + up[a, 1] * (rest[j, 1] - rest[parent, 1])
                    + up[a, 2] * (rest[j, 2] - rest[parent, 2])
                )
    for j in range(JOINT_COUNT):
        m, out = turned[j], found[j]
        for a in range(3):
            place = placed[j, a] + shift[a]
            moved = place - (m[a, 0] * rest[j, 0] + m[a, 1] * rest[j, 1] + m[a, 2] * rest[j, 2])
            row = 4 * ((a + 1) % 3)  # of GN0's axes: `avatar.TO_WORLD`
            out[row], out[row + 1], out[row + 2], out[row + 3] = m[a, 0], m[a, 1], m[a, 2], moved
            out[16 + a] = place
            fine = fine and np.isfinite(moved)
        _find_turn(out)
    return fine


@njit
def _turn(x, y, z, out):  # type: ignore[no-untyped-def]
    """The rotation matrix of an axis-angle vector; as `skinning.rotations_of`."""
    angle = math.sqrt(x * x + y * y + z * z)
    if angle < _SMALL:
        first, second = 1.0 - angle * angle / 6.0, 0.5 - angle * angle / 24.0
    else:
        first = math.sin(angle) / angle
        half = math.sin(angle / 2.0) / angle
        second = 2.0 * (half * half)
    out[0, 0] = 1.0 + second * (-z * z - y * y)
    out[1, 1] = 1.0 + second * (-z * z - x * x)
    out[2, 2] = 1.0 + second * (-y * y - x * x)
    out[0, 1], out[1, 0] = -first * z + second * (x * y), first * z + second * (x * y)
    out[0, 2], out[2, 0] = first * y + second * (x * z), -first * y + second * (x * z)
    out[1, 2], out[2, 1] = -first * x + second * (y * z), first * x + second * (y * z)


@njit
def _find_turn(out):  # type: ignore[no-untyped-def]
    """The quaternion, at 12, of the matrix at 0."""
    out[12], out[13], out[14], out[15] = unit_quat(
        out[0], out[1], out[2], out[4], out[5], out[6], out[8], out[9], out[10]
    )
