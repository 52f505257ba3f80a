"""BVH: a skeleton as text, then a line of channels a frame.

Offsets are the rest pose, in which nothing is turned. Rotations apply in the order of the channels:
R = R1 R2 R3. A joint with position channels stands there instead of at its offset. Source: the
format as Biovision left it (M. Meredith, S. Maddock: Motion Capture File Formats Explained, 2001).
"""

from __future__ import annotations

import math
import re
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from gn0.avatars.motion.rig import JOINT_LIMIT, RigMotion, check_rig, check_rig_size, tidy_rate
from gn0.avatars.motion.turns import about_axis, multiply
from gn0.errors import FormatError
from gn0.geometry import F64

_HEAD_LIMIT = 1 << 20  # bytes of the skeleton; a real one has some ten thousand
_WORD = re.compile(rb"[{}]|[^\s{}]+")
_MOTION = re.compile(
    rb"MOTION\s+Frames\s*:\s*(\d{1,12})\s+Frame\s+Time\s*:\s*([^\s]{1,40})[ \t]*\r?\n?", re.I
)
_CHANNEL = re.compile(r"([xyz])(position|rotation)", re.I)


@dataclass
class _Joint:
    """A joint while its block is being read."""

    name: str
    parent: int
    offset: tuple[float, ...] = (0.0, 0.0, 0.0)
    channels: list[tuple[str, str]] = field(default_factory=list)


def decode_bvh(data: bytes, file: Path | str) -> RigMotion:
    """The skeleton and motion of a BVH.

    Raises:
        FormatError: no BVH, a broken skeleton, frames missing, or numbers that are none.
    """
    found = _MOTION.search(data)
    if found is None:
        raise FormatError(
            "has no MOTION with its number of frames and frame time",
            file=file,
            offset=len(data),
            field="MOTION",
            remedy="fetch or export the file again",
        )
    if found.start() > _HEAD_LIMIT:
        raise FormatError(
            f"the skeleton takes {found.start()} bytes, more than the {_HEAD_LIMIT} that are read",
            file=file,
            offset=_HEAD_LIMIT,
            remedy="is this a BVH?",
        )
    joints = _Reader(data[: found.start()], file).joints()
    frames, seconds = int(found[1]), _number(found[2], file, found.start(2), "Frame Time")
    check_rig_size(len(joints), frames, len(data), file)
    if not 1e-3 <= seconds <= 1.0:
        raise FormatError(
            f"a frame takes {seconds:g} s, not 0.001 to 1",
            file=file,
            offset=found.start(2),
            field="Frame Time",
            remedy="correct the frame time",
        )
    width = sum(len(joint.channels) for joint in joints)
    rows, left = _rows(data, found.end(), frames, width, file)
    quats, steps = _frames(joints, rows)
    parents = tuple(joint.parent for joint in joints)
    offsets = np.array([joint.offset for joint in joints])
    places = offsets.copy()
    for k, parent in enumerate(parents):
        if parent >= 0:
            places[k] += places[parent]
    rig = RigMotion(
        names=tuple(joint.name for joint in joints),
        parents=parents,
        rest_rotations=np.tile(np.eye(3), (len(joints), 1, 1)),
        rest_positions=places,
        quats=quats,
        translations=steps,
        fps=tidy_rate(1.0 / seconds),
        name=Path(file).stem,
        notes=("there are more frames than the file says; they were left",) if left else (),
    )
    return check_rig(rig, file)


