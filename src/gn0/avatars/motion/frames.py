"""Frames of clips mixed, stepped and solved in compiled code, each by itself.

A frame is a row of `legs.flatten_plan`. What is written here runs alike for one frame and for
thousands of many bodies, on one thread or on all: to the bit.
"""

from __future__ import annotations

import math

import numpy as np

from gn0.avatars.motion.legs import (
    ANKLES,
    FLAT_WIDTH,
    HIPS,
    KNEES,
    TOES,
    Build,
    Plan,
    flatten_plan,
)
from gn0.avatars.motion.turns import slerp_one, unit_quat
from gn0.avatars.skeleton import INDEX, JOINT_COUNT
from gn0.geometry import F64
from gn0.jit import njit, njit_borrowing, prange

STEP_LIFT = 0.035  # m that a foot is lifted as it steps on the spot
SPAN = 0.998  # of a leg, at most, of who sets off or stops
# where the numbers of a frame begin: see `legs.flatten_plan`
_PELVIS, _TURN, _ANKLES, _FEET, _TOES, _KNEES, _UPPER = 0, 3, 7, 13, 21, 23, 25
_AT = np.stack([HIPS, KNEES, ANKLES, TOES])
_NECK, _HEAD = INDEX["neck"], INDEX["head"]
_LOOKS_MOST = math.pi / 3  # rad


@njit_borrowing
def mix_frames(first, second, share, out):  # type: ignore[no-untyped-def]
    """The `share` of the way between frames; `out` may be one of them."""
    _line(first, second, share, _PELVIS, 3, out)
    slerp_one(first, second, share, out, _TURN)
    _line(first, second, share, _ANKLES, 6, out)
    for k in range(2):
        slerp_one(first, second, share, out, _FEET + 4 * k)
    _line(first, second, share, _TOES, 4, out)
    for j in range(JOINT_COUNT):
        slerp_one(first, second, share, out, _UPPER + 4 * j)


@njit_borrowing
def _line(first, second, share, begin, count, out):  # type: ignore[no-untyped-def]
    for k in range(begin, begin + count):
        out[k] = first[k] * (1.0 - share) + second[k] * share


@njit_borrowing
def _ease(u):  # type: ignore[no-untyped-def]
    """As `standing.ease`."""
    x = min(max(u, 0.0), 1.0)
    return x * x * x * (10.0 + x * (6.0 * x - 15.0))


@njit
def step_frames(joints, first, second, share, early, stops, stood, turned):  # type: ignore[no-untyped-def]
    """Mix `second` into `first`, one foot after the other, and lifted; both are written to.

    The last four are those of `stepping.Steps`.
    """
    if stops:  # feet of the walk stay as the body turns on them
        c, s = math.cos(-turned), math.sin(-turned)
        w, y = math.cos(-turned / 2.0), math.sin(-turned / 2.0)
        for k in range(2):
            a, q = _ANKLES + 3 * k, _FEET + 4 * k
            x, z = first[a], first[a + 2]
            first[a], first[a + 2] = c * x + s * z, c * z - s * x
            q0, q1, q2, q3 = first[q], first[q + 1], first[q + 2], first[q + 3]
            first[q], first[q + 1] = w * q0 - y * q2, w * q1 + y * q3
            first[q + 2], first[q + 3] = w * q2 + y * q0, w * q3 - y * q1
            first[_KNEES + k] -= 0.7 * turned
            second[a] -= stood * math.sin(turned)
            second[a + 2] += stood * math.cos(turned)
    else:
        for k in range(2):
            first[_ANKLES + 3 * k + 2] += stood
    # who sets off may still be turning, and what is down would turn with him: down in the end
    quick = 2.0 if stops else 1.6
    feet = np.empty(18)  # ankles, feet, toes, knees
    for k in range(2):
        u = min(max(quick * share if k == early else 2.0 * share - 1.0, 0.0), 1.0)
        part, a = _ease(u), _ANKLES + 3 * k
        away = 0.0
        for axis in range(3):
            away += (second[a + axis] - first[a + axis]) ** 2
            feet[3 * k + axis] = first[a + axis] * (1.0 - part) + second[a + axis] * part
        middle = (2.0 * u - 1.0) * (2.0 * u - 1.0)
        feet[3 * k + 1] += STEP_LIFT * (1.0 - middle * middle) * min(math.sqrt(away) / 0.05, 1.0)
        slerp_one(first, second, part, feet, 6 + 4 * k, _FEET + 4 * k)
        feet[14 + k] = first[_TOES + k] * (1.0 - part) + second[_TOES + k] * part
        feet[16 + k] = first[_KNEES + k] * (1.0 - part) + second[_KNEES + k] * part
    mix_frames(first, second, share, first)
    for k in range(18):
        first[_ANKLES + k] = feet[k]
    first[_PELVIS + 1] = min(first[_PELVIS + 1], _highest_pelvis(joints, first))


