"""`StreamGrowing`: a stream whose scenes become more while it is drawn from.

Scenes are made beside the learner, so training begins with the first of them and takes up the
others at fixed numbers of samples. Whoever comes to such a number before its scenes are there
waits; so the samples are the same wherever they are drawn, however long the scenes take. Where
that matters less than the time of a card, scenes that are late join when they are there.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from itertools import pairwise, takewhile
from typing import Any

from gn0.errors import CheckpointError, ConfigError, FormatError
from gn0.sim.sensors import MapFrame
from gn0.training.streams.live_counts import LiveCounts
from gn0.training.streams.samples import LabelledStates, Stream, find_frames


def check_joins(joins: Sequence[int]) -> None:
    """Refuse numbers of samples at which scenes cannot join.

    The first is 0, and they do not fall: lots of one number join together.

    Raises:
        ConfigError: they are others; says which.
    """
    rising = all(a <= b for a, b in pairwise(joins))
    if not joins or joins[0] != 0 or not rising:
        raise ConfigError(
            f"scenes that join at {', '.join(map(str, joins)) or 'nothing'} samples",
            where="joins",
            remedy="give numbers that begin with 0 and do not fall",
        )


class StreamGrowing:
    """One stream after the other, each of more scenes than the one before.

    Args:
        open_part: opens the k-th stream, with the first k + 1 lots of scenes, after so many samples
            of this process, and says their hash; waits until they are there.
        joins: samples drawn when each lot joins, see `check_joins`.
        there: whether the k-th lot is; one that is due and is not joins with the first samples that
            find it. None: it is waited for.

    Attributes:
        part: the number of the lot that joined last.

    Raises:
        ConfigError: joins that make no sense.
    """

    def __init__(
        self,
        open_part: Callable[[int, int], tuple[Stream, str]],
        joins: Sequence[int],
        there: Callable[[int], bool] | None = None,
    ) -> None:
        check_joins(joins)
        self._open, self.joins, self._there = open_part, tuple(joins), there
        self.part, self.drawn, self._begun = self._find_part(0), 0, 0
        self._stream, self.hash = open_part(self.part, 0)

    @property
    def texts(self) -> tuple[str, ...]:
        """Instructions by episode number; another object once scenes have joined."""
        return self._stream.texts

    @property
    def frames(self) -> tuple[MapFrame, ...]:
        """The whole map of each episode, by number."""
        return find_frames(self._stream)

    def draw(self, count: int) -> LabelledStates:
        """The next states; first the scenes that are due join."""
        due = self._find_due()
        if due > self.part:
            self._enter(due, self.drawn)
        self.drawn += count
        return self._stream.draw(count)

    def tell(self) -> LiveCounts:
        """What the walks of these scenes came to since they joined or since it was last told.

        All are 0 where nobody walks. Waits for the device.
        """
        tell = getattr(self._stream, "tell", LiveCounts)
        found: LiveCounts = tell()
        return found

    def _find_part(self, drawn: int) -> int:
        return sum(join <= drawn for join in self.joins) - 1

    def _find_due(self) -> int:
        """The last lot that joins now."""
        due = self._find_part(self.drawn)
        if self._there is None:
            return due
        return max(takewhile(self._there, range(self.part + 1, due + 1)), default=self.part)

    def _enter(self, part: int, begun: int) -> None:
        del self._stream  # its maps and pictures make room on the device
        self.part, self._begun = part, begun
        self._stream, self.hash = self._open(part, begun)

    def state(self) -> dict[str, Any]:
        """Where it stands, as JSON: what `restore` takes."""
        return {
            "part": self.part,
            "drawn": self.drawn,
            "begun": self._begun,
            "hash": self.hash,
            "stream": self._stream.state(),
        }

    def restore(self, state: Mapping[str, Any]) -> None:
        """Go on from there: the same states follow.

        Raises:
            FormatError: it is no such state.
            CheckpointError: it was taken with other scenes.
        """
        part, drawn = state.get("part"), state.get("drawn")
        if not (isinstance(part, int) and isinstance(drawn, int) and 0 <= part < len(self.joins)):
            raise FormatError(f"part {part!r} of {len(self.joins)} lots of scenes", where="stream")
        begun = state.get("begun", self.joins[part])  # states of old do not tell
        if not isinstance(begun, int) or not 0 <= begun <= drawn:
            raise FormatError(f"scenes that joined after {begun!r} samples", where="stream")
        if part != self.part:
            self._enter(part, begun)
        if state.get("hash") != self.hash:
            raise CheckpointError(
                f"the state learned from scenes {state.get('hash')}, these are {self.hash}",
                where="stream",
                remedy="give the suites of the run, or start a new run from its weights",
            )
        self.drawn = drawn
        self._stream.restore(state["stream"])
