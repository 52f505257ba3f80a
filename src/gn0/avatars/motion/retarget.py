"""From a rig of whatever names, axes and units to our 55 joints, by algebra of rest poses.

D(t) = G(t) G_rest⁻¹ is how a joint of the rig has turned since its rest; our joint takes D O, where
O turns our bone at rest into the rig's (its A-pose, say). O is left out at ankles, feet, collars
and hands: there it is the rig's anatomy, and would tilt the soles. Where a rig has joints in
between, or its bones stretch, a bone is turned on by the least angle to where its end is. The way
of the hips is scaled by the height of the hips. Source: rest-pose transfer as in A. Gleicher,
Retargetting Motion to New Characters (1998), without its solver.
"""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from gn0.avatars.motion.feet import move_joints
from gn0.avatars.motion.motion import Motion, build_motion
from gn0.avatars.motion.name_maps import JointMap, axis_name, map_joints, rest_axes, snap_axis
from gn0.avatars.motion.rig import RigMotion, global_frames
from gn0.avatars.motion.standing_joints import FEET, hip_height_of
from gn0.avatars.motion.turns import (
    angles_between,
    least_turns,
    quats_of_matrices,
    vectors_of_quats,
)
from gn0.avatars.skeleton import INDEX, JOINT_COUNT, JOINTS, PARENTS
from gn0.errors import DataError, FormatError
from gn0.geometry import F64

_BLOCK = 256  # frames at once
_CHAINS: tuple[tuple[str, ...], ...] = (
    ("spine1", "spine2", "spine3", "neck", "head"),
    *((f"{s}_hip", f"{s}_knee", f"{s}_ankle") for s in ("left", "right")),
    *((f"{s}_shoulder", f"{s}_elbow", f"{s}_wrist") for s in ("left", "right")),
    *(
        tuple(f"{s}_{f}{k}" for k in (1, 2, 3))
        for s in ("left", "right")
        for f in ("index", "middle", "pinky", "ring", "thumb")
    ),
)
_CHEST = INDEX["spine3"]
_CMU = 0.056444  # m; they left an inch of 0.45 in their files
_UNITS = (
    (1.0, "metres"), (0.01, "centimetres"), (0.1, "decimetres"), (0.001, "millimetres"),
    (0.0254, "inches"), (0.3048, "feet"), (_CMU, "the units of CMU (0.0564 m)"),
)  # fmt: skip
_NEAR_FLOOR = 0.05  # m
_ADULT = (0.7, 1.35)  # m, hips of adults, tall cartoons included


def bone_ends(joints: JointMap) -> dict[int, int]:
    """By joint of ours, the joint at which its bone ends: bones whose direction is carried over.

    The chest is none, as neck and arms hang on it; a bone ends at the next joint that the rig has.
    """
    ends: dict[int, int] = {}
    for chain in _CHAINS:
        held = [INDEX[name] for name in chain if name in joints]
        for start, end in pairwise(held):
            if start != _CHEST:
                ends[start] = end
    return ends


def retarget(rig: RigMotion, joints: NDArray[np.floating], file: Path | str = "") -> Motion:
    """The motion of a rig as that of a body, its lowest foot on the floor, from the origin on.

    Args:
        rig: what a reader gives.
        joints: joints of the body at rest [55, 3] m: a T-pose, y up, +z to the front.
        file: for messages.

    Raises:
        FormatError: joints that cannot be matched (they are named), a rest pose that does not
            stand, or a motion that is none.
    """
    rest = check_joints(joints)
    known = map_joints(rig, file)
    to_rest, stands = rest_axes(rig, known, file)
    to_world, notes = _world_axes(rig, known, to_rest, stands)
    source_hips = _hip_height(rig.rest_positions @ to_rest.T, known)
    body_hips = hip_height_of(rest)
    if not source_hips > 0:
        raise FormatError(
            "the hips lie below the feet at rest", file=file, field="rest", remedy="check the rig"
        )
    notes.append(_unit_note(rig, source_hips))
    ends = bone_ends(known)
    offsets = rest_offsets(rig, known, rest, to_rest, ends)
    poses = np.empty((len(rig), JOINT_COUNT, 3))
    way = np.empty((len(rig), 3))
    for first in range(0, len(rig), _BLOCK):
        turned, placed = global_frames(rig, first, first + _BLOCK)
        part = slice(first, first + len(turned))
        poses[part] = _poses(rig, known, turned, placed, to_rest, to_world, offsets, ends)
        way[part] = placed[:, known["pelvis"]] @ to_world.T
    way *= body_hips / source_hips
    way -= [way[0, 0], 0.0, way[0, 2]]
    motion = build_motion(
        file,
        poses=poses,
        shift=way,
        fps=rig.fps,
        hip_height=body_hips,
        name=rig.name,
        notes=(*rig.notes, *known.notes, *notes),
    )
    return _put_on_floor(motion, rest)