class _Reader:
    """The words of a skeleton, one after the other."""

    def __init__(self, head: bytes, file: Path | str) -> None:
        self.file = file
        self._end = len(head)
        self._at = 0
        self._words = _WORD.finditer(head)

    def word(self) -> str:
        found = next(self._words, None)
        if found is None:
            raise self.refuse("the skeleton is cut off", self._end)
        self._at = found.start()
        return found[0].decode("utf-8", "replace")

    def number(self, what: str) -> float:
        return _number(self.word().encode(), self.file, self._at, what)

    def refuse(self, what: str, offset: int | None = None) -> FormatError:
        return FormatError(
            what,
            file=self.file,
            offset=self._at if offset is None else offset,
            field="HIERARCHY",
            remedy="fetch or export the file again",
        )

    def title(self) -> str:
        """A name, all words up to the brace."""
        words = []
        while (word := self.word()) != "{":
            words.append(word)
            if len(words) > 16:
                raise self.refuse("a joint has no brace after its name")
        return " ".join(words)[:200]

    def joints(self) -> list[_Joint]:
        """All joints, each after its parent."""
        if self.word().upper() != "HIERARCHY":
            raise self.refuse("is not a BVH: it does not start with HIERARCHY")
        joints: list[_Joint] = []
        open_blocks: list[int] = []  # −1 is the end of a chain
        while (found := next(self._words, None)) is not None:
            self._at = found.start()
            word = found[0].decode("utf-8", "replace")
            kind = word.upper()
            inside = open_blocks[-1] if open_blocks else None
            if kind == "ROOT" and inside is None:
                joints.append(_Joint(self.title(), -1))
                open_blocks.append(len(joints) - 1)
            elif kind == "JOINT" and inside is not None and inside >= 0:
                joints.append(_Joint(self.title(), inside))
                open_blocks.append(len(joints) - 1)
            elif kind == "END" and inside is not None and inside >= 0:
                self.title()
                open_blocks.append(-1)
            elif kind == "OFFSET" and inside is not None:
                offset = tuple(self.number("OFFSET") for _ in range(3))
                if inside >= 0:
                    joints[inside].offset = offset
            elif kind == "CHANNELS" and inside is not None and inside >= 0:
                joints[inside].channels = self._channels()
            elif kind == "}" and open_blocks:
                open_blocks.pop()
            else:
                raise self.refuse(f"{word[:40]!r} is out of place")
            if len(joints) > JOINT_LIMIT:
                raise self.refuse(f"more than {JOINT_LIMIT} joints")
        if open_blocks or not joints:
            raise self.refuse("the skeleton is cut off: a brace is still open", self._end)
        return joints

    def _channels(self) -> list[tuple[str, str]]:
        count = self.number("CHANNELS")
        if count not in range(7):
            raise self.refuse(f"a joint has {count:g} channels, not 0 to 6")
        channels: list[tuple[str, str]] = []
        for _ in range(int(count)):
            word = self.word()
            found = _CHANNEL.fullmatch(word)
            if found is None:
                raise self.refuse(f"channel {word[:40]!r} is not known")
            channel = (found[2].lower(), found[1].lower())
            if channel in channels and channel[0] == "position":
                raise self.refuse(f"channel {word[:40]!r} is there twice")
            channels.append(channel)
        return channels


def _number(word: bytes, file: Path | str, offset: int, what: str) -> float:
    try:
        value = float(word)
    except ValueError:
        value = math.nan
    if not math.isfinite(value) or b"_" in word:
        raise FormatError(
            f"{word[:40].decode('utf-8', 'replace')!r} is not a number",
            file=file,
            offset=offset,
            field=what,
            remedy="fetch or export the file again",
        )
    return value


def _rows(data: bytes, start: int, frames: int, width: int, file: Path | str) -> tuple[F64, bool]:
    """Channels [frames, width], and whether there are more lines than that."""
    held = len(data) - start
    if frames * (2 * width) > held + 1:  # a digit and a blank each
        raise FormatError(
            f"is cut off or forged: {frames} frames of {width} numbers need at least "
            f"{frames * 2 * width} bytes, and {held} are there",
            file=file,
            offset=len(data),
            field="Frames",
            remedy="fetch or export the file again",
        )
    rows = np.empty((frames, width))
    at, row = start, 0
    while at < len(data):
        stop = data.find(b"\n", at)
        stop = len(data) if stop < 0 else stop
        words = data[at:stop].split(None, width + 1)
        if words and row == frames:
            return rows, True
        if words:
            if len(words) != width:
                many = "more" if len(words) > width else str(len(words))
                raise FormatError(
                    f"frame {row} has {many} numbers, not {width}",
                    file=file,
                    offset=at,
                    field=f"frame {row}",
                    remedy="fetch or export the file again",
                )
            try:
                rows[row] = [float(word) for word in words]
            except ValueError:
                raise FormatError(
                    f"frame {row} holds something that is not a number",
                    file=file,
                    offset=at,
                    field=f"frame {row}",
                    remedy="fetch or export the file again",
                ) from None
            row += 1
        at = stop + 1
    if row < frames:
        raise FormatError(
            f"is cut off: it says {frames} frames and has {row}",
            file=file,
            offset=len(data),
            field="Frames",
            remedy="fetch or export the file again",
        )
    return rows, False


def _frames(joints: list[_Joint], rows: F64) -> tuple[F64, F64]:
    """Quaternions [T, J, 4] and translations [T, J, 3] of channels [T, C] in degrees and units."""
    quats = np.zeros((len(rows), len(joints), 4))
    steps = np.empty((len(rows), len(joints), 3))
    column = 0
    for k, joint in enumerate(joints):
        turn = np.tile([1.0, 0.0, 0.0, 0.0], (len(rows), 1))
        steps[:, k] = joint.offset
        for kind, axis in joint.channels:
            values = rows[:, column]
            column += 1
            if kind == "position":
                steps[:, k, "xyz".index(axis)] = values
            else:
                # beyond some turns a sine has no digits left: let the check of frames name them
                angles = np.where(np.abs(values) < 1e9, values, np.nan)
                turn = multiply(turn, about_axis(axis, np.deg2rad(angles)))
        quats[:, k] = turn
    return quats, steps