@njit
def _highest_pelvis(joints, frame):  # type: ignore[no-untyped-def]
    """As `legs.highest_pelvis`, of legs that are `SPAN` of their length."""
    turn, hip = np.empty((3, 3)), np.empty(3)
    _matrix(frame, _TURN, turn)
    found = math.inf
    for k in range(2):
        _hip(joints, frame, turn, k, hip)
        length = SPAN * (_bone(joints, 0, k) + _bone(joints, 1, k))
        a = _ANKLES + 3 * k
        level = (hip[0] - frame[a]) ** 2 + (hip[2] - frame[a + 2]) ** 2
        room = math.sqrt(max(length * length - level, 0.0))
        found = min(found, frame[a + 1] + room - (hip[1] - frame[_PELVIS + 1]))
    return found


@njit_borrowing
def _bone(joints, part, k):  # type: ignore[no-untyped-def]
    """Length of a thigh (0) or shank (1) at rest."""
    one, other = _AT[part, k], _AT[part + 1, k]
    total = 0.0
    for a in range(3):
        total += (joints[other, a] - joints[one, a]) ** 2
    return math.sqrt(total)


@njit_borrowing
def _hip(joints, frame, turn, k, out):  # type: ignore[no-untyped-def]
    """Where a hip joint is."""
    j = _AT[0, k]
    x, y, z = joints[j, 0] - joints[0, 0], joints[j, 1] - joints[0, 1], joints[j, 2] - joints[0, 2]
    for a in range(3):
        out[a] = frame[_PELVIS + a] + (turn[a, 0] * x + turn[a, 1] * y + turn[a, 2] * z)


@njit_borrowing
def _matrix(quats, at, out):  # type: ignore[no-untyped-def]
    """As `gn0.geometry.rotation_from_quaternion`, of the four numbers from `at` on."""
    w, x, y, z = quats[at], quats[at + 1], quats[at + 2], quats[at + 3]
    out[0, 0], out[0, 1] = 1 - 2 * (y * y + z * z), 2 * (x * y - w * z)
    out[0, 2], out[1, 0] = 2 * (x * z + w * y), 2 * (x * y + w * z)
    out[1, 1], out[1, 2] = 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)
    out[2, 0], out[2, 1] = 2 * (x * z - w * y), 2 * (y * z + w * x)
    out[2, 2] = 1 - 2 * (x * x + y * y)


@njit_borrowing
def _quat(m, out):  # type: ignore[no-untyped-def]
    """Unit quaternion of a matrix [3, 3]."""
    out[0], out[1], out[2], out[3] = unit_quat(
        m[0, 0], m[0, 1], m[0, 2], m[1, 0], m[1, 1], m[1, 2], m[2, 0], m[2, 1], m[2, 2]
    )


@njit_borrowing
def _vector(w, x, y, z, out):  # type: ignore[no-untyped-def]
    """As `turns.vectors_of_quats`."""
    if w < 0:
        w, x, y, z = -w, -x, -y, -z
    length = math.sqrt(x * x + y * y + z * z)
    scale = 2.0
    if length > 1e-12:
        scale = 2.0 * math.atan2(length, w) / length
    out[0], out[1], out[2] = scale * x, scale * y, scale * z


