"""Shards of a dataset, built on several machines, joined into the dataset of one build.

The files of every part are copied and checked; then the dataset is finished as any build is. So the
bytes are those of a build by one machine, and a merge that was stopped goes on.
"""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from pathlib import Path
from typing import IO, NamedTuple

import msgspec

from gn0.data.build import check_target, finish_dataset, tell_difference
from gn0.data.dataset import (
    JOURNAL,
    Dataset,
    DatasetFile,
    FileRecord,
    open_dataset,
    save_dataset_file,
)
from gn0.data.part import PartDone
from gn0.data.shard import ShardFile, find_damage, load_shard
from gn0.errors import DataError
from gn0.locked_folder import check_room, lock_folder, sweep_folder
from gn0.progress import Progress, no_progress
from gn0.remote import local_path
from gn0.storage import Journal, plain_path, safe_join, storage_error, write_atomic

_BLOCK = 2**20
_AGAIN = "give that shard's `gn0 data build --shard` again: it makes what is damaged again"


class _Place(NamedTuple):
    """A shard and its folder."""

    folder: Path
    shard: ShardFile


def merge_shards(
    shards: Sequence[Path | str],
    out: Path | str,
    *,
    progress: Progress = no_progress,
) -> Dataset:
    """Join all shards of a dataset; the bytes are those of a build without shards.

    Args:
        shards: their folders, or URLs of them, in any order.
        out: the dataset folder; a merge that was interrupted there goes on.
        progress: progress sink.

    Raises:
        DataError: a shard is missing, given twice, of another plan, unfinished or damaged; or `out`
            holds something else.
        StorageError, FormatError: a file cannot be read or written.
    """
    folders = [local_path(folder, progress=progress) for folder in shards]
    places = [_Place(folder, load_shard(folder)) for folder in folders]
    check_shards(places)
    out = plain_path(out)
    first = places[0].shard
    about = msgspec.structs.replace(first.about, files=(), shard=msgspec.UNSET)
    made = sorted(
        (entry for place in places for entry in place.shard.made()), key=lambda entry: entry[0]
    )
    parts = [done for _, done in made]
    check_target(out, about)
    check_room(out, sum(record.size for place in places for record in place.shard.records()))
    with lock_folder(out, refuse=DataError):
        found = check_target(out, about)
        sweep_folder(out)
        if found is not None and found.complete:
            _check_same(out, found, parts)
            return open_dataset(out)
        whole = msgspec.structs.replace(about, files=_join_files(places))
        save_dataset_file(out, whole)  # the folder is ours, and known as such, from here on
        _copy_all(places, out, progress)
        _note(out / JOURNAL, parts)
        progress("finishing", 0, 1)
        finish_dataset(out, whole, parts)
        progress("finishing", 1, 1)
    return open_dataset(out)


def check_shards(places: Sequence[tuple[Path, ShardFile]]) -> None:
    """Refuse shards that are not all of one dataset.

    Raises:
        DataError: none are given; one is missing, given twice, or of another plan.
    """
    if not places:
        raise DataError("no shard to merge", where="SHARD", remedy="give the folders of all")
    folder, first = places[0]
    seen: dict[int, Path] = {}
    for other, shard in places:
        if shard.count != first.count:
            raise DataError(
                f"shard {shard.name} of a dataset in {shard.count} shards beside shard "
                f"{first.name} in {folder}",
                where=other,
                remedy="merge the shards of one split",
            )
        about = msgspec.structs.replace(shard.about, files=(), shard=msgspec.UNSET)
        wanted = msgspec.structs.replace(first.about, files=(), shard=msgspec.UNSET)
        if about != wanted or shard.plan != first.plan or shard.total != first.total:
            difference = "its parts differ" if about == wanted else tell_difference(about, wanted)
            raise DataError(
                f"a shard of another plan than the one in {folder}: {difference}",
                where=other,
                remedy="build all shards from one suite with the same options",
            )
        if shard.index in seen:
            raise DataError(
                f"shard {shard.name} is given twice; it is in {seen[shard.index]}, too",
                where=other,
                remedy="give each shard once",
            )
        seen[shard.index] = other
    missing = [str(i) for i in range(1, first.count + 1) if i not in seen]
    if missing:
        names = ", ".join(missing[:8]) + (", …" if len(missing) > 8 else "")
        one = len(missing) == 1
        raise DataError(
            f"{'shard' if one else 'shards'} {names} of {first.count} {'is' if one else 'are'} "
            "missing",
            where=folder,
            remedy=f"build {'it' if one else 'them'} with --shard {missing[0]}/{first.count}"
            + ("" if one else " and so on"),
        )


def _check_same(out: Path, found: DatasetFile, parts: Sequence[PartDone]) -> None:
    if found.parts != tuple(done.part for done in parts):
        raise DataError(
            "the folder holds a dataset whose parts are not those of these shards",
            where=out,
            remedy="choose another --out, or delete that folder",
        )


def _join_files(places: Sequence[_Place]) -> tuple[FileRecord, ...]:
    """Scenes and episodes of all shards, each once."""
    found = {record.path: record for place in places for record in place.shard.about.files}
    return tuple(found[path] for path in sorted(found))


def _copy_all(places: Sequence[_Place], out: Path, progress: Progress) -> None:
    """Every file of every shard, once, unless it is there whole."""
    wanted: dict[str, tuple[Path, FileRecord]] = {}
    for folder, shard in places:
        for record in shard.records():
            wanted.setdefault(record.path, (folder, record))
    for done, (path, (folder, record)) in enumerate(sorted(wanted.items())):
        progress("files", done, len(wanted))
        if find_damage(out, [record]):
            _copy(safe_join(folder, path), safe_join(out, path), record)
    progress("files", len(wanted), len(wanted))


def _copy(source: Path, target: Path, record: FileRecord) -> None:
    """Copy a file; it appears under its name only when every byte is the recorded one."""
    digest, size = hashlib.blake2b(digest_size=16), 0

    def pour(stream: IO[bytes]) -> None:
        nonlocal size
        with open(source, "rb") as file:
            while block := file.read(_BLOCK):
                digest.update(block)
                size += len(block)
                stream.write(block)
        if (size, digest.hexdigest()) != (record.size, record.digest):
            raise DataError("its bytes are not those that were built", where=source, remedy=_AGAIN)

    if not source.is_file():
        raise DataError("a file of the shard is missing", where=source, remedy=_AGAIN)
    try:
        target.parent.mkdir(parents=True, exist_ok=True)
        write_atomic(target, pour)
    except OSError as error:
        raise storage_error(error, source, "copy") from error


def _note(path: Path, parts: Sequence[PartDone]) -> None:
    """The journal of a build that made all parts here, so that a build goes on from it, too."""
    with Journal(path) as journal:
        known = {record["part"]["name"] for record in journal.read() if "part" in record}
        for done in parts:
            if done.part.name not in known:
                journal.append(msgspec.to_builtins(done))
