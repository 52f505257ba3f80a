"""The order in which a dataset's samples are given: by its seed, whoever reads them.

An epoch takes the parts in an order of its own and shuffles blocks of so many samples. A sample of
weight w is in ⌊w (e + 1) + u⌋ − ⌊w e + u⌋ places of epoch e, u a random number of its own in
[0, 1): once an epoch where w is 1, and over any E epochs within one of w E times.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from gn0.errors import ConfigError, DataError
from gn0.seeds import random_stream

I64 = NDArray[np.int64]
_UNITS = 2.0**-32  # of u, so that sums with whole numbers are exact
_KEPT = 2  # epochs whose order is remembered


@dataclass(frozen=True)
class Place:
    """Where a stream stands over all its ranks: the next place of an epoch."""

    epoch: int = 0
    place: int = 0


@dataclass(frozen=True)
class Rows:
    """Samples to give.

    Attributes:
        rows: int64 [N] of the dataset, over all parts in order.
        epochs, places: int64 [N] where in the order they stand.
    """

    rows: I64
    epochs: I64
    places: I64

    def __len__(self) -> int:
        return len(self.rows)


@dataclass(eq=False)
class SampleOrder:
    """The order of the samples of all epochs.

    Args:
        sizes: samples of each part.
        weights: float64 [samples]; None counts each once.
        seed: of the order.
        buffer: samples of a block that is shuffled.

    Raises:
        ConfigError: an empty buffer.
        DataError: there is nothing to draw.
    """

    sizes: Sequence[int]
    weights: NDArray[np.float64] | None = None
    seed: int = 0
    buffer: int = 8192
    _kept: dict[int, I64] = field(default_factory=dict, repr=False)

    def __post_init__(self) -> None:
        if self.buffer < 1:
            raise ConfigError(
                f"a buffer of {self.buffer} samples", where="buffer", remedy="give 1 or more"
            )
        total = int(sum(self.sizes))
        if not total or (self.weights is not None and not self.weights.any()):
            raise DataError("there are no samples to draw", remedy="build more episodes")
        self._begins = np.concatenate([[0], np.cumsum(np.asarray(self.sizes, np.int64))])

    def part_of(self, rows: I64) -> I64:
        """The part that holds each of these rows."""
        return np.searchsorted(self._begins, rows, side="right") - 1

    def begin_of(self, part: int) -> int:
        """The first row of a part."""
        return int(self._begins[part])

    def count(self, epoch: int) -> I64:
        """In how many places of an epoch each sample is, int64 [samples]."""
        total = int(self._begins[-1])
        if self.weights is None:
            return np.ones(total, np.int64)
        stream = random_stream(self.seed, "samples", "share")
        share = stream.integers(0, 2**32, total) * _UNITS
        upto = np.floor(self.weights * (epoch + 1) + share) - np.floor(self.weights * epoch + share)
        return upto.astype(np.int64)

    def epoch(self, epoch: int) -> I64:
        """The rows of an epoch, in the order in which they are given."""
        if epoch not in self._kept:
            while len(self._kept) >= _KEPT:
                self._kept.pop(next(iter(self._kept)))
            self._kept[epoch] = self._shuffle(epoch)
        return self._kept[epoch]

    def _shuffle(self, epoch: int) -> I64:
        parts = random_stream(self.seed, "samples", "parts", epoch).permutation(len(self.sizes))
        rows = np.concatenate([np.arange(*self._begins[[k, k + 1]]) for k in parts])
        rows = np.repeat(rows, self.count(epoch)[rows])
        stream = random_stream(self.seed, "samples", "blocks", epoch)
        for begin in range(0, len(rows), self.buffer):
            stream.shuffle(rows[begin : begin + self.buffer])
        return rows

    def take(self, start: Place, count: int, rank: int = 0, ranks: int = 1) -> Rows:
        """The next `count` samples of a rank: every `ranks`-th place from `start` on."""
        epoch, place, left = start.epoch, start.place + rank, count
        found: list[Rows] = []
        while left:
            order = self.epoch(epoch)
            if place >= len(order):
                epoch, place = epoch + 1, place - len(order)
                continue
            places = np.arange(place, len(order), ranks)[:left]
            found.append(Rows(order[places], np.full_like(places, epoch), places))
            left -= len(places)
            place = int(places[-1]) + ranks
        return Rows(
            *(
                np.concatenate([getattr(one, name) for one in found] or [np.empty(0, np.int64)])
                for name in ("rows", "epochs", "places")
            )
        )

    def advance(self, start: Place, count: int) -> Place:
        """Where a stream stands after `count` samples over all ranks."""
        epoch, place = start.epoch, start.place + count
        while place >= (size := len(self.epoch(epoch))):
            epoch, place = epoch + 1, place - size
        return Place(epoch, place)