def check_joints(joints: NDArray[np.floating]) -> F64:
    """Joints of a body at rest [55, 3] as float64.

    Raises:
        DataError: another shape, not finite, or no person who stands.
    """
    rest = np.asarray(joints, np.float64)
    if rest.shape != (JOINT_COUNT, 3) or not np.isfinite(rest).all():
        raise DataError(
            f"joints of a body are 55 finite places, not {rest.shape}",
            where="joints",
            remedy="give the joints of a body at rest",
        )
    if not 0.1 < hip_height_of(rest) < 10 or rest[1, 0] <= rest[2, 0]:
        raise DataError(
            "joints of a body do not stand: y is up, +x is the person's left, in metres",
            where="joints",
            remedy="give the joints of a body at rest",
        )
    return rest


def bone_errors(
    rig: RigMotion, motion: Motion, joints: NDArray[np.floating], file: Path | str = ""
) -> dict[str, float]:
    """By bone, the largest angle [degrees] between where it points in the rig and in the motion.

    Args:
        rig: the source.
        motion: what `retarget` made of it, frame by frame.
        joints: joints of the body at rest [55, 3] m.
        file: for messages.
    """
    known = map_joints(rig, file)
    to_rest, stands = rest_axes(rig, known, file)
    to_world, _ = _world_axes(rig, known, to_rest, stands)
    worst: dict[str, float] = {}
    for first in range(0, len(rig), _BLOCK):
        _, placed = global_frames(rig, first, first + _BLOCK)
        _, ours = move_joints(motion, joints, first, first + len(placed))
        for start, end in bone_ends(known).items():
            theirs = placed[:, known.joint[end]] - placed[:, known.joint[start]]
            angle = angles_between(theirs @ to_world.T, ours[:, end] - ours[:, start])
            name = JOINTS[start]
            worst[name] = max(worst.get(name, 0.0), float(np.rad2deg(angle.max())))
    return worst


def _poses(
    rig: RigMotion,
    known: JointMap,
    turned: F64,
    placed: F64,
    to_rest: F64,
    to_world: F64,
    offsets: dict[int, F64],
    ends: dict[int, int],
) -> F64:
    """Axis-angles [N, 55, 3] of a block of frames."""
    ours = np.empty((len(turned), JOINT_COUNT, 3, 3))
    poses = np.zeros((len(turned), JOINT_COUNT, 3))
    for k, parent in enumerate(PARENTS):
        joint = known.joint.get(k)
        if joint is None:  # goes with its parent
            ours[:, k] = ours[:, parent]
            continue
        back = rig.rest_rotations[joint].T @ to_rest.T
        change = to_world @ turned[:, joint] @ back
        if k in ends:
            end = known.joint[ends[k]]
            bone = to_rest @ (rig.rest_positions[end] - rig.rest_positions[joint])
            there = (placed[:, end] - placed[:, joint]) @ to_world.T
            change = least_turns(change @ bone, there) @ change
        ours[:, k] = change @ offsets[k] if k in offsets else change
        above = ours[:, k] if parent < 0 else np.swapaxes(ours[:, parent], -1, -2) @ ours[:, k]
        poses[:, k] = vectors_of_quats(quats_of_matrices(above))
    return poses


def rest_offsets(
    rig: RigMotion, known: JointMap, rest: F64, to_rest: F64, ends: dict[int, int]
) -> dict[int, F64]:
    """O of each joint that has one [3, 3]; a hand keeps that of its forearm."""
    offsets: dict[int, F64] = {}
    for k, parent in enumerate(PARENTS):
        if k not in known.joint:
            continue
        arm = JOINTS[k].endswith(("_elbow", "_wrist")) or k >= INDEX["left_index1"]
        before = offsets.get(parent, np.eye(3)) if arm else np.eye(3)
        if k in ends:
            end = ends[k]
            theirs = to_rest @ (
                rig.rest_positions[known.joint[end]] - rig.rest_positions[known.joint[k]]
            )
            offsets[k] = least_turns(before @ (rest[end] - rest[k]), theirs) @ before
        elif arm:
            offsets[k] = before
    return offsets


