"""A motion: poses of our 55 joints, frame by frame, and where the body goes.

Frame of bodies: y up, +z to the front, +x to the person's left, metres. A pose is axis-angle in the
parent's axes; the root turns about its own joint; the shift is added after the pose (SMPL-X).
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gn0.avatars.motion.turns import quats_of, slerp, vectors_of_quats
from gn0.avatars.skeleton import JOINT_COUNT
from gn0.errors import DataError, FormatError
from gn0.geometry import F64

FPS_RANGE = (1.0, 1000.0)
_HIP_RANGE = (0.1, 10.0)  # m, dwarfs and giants included
FAR = 1e4  # m, beyond any capture hall
TURNS = 1e3  # rad, of one joint


@dataclass(frozen=True, eq=False)
class Motion:
    """Poses of a body in time, checked.

    A loop ends with the pose that it begins with.

    Attributes:
        poses: axis-angle of each joint in its parent's axes [T, 55, 3] rad.
        shift: what is added after the pose [T, 3] m, y up.
        fps: frames a second, 1 to 1000.
        hip_height: height of the pelvis above the lowest joint of the feet, of the body that
            `shift` is for [m].
        name: of the clip.
        category: walk, run, wave, …; "" where unknown.
        source: where it comes from.
        licence: what it may be used for.
        loop: whether it goes on from its end at its start.
        displacement: way gone since the first frame, which is not in `shift` [T] m; None where all
            is in `shift`.
        contacts: whether the left and the right foot stand [T, 2]; None where unknown.
        notes: what a reader found out or put right.

    Raises:
        DataError: arrays of the wrong shape, not finite (the frame is named) or out of range, one
            frame only, or a rate out of range.
    """

    poses: F64
    shift: F64
    fps: float
    hip_height: float
    name: str = ""
    category: str = ""
    source: str = ""
    licence: str = ""
    loop: bool = False
    displacement: F64 | None = None
    contacts: NDArray[np.bool_] | None = None
    notes: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        fault = _find_fault(self)
        if fault is not None:
            what, field, remedy = fault
            raise DataError(what, where=f"motion {self.name!r}, {field}", remedy=remedy)

    def __len__(self) -> int:
        return len(self.poses)

    @property
    def seconds(self) -> float:
        """Time from the first frame to the last [s]."""
        return (len(self) - 1) / self.fps


def build_motion(file: Path | str, **fields: Any) -> Motion:
    """A `Motion` of what a file holds.

    Raises:
        FormatError: what `Motion` refuses; names the file.
    """
    for name in ("poses", "shift", "displacement"):
        if fields.get(name) is not None:
            fields[name] = np.ascontiguousarray(fields[name], np.float64)
    try:
        return Motion(**fields)
    except DataError as error:
        field = error.where.rsplit(", ", 1)[-1]
        raise FormatError(error.what, file=file, field=field, remedy=error.remedy) from None


def check_finite(
    values: NDArray[np.floating], file: Path | str, field: str, most: float = math.inf
) -> None:
    """Refuse values [T, …] of which one is not finite, or `most` or beyond.

    Raises:
        FormatError: names the first frame that is at fault.
    """
    fault = _unsound_frame(values, most)
    if fault is not None:
        raise FormatError(
            f"frame {fault} holds a value that is not finite"
            + (f", or beyond {most:g}" if math.isfinite(most) else ""),
            file=file,
            field=field,
            remedy="cut the frames that the capture lost, or fill them",
        )


def _unsound_frame(values: NDArray[np.floating], most: float) -> int | None:
    if not len(values):
        return None
    flat = values.reshape(len(values), -1)
    with np.errstate(invalid="ignore"):
        sound = (np.abs(flat) < most).all(axis=1) if flat.size else np.ones(len(values), bool)
    return None if sound.all() else int(np.flatnonzero(~sound)[0])


def _find_fault(motion: Motion) -> tuple[str, str, str] | None:
    """(what, field, remedy) of what is wrong with a motion."""
    poses, shift = motion.poses, motion.shift
    frames = len(poses) if poses.ndim else 0
    if poses.shape != (frames, JOINT_COUNT, 3):
        return f"poses have shape {poses.shape}, not (T, 55, 3)", "poses", "give all 55 joints"
    if frames < 2:
        return (
            f"a motion of {frames} frame{'s' * (frames != 1)} does not move",
            "poses",
            "give at least two frames; a still pose does not move",
        )
    if shift.shape != (frames, 3):
        return f"shape {shift.shape}, not ({frames}, 3)", "shift", "give one shift a frame"
    for field, values, most in (("poses", poses, TURNS), ("shift", shift, FAR)):
        frame = _unsound_frame(values, most)
        if frame is not None:
            what = f"frame {frame} holds a value that is not finite, or beyond {most:g}"
            return what, field, "cut the frames that the capture lost, or fill them"
    low, high = FPS_RANGE
    if not low <= motion.fps <= high:
        return f"{motion.fps} frames a second, not {low:g} to {high:g}", "fps", "correct the rate"
    low, high = _HIP_RANGE
    if not low <= motion.hip_height <= high:
        what = f"hips {motion.hip_height} m high, not {low:g} to {high:g}"
        return what, "hip_height", "give metres"
    way, feet = motion.displacement, motion.contacts
    if way is not None and (way.shape != (frames,) or not np.isfinite(way).all()):
        return f"needs {frames} finite numbers", "displacement", "give the way gone at each frame"
    if feet is not None and (feet.shape != (frames, 2) or feet.dtype != np.bool_):
        return f"needs {frames} × 2 flags", "contacts", "say of each frame which foot stands"
    return None


def resample(motion: Motion, fps: float) -> Motion:
    """The same motion at another rate: joints by slerp, the rest linear, contacts by the nearest.

    A loop keeps its last frame, for which its rate may differ a little from `fps`.

    Raises:
        DataError: a rate out of 1..1000, or fewer than two frames left.
    """
    if not FPS_RANGE[0] <= fps <= FPS_RANGE[1]:
        raise DataError(f"{fps} frames a second are out of 1 to 1000", where="resample")
    if motion.loop:
        count = max(1, round(motion.seconds * fps)) + 1
        fps = (count - 1) / motion.seconds
    else:
        count = int(motion.seconds * fps + 1e-6) + 1
    return replace(sample(motion, np.arange(count) / fps), fps=fps)


def sample(motion: Motion, times: NDArray[np.floating]) -> Motion:
    """The motion at `times` [N] s after its first frame, held at its ends; `fps` is kept.

    Raises:
        DataError: fewer than two times.
    """
    at = np.clip(np.asarray(times, np.float64) * motion.fps, 0.0, len(motion) - 1.0)
    first = np.minimum(at.astype(np.int64), len(motion) - 2)
    share = at - first
    quats = quats_of(motion.poses)
    poses = vectors_of_quats(slerp(quats[first], quats[first + 1], share[:, None]))
    kept = (share == 0.0) | (share == 1.0)  # frames that are there stay as they are
    poses[kept] = motion.poses[(first + (share == 1.0))[kept]]

    def mixed(values: F64) -> F64:
        part = share.reshape(-1, *([1] * (values.ndim - 1)))
        return values[first] * (1.0 - part) + values[first + 1] * part

    way, feet = motion.displacement, motion.contacts
    return replace(
        motion,
        poses=poses,
        shift=mixed(motion.shift),
        displacement=None if way is None else mixed(way),
        contacts=None if feet is None else feet[np.rint(at).astype(np.int64)],
    )
