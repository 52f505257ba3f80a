"""What files of motion give: a skeleton of whatever names and axes, at rest and frame by frame."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from gn0.avatars.motion.motion import FPS_RANGE, check_finite
from gn0.avatars.motion.turns import matrices_of, quats_of_matrices
from gn0.errors import FormatError
from gn0.geometry import F64

JOINT_LIMIT = 1024  # rigs of people have 20 to 200
_PLAIN = 1 << 18  # joints × frames of any file, about 50 MB; larger files may hold more
_LEAST = 32  # joints that each frame counts for: it becomes a pose of 55
_FAR = 1e9  # units


@dataclass(frozen=True, eq=False)
class RigMotion:
    """A moving skeleton in the axes and units of its file.

    A parent stands before its children. At rest is the pose in which the skin was bound.

    Attributes:
        names: of the joints [J].
        parents: numbers of their parents [J]; −1 for a root.
        rest_rotations: of each joint to the file's axes, at rest [J, 3, 3].
        rest_positions: of each joint at rest [J, 3] in units.
        quats: rotation of each joint in its parent's axes (w, x, y, z) [T, J, 4].
        translations: place of each joint in its parent's axes [T, J, 3] in units.
        fps: frames a second.
        metres: metres in a unit, as the file says; None where it does not.
        up: axis that the file says is up, "x", "y" or "z", "-" before it if down; "" if unsaid.
        name: of the clip.
        notes: what the reader found out.
    """

    names: tuple[str, ...]
    parents: tuple[int, ...]
    rest_rotations: F64
    rest_positions: F64
    quats: F64
    translations: F64
    fps: float
    metres: float | None = None
    up: str = ""
    name: str = ""
    notes: tuple[str, ...] = ()

    def __len__(self) -> int:
        return len(self.quats)


def check_rig_size(joints: int, frames: int, size: int, file: Path | str) -> None:
    """Refuse more than a file of `size` bytes can mean, before anything is allocated.

    Raises:
        FormatError: too many joints, no frame, or too many frames.
    """
    if not 1 <= joints <= JOINT_LIMIT:
        raise FormatError(
            f"a skeleton of {joints} joints is not read (1 to {JOINT_LIMIT} are)",
            file=file,
            field="joints",
            remedy="export the skeleton of one person",
        )
    most = (_PLAIN + size // 16) // max(joints, _LEAST)
    if not 1 <= frames <= most:
        raise FormatError(
            f"a motion of {frames} frames is not read (1 to {most} are, of {joints} joints)",
            file=file,
            field="frames",
            remedy="check the time range and the frame rate, or cut the clip",
        )


def check_rig(rig: RigMotion, file: Path | str) -> RigMotion:
    """The same rig, checked.

    Raises:
        FormatError: numbers that are not finite (the frame is named), a rate out of 1 to 1000, a
            parent that stands after its child, or rotations at rest that are none.
    """
    for k, parent in enumerate(rig.parents):
        if not -1 <= parent < k:
            raise FormatError(
                f"joint {rig.names[k]!r} hangs on one that does not stand before it",
                file=file,
                field="parents",
                remedy="check the skeleton for loops",
            )
    check_finite(rig.quats, file, "rotations")
    check_finite(np.where(np.abs(rig.translations) < _FAR, rig.translations, np.nan), file, "place")
    rest = rig.rest_rotations
    straight = rest @ np.swapaxes(rest, -1, -2) - np.eye(3)
    if not (np.abs(straight) < 1e-4).all() or not (np.abs(rig.rest_positions) < _FAR).all():
        raise FormatError(
            "the rest pose is not finite, or squeezes joints flat",
            file=file,
            field="rest",
            remedy="apply scales, then export again",
        )
    if not FPS_RANGE[0] <= rig.fps <= FPS_RANGE[1]:
        raise FormatError(
            f"{rig.fps:g} frames a second, not 1 to 1000",
            file=file,
            field="frame time",
            remedy="correct the frame rate",
        )
    if rig.metres is not None and not (math.isfinite(rig.metres) and 1e-9 < rig.metres < 1e9):
        raise FormatError(
            f"a unit of {rig.metres} m is not read",
            file=file,
            field="unit",
            remedy="correct the unit",
        )
    return rig


def global_frames(rig: RigMotion, first: int = 0, last: int | None = None) -> tuple[F64, F64]:
    """Rotations [N, J, 3, 3] and places [N, J, 3] of frames `first` to `last` in the file's axes.

    Source: forward kinematics along the parents.
    """
    local = matrices_of(rig.quats[first:last])
    turned, placed = np.empty_like(local), np.empty((*local.shape[:2], 3))
    for k, parent in enumerate(rig.parents):
        step = rig.translations[first:last, k]
        if parent < 0:
            turned[:, k], placed[:, k] = local[:, k], step
        else:
            turned[:, k] = turned[:, parent] @ local[:, k]
            placed[:, k] = placed[:, parent] + np.einsum("tab,tb->ta", turned[:, parent], step)
    return turned, placed


def local_frames(
    parents: tuple[int, ...], turned: NDArray[np.floating], placed: NDArray[np.floating]
) -> tuple[F64, F64]:
    """Quaternions [T, J, 4] and translations [T, J, 3] in the parents' axes.

    Args:
        parents: numbers of the parents [J].
        turned: rotations to the file's axes [T, J, 3, 3].
        placed: places in the file's axes [T, J, 3].
    """
    quats, steps = np.empty((*turned.shape[:2], 4)), np.empty(placed.shape)
    for k, parent in enumerate(parents):
        if parent < 0:
            quats[:, k], steps[:, k] = quats_of_matrices(turned[:, k]), placed[:, k]
        else:
            back = np.swapaxes(turned[:, parent], -1, -2)
            quats[:, k] = quats_of_matrices(back @ turned[:, k])
            steps[:, k] = np.einsum("tab,tb->ta", back, placed[:, k] - placed[:, parent])
    return quats, steps


def tidy_rate(fps: float) -> float:
    """A rate as it was meant: the whole number that is within 0.05 % of it, else itself."""
    return float(round(fps)) if math.isfinite(fps) and abs(fps - round(fps)) < 5e-4 * fps else fps
