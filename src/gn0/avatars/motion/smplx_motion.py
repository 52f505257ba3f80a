"""Poses of SMPL and its kin: AMASS (SMPL-H and SMPL-X), and plain arrays of 165 numbers a frame.

AMASS has z up and its own person facing −y; that is turned to y up. As the root turns about its own
joint p0, a change of frame R also moves: t' = R (t + p0) − p0. Source: the files of AMASS
(Mahmood et al. 2019) and of `vchoutas/smplx`, whose code is not used.
"""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gn0.avatars.motion.motion import FAR, TURNS, Motion, build_motion, check_finite
from gn0.avatars.motion.standing_joints import STANDING_JOINTS, hip_height_of
from gn0.avatars.motion.turns import (
    as_numbers,
    matrices_of,
    multiply,
    quats_of,
    quats_of_matrices,
    vectors_of_quats,
)
from gn0.avatars.npz_arrays import ArrayFile, read_npy
from gn0.avatars.skeleton import INDEX, JOINT_COUNT
from gn0.errors import FormatError
from gn0.geometry import F64

Z_UP = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]])  # (x, y, z) → (x, z, −y)
Y_DOWN = np.diag([1.0, -1.0, -1.0])  # half a turn about x
PLAIN_FPS = 30.0
_BODY = 22  # joints that all of the family have
_HANDS = INDEX["left_index1"]
_RATES = ("mocap_framerate", "mocap_frame_rate", "fps")
_PARTS = ("root_orient", "pose_body")
_FASTEST = 12.5  # m/s that a person has run


def turn_frame(
    poses: NDArray[np.floating], shift: NDArray[np.floating], turn: F64, pelvis: F64
) -> tuple[F64, F64]:
    """Poses and shifts in another frame.

    Args:
        poses: axis-angle [T, 55, 3] rad.
        shift: added after the pose [T, 3] m.
        turn: rotation from the old frame to the new one [3, 3].
        pelvis: the root joint at rest [3] m.

    Returns:
        poses [T, 55, 3] and shifts [T, 3], t' = R (t + p0) − p0.
    """
    turned = np.array(poses, np.float64)
    turned[:, 0] = vectors_of_quats(multiply(quats_of_matrices(turn), quats_of(turned[:, 0])))
    return turned, (np.asarray(shift, np.float64) + pelvis) @ turn.T - pelvis


def tell_posture(poses: F64, where: str) -> tuple[str, ...]:
    """A note where most of the poses [T, 55, 3], in y up, do not stand; `where` says in what."""
    up = matrices_of(quats_of(poses[:, 0]))[:, 1, 1]
    standing = float(np.median(up)) if len(up) else 1.0
    if standing < -0.5:
        return ("upside down: perhaps its frame is a camera's, with y down, as LHM's frames have",)
    return (f"does not stand {where}",) if standing < 0.5 else ()


def tell_pace(shift: F64, fps: float) -> tuple[str, ...]:
    """A note where a way [T, 3] m is faster than any person's, as one in centimetres is."""
    if len(shift) < 2 or not fps > 0:
        return ()
    pace = float(np.quantile(np.linalg.norm(np.diff(shift, axis=0), axis=1), 0.9)) * fps
    if not pace > _FASTEST:
        return ()
    return (f"goes at {pace:.0f} m/s: trans is read in metres, perhaps it is in centimetres",)


def is_smpl(names: frozenset[str]) -> bool:
    """Whether the members of an .npz are those of AMASS or of SMPL-X."""
    return {"poses", "trans"} <= names or {"root_orient", "pose_body"} <= names


def decode_smplx_npz(arrays: ArrayFile, joints: NDArray[np.floating] | None = None) -> Motion:
    """The motion of an AMASS .npz, z up: SMPL-H poses [T, 156], or SMPL-X [T, 165] or its parts.

    Args:
        arrays: the open file.
        joints: joints of the body at rest [55, 3] m; an average body by default.

    Raises:
        FormatError: members missing or of other shapes, numbers that are not finite, or no rate.
    """
    file, names = arrays.path, arrays.names
    body = STANDING_JOINTS if joints is None else np.asarray(joints, np.float64)
    poses = _poses(arrays)
    rate = next((name for name in _RATES if name in names), None)
    if rate is None:
        raise arrays.refuse(
            f"has no frame rate ({' or '.join(_RATES)})", remedy="add mocap_frame_rate"
        )
    fps = float(arrays.read_numbers(rate, ()))
    shift = (
        arrays.read_numbers("trans", (None, 3)) if "trans" in names else np.zeros((len(poses), 3))
    )
    if len(shift) != len(poses):
        raise arrays.refuse(f"{len(shift)} places for {len(poses)} poses", field="trans")
    _check_numbers(poses, shift, file)
    poses, shift = turn_frame(poses, shift, Z_UP, body[0])
    posture = tell_posture(poses, "in a file that is read with z up: perhaps y is up there")
    model = arrays.text("surface_model_type") or ("smplh" if _width(arrays) == 156 else "smplx")
    return build_motion(
        file,
        poses=poses,
        shift=shift,
        fps=fps,
        hip_height=hip_height_of(body),
        name=Path(file).stem,
        notes=(
            f"{model[:20]}, z up; its betas are left: they shape another body than ours",
            *posture,
            *tell_pace(shift, fps),
        ),
    )


