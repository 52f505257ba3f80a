"""Poses of avatars that are asked for by numbers: many at once, or one by one."""

from __future__ import annotations

from collections.abc import Callable, Hashable, Sequence
from typing import Any, Protocol, runtime_checkable

import numpy as np

from gn0.avatars.avatar import Avatar, shadow_places
from gn0.avatars.body import check_pose
from gn0.avatars.code_map import I64, U64
from gn0.avatars.posture import Posture, place_all
from gn0.avatars.skeleton import JOINT_COUNT
from gn0.geometry import F32, F64
from gn0.render.cuda.posed import RestDevice, ready_all


class AvatarPose(Protocol):
    """A pose of an avatar that is to be drawn."""

    @property
    def avatar(self) -> Avatar:
        """Of whom, at a level of detail."""
        ...

    @property
    def rest_key(self) -> Hashable:
        """Equal for poses of the same avatar at the same level."""
        ...

    def turn(self) -> tuple[F64, F64]:
        """Pose [55, 3] rad and shift [3] m."""
        ...


@runtime_checkable
class PosesTogether(Protocol):
    """A pose whose like are quicker found together."""

    @staticmethod
    def turn_all(poses: Sequence[Any]) -> tuple[F64, F64]:
        """What `turn` gives for each of the same type: poses [n, 55, 3] and shifts [n, 3]."""
        ...


class CodedPoses(Protocol):
    """What codes above 0, below 2⁶⁴, stand for."""

    def postures(self, codes: U64) -> U64:
        """Codes above 0, equal for codes [n] of one posture, as levels of detail have."""
        ...

    def rests(self, codes: U64) -> tuple[list[Hashable], I64]:
        """Values of `AvatarPose.rest_key`, and the place among them of each code [n]."""
        ...

    def avatar(self, code: int) -> Avatar:
        """Of whom a code is, at its level of detail."""
        ...

    def ready(
        self, codes: U64, rests: Sequence[RestDevice], which: I64, rows: F32, at: I64
    ) -> tuple[F32, F32]:
        """Write poses of codes to rows `at` of an array as `ReadyPoses.rows` is one.

        Args:
            codes: of whom [n].
            rests: whom a card has at rest.
            which: of those, for each code [n].
            rows: what is written to.
            at: where, for each code [n].

        Returns:
            boxes and steps, as of `ReadyPoses`.

        Raises:
            DataError: a pose is not finite.
            RenderError: somebody reaches so far that its places would be too coarse.
        """
        ...


class PosesOneByOne:
    """Codes each of which a function poses.

    Args:
        pose: what poses a code; asked once for each.
        posture: equal numbers above 0 for codes whose poses have the same turn and the same joints
            at rest; without it each has its own.
    """

    def __init__(
        self, pose: Callable[[int], AvatarPose], posture: Callable[[int], int] | None = None
    ) -> None:
        self._pose, self._posture = pose, posture
        self._poses: dict[int, AvatarPose] = {}

    def _find(self, code: int) -> AvatarPose:
        if code not in self._poses:
            self._poses[code] = self._pose(code)
        return self._poses[code]

    def postures(self, codes: U64) -> U64:
        """See `CodedPoses`."""
        if self._posture is None:
            return codes
        return np.array([self._posture(code) for code in codes.tolist()], np.uint64)

    def rests(self, codes: U64) -> tuple[list[Hashable], I64]:
        """See `CodedPoses`."""
        numbers: dict[Hashable, int] = {}
        keys = [self._find(code).rest_key for code in codes.tolist()]
        which = [numbers.setdefault(key, len(numbers)) for key in keys]
        return list(numbers), np.array(which, np.int64)

    def avatar(self, code: int) -> Avatar:
        """See `CodedPoses`."""
        return self._find(code).avatar

    def ready(
        self, codes: U64, rests: Sequence[RestDevice], which: I64, rows: F32, at: I64
    ) -> tuple[F32, F32]:
        """See `CodedPoses`."""
        poses = [self._find(code) for code in codes.tolist()]
        placed = place_avatars([one.avatar for one in poses], *_turn_all(poses))
        floors = shadow_places(placed.joints)
        ready = ready_all(rests, which, placed.transforms, placed.turns, floors)
        rows[at] = ready.rows
        return ready.boxes, ready.steps


def _turn_all(poses: Sequence[AvatarPose]) -> tuple[F64, F64]:
    """Poses [n, 55, 3] and shifts [n, 3] of all."""
    first = poses[0]
    if isinstance(first, PosesTogether) and all(type(pose) is type(first) for pose in poses):
        return first.turn_all(poses)
    turns, shifts = zip(*(pose.turn() for pose in poses), strict=True)
    return check_all(turns), np.stack(shifts)


def place_avatars(avatars: Sequence[Avatar], poses: F64, shifts: F64) -> Posture:
    """Joints of avatars, by pose [n, 55, 3], checked, and shift [n, 3] of each.

    Raises:
        DataError: a pose is not finite.
    """
    kinds = {id(avatar): avatar.joints for avatar in avatars}
    number = {key: n for n, key in enumerate(kinds)}
    rests = np.stack(list(kinds.values()))
    return place_all(rests[[number[id(avatar)] for avatar in avatars]], poses, shifts)


def check_all(poses: Sequence[F64]) -> F64:
    """Poses [n, 55, 3] of arrays whose shapes nobody has looked at.

    Raises:
        DataError: one has another number of joints.
    """
    return np.stack(
        [pose if pose.shape == (JOINT_COUNT, 3) else check_pose(pose) for pose in poses]
    )
