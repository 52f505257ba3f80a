"""Frames that LHM's pose estimation writes: smplx_params/00001.json, …, one person, one camera.

A document of ours, smplx.json, holds such frames in one file, and their rate.
The frame is the camera's, y down; it is turned by half about x. Betas are left: they shape another
body than ours. Source: `aigc3d/LHM`, engine/pose_estimation/video2motion.py (read, not used).
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path

import msgspec
import numpy as np
from numpy.typing import NDArray

from gn0.avatars.motion.motion import FAR, TURNS, Motion, build_motion, check_finite
from gn0.avatars.motion.smplx_motion import (
    PLAIN_FPS,
    Y_DOWN,
    tell_pace,
    tell_posture,
    turn_frame,
)
from gn0.avatars.motion.standing_joints import STANDING_JOINTS, hip_height_of
from gn0.avatars.skeleton import JOINT_COUNT
from gn0.errors import FormatError
from gn0.geometry import F64
from gn0.storage import plain_path, read_bytes, storage_error, write_bytes

FRAME_LIMIT = 1 << 16  # bytes of one frame; real ones have six thousand
_MOST = 20_000  # frames
FOLDER = "smplx_params"
_PARTS = (
    ("root_pose", 0, 1), ("body_pose", 1, 21), ("jaw_pose", 22, 1), ("leye_pose", 23, 1),
    ("reye_pose", 24, 1), ("lhand_pose", 25, 15), ("rhand_pose", 40, 15),
)  # fmt: skip

Numbers = list[float | list[float]]


class LhmFrame(msgspec.Struct, frozen=True):
    """One frame, as it is written."""

    root_pose: Numbers
    body_pose: Numbers
    trans: list[float]
    jaw_pose: Numbers = []
    leye_pose: Numbers = []
    reye_pose: Numbers = []
    lhand_pose: Numbers = []
    rhand_pose: Numbers = []


def is_lhm_frame(data: bytes) -> bool:
    """Whether JSON looks like one frame of LHM."""
    return b'"root_pose"' in data and b'"body_pose"' in data


class LhmDocument(msgspec.Struct, frozen=True):
    """A motion in one file: frames a second, whose betas they are, frames."""

    fps: float
    frames: list[LhmFrame]
    shape_space: str = "smplx"


def is_lhm_document(data: bytes) -> bool:
    """Whether JSON looks like a document of frames."""
    head = data[:1024].lstrip()
    return head.startswith(b"{") and b'"frames"' in head and is_lhm_frame(data[: 1 << 16])


def save_lhm_document(
    path: Path | str,
    motion: Motion,
    betas: NDArray[np.floating],
    shape_space: str,
    joints: NDArray[np.floating],
) -> None:
    """Write a motion as a document of frames, y down, which `load_motion` reads back.

    Args:
        path: the file to write.
        motion: whose way is in its shift.
        betas: shape of the body, the same in all frames.
        shape_space: what the betas belong to, `gn0` or `smplx`.
        joints: of the body at rest [55, 3] m.

    Raises:
        StorageError: the file cannot be written.
    """
    pelvis = np.asarray(joints, np.float64)[0]
    poses, shift = turn_frame(motion.poses, motion.shift, Y_DOWN, pelvis)
    shape = [float(value) for value in np.asarray(betas).reshape(-1)]
    frames = []
    for pose, trans in zip(poses, shift, strict=True):
        frame: dict[str, object] = {"betas": shape, "trans": trans.tolist()}
        for name, first, count in _PARTS:
            part = pose[first : first + count].tolist()
            frame[name] = part[0] if count == 1 else part
        frames.append(frame)
    document = {"fps": motion.fps, "shape_space": shape_space, "frames": frames}
    write_bytes(path, msgspec.json.encode(document) + b"\n")


def decode_lhm_document(
    data: bytes, file: Path | str, joints: NDArray[np.floating] | None = None
) -> Motion:
    """The motion of a document of frames.

    Args:
        data: its bytes.
        file: for errors.
        joints: joints of the body at rest [55, 3] m; an average body by default.

    Raises:
        FormatError: damaged, too many frames, or one that is no pose.
    """
    try:
        document = msgspec.json.decode(data, type=LhmDocument)
    except (msgspec.DecodeError, UnicodeDecodeError, RecursionError) as error:
        raise FormatError(
            f"is not a document of LHM frames: {error}", file=file, remedy="write it again"
        ) from None
    if not 1 <= len(document.frames) <= _MOST:
        raise FormatError(
            f"holds {len(document.frames)} frames, not 1 to {_MOST}",
            file=file,
            field="frames",
            remedy="cut it into parts",
        )
    found = [_frame_numbers(frame, file) for frame in document.frames]
    poses, shift = (np.array([one[k] for one in found]) for k in (0, 1))
    return _motion(poses, shift, document.fps, Path(file), joints, ["y down turned to y up"])


def decode_lhm_frame(data: bytes, file: Path | str) -> tuple[F64, F64]:
    """Pose [55, 3] rad and place [3] m of one frame, in the camera's frame.

    Raises:
        FormatError: no JSON, a member missing or of another length, or not finite.
    """
    try:
        frame = msgspec.json.decode(data, type=LhmFrame)
    except (msgspec.DecodeError, UnicodeDecodeError, RecursionError) as error:
        raise FormatError(
            f"is not a frame of LHM: {error}", file=file, remedy="write the frame again"
        ) from None
    return _frame_numbers(frame, file)


def _frame_numbers(frame: LhmFrame, file: Path | str) -> tuple[F64, F64]:
    pose = np.zeros((JOINT_COUNT, 3))
    for name, first, count in _PARTS:
        given = getattr(frame, name)
        if given:
            pose[first : first + count] = _numbers(given, count * 3, name, file).reshape(-1, 3)
    shift = _numbers(frame.trans, 3, "trans", file)
    if not (np.isfinite(pose).all() and np.isfinite(shift).all()):
        raise FormatError("is not finite", file=file, remedy="cut the frame, or fill it")
    return pose, shift


def _numbers(given: Sequence[float | list[float]], count: int, name: str, file: Path | str) -> F64:
    flat: list[float] = []
    for item in given:
        flat.extend(item if isinstance(item, list) else [item])
    if len(flat) != count:
        raise FormatError(
            f"has {len(flat)} numbers, not {count}",
            file=file,
            field=name,
            remedy="write the frame again",
        )
    return np.array(flat, np.float64)


def load_lhm(
    path: Path | str, joints: NDArray[np.floating] | None = None, fps: float = PLAIN_FPS
) -> Motion:
    """The motion of a folder of frames, in the order of their numbers.

    Args:
        path: the folder, or the one that holds `smplx_params`.
        joints: joints of the body at rest [55, 3] m; an average body by default.
        fps: frames a second of the video, which the frames do not say.

    Raises:
        StorageError: the folder cannot be read, or a frame is too large.
        FormatError: no frames, too many, or one that is damaged.
    """
    folder = plain_path(path)
    if (folder / FOLDER).is_dir():
        folder = folder / FOLDER
    try:
        found = [entry for entry in folder.iterdir() if entry.suffix == ".json"]
    except OSError as error:
        raise storage_error(error, folder, "read") from error
    numbered = sorted(
        (int(entry.stem), entry) for entry in found if re.fullmatch(r"[0-9]{1,12}", entry.stem)
    )
    if not numbered or len(numbered) > _MOST:
        raise FormatError(
            f"holds {len(numbered)} frames of LHM (00001.json, …), not 1 to {_MOST}",
            file=folder,
            remedy="give the folder that holds smplx_params",
        )
    poses, shift = np.empty((len(numbered), JOINT_COUNT, 3)), np.empty((len(numbered), 3))
    for k, (_, entry) in enumerate(numbered):
        poses[k], shift[k] = decode_lhm_frame(read_bytes(entry, FRAME_LIMIT), entry)
    first, last = numbered[0][0], numbered[-1][0]
    notes = [f"frames say no rate: {fps:g} a second were taken; y down turned to y up"]
    if last - first + 1 != len(numbered):
        notes.append(f"{last - first + 1 - len(numbered)} frames between {first} and {last} miss")
    return _motion(poses, shift, fps, folder, joints, notes)


def _motion(
    poses: F64,
    shift: F64,
    fps: float,
    file: Path,
    joints: NDArray[np.floating] | None,
    notes: list[str],
) -> Motion:
    check_finite(poses, file, "poses", TURNS)
    check_finite(shift, file, "trans", FAR)
    body = STANDING_JOINTS if joints is None else np.asarray(joints, np.float64)
    poses, shift = turn_frame(poses, shift, Y_DOWN, body[0])
    name = file.parent.name if file.name == FOLDER else file.stem
    return build_motion(
        file,
        poses=poses,
        shift=shift,
        fps=fps,
        hip_height=hip_height_of(body),
        name=name,
        notes=(
            *notes,
            *tell_posture(poses, "though y is taken to be down: perhaps it is not a camera's"),
            *tell_pace(shift, fps),
        ),
    )
