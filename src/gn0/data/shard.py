"""Shards of a dataset: what one of several machines builds by itself, for `gn0.data.merge`.

A dataset is planned as a list of parts. Shard i of n is a run of that list, about as many episodes
as any other. Its folder is one of a build that has not ended: the scenes and files of its parts,
and, written last, `shard.json`, which names them. Nothing in it depends on the other shards.
"""

from __future__ import annotations

import hashlib
import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, TypeVar

import msgspec
import numpy as np

from gn0.config import Config, decode_json
from gn0.data.dataset import PICTURE_FOLDER, DatasetFile, FileRecord, compute_seal
from gn0.errors import ConfigError, DataError, FormatError
from gn0.storage import check_contained, content_hash, plain_path, read_bytes, safe_join, write_json

if TYPE_CHECKING:
    from gn0.data.part import PartDone, PartPlan

SHARD_FILE = "shard.json"
SHARD_LAYOUT = 1  # raise it when a field changes its name or meaning
MOST_SHARDS = 100_000
_LIMIT = 2**30  # bytes of shard.json
_BLOCK = 2**20
_NAME = re.compile(r"([1-9][0-9]{0,5})/([1-9][0-9]{0,5})")
P = TypeVar("P", bound="PartPlan")


@dataclass(frozen=True)
class ShardName:
    """Shard `index` of `count`, counted from 1."""

    index: int
    count: int

    def __post_init__(self) -> None:
        if not 1 <= self.index <= self.count <= MOST_SHARDS:
            raise ConfigError(
                f"there is no shard {self.index} of {self.count}",
                where="--shard",
                remedy="give i/n with i from 1 to n, e.g. 2/8",
            )

    @classmethod
    def parse(cls, text: str) -> ShardName:
        """The shard that "i/n" names.

        Raises:
            ConfigError: it names none.
        """
        match = _NAME.fullmatch(text)
        if match is None:
            raise ConfigError(
                f"{text!r} names no shard",
                where="--shard",
                remedy="give i/n with i from 1 to n, e.g. 2/8",
            )
        return cls(int(match[1]), int(match[2]))

    def __str__(self) -> str:
        return f"{self.index}/{self.count}"

    def choose(self, plans: Sequence[P]) -> list[P]:
        """The parts of this shard: a run of all, cut where episodes are shared out evenly."""
        ends = np.cumsum([len(plan.episodes) for plan in plans], dtype=np.int64)
        total = int(ends[-1]) if len(ends) else 0
        # a part goes to the shard in whose share its middle lies
        middles = [2 * int(end) - len(plan.episodes) for end, plan in zip(ends, plans, strict=True)]
        return [
            plan
            for middle, plan in zip(middles, plans, strict=True)
            if min(middle * self.count // (2 * total), self.count - 1) == self.index - 1
        ]


class ShardPart(Config, frozen=True):
    """A part that was built.

    Attributes:
        number: number of the part in the whole dataset, from 0.
        done: what was made, as the build's journal says it.
        waiting: files of it that the cache's last step takes up: depth of LeRobot's layout.
    """

    number: int
    done: dict[str, object]
    waiting: tuple[FileRecord, ...] = ()


class ShardFile(Config, frozen=True):
    """The content of `shard.json`.

    Attributes:
        layout: version of this file's layout.
        index: which shard, from 1.
        count: how many shards there are.
        plan: digest of all parts of all shards: their names and episodes.
        total: parts of all shards.
        about: the dataset's description; `files` are the scenes of this shard, and the episodes.
        parts: its parts, in order.
        seal: digest of all the rest.
    """

    layout: int
    index: int
    count: int
    plan: str
    total: int
    about: DatasetFile
    parts: tuple[ShardPart, ...]
    seal: str = ""

    @property
    def name(self) -> ShardName:
        """Which it is."""
        return ShardName(self.index, self.count)

    @property
    def rows(self) -> int:
        """Samples in it."""
        return sum(done.part.rows for _, done in self.made())

    def made(self) -> list[tuple[int, PartDone]]:
        """(number, what was made) of its parts."""
        from gn0.data.part import PartDone

        return [(part.number, msgspec.convert(part.done, PartDone)) for part in self.parts]

    def records(self) -> list[FileRecord]:
        """Every file of it that a whole dataset needs, paths relative to the folder."""
        layout = self.about.settings.pictures.layout
        every = list(self.about.files)
        for part, (_, done) in zip(self.parts, self.made(), strict=True):
            every += [*part_records(done, layout), *part.waiting]
        found = {record.path: record for record in every}
        return [found[path] for path in sorted(found)]


def part_records(done: PartDone, layout: str) -> list[FileRecord]:
    """The files of a part, paths relative to the dataset.

    Args:
        done: what was made.
        layout: layout of its pictures.
    """
    part = done.part
    table = FileRecord(path=part.path, size=part.size, digest=part.file)
    folder = f"{PICTURE_FOLDER}/{layout}"
    return [
        table,
        *(msgspec.structs.replace(own, path=f"{folder}/{own.path}") for own in done.files),
    ]


def find_damage(folder: Path, records: Iterable[FileRecord]) -> list[str]:
    """Paths of those files that are missing, or whose bytes are not the recorded ones."""
    return [record.path for record in records if not _is_whole(folder, record)]


def _is_whole(folder: Path, record: FileRecord) -> bool:
    path = safe_join(folder, record.path)
    try:
        return path.stat().st_size == record.size and digest_file(path) == record.digest
    except OSError:
        return False


def digest_file(path: Path) -> str:
    """Digest of a file's bytes, which are not held all at once.

    Raises:
        OSError: the system refuses.
    """
    digest = hashlib.blake2b(digest_size=16)
    with open(path, "rb") as stream:
        while block := stream.read(_BLOCK):
            digest.update(block)
    return digest.hexdigest()


def digest_plan(plans: Sequence[PartPlan]) -> str:
    """Digest of a plan: which parts, with which episodes."""
    return content_hash(msgspec.json.encode([(plan.name, plan.episodes) for plan in plans]))


def save_shard(
    folder: Path,
    name: ShardName,
    about: DatasetFile,
    plans: Sequence[PartPlan],
    parts: Sequence[PartDone],
) -> ShardFile:
    """Write `shard.json`, which seals a shard.

    Args:
        folder: folder of the shard.
        name: which it is.
        about: its `dataset.json`.
        plans: plans of the whole dataset.
        parts: what was made.

    Raises:
        StorageError: it cannot be written.
    """
    number = {plan.name: plan.number for plan in plans}
    deep = about.settings.pictures.layout == "lerobot" and about.settings.pictures.depth
    shard = ShardFile(
        layout=SHARD_LAYOUT,
        index=name.index,
        count=name.count,
        plan=digest_plan(plans),
        total=len(plans),
        about=about,
        parts=tuple(
            ShardPart(
                number=number[done.part.name],
                done=msgspec.to_builtins(done),
                waiting=_find_waiting(folder, number[done.part.name]) if deep else (),
            )
            for done in parts
        ),
    )
    shard = msgspec.structs.replace(shard, seal=compute_seal(shard))
    write_json(folder / SHARD_FILE, msgspec.to_builtins(shard))
    return shard


def _find_waiting(folder: Path, number: int) -> tuple[FileRecord, ...]:
    """The depth of a part, which waits in its data file for the labels of all others."""
    from gn0.data.lerobot_tables import file_path

    path = f"{PICTURE_FOLDER}/lerobot/{file_path('data', number)}"
    file = safe_join(folder, path)
    if not file.is_file():  # a part without samples
        return ()
    size = file.stat().st_size
    return (FileRecord(path=path, size=size, digest=digest_file(file)),)


def load_shard(path: Path | str) -> ShardFile:
    """`shard.json` of a folder.

    Raises:
        DataError: it is no shard, or its build has not ended.
        StorageError, FormatError: unreadable, damaged, or of another layout.
    """
    folder = plain_path(path)
    check_contained(folder)
    file = folder / SHARD_FILE
    if not file.is_file():
        _refuse(folder)
    data = read_bytes(file, _LIMIT)
    layout = decode_json(data, dict, file=file).get("layout")
    if layout != SHARD_LAYOUT:
        raise FormatError(
            f"shard layout {layout!r}, this version reads {SHARD_LAYOUT}",
            file=file,
            field="layout",
            remedy="build the shard again with this gn0",
        )
    shard = decode_json(data, ShardFile, file=file)
    if shard.seal != compute_seal(shard):
        raise FormatError(
            "something in it was changed after it was written",
            file=file,
            field="seal",
            remedy="delete it and give the same `gn0 data build --shard` again",
        )
    return shard


def _refuse(folder: Path) -> None:
    from gn0.data.dataset import DATASET_FILE, load_dataset_file

    if (folder / DATASET_FILE).is_file():
        about = load_dataset_file(folder)
        if about.shard:
            raise DataError(
                f"shard {about.shard} has not been built to its end",
                where=folder,
                remedy="give the same `gn0 data build --shard` again: it goes on where it stopped",
            )
        raise DataError(
            "a dataset, not a shard of one", where=folder, remedy="leave it out of the merge"
        )
    raise DataError(
        "no shard of a dataset: it has no shard.json",
        where=folder,
        remedy="make one with `gn0 data build SUITE --shard i/n --out DIR`",
    )


def describe_shard(shard: ShardFile, folder: Path | str) -> str:
    """A shard that has been built, in a few lines of plain words."""
    count = len(shard.parts)
    return (
        f"shard {shard.name}: {shard.rows:,} samples in {count} of {shard.total} "
        f"{'part' if shard.total == 1 else 'parts'}, written to {folder}\n"
        f"when all {shard.count} are built: gn0 data merge SHARD… --out DATASET"
    )
