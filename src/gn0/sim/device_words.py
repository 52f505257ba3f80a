"""What agents on a device are told, and observations as their caller wants them laid out."""

from __future__ import annotations

import warnings
from collections.abc import Iterable, Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from gn0.device.device import DeviceArray
from gn0.errors import ConfigError
from gn0.sim.device_layout import blocks_of
from gn0.sim.device_records import MoveChannels, TakeRows
from gn0.sim.words import WordTable

if TYPE_CHECKING:
    from gn0.missions.episode import Episode
    from gn0.sim.device_state import SimulatorDevice

THREADS = 256
Observations = dict[str, DeviceArray]
OLD_NAME = (
    "a device has no texts: 'instruction' gives the number of the episode there; "
    "name 'instruction_index' (docs/learning.md)"
)


class ObservationsDevice(dict[str, DeviceArray]):
    """Observations by name; `instruction` is still found as what `instruction_index` is now."""

    def __missing__(self, name: str) -> DeviceArray:
        if name != "instruction" or "instruction_index" not in self:
            raise KeyError(name)
        warnings.warn(OLD_NAME, DeprecationWarning, stacklevel=2)
        return self["instruction_index"]

    def get(self, name: str, default: Any = None) -> Any:
        """An observation, or something else where there is none."""
        return self[name] if name in self or name == "instruction" else default


def rename_words(words: frozenset[str]) -> frozenset[str]:
    """Words that a device knows; `instruction` is there as `instruction_index`, with a warning."""
    if "instruction" not in words:
        return words
    warnings.warn(OLD_NAME, DeprecationWarning, stacklevel=3)
    return words - {"instruction"} | {"instruction_index"}


class WordsDevice:
    """Tokens and numbers of instructions, by what episodes agents are in.

    Args:
        simulator: in which they are.
        words: names of what they are told.
        table: their tokens, where those are among the words.
    """

    def __init__(
        self, simulator: SimulatorDevice, words: frozenset[str], table: WordTable | None
    ) -> None:
        self._simulator, self._words, self._rows = simulator, words, table
        self._table: DeviceArray | None = None
        self._kept: dict[str, DeviceArray] = {}

    def tell(self, prefix: str = "") -> dict[str, DeviceArray]:
        """What agents are told now, or with prefix `final_` were told last, [N, …]."""
        numbers = self._simulator.outputs[prefix + "episode"]
        found: dict[str, DeviceArray] = {}
        if "instruction_index" in self._words:
            found["instruction_index"] = numbers
        if "instruction_tokens" in self._words:
            found["instruction_tokens"] = self._take(prefix, numbers)
        return found

    @property
    def table(self) -> DeviceArray:
        """Tokens int32 [E, L] by number of the episode; uploaded when episodes were added.

        Raises:
            ConfigError: tokens are not among the words.
        """
        if self._rows is None:
            raise ConfigError(
                "agents are not told in tokens", remedy="name sensor 'instruction_tokens'"
            )
        if self._rows.extend(self._simulator.store.episodes) or self._table is None:
            self._table = self._simulator.device.upload(self._rows.rows)
        return self._table

    def check(self, episode: Episode) -> None:
        """Refuse an episode that has no tokens.

        Raises:
            EpisodeError: see `gn0.sim.words.WordTable`.
        """
        if self._rows is not None:
            self._rows.row(episode)

    def _take(self, name: str, numbers: DeviceArray) -> DeviceArray:
        simulator, table = self._simulator, self.table
        length = table.shape[1]
        if name not in self._kept:
            self._kept[name] = simulator.device.zeros((simulator.count, length), np.int32)
        out = self._kept[name]
        taking = TakeRows(
            table=table,
            numbers=numbers,
            width=np.uint64(length),
            size=np.uint64(out.size),
            out=out,
        )
        simulator.kernels["take_rows"].launch(blocks_of(out.size, THREADS), THREADS, taking)
        return out


class LayoutDevice:
    """How observations are handed out.

    Args:
        simulator: whose memory it is.
        pictures: names of those that go channels first.
        copy: in memory of their own.
    """

    def __init__(self, simulator: SimulatorDevice, pictures: Iterable[str], copy: bool) -> None:
        self._simulator, self._pictures, self._copy = simulator, frozenset(pictures), copy

    def turn(self, seen: Mapping[str, Any]) -> dict[str, Any]:
        """Pictures [N, H, W, 3] as [N, 3, H, W], the rest as it is."""
        if not self._pictures:
            return dict(seen)
        return {
            name: self._move(value) if name in self._pictures else value
            for name, value in seen.items()
        }

    def hand_out(self, values: Mapping[str, Any]) -> dict[str, Any]:
        """The arrays themselves, or copies of them."""
        return {name: self.own(value) for name, value in values.items()}

    def own(self, value: Any) -> Any:
        """An array itself, or a copy of it; anything else as it is."""
        if not self._copy or not isinstance(value, DeviceArray):
            return value
        out = self._simulator.device.empty(value.shape, value.dtype)
        if value.size:
            self._simulator.copy(value, out)
        return out

    def _move(self, pictures: DeviceArray) -> DeviceArray:
        count, height, width, channels = pictures.shape
        simulator = self._simulator
        out = simulator.device.empty((count, channels, height, width), pictures.dtype)
        size = pictures.nbytes
        if size:
            moving = MoveChannels(
                in_=pictures,
                pixels=np.uint64(height * width),
                width=np.uint64(pictures.dtype.itemsize),
                size=np.uint64(size),
                out=out,
            )
            simulator.kernels["move_channels"].launch(blocks_of(size, THREADS), THREADS, moving)
        return out
