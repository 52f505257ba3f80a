"""How people look as numbers that a kernel writes: what they stand for, and their poses at once.

A code above 0 holds all of a `Shown`, who it is and its level of detail. Thousands are read as
columns, so that no person is an object on the way to a card.
"""

from __future__ import annotations

from collections.abc import Hashable, Sequence

import numpy as np

from gn0.avatars.avatar import Avatar
from gn0.avatars.code_map import I64, U64
from gn0.avatars.held import HELD
from gn0.avatars.kept_rows import KeptRows
from gn0.avatars.motion.gait import SPEEDS
from gn0.avatars.motion.library import BY_SPEED
from gn0.errors import ConfigError
from gn0.geometry import F32, F64
from gn0.people.cast import Cast
from gn0.people.shown import STOOD, PoseShown, Shown, rest_key
from gn0.people.shown_poses import BLEND, FRAME_WIDTH, KINDS, frame_of, ready_people
from gn0.render.cuda.posed import RestDevice

_NONE = 63  # no clip
_BITS = (15, 3, 6, 10, 3, 3, 6, 9, 2, 1, 6)  # of a code, from its lowest; `shown.cu` has the same
_LEVEL = np.uint64((1 << _BITS[1]) - 1 << _BITS[0])
_ROLES, _GAITS, _FRAMES = 1 << _BITS[0], 1 << _BITS[4], 1 << _BITS[3]
_KEPT = 2**15  # frames of clips, 3.3 kB each; memory that nobody wrote to is none
_TOGETHER = 2**13  # people whose frames, two each, are there at once


class _Columns:
    """Codes as columns."""

    def __init__(self, codes: U64) -> None:
        left, columns = codes - np.uint64(1), []
        for bits in _BITS:
            columns.append((left & np.uint64((1 << bits) - 1)).astype(np.int64))
            left = left >> np.uint64(bits)
        self.role, self.level, self.clip, self.frame, self.gait, self.look, *more = columns
        self.other, self.other_frame, quarter, self.early, stood = more
        self.blends = self.other != _NONE
        self.quarter = np.where(quarter > 0, quarter, BLEND)
        self.stood = np.where(self.blends, stood + STOOD[0], 0)