@njit_borrowing
def _axes(hinge, bone, out):  # type: ignore[no-untyped-def]
    """Columns: across a bone, in its hinge; along it; and across both."""
    length = math.sqrt(bone[0] * bone[0] + bone[1] * bone[1] + bone[2] * bone[2])
    u, v, w = bone[0] / length, bone[1] / length, bone[2] / length
    dot = hinge[0] * u + hinge[1] * v + hinge[2] * w
    x, y, z = hinge[0] - dot * u, hinge[1] - dot * v, hinge[2] - dot * w
    length = math.sqrt(x * x + y * y + z * z)
    x, y, z = x / length, y / length, z / length
    out[0, 0], out[1, 0], out[2, 0] = x, y, z
    out[0, 1], out[1, 1], out[2, 1] = u, v, w
    out[0, 2], out[1, 2], out[2, 2] = y * w - z * v, z * u - x * w, x * v - y * u


@njit_borrowing
def _times(a, b, out):  # type: ignore[no-untyped-def]
    """A matrix times the transpose of another."""
    for i in range(3):
        for j in range(3):
            out[i, j] = a[i, 0] * b[j, 0] + a[i, 1] * b[j, 1] + a[i, 2] * b[j, 2]


@njit_borrowing
def _back_times(a, b, out):  # type: ignore[no-untyped-def]
    """The transpose of a matrix times another."""
    for i in range(3):
        for j in range(3):
            out[i, j] = a[0, i] * b[0, j] + a[1, i] * b[1, j] + a[2, i] * b[2, j]


@njit
def solve_frame(joints, frame, pose, shift):  # type: ignore[no-untyped-def]
    """Write the pose [55, 3] rad and shift [3] m of a frame of a body; see `solve_plan`."""
    turn, hip = np.empty((3, 3)), np.empty(3)
    u, front, hinge, knee, low = (
        np.empty(3), np.empty(3), np.empty(3), np.empty(3), np.empty(3),
    )  # fmt: skip
    rest, bent = np.empty((3, 3)), np.empty((3, 3))
    thigh, shank, foot = np.empty((3, 3)), np.empty((3, 3)), np.empty((3, 3))
    side, bone, quat = np.zeros(3), np.empty(3), np.empty(4)
    side[0] = 1.0
    _matrix(frame, _TURN, turn)
    for j in range(JOINT_COUNT):
        at = _UPPER + 4 * j
        _vector(frame[at], frame[at + 1], frame[at + 2], frame[at + 3], pose[j])
    _vector(frame[_TURN], frame[_TURN + 1], frame[_TURN + 2], frame[_TURN + 3], pose[0])
    for k in range(2):
        _hip(joints, frame, turn, k, hip)
        upper, lower = _bone(joints, 0, k), _bone(joints, 1, k)
        away = 0.0
        for a in range(3):
            u[a] = frame[_ANKLES + 3 * k + a] - hip[a]
            away += u[a] * u[a]
        away = math.sqrt(away)
        for a in range(3):
            u[a] = u[a] / away
        span = min(max(away, 0.25 * (upper + lower)), 0.9995 * (upper + lower))
        half = frame[_KNEES + k] / 2.0
        w, y = math.cos(half), math.sin(half)
        front[0], front[1], front[2] = 2 * (w * y), 0.0, 1 - 2 * (y * y)
        dot = front[0] * u[0] + front[1] * u[1] + front[2] * u[2]
        length = 0.0
        for a in range(3):
            front[a] -= dot * u[a]
            length += front[a] * front[a]
        length = math.sqrt(length)
        for a in range(3):
            front[a] = front[a] / length
        cosine = (upper * upper + span * span - lower * lower) / (2.0 * upper * span)
        cosine = min(max(cosine, -1.0), 1.0)
        sine = math.sqrt(1.0 - cosine * cosine)
        for a in range(3):
            knee[a] = upper * (cosine * u[a] + sine * front[a])
            low[a] = u[a] * span - knee[a]
        hinge[0] = front[1] * u[2] - front[2] * u[1]
        hinge[1] = front[2] * u[0] - front[0] * u[2]
        hinge[2] = front[0] * u[1] - front[1] * u[0]
        for a in range(3):
            bone[a] = joints[_AT[1, k], a] - joints[_AT[0, k], a]
        _axes(side, bone, rest)
        _axes(hinge, knee, bent)
        _times(bent, rest, thigh)
        for a in range(3):
            bone[a] = joints[_AT[2, k], a] - joints[_AT[1, k], a]
        _axes(side, bone, rest)
        _axes(hinge, low, bent)
        _times(bent, rest, shank)
        _matrix(frame, _FEET + 4 * k, foot)
        _back_times(turn, thigh, rest)
        _quat(rest, quat)
        _vector(quat[0], quat[1], quat[2], quat[3], pose[_AT[0, k]])
        _back_times(thigh, shank, rest)
        _quat(rest, quat)
        _vector(quat[0], quat[1], quat[2], quat[3], pose[_AT[1, k]])
        _back_times(shank, foot, rest)
        _quat(rest, quat)
        _vector(quat[0], quat[1], quat[2], quat[3], pose[_AT[2, k]])
        half = -frame[_TOES + k] / 2.0
        _vector(math.cos(half), math.sin(half), 0.0, 0.0, pose[_AT[3, k]])
    for a in range(3):
        shift[a] = frame[_PELVIS + a] - joints[0, a]


