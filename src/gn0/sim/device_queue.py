"""The episodes that come next, environment by environment, drawn and made ready ahead of need.

A step on the device ends episodes and begins the next ones by itself, so each environment has a
queue of slots there. The host knows how many draws were begun only as of some steps ago; what may
have been begun since stays pinned, and the queues are long enough for an episode a step.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from gymnasium.utils import seeding
from numpy.typing import NDArray

from gn0.sim.device_store import EpisodeStore

_CHUNK = 256  # draws at a time from a generator; their sequence does not depend on it


class Draws(NamedTuple):
    """What an environment will draw next.

    Attributes:
        numbers: of episodes that are drawn already.
        stream: state of the generator that draws those after them.
    """

    numbers: NDArray[np.int64]
    stream: Mapping[str, Any]


class EpisodeQueue:
    """Draws of N environments, each from its own generator.

    A draw's position counts from the first one that its environment ever made.

    Args:
        count: N.
        ahead: draws held ready beyond the last one that is known to have begun.
        numbers: episode numbers [E] to draw from.
        store: makes them ready.

    Attributes:
        known: [N] draws that are known to have begun.
        filled: [N] draws that are in the queue.
    """

    def __init__(
        self, count: int, ahead: int, numbers: NDArray[np.int64], store: EpisodeStore
    ) -> None:
        self.ahead = ahead
        self.known = np.zeros(count, np.int32)
        self.filled = np.zeros(count, np.int32)
        self._numbers = numbers
        self._store = store
        self._streams: list[np.random.Generator | None] = [None] * count
        self._drawn = np.zeros((count, _CHUNK + ahead), np.int64)  # numbers
        self._at = np.zeros(count, np.int64)
        self._end = np.zeros(count, np.int64)
        self._window = np.full((count, ahead), -1, np.int32)  # slots, by position modulo `ahead`
        self._playing = np.full(count, -1, np.int32)  # slots, as far as is known
        self._seeded = np.zeros(count, np.int32)  # `known` when the generators began

    def seed(self, which: NDArray[np.int64], seeds: Sequence[int | None] | None) -> None:
        """Begin new generators where there is a seed, or none yet; `known` must be exact."""
        fresh = []
        for i in which.tolist():
            given = None if seeds is None else seeds[i]
            if given is not None or self._streams[i] is None:
                self._streams[i], _ = seeding.np_random(given)
                fresh.append(i)
        self._forget(np.array(fresh, np.int64))
        self._seeded[fresh] = self.known[fresh]

    @property
    def begun(self) -> NDArray[np.int32]:
        """Draws [N] begun since each was seeded; `known` must be exact, and nothing restored."""
        found: NDArray[np.int32] = self.known - self._seeded
        return found

    def begin_at(self, seeds: Sequence[int], begun: NDArray[np.int32]) -> None:
        """Begin new generators, and be where `begun` [N] of their draws have begun.

        `known` must be exact. The draws before are passed over.
        """
        self.seed(np.arange(len(begun)), seeds)
        for i, left in enumerate(begun.tolist()):
            while left > self._end[i] - self._at[i]:
                left -= int(self._end[i] - self._at[i])
                self._at[i] = self._end[i] = 0
                self._draw(i)
            self._at[i] += left
        self._seeded -= begun

    def _forget(self, which: NDArray[np.int64]) -> None:
        """Take back what the queues of `which` hold."""
        rows, places = _spans(which, self.known[which], self.filled[which])
        self._store.release(self._window[rows, places % self.ahead])
        self.filled[which] = self.known[which]
        self._at[which] = self._end[which] = 0

    def advance(self, begun: NDArray[np.int32]) -> None:
        """Learn that `begun` [N] draws have begun by now; what was played before is let go."""
        moved = np.flatnonzero(begun > self.known)
        if not len(moved):
            return
        playing = self._playing[moved]
        self._store.release(playing[playing >= 0])
        rows, places = _spans(moved, self.known[moved], begun[moved] - 1)
        self._store.release(self._window[rows, places % self.ahead])
        self._playing[moved] = self._window[moved, (begun[moved] - 1) % self.ahead]
        self.known[moved] = begun[moved]

    def play(self, which: NDArray[np.int64], slots: NDArray[np.int32]) -> None:
        """Learn that environments `which` play the pinned episodes at `slots` from now on."""
        playing = self._playing[which]
        self._store.release(playing[playing >= 0])
        self._playing[which] = slots

    def playing(self, which: NDArray[np.int64]) -> NDArray[np.int32]:
        """Slots of the episodes that `which` play; `known` must be exact."""
        return self._playing[which]

    def save(self, which: NDArray[np.int64]) -> list[Draws]:
        """What `which` will draw next, to be handed to `restore`; `known` must be exact."""
        found = []
        for i in which.tolist():
            stream = self._streams[i]
            assert stream is not None
            places = np.arange(self.known[i], self.filled[i]) % self.ahead
            ready = self._store.numbers_at(self._window[i, places])
            drawn = self._drawn[i, self._at[i] : self._end[i]]
            found.append(Draws(np.concatenate([ready, drawn]), stream.bit_generator.state))
        return found

    def restore(self, which: NDArray[np.int64], draws: Sequence[Draws]) -> None:
        """Let `which` [K] draw what was saved [K]; `known` must be exact."""
        self._forget(which)
        for i, saved in zip(which.tolist(), draws, strict=True):
            stream, count = self._streams[i], len(saved.numbers)
            assert stream is not None
            self._drawn[i, :count] = saved.numbers
            self._end[i] = count
            stream.bit_generator.state = saved.stream

    def refill(self) -> tuple[NDArray[np.int32], int] | None:
        """Draw until each queue holds `ahead` draws beyond what is known to have begun.

        Returns:
            What the kernel `fill_queue` reads, and the number of its entries; None when the
            queues are full.

        Raises:
            EpisodeError: an episode does not fit its scene; then nothing is drawn.
            DeviceMemoryError: what is in the queues does not fit the device.
        """
        need = self.known + self.ahead - self.filled
        which = np.flatnonzero(need > 0)
        if not len(which):
            return None
        for i in which[self._end[which] - self._at[which] < need[which]].tolist():
            self._draw(i)
        first = self.filled[which]
        rows, places = _spans(which, first, first + need[which])
        steps = places - np.repeat(first, need[which])
        slots = self._store.pin(self._drawn[rows, self._at[rows] + steps])
        self._at[which] += need[which]
        self.filled[which] += need[which]
        self._window[rows, places % self.ahead] = slots
        cells = rows * self.ahead + places % self.ahead
        entries = np.stack([cells.astype(np.int32), slots], axis=1)
        return np.concatenate([self.filled, entries.ravel()]), len(rows)

    def _draw(self, i: int) -> None:
        stream, left = self._streams[i], int(self._end[i] - self._at[i])
        assert stream is not None
        self._drawn[i, :left] = self._drawn[i, self._at[i] : self._end[i]]
        drawn = stream.integers(len(self._numbers), size=_CHUNK)
        self._drawn[i, left : left + _CHUNK] = self._numbers[drawn]
        self._at[i], self._end[i] = 0, left + _CHUNK


def _spans(
    which: NDArray[np.int64], first: NDArray[np.int32], end: NDArray[np.int32]
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """(row, place) of all places first[k]..end[k] of rows which[k]."""
    lengths = np.maximum(end - first, 0).astype(np.int64)
    rows = np.repeat(which, lengths)
    begins = np.repeat(np.cumsum(lengths) - lengths, lengths)
    return rows, np.repeat(first.astype(np.int64), lengths) + np.arange(len(rows)) - begins
