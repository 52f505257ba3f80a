"""Poses of people as they are shown, in compiled code: for one on a CPU, for thousands on a card.

Whoever blends is solved, turned to look aside, placed, and written as a card reads it by one kernel
over all people of a call, who share the cores; one person is posed to the bit as among others.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from gn0.avatars.avatar import SHADOWS, lay_shadow
from gn0.avatars.motion.frames import look_aside, solve_frame, step_frames
from gn0.avatars.motion.gait import PHASES
from gn0.avatars.motion.legs import FLAT_WIDTH
from gn0.avatars.motion.library import LOOKS, PIVOTS, SETTLES, ClipLibrary
from gn0.avatars.motion.standing import FPS, ease
from gn0.avatars.motion.stepping import PIVOT, PIVOT_ROWS, SETTLE_ROWS
from gn0.avatars.posture import place_body
from gn0.avatars.skeleton import JOINT_COUNT
from gn0.errors import DataError
from gn0.geometry import F32, F64
from gn0.jit import njit, prange
from gn0.render.cuda.posed import RestDevice, choose_steps, shapes_of, write_pose

BLEND = 4  # ticks that one clip goes over into another
_POSE = FLAT_WIDTH  # where the pose of a frame begins, solved already, and its shift
_SHIFT = _POSE + 3 * JOINT_COUNT
FRAME_WIDTH = _SHIFT + 3
_SHARES = np.array([float(ease(np.asarray(quarter / BLEND))) for quarter in range(BLEND + 1)])
_YAWS = np.array([math.radians(look) for look in LOOKS])
# whole numbers of each person: kind of its clip, frame, whether another clip blends in, and what
# `Shown` says of the blend and of the head
_KIND, _FRAME, _BLENDS, _QUARTER, _LOOK, _EARLY, _STOOD = range(7)
KINDS = ("walk", *PIVOTS, *SETTLES)
_LEFT = 1, 3  # of those
I64 = NDArray[np.int64]


def kind_of(clip: str) -> int:
    """The kind of a clip: its place in `KINDS`, or behind them."""
    return KINDS.index(clip) if clip in KINDS else len(KINDS)


def frame_of(library: ClipLibrary, clip: str, frame: int, speed: float) -> F64:
    """A frame of a clip [`FRAME_WIDTH`]: its plan, its pose and its shift.

    Args:
        library: whose clips.
        clip: its name.
        frame: of it, of a walk the phase, 0 to 63.
        speed: of a walk [m/s].

    Raises:
        DataError: no clip of that name.
    """
    poses, shifts = library.table(clip, speed)
    one = library.clip(clip, speed)
    row = one.row(frame / PHASES if clip == "walk" else frame / FPS)
    return np.concatenate([one.flat[row], poses[row].ravel(), shifts[row]])


def turn_people(frames: F64, now: I64, before: I64, looks: I64, joints: F64) -> tuple[F64, F64]:
    """Poses [n, 55, 3] rad and shifts [n, 3] m of people.

    Args:
        frames: of clips [F, `FRAME_WIDTH`].
        now: what each does, of those [n].
        before: what each did, of those [n].
        looks: kind, frame, blends, quarter, look, early, stood of each [n, 7]; see `Shown`.
        joints: of each at rest [n, 55, 3] m.
    """
    count = len(now)
    poses, shifts = np.empty((count, JOINT_COUNT, 3)), np.empty((count, 3))
    _turn_people(frames, now, before, looks, joints, poses, shifts)
    return poses, shifts


def ready_people(
    frames: F64,
    now: I64,
    before: I64,
    looks: I64,
    joints: F64,
    whose: I64,
    rests: Sequence[RestDevice],
    which: I64,
    rows: F32,
    at: I64,
) -> tuple[F32, F32]:
    """Write people as a card reads them, to the bit as `turn_people` and `ready_all` make them.

    Args:
        frames: as of `turn_people`.
        now: likewise.
        before: likewise.
        looks: likewise.
        joints: of bodies at rest [B, 55, 3] m.
        whose: of those, for each person [n].
        rests: whom a card has at rest.
        which: of those, for each person [n].
        rows: as of `ReadyPoses`, written to.
        at: where of those each person is written [n].

    Returns:
        boxes and steps, as of `ReadyPoses`.

    Raises:
        DataError: a pose is not finite.
        RenderError: somebody reaches so far that its places would be too coarse.
    """
    count = len(now)
    boxes, fine = np.empty((count, 7), np.float32), np.empty(count, np.bool_)
    shapes = shapes_of(rests)
    _ready_people(
        *(frames, now, before, looks, joints, whose, *shapes, which, rows, at, boxes, fine)
    )
    if not fine.all():
        raise DataError("a pose is not finite", where=f"pose {int(np.flatnonzero(~fine)[0])}")
    return boxes, choose_steps(boxes)


@njit
def _turn_one(now, before, look, joints, pose, shift):  # type: ignore[no-untyped-def]
    if look[_BLENDS]:
        kind, row, turned = look[_KIND], look[_FRAME], 0.0
        if 1 <= kind < len(KINDS):  # feet of a walk stay behind while its body turns on them
            row = row // SETTLE_ROWS if kind > len(PIVOTS) else row
            turned = (1.0 if kind in _LEFT else -1.0) * row * PIVOT / PIVOT_ROWS
        first, second = before[:_POSE].copy(), now[:_POSE].copy()
        share, stood = _SHARES[look[_QUARTER]], 1e-3 * look[_STOOD]
        step_frames(joints, first, second, share, look[_EARLY], kind != 0, stood, turned)
        solve_frame(joints, first, pose, shift)
    else:
        for j in range(JOINT_COUNT):
            for a in range(3):
                pose[j, a] = now[_POSE + 3 * j + a]
        for a in range(3):
            shift[a] = now[_SHIFT + a]
    if _YAWS[look[_LOOK]] != 0.0:
        look_aside(pose, _YAWS[look[_LOOK]])


@njit
def _turn_people(frames, now, before, looks, joints, poses, shifts):  # type: ignore[no-untyped-def]
    for n in range(now.shape[0]):
        one, other = frames[now[n]], frames[before[n]]
        _turn_one(one, other, looks[n], joints[n], poses[n], shifts[n])


@njit(parallel=True)
def _ready_people(  # type: ignore[no-untyped-def]
    frames, now, before, looks, joints, whose, reach, lying, widest, which,
    rows, at, boxes, fine,
):  # fmt: skip
    for n in prange(now.shape[0]):
        pose, shift = np.empty((JOINT_COUNT, 3)), np.empty(3)
        placed, floor = np.empty((JOINT_COUNT, 19)), np.empty((SHADOWS, 4), np.float32)
        own, k = joints[whose[n]], which[n]
        one, other = frames[now[n]], frames[before[n]]
        _turn_one(one, other, looks[n], own, pose, shift)
        fine[n] = place_body(own, pose, shift, placed)
        lay_shadow(placed[:, 16:], floor)
        write_pose(placed, floor, reach[k], lying[k], widest[k], rows[at[n]], boxes[n])