def _width(arrays: ArrayFile) -> int:
    shape = arrays.read("poses").shape if "poses" in arrays.names else ()
    return shape[1] if len(shape) == 2 else 0


def _poses(arrays: ArrayFile) -> F64:
    """Axis-angles [T, 55, 3] of whichever members there are."""
    names = arrays.names
    if "poses" in names:
        values = arrays.read_numbers("poses", (None, None))
        return widen_poses(values, arrays.path)
    root = arrays.read_numbers("root_orient", (None, 3))
    parts = {
        "root_orient": root,
        "pose_body": arrays.read_numbers("pose_body", (None, 63)),
    }
    whole = np.zeros((len(root), JOINT_COUNT * 3))
    for name, width, first in (
        ("root_orient", 3, 0), ("pose_body", 63, 3), ("pose_jaw", 3, 66), ("pose_eye", 6, 69),
        ("pose_hand", 90, 75),
    ):  # fmt: skip
        if name in names:
            part = parts[name] if name in parts else arrays.read_numbers(name, (None, width))
            if len(part) != len(root):
                raise arrays.refuse(
                    f"{len(part)} frames, and {len(root)} of root_orient", field=name
                )
            whole[:, first : first + width] = part
    return whole.reshape(len(whole), JOINT_COUNT, 3)


def widen_poses(values: NDArray[np.floating], file: Path | str) -> F64:
    """Axis-angles [T, 55, 3] of SMPL-X [T, 165], SMPL-H [T, 156] or body [T, 66] numbers.

    Raises:
        FormatError: another width.
    """
    width = values.shape[1]
    if width == JOINT_COUNT * 3:
        return np.asarray(values, np.float64).reshape(len(values), JOINT_COUNT, 3)
    if width not in (156, 66):
        raise FormatError(
            f"{width} numbers a frame are not poses of SMPL-X (165), SMPL-H (156) or a body (66)",
            file=file,
            field="poses",
            remedy="give axis-angles of 55, 52 or 22 joints",
        )
    whole = np.zeros((len(values), JOINT_COUNT, 3))
    whole[:, :_BODY] = values[:, : _BODY * 3].reshape(len(values), _BODY, 3)
    if width == 156:  # no jaw and no eyes; the hands follow the body, in the order of SMPL-X
        whole[:, _HANDS:] = values[:, _BODY * 3 :].reshape(len(values), 30, 3)
    return whole


def _check_numbers(poses: F64, shift: F64, file: Path | str) -> None:
    check_finite(poses, file, "poses", TURNS)
    check_finite(shift, file, "trans", FAR)


def decode_plain_poses(
    data: bytes, file: Path | str, joints: NDArray[np.floating] | None = None
) -> Motion:
    """The motion of a plain .npy of poses [T, 165] or [T, 55, 3], y up, on the spot.

    Raises:
        FormatError: another shape, no numbers, or Python objects.
    """
    values: NDArray[Any] = read_npy(data, file)
    if values.dtype.kind not in "fiu" or values.ndim not in (2, 3):
        raise FormatError(
            f"an array {values.shape} of {values.dtype.str} is not a motion",
            file=file,
            remedy="give poses (T, 165) or (T, 55, 3), in radians",
        )
    if values.ndim == 3 and values.shape[1:] != (JOINT_COUNT, 3):
        raise FormatError(
            f"an array {values.shape} is not a motion", file=file, remedy="give poses (T, 55, 3)"
        )
    body = STANDING_JOINTS if joints is None else np.asarray(joints, np.float64)
    flat = as_numbers(values).reshape(len(values), math.prod(values.shape[1:]))
    poses = widen_poses(flat, file)
    shift = np.zeros((len(poses), 3))
    _check_numbers(poses, shift, file)
    notes = [
        f"a plain array says no rate: {PLAIN_FPS:g} frames a second were taken; on the spot",
        *tell_posture(
            poses,
            "in a frame with y up: perhaps z is up there, as in an .npz of poses, trans and "
            "mocap_frame_rate",
        ),
    ]
    return build_motion(
        file,
        poses=poses,
        shift=shift,
        fps=PLAIN_FPS,
        hip_height=hip_height_of(body),
        name=Path(file).stem,
        notes=tuple(notes),
    )
