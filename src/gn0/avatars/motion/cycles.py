"""Cycles of a walk: found, cut out and closed, without the way gone, and given it back by distance.

Phase goes by distance, not by time: the place of a planted foot then depends on the way gone alone,
so it stays where it is at any pace.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from gn0.avatars.motion.feet import find_contacts, move_joints
from gn0.avatars.motion.motion import Motion, sample
from gn0.avatars.motion.standing_joints import FEET
from gn0.avatars.motion.turns import (
    about_axis,
    matrices_of,
    multiply,
    quats_of,
    slerp,
    vectors_of_quats,
)
from gn0.avatars.skeleton import INDEX
from gn0.errors import DataError
from gn0.geometry import F64

CLOSED = 0.01  # m
_FINE_FPS = 100.0  # frames a second at which cycles are sought
_LIMBS = np.array(
    [INDEX[f"{side}_{part}"] for side in ("left", "right")
     for part in ("knee", "ankle", "foot", "elbow", "wrist")] + [INDEX["spine3"], INDEX["head"]]
)  # fmt: skip
_SWING = 0.10  # m that some limb must be away from where it was, part of a cycle before
_TURN = 0.5  # rad; a bend is no cycle
_STEPS = 0.3  # m; a cycle on the spot whose feet go less does not walk
_SEEN = 6000  # fine frames that are looked at, a minute


@dataclass(frozen=True)
class Cycle:
    """A part of a motion that ends as it begins.

    Attributes:
        start: its first moment [s].
        stop: its last moment [s].
        closure: the farthest that a limb is from where it began, the way gone left out [m].
        distance: way gone in it [m].
    """

    start: float
    stop: float
    closure: float
    distance: float

    @property
    def seconds(self) -> float:
        """How long it takes [s]."""
        return self.stop - self.start


def _headings(motion: Motion) -> F64:
    """Which way the body faces on the floor [T] rad, 0 along +z, to the left positive."""
    front = matrices_of(quats_of(motion.poses[:, 0]))[:, :, 2]
    return np.unwrap(np.arctan2(front[:, 0], front[:, 2]))


def _shapes(motion: Motion, joints: F64) -> tuple[F64, F64, F64]:
    """Limbs [T, L, 3] m in the frame of the hips on the floor, headings [T], hips [T, 3]."""
    _, placed = move_joints(motion, joints)
    heading = _headings(motion)
    hips = placed[:, 0].copy()
    level = hips * [1.0, 0.0, 1.0]
    limbs = placed[:, _LIMBS] - level[:, None]
    back = matrices_of(about_axis("y", -heading))
    return np.einsum("tab,tkb->tka", back, limbs), heading, hips


def find_cycles(
    motion: Motion,
    joints: NDArray[np.floating],
    *,
    shortest: float = 0.4,
    longest: float = 2.5,
    closure: float = CLOSED,
) -> tuple[Cycle, ...]:
    """Cycles of a walk or run, the best closed first; none overlaps another.

    Args:
        motion: of a body; the first minute is looked at.
        joints: its joints at rest [55, 3] m.
        shortest: the least time that a cycle takes [s].
        longest: the most [s].
        closure: the farthest that a limb may end from where it began [m].
    """
    rest = np.asarray(joints, np.float64)
    times_finer = max(1, int(np.ceil(_FINE_FPS / motion.fps)))
    fps = motion.fps * times_finer
    count = min((len(motion) - 1) * times_finer + 1, _SEEN)
    fine = sample(motion, np.arange(count) / fps)
    limbs, heading, hips = _shapes(fine, rest)
    found: list[tuple[float, int, int]] = []
    for lag in range(max(2, round(shortest * fps)), min(count - 1, round(longest * fps)) + 1):
        gap = np.linalg.norm(limbs[lag:] - limbs[:-lag], axis=-1).max(axis=1)
        bent = np.abs(heading[lag:] - heading[:-lag]) > _TURN
        half = lag // 2
        swing = np.linalg.norm(limbs[half : half + len(gap)] - limbs[: len(gap)], axis=-1).max(
            axis=1
        )
        # what swings out and back ends where it began, but is the same a quarter before as after
        quarter = lag // 4
        there, back = limbs[quarter:][: len(gap)], limbs[lag - quarter :][: len(gap)]
        other = np.linalg.norm(there - back, axis=-1).max(axis=1) < _SWING
        gap = np.where(bent | other | (swing < _SWING), np.inf, gap)
        best = int(np.argmin(gap))
        found += [(float(gap[k]), int(k), lag) for k in np.flatnonzero(gap <= closure)[:50]]
        if np.isfinite(gap[best]) and gap[best] <= closure:
            found.append((float(gap[best]), best, lag))
    if not found:
        return ()
    # two rounds close as well as one, so take the shortest kind
    single = min(lag for _, _, lag in found) * 1.3
    taken: list[Cycle] = []
    for gap_there, start, lag in sorted(found):
        stop = start + lag
        if lag > single or any(
            start / fps < cycle.stop and stop / fps > cycle.start for cycle in taken
        ):
            continue
        way = hips[stop] - hips[start]
        way_gone = float(np.hypot(way[0], way[2]))
        if motion.displacement is not None:
            assert fine.displacement is not None
            way_gone += float(fine.displacement[stop] - fine.displacement[start])
        taken.append(Cycle(start / fps, stop / fps, gap_there, way_gone))
    return tuple(taken)


def cut_cycle(
    motion: Motion, cycle: Cycle, joints: NDArray[np.floating], frames: int = 32
) -> Motion:
    """One cycle as a loop that walks along +z on the spot; the way gone is its `displacement`.

    What is left open between its ends is spread over the cycle, so that they are one pose.

    Args:
        motion: of a body.
        cycle: one of `find_cycles`.
        joints: joints of the body at rest [55, 3] m.
        frames: how many frames it shall have; one more closes it.

    Raises:
        DataError: fewer than four frames, or a cycle outside the motion.
    """
    if frames < 4 or not 0 <= cycle.start < cycle.stop <= motion.seconds + 1e-9:
        raise DataError(
            f"no cycle from {cycle.start:.3f} to {cycle.stop:.3f} s of {frames} frames",
            where=f"motion {motion.name!r}",
            remedy="take a cycle that find_cycles found in it, and at least 4 frames",
        )
    rest = np.asarray(joints, np.float64)
    part = np.linspace(0.0, 1.0, frames + 1)
    cut = sample(motion, cycle.start + part * cycle.seconds)
    fps = frames / cycle.seconds
    hips = cut.shift + rest[0]
    along = hips[-1] - hips[0]
    heading = _headings(cut)
    way = float(np.hypot(along[0], along[2]))
    goes = float(np.arctan2(along[0], along[2])) if way > 0.05 else float(heading.mean())
    # turn it to +z, and undo what it turned over the cycle
    turn = about_axis("y", -goes - (heading[-1] - heading[0]) * (part - 0.5))
    quats = quats_of(cut.poses)
    quats[:, 0] = multiply(turn, quats[:, 0])
    hips = np.einsum("tab,tb->ta", matrices_of(turn), hips - hips[0] * [1, 0, 1])
    hips -= hips[0] * [1.0, 0.0, 1.0]
    gone = np.maximum.accumulate(hips[:, 2]) if way > 0.05 else np.zeros(len(part))
    notes = [f"a cycle of {cycle.seconds:.2f} s"]
    if cut.displacement is not None:
        gone = gone + cut.displacement - cut.displacement[0]
    elif way <= 0.05:
        stepped = _way_of_feet(
            replace(cut, poses=vectors_of_quats(quats), shift=hips - rest[0]), rest
        )
        if stepped[-1] > _STEPS:
            gone = stepped
            notes.append("on the spot; its way is that of the lower foot, backwards")
    local = hips - np.stack([0 * part, 0 * part, gone if way > 0.05 else 0 * part], axis=1)
    local -= part[:, None] * (local[-1] - local[0])
    back = multiply(quats[0], quats[-1] * [1.0, -1.0, -1.0, -1.0])
    none = np.broadcast_to([1.0, 0.0, 0.0, 0.0], (frames + 1, *back.shape))
    share = np.repeat(part[:, None], back.shape[0], axis=1)
    quats = multiply(slerp(none, np.broadcast_to(back, none.shape), share), quats)
    poses = vectors_of_quats(quats)
    poses[-1] = poses[0]
    local[-1] = local[0]
    closed = replace(
        cut,
        poses=poses,
        shift=local - rest[0] * [0.0, 1.0, 0.0],
        fps=fps,
        loop=True,
        displacement=gone,
        contacts=None,
        notes=(*motion.notes, *notes, f"{gone[-1]:.2f} m"),
    )
    return find_contacts(closed, rest)


def _way_of_feet(motion: Motion, joints: F64) -> F64:
    """Way [T] m that a walk on the spot would go, did its lower foot stand."""
    _, placed = move_joints(motion, joints)
    feet = placed[:, list(FEET)]
    lower = np.argmin(feet[..., 1] - joints[list(FEET), 1], axis=1)[:-1]
    back = -np.diff(feet[..., 2], axis=0)[np.arange(len(lower)), lower]
    return np.concatenate([[0.0], np.maximum.accumulate(np.cumsum(back))]).clip(0.0)


def loop_closure(motion: Motion, joints: NDArray[np.floating]) -> float:
    """The farthest that a limb ends from where it began, the way gone left out [m]."""
    limbs, _, _ = _shapes(motion, np.asarray(joints, np.float64))
    return float(np.linalg.norm(limbs[-1] - limbs[0], axis=-1).max())


def walk_cycle(cycle: Motion, distances: NDArray[np.floating], fps: float) -> Motion:
    """A loop that goes: its pose at each way gone, and the way given back along +z.

    Args:
        cycle: a loop with `displacement`, as `cut_cycle` makes.
        distances: way gone at each frame [N] m.
        fps: frames a second of the result.

    Raises:
        DataError: no loop with a way, or fewer than two frames.
    """
    way = cycle.displacement
    if not cycle.loop or way is None or not way[-1] > 0:
        raise DataError(
            "is not a loop that goes somewhere",
            where=f"motion {cycle.name!r}",
            remedy="cut a cycle of a walk, by cut_cycle",
        )
    gone = np.asarray(distances, np.float64)
    phase = np.mod(gone, way[-1])
    # where it stands for a while, its first moment there counts
    rising = np.concatenate([[True], np.diff(way) > 0])
    at = np.interp(phase, way[rising], np.flatnonzero(rising).astype(np.float64))
    went = sample(cycle, at / cycle.fps)
    shift = went.shift + np.stack([0 * gone, 0 * gone, gone], axis=1)
    return replace(went, shift=shift, fps=fps, loop=False, displacement=None)
