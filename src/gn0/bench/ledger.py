"""Which episodes of a run have a result: one number each; everything else stays on disk.

A result, its trace and its times are in the journal before anybody counts them; kept in memory is
only where. So the parent of a run needs no more for an episode than for the place of its line, and
the files of a finished run are written from the journal, line by line in order of episode.
"""

from __future__ import annotations

import json
import math
from array import array
from bisect import bisect_left
from collections.abc import Iterator, Sequence
from operator import attrgetter
from pathlib import Path
from typing import IO, Any, TypeVar

import msgspec

from gn0.bench.results import EpisodeResult, EpisodeTrace, write_lines
from gn0.missions.episode import Episode
from gn0.storage import Journal, write_atomic
from gn0.suites.run_files import RESULTS, RUN, TRAJECTORIES

T = TypeVar("T")
_id_of = attrgetter("id")
_NONE = -1  # no result yet
_EPISODES = '\n  "episodes": {}'  # in run.json: no text of JSON holds a line feed


class ResultLine(msgspec.Struct, frozen=True):
    """The outcome of a journal's line of type "result"."""

    result: EpisodeResult


class TraceLine(msgspec.Struct, frozen=True):
    """Its trace."""

    trace: EpisodeTrace


class AboutLine(msgspec.Struct, frozen=True):
    """Its times, attempts and worker."""

    about: dict[str, Any]


class Ledger:
    """Where in the journal the result of each episode stands.

    Attributes:
        done: how many episodes have one.
    """

    def __init__(self, episodes: Sequence[Episode]) -> None:
        self._episodes = sorted(episodes, key=_id_of)
        self._places = array("q", [_NONE]) * len(self._episodes)
        self._failed = bytearray(len(self._episodes))
        self._invalid = bytearray(len(self._episodes))
        self.done = 0

    @property
    def failed(self) -> int:
        """How many of the results are failures."""
        return sum(self._failed)

    @property
    def invalid(self) -> int:
        """How many of the results are of episodes that cannot be scored."""
        return sum(self._invalid)

    def find(self, episode_id: str) -> Episode | None:
        """The episode of that id; None when this run has none."""
        index = self._index(episode_id)
        return None if index is None else self._episodes[index]

    def holds(self, episode_id: str) -> bool:
        """Whether the episode has a result."""
        index = self._index(episode_id)
        return index is not None and self._places[index] != _NONE

    def note(self, result: EpisodeResult, place: int) -> None:
        """Note at which byte of the journal the line of an episode's result begins."""
        index = self._index(result.episode)
        if index is None:
            return
        self.done += self._places[index] == _NONE
        self._places[index] = place
        self._failed[index] = result.status == "failed"
        self._invalid[index] = result.status == "invalid"

    def _index(self, episode_id: str) -> int | None:
        index = bisect_left(self._episodes, episode_id, key=_id_of)
        there = index < len(self._episodes) and self._episodes[index].id == episode_id
        return index if there else None

    def _noted(self) -> Iterator[int]:
        return (place for place in self._places if place != _NONE)

    def _read(self, journal: Journal, kind: type[T]) -> Iterator[T]:
        """One part of each result's line, in order of episode; the others are skipped."""
        return map(msgspec.json.Decoder(kind).decode, journal.read_bodies(self._noted()))

    def save(self, journal: Journal, out: Path) -> None:
        """Write results and trajectories, in order of episode.

        Raises:
            StorageError: the journal cannot be read, or a file cannot be written.
        """
        write_lines(out / RESULTS, (line.result for line in self._read(journal, ResultLine)))
        write_lines(out / TRAJECTORIES, (line.trace for line in self._read(journal, TraceLine)))

    def save_run(self, journal: Journal, out: Path, about: dict[str, Any]) -> None:
        """Write `run.json`: what may differ between equal runs, with the times of each episode.

        Raises:
            StorageError: the journal cannot be read, or the file cannot be written.
        """
        seconds = math.fsum(
            line.about.get("seconds", 0.0) for line in self._read(journal, AboutLine)
        )
        text = _dump({**about, "seconds": round(seconds, 3), "episodes": {}})
        head, tail = text.split(_EPISODES)

        def write(stream: IO[bytes]) -> None:
            stream.write(f'{head}\n  "episodes": {{'.encode())
            names = (e.id for e, p in zip(self._episodes, self._places, strict=True) if p != _NONE)
            between = "\n"
            for name, line in zip(names, self._read(journal, AboutLine), strict=True):
                shown = _dump(line.about).replace("\n", "\n    ")
                stream.write(f"{between}    {_dump(name)}: {shown}".encode())
                between = ",\n"
            stream.write((("\n  }" if self.done else "}") + tail + "\n").encode())

        write_atomic(out / RUN, write)


def _dump(value: Any) -> str:
    return json.dumps(value, indent=2, sort_keys=True, ensure_ascii=False, allow_nan=False)