def _world_axes(
    rig: RigMotion, known: JointMap, to_rest: F64, stands: str
) -> tuple[F64, list[str]]:
    """Rotation [3, 3] from the file's axes in motion to those of bodies, and what to say of it."""
    notes: list[str] = []
    up = to_rest[1]
    moving = _moving_up(rig, known)
    upright = (moving @ up > 0.5).mean()
    if upright < 0.1:  # it does not stand as it rests: lying people, or other axes at rest
        middle = snap_axis(np.median(moving, axis=0), 20.0)
        steady = (moving @ middle > np.cos(np.deg2rad(35.0))).mean() > 0.9
        said = axis_name(middle) == rig.up if rig.up else True
        if steady and said and axis_name(middle):
            turn = least_turns(middle, up)
            notes.append(f"stands along {axis_name(middle)} in motion and {stands or '?'} at rest")
            return to_rest @ turn, notes
    if rig.up and stands and rig.up != stands:
        notes.append(
            f"the file says {rig.up} is up, but its people stand along {stands}: corrected"
        )
    else:
        notes.append(f"{stands or 'a slanting axis'} is up")
    return to_rest, notes


def _moving_up(rig: RigMotion, known: JointMap) -> F64:
    """From ankles to shoulders, unit vectors [N, 3] of up to 256 frames."""
    stride = -(-len(rig) // _BLOCK)
    part = replace(rig, quats=rig.quats[::stride], translations=rig.translations[::stride])
    _, placed = global_frames(part)
    ends = [
        (placed[:, known[f"left_{name}"]] + placed[:, known[f"right_{name}"]]) / 2
        for name in ("ankle", "shoulder")
    ]
    span = ends[1] - ends[0]
    unit: F64 = span / np.maximum(np.linalg.norm(span, axis=1, keepdims=True), 1e-300)
    return unit


def _hip_height(place: F64, known: JointMap) -> float:
    """Height of the hips of a rig at rest, its legs stretched straight down, in its units."""
    legs = lowest = 0.0
    for side in ("left", "right"):
        hip, knee, ankle = (place[known[f"{side}_{part}"]] for part in ("hip", "knee", "ankle"))
        length = float(np.linalg.norm(hip - knee) + np.linalg.norm(knee - ankle))
        above = float(place[known["pelvis"], 1] - hip[1])
        toe = place[known[f"{side}_foot"], 1] if f"{side}_foot" in known else ankle[1]
        legs += (length + above) / 2
        lowest = max(lowest, float(ankle[1] - toe))
    return legs + lowest


def _unit_note(rig: RigMotion, hips: float) -> str:
    """What a unit is, by the file and by the height of the hips."""
    said = "" if rig.metres is None else f"the file says a unit is {rig.metres:g} m; "
    if rig.metres is not None and _ADULT[0] <= hips * rig.metres <= _ADULT[1]:
        return f"a unit is {rig.metres:g} m, hips {hips * rig.metres:.2f} m high"
    for metres, name in _UNITS:
        most = 1.1 if metres == _CMU else _ADULT[1]
        if _ADULT[0] <= hips * metres <= most:
            return f"{said}by its hips, {hips * metres:.2f} m high, it is in {name}"
    return f"{said}hips {hips:.3g} units high; scaled by them alone"


def tell_lift(motion: Motion, rest: F64) -> Motion:
    """The same motion, which says so where both feet of a body [55, 3] m leave the floor."""
    return replace(motion, notes=(*motion.notes, *_lift(motion, rest)[1]))


def put_on_floor(motion: Motion, rest: F64) -> Motion:
    """The same motion of a body [55, 3] m, its lowest foot on the floor; a note if it moved.

    What a camera saw knows no floor, and a capture's is that of another body. Within 5 cm it stays.
    """
    down, _ = _lift(motion, rest)
    if abs(down) <= _NEAR_FLOOR:
        return motion
    side = "above" if down > 0 else "under"
    note = f"was {abs(down):.2f} m {side} the floor: its lowest foot is put on it"
    shift = motion.shift - [0.0, down, 0.0]
    return replace(motion, shift=shift, notes=(*motion.notes, note))


def _put_on_floor(motion: Motion, rest: F64) -> Motion:
    """The same motion with its lowest foot as high as at rest, and what was unusual about it."""
    down, notes = _lift(motion, rest)
    shift = motion.shift - [0.0, down, 0.0]
    return replace(motion, shift=shift, notes=(*motion.notes, *notes))


def _lift(motion: Motion, rest: F64) -> tuple[float, list[str]]:
    """How high the lowest foot ever is above where it rests [m], and a note of those who fly."""
    feet = list(FEET)
    low = np.empty(len(motion))
    for first in range(0, len(motion), _BLOCK):
        _, placed = move_joints(motion, rest, first, first + _BLOCK)
        low[first : first + len(placed)] = (placed[:, feet, 1] - rest[feet, 1]).min(axis=1)
    down = float(low.min())
    away = float((low - down).max())
    if away <= 0.6:
        return down, []
    return down, [f"leaves the floor: at times the lower foot is {away:.2f} m above it"]
