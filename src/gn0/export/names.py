"""Which episode is which: ids that a third-party format cannot hold, kept in a file beside it."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import msgspec

from gn0.errors import FormatError
from gn0.export.exporter import Record
from gn0.export.faults import load_typed
from gn0.export.trips import Trip
from gn0.storage import write_bytes

NAMES_FILE = "gn0_ids.json"


class Name(msgspec.Struct, frozen=True):
    """An episode of ours: its id, its scene, its split."""

    id: str
    scene: str
    split: str


def name_of(trip: Trip) -> list[str]:
    """What a record keeps under "gn0"."""
    return [trip.episode.id, trip.episode.scene_id, trip.episode.split]


def save_names(folder: Path, records: Sequence[Record]) -> None:
    """Write the names of all episodes, in their order.

    Raises:
        StorageError: the file cannot be written.
    """
    names = [Name(*record["gn0"]) for record in records]
    write_bytes(folder / NAMES_FILE, msgspec.json.encode(names) + b"\n")


def load_names(folder: Path, count: int) -> list[Name]:
    """The names of `count` episodes.

    Raises:
        StorageError, FormatError: missing, damaged, or of another number of episodes.
    """
    names = load_typed(folder / NAMES_FILE, list[Name])
    if len(names) != count:
        raise FormatError(
            f"names {len(names)} episodes, the export has {count}",
            file=folder / NAMES_FILE,
            remedy="export it again",
        )
    return names