@njit_borrowing
def look_aside(pose, yaw):  # type: ignore[no-untyped-def]
    """Turn the head of a pose [55, 3] by a yaw more; see `library.turn_head`."""
    half = min(max(yaw, -_LOOKS_MOST), _LOOKS_MOST) / 2.0 / 2.0
    c, s = math.cos(half), math.sin(half)
    for j in (_NECK, _HEAD):
        x, y, z = pose[j, 0], pose[j, 1], pose[j, 2]
        angle = math.sqrt(x * x + y * y + z * z)
        w, scale = math.cos(angle / 2.0), 0.5
        if angle > 0.0:
            scale = math.sin(angle / 2.0) / angle
        x, y, z = scale * x, scale * y, scale * z
        _vector(c * w - s * y, c * x + s * z, c * y + s * w, c * z - s * x, pose[j])


def solve_plan(build: Build, plan: Plan) -> tuple[F64, F64]:
    """Poses [T, 55, 3] rad and shifts [T, 3] m of a plan.

    Legs follow by two-bone inverse kinematics in closed form. Knees bend to the front alone; a foot
    out of reach is reached for with a straight leg.
    """
    count = len(plan)
    poses, shifts = np.empty((count, JOINT_COUNT, 3)), np.empty((count, 3))
    frames = flatten_plan(plan)
    _solve_frames(np.ascontiguousarray(build.joints, np.float64), frames, poses, shifts)
    return poses, shifts


def blend_ends(
    joints: F64, ends: F64, parts: F64, share: F64, steps: F64 | None
) -> tuple[F64, F64]:
    """Poses [T, 55, 3] rad and shifts [T, 3] m of blends between two clips each.

    Args:
        joints: of each body at rest [T, 55, 3] m.
        ends: frames [T, 4, 245]: before and after where the first clip is read, and the second.
        parts: of the way between those [T, 2].
        share: of the way from one clip to the other [T].
        steps: early, stops, stood and turned of `stepping.Steps` [T, 4]; without, feet slide.
    """
    count = len(share)
    poses, shifts = np.empty((count, JOINT_COUNT, 3)), np.empty((count, 3))
    _blend_ends(
        joints, ends, parts, share, np.empty((0, 4)) if steps is None else steps, poses, shifts
    )
    return poses, shifts


@njit(parallel=True)
def _solve_frames(joints, frames, poses, shifts):  # type: ignore[no-untyped-def]
    for n in prange(frames.shape[0]):
        solve_frame(joints, frames[n], poses[n], shifts[n])


@njit(parallel=True)
def _blend_ends(joints, ends, parts, share, steps, poses, shifts):  # type: ignore[no-untyped-def]
    for n in prange(share.shape[0]):
        first, second = np.empty(FLAT_WIDTH), np.empty(FLAT_WIDTH)
        mix_frames(ends[n, 0], ends[n, 1], parts[n, 0], first)
        mix_frames(ends[n, 2], ends[n, 3], parts[n, 1], second)
        if steps.shape[0]:
            early, stops = int(steps[n, 0]), steps[n, 1] > 0.0
            step_frames(joints[n], first, second, share[n], early, stops, steps[n, 2], steps[n, 3])
        else:
            mix_frames(first, second, share[n], first)
        solve_frame(joints[n], first, poses[n], shifts[n])
