"""Where a motion takes the joints of a body, when its feet stand, and whether they slide."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from gn0.avatars.motion.motion import Motion
from gn0.avatars.motion.turns import matrices_of, quats_of
from gn0.avatars.skeleton import INDEX, PARENTS
from gn0.geometry import F64

_NEAR_FLOOR = 0.04  # m above rest
_SLOW = 0.4  # m/s; a foot that swings goes at several
_FEET = tuple((INDEX[f"{side}_ankle"], INDEX[f"{side}_foot"]) for side in ("left", "right"))


def move_joints(
    motion: Motion, joints: NDArray[np.floating], first: int = 0, last: int | None = None
) -> tuple[F64, F64]:
    """Rotations [N, 55, 3, 3] and places [N, 55, 3] m of frames `first` to `last`.

    As `gn0.avatars.skinning.pose_joints`, of many frames at once; the way gone (`displacement`) is
    not put in.
    """
    rest = np.asarray(joints, np.float64)
    local = matrices_of(quats_of(motion.poses[first:last]))
    turned, placed = np.empty_like(local), np.empty((*local.shape[:2], 3))
    for k, parent in enumerate(PARENTS):
        if parent < 0:
            turned[:, k], placed[:, k] = local[:, k], rest[k] + motion.shift[first:last]
        else:
            turned[:, k] = turned[:, parent] @ local[:, k]
            step = turned[:, parent] @ (rest[k] - rest[parent])
            placed[:, k] = placed[:, parent] + step
    return turned, placed


@dataclass(frozen=True)
class Soles:
    """How the feet of a motion meet the floor.

    Attributes:
        skate: median speed along the floor of feet that stand [m/s].
        worst_skate: its 95th percentile [m/s].
        lowest: lowest point of the feet against their rest [m], below 0 in the floor.
        standing: share of frames with a foot down.
    """

    skate: float
    worst_skate: float
    lowest: float
    standing: float


def _foot_places(motion: Motion, joints: NDArray[np.floating]) -> F64:
    """Ankles and toes [T, 2, 2, 3] m, with the way gone along +z."""
    _, placed = move_joints(motion, joints)
    feet = placed[:, _FEET]
    if motion.displacement is not None:
        feet[..., 2] += motion.displacement[:, None, None]
    return feet


def find_contacts(motion: Motion, joints: NDArray[np.floating]) -> Motion:
    """The same motion with `contacts`: a foot stands that is low and slow.

    Args:
        motion: of a body.
        joints: its joints at rest [55, 3] m.
    """
    feet = _foot_places(motion, joints)
    rest = np.asarray(joints, np.float64)[_FEET, 1]
    low = (feet[..., 1] - rest).min(axis=2) < _NEAR_FLOOR
    pace = np.linalg.norm(np.gradient(feet, 1.0 / motion.fps, axis=0), axis=-1).min(axis=2)
    return replace(motion, contacts=low & (pace < _SLOW))


def measure_soles(motion: Motion, joints: NDArray[np.floating]) -> Soles:
    """How feet slide and sink, where they stand by `contacts` (found where unknown)."""
    if motion.contacts is None:
        motion = find_contacts(motion, joints)
    assert motion.contacts is not None
    feet = _foot_places(motion, joints)
    rest = np.asarray(joints, np.float64)[_FEET, 1]
    stays = motion.contacts[1:] & motion.contacts[:-1]
    # rolling from heel to toe, one end of the foot rests
    pace = np.linalg.norm(np.diff(feet[..., [0, 2]], axis=0), axis=-1).min(axis=2) * motion.fps
    slides = pace[stays]
    return Soles(
        skate=float(np.median(slides)) if slides.size else 0.0,
        worst_skate=float(np.percentile(slides, 95)) if slides.size else 0.0,
        lowest=float((feet[..., 1] - rest).min()),
        standing=float(motion.contacts.any(axis=1).mean()),
    )