class ShownCodes:
    """Reads codes of people, whose roles and clips get their numbers here.

    Args:
        cast: who can be shown.
    """

    def __init__(self, cast: Cast) -> None:
        self._cast = cast
        self._roles: dict[tuple[str, float], int] = {}
        self._whom: list[tuple[str, float]] = []
        # `shown.cu` knows the numbers of the first
        self._clips = {clip: number for number, clip in enumerate(KINDS)}
        self._names = list(KINDS)
        self._kept = KeptRows((np.float64, (FRAME_WIDTH,)), _KEPT)
        self._joints: list[F64] = []  # of roles at rest
        self._bodies: F64 | None = None

    def role(self, identity: str, seat: float) -> int:
        """The number of somebody with a seat of a height [m].

        Raises:
            ConfigError: a code has no room for as many.
            EpisodeError, StorageError, FormatError: see `Cast.find`.
        """
        number = self._roles.get((identity, seat))
        if number is None:
            number = len(self._whom)
            if number >= _ROLES:
                raise ConfigError(
                    f"more than {_ROLES:,} people who differ by identity or height of seat",
                    where=f"identity {identity!r}",
                    remedy="share the episodes out over several environments, or use VectorEnv",
                )
            joints = self._cast.find(identity).levels[0].joints
            self._roles[identity, seat] = number
            self._whom.append((identity, seat))
            self._joints.append(joints)
            self._bodies = None
        return number

    def clip(self, name: str) -> int:
        """The number of a clip."""
        number = self._clips.setdefault(name, len(self._names))
        if number == len(self._names):
            self._names.append(name)
        return number

    def read(self, code: int) -> PoseShown:
        """Who is shown how by a code."""
        one = _Columns(np.array([code], np.uint64))
        identity, seat = self._whom[int(one.role[0])]
        before = self._names[int(one.other[0])] if one.blends[0] else ""
        shown = Shown(
            clip=self._names[int(one.clip[0])],
            frame=int(one.frame[0]),
            other=before,
            other_frame=int(one.other_frame[0]),
            quarter=int(one.quarter[0]),
            speed=int(one.gait[0]),
            look=int(one.look[0]),
            seat=seat,
            early=int(one.early[0]),
            stood=int(one.stood[0]),
        )
        return PoseShown(self._cast.find(identity), shown, int(one.level[0]))

    def postures(self, codes: U64) -> U64:
        """Codes of the same postures, whatever the level of detail."""
        return ((codes - np.uint64(1)) & ~_LEVEL) + np.uint64(1)

    def rests(self, codes: U64) -> tuple[list[Hashable], I64]:
        """Keys of those at rest (`PoseShown.rest_key`), and the place among them of each code."""
        columns = _Columns(codes)
        things = np.array([list(HELD).index(n) if n in HELD else -1 for n in self._names]) + 1
        kinds = ((columns.role << _BITS[1]) + columns.level) * (len(HELD) + 1) + things[
            columns.clip
        ]
        _, first, which = np.unique(kinds, return_index=True, return_inverse=True)
        keys: list[Hashable] = []
        for n in first.tolist():
            actor = self._cast.find(self._whom[columns.role[n]][0])
            keys.append(rest_key(actor, int(columns.level[n]), self._names[columns.clip[n]]))
        return keys, which

    def avatar(self, code: int) -> Avatar:
        """Whom a code shows, at its level of detail."""
        return self.read(code).avatar

    def ready(
        self, codes: U64, rests: Sequence[RestDevice], which: I64, rows: F32, at: I64
    ) -> tuple[F32, F32]:
        """Write poses to rows; see `CodedPoses.ready`.

        Raises:
            DataError, RenderError: see `shown_poses.ready_people`.
        """
        parts = [slice(n, n + _TOGETHER) for n in range(0, len(codes), _TOGETHER)]
        made = [self._ready(codes[p], rests, which[p], rows, at[p]) for p in parts]
        boxes, steps = zip(*made, strict=True)
        return np.concatenate(boxes), np.concatenate(steps)

    def _ready(
        self, codes: U64, rests: Sequence[RestDevice], which: I64, rows: F32, at: I64
    ) -> tuple[F32, F32]:
        one = _Columns(codes)
        before = np.where(one.blends, one.other, one.clip)
        frame = np.where(one.blends, one.other_frame, one.frame)
        now, before = self._frames(
            np.concatenate([one.role, one.role]),
            np.concatenate([one.clip, before]),
            np.concatenate([one.gait, one.gait]),
            np.concatenate([one.frame, frame]),
        ).reshape(2, -1)
        kind = np.minimum(one.clip, len(KINDS))
        head = one.look, one.early, one.stood
        looks = np.stack([kind, one.frame, one.blends, one.quarter, *head], axis=1)
        if self._bodies is None:
            self._bodies = np.stack(self._joints)
        bodies, chosen = self._bodies, which.astype(np.int64)
        people = self._kept.rows, now, before, looks, bodies, one.role
        return ready_people(*people, rests, chosen, rows, at)

    def _frames(self, role: I64, clip: I64, gait: I64, frame: I64) -> I64:
        """Where frames of clips are kept."""
        by_speed = np.array([name in BY_SPEED for name in self._names])
        gait = np.where(by_speed[clip], gait, 0)
        keys = (((clip * _GAITS + gait) * _FRAMES + frame) * _ROLES + role + 1).astype(np.uint64)
        at = self._kept.find(keys)
        lacking = np.flatnonzero(at < 0)
        if not len(lacking):
            return at
        _, first = np.unique(keys[lacking], return_index=True)
        new = lacking[first]
        rows = np.stack([self._frame(*(int(c[n]) for c in (role, clip, gait, frame))) for n in new])
        self._kept.keep(keys[new], rows)
        return self._kept.find(keys)

    def _frame(self, role: int, clip: int, gait: int, frame: int) -> F64:
        identity, seat = self._whom[role]
        library = self._cast.find(identity).library(seat)
        return frame_of(library, self._names[clip], frame, SPEEDS[gait])
