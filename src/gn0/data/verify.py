"""Reads every byte of a dataset again, and names what is damaged.

Files are compared with the digests that were noted when they were written. What differs is then
read, to say which rows are meant.
"""

from __future__ import annotations

import hashlib
import os
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np

from gn0.data.build_folder import parts_journal
from gn0.data.cache_webdataset import load_index, sample_key
from gn0.data.dataset import (
    JOURNAL,
    PICTURE_FOLDER,
    Dataset,
    DatasetPart,
    FileRecord,
    file_digest,
    open_dataset,
)
from gn0.data.drawing_process import count_workers, open_drawing
from gn0.data.part import PartPlan, collect_part, open_building, told_steps
from gn0.data.picture_cache import MANIFEST, cache_folder, load_manifest
from gn0.data.sample_table import EpisodeRows, decode_rows, digest_labels, load_sample_table
from gn0.errors import Gn0Error, StorageError
from gn0.jobs import ExecutorName, run_jobs
from gn0.jobs.process import count_cores
from gn0.progress import Progress, no_progress
from gn0.render.share.server_process import DrawServer
from gn0.storage import read_bytes, safe_join, storage_error

Kind = Literal["source", "samples", "cache", "journal"]
CHUNK = 1 << 22  # bytes read at a time
ROWS_NAMED = 5


@dataclass(frozen=True)
class Damage:
    """Something that is not as it was written.

    Attributes:
        kind: "source" (episodes and scenes), "samples" (a sample table), "cache" (pictures) or
            "journal".
        path: the file, relative to the dataset.
        what: what is wrong with it.
        rows: samples that are meant, in words; empty where the whole file is.
        part: the part that it belongs to, where there is one.
        layout: layout of the cache, where it is one.
    """

    kind: Kind
    path: str
    what: str
    rows: tuple[str, ...] = ()
    part: str = ""
    layout: str = ""

    def __str__(self) -> str:
        named = ", ".join(self.rows[:ROWS_NAMED])
        more = len(self.rows) - ROWS_NAMED
        text = f"{self.path}: {self.what}"
        if named:
            text += f": {named}" + (f" and {more} more" if more > 0 else "")
        return text


@dataclass(frozen=True)
class VerifyReport:
    """What was looked at, and what is damaged.

    Attributes:
        files: how many were read.
        size: their bytes.
        samples: rows of the dataset.
        layouts: caches that are there.
        pixels: how many samples were drawn again and compared.
        damages: sorted by path.
    """

    files: int
    size: int
    samples: int
    layouts: tuple[str, ...]
    pixels: int
    damages: tuple[Damage, ...]

    @property
    def ok(self) -> bool:
        """Whether nothing is damaged."""
        return not self.damages


def verify_dataset(
    path: Path | str,
    *,
    pixels: bool = False,
    workers: int = 0,
    executor: ExecutorName = "process",
    batch: int = 0,
    server: DrawServer | None = None,
    progress: Progress = no_progress,
    note: Callable[[str], None] = lambda text: None,
) -> VerifyReport:
    """Read every file of a dataset and compare it with what was written.

    Args:
        path: the dataset folder.
        pixels: also draw every picture again, and compare it with the hash in its row.
        workers: readers (threads), and processes that draw; 0 means one per core.
        executor: where the processes that draw run.
        batch: views per call of the GPU's renderer; 0 takes its default.
        server: a drawing process with the dataset's backend, when one is running already.
        progress: progress sink.
        note: called with each thing that a person should be told, once.

    Raises:
        StorageError, FormatError, DataError: `dataset.json` itself is missing or damaged, the
            build has not ended, or the backend that drew its pictures is not here.
    """
    dataset = open_dataset(path)
    expected = list_files(dataset)
    damages, unread = [], []
    for layout, fault in expected.faults:
        damages.append(
            Damage("cache", f"{PICTURE_FOLDER}/{layout}/{MANIFEST}", fault, layout=layout)
        )
    total = sum(claim.record.size for claim in expected.claims)
    with ThreadPoolExecutor(workers or count_cores()) as pool:
        answers = pool.map(lambda claim: _look(dataset.folder, claim), expected.claims)
        for number, (claim, fault) in enumerate(zip(expected.claims, answers, strict=True), 1):
            progress("files", number, len(expected.claims))
            if fault:
                unread.append((claim, fault))
    for claim, fault in unread:
        rows: tuple[str, ...] = ()
        sources = any(other.kind == "source" for other, _ in unread)
        if fault != MISSING and not (claim.kind == "samples" and sources):
            rows = tuple(find_rows(dataset, claim))
        damages.append(Damage(claim.kind, claim.path, fault, rows, claim.part, claim.layout))
    drawn = 0
    if pixels and not damages and dataset.about.rendered:
        pictures = dataset.about.settings.pictures
        with open_drawing(
            pictures, executor=executor, batch=batch, server=server, note=note
        ) as drawing:
            address = "" if drawing is None else drawing.address
            many = count_workers(workers, pictures)
            found, drawn = _compare_pixels(dataset, address, many, executor, progress)
        damages += found
    return VerifyReport(
        files=len(expected.claims),
        size=total,
        samples=dataset.about.rows,
        layouts=expected.layouts,
        pixels=drawn,
        damages=tuple(sorted(damages, key=lambda d: d.path)),
    )


CHANGED, MISSING = "other bytes than were written", "missing"


@dataclass(frozen=True)
class Claim:
    """A file that must be there: its record, relative path in the dataset, and what it is."""

    kind: Kind
    path: str
    record: FileRecord
    part: str = ""
    layout: str = ""


@dataclass(frozen=True)
class FileList:
    """All files that a dataset claims, the caches it has, and manifests that cannot be read."""

    claims: tuple[Claim, ...]
    layouts: tuple[str, ...]
    faults: tuple[tuple[str, str], ...]


def list_files(dataset: Dataset) -> FileList:
    """Every file of a dataset with its digest, by `dataset.json` and the manifests."""
    about = dataset.about
    claims = [Claim("source", record.path, record) for record in about.files]
    for part in about.parts:
        record = FileRecord(path=part.path, size=part.size, digest=part.file)
        claims.append(Claim("samples", part.path, record, part.name))
    journal = parts_journal(about)
    record = FileRecord(path=JOURNAL, size=len(journal), digest=file_digest(journal))
    claims.append(Claim("journal", JOURNAL, record))
    layouts, faults = [], []
    folder = dataset.folder / PICTURE_FOLDER
    for layout in sorted(path.name for path in folder.iterdir()) if folder.is_dir() else []:
        if not (folder / layout).is_dir():
            continue
        layouts.append(layout)
        try:
            manifest = load_manifest(dataset.folder, layout)
        except Gn0Error as error:
            faults.append((layout, error.what))
            continue
        if manifest is None:
            faults.append((layout, "missing: the cache is not whole"))
            continue
        for record in manifest.files:
            path = f"{PICTURE_FOLDER}/{layout}/{record.path}"
            owner = _part_of(record.path) if layout == "webdataset" else ""
            claims.append(Claim("cache", path, record, owner, layout))
    return FileList(tuple(claims), tuple(layouts), tuple(faults))


def _part_of(path: str) -> str:
    """The part that a file of a WebDataset cache belongs to; "" for maps."""
    for ending in (".index.parquet", ".tar"):
        if path.endswith(ending) and "/" not in path:
            return path.removesuffix(ending)
    return ""


def _look(folder: Path, claim: Claim) -> str:
    """What is wrong with a file; "" when nothing is."""
    try:
        path = safe_join(folder, claim.path)
        if not path.is_file():
            return MISSING
        size = path.stat().st_size
        if size != claim.record.size:
            return f"{size} bytes, {claim.record.size} were written"
        return "" if digest_file(path) == claim.record.digest else CHANGED
    except StorageError as error:
        return error.what


def digest_file(path: Path) -> str:
    """Digest of a file's bytes.

    Raises:
        StorageError: it cannot be read.
    """
    digest = hashlib.blake2b(digest_size=16)
    try:
        with open(path, "rb", buffering=0) as stream:
            if hasattr(os, "posix_fadvise"):
                os.posix_fadvise(stream.fileno(), 0, 0, os.POSIX_FADV_SEQUENTIAL)
            buffer = memoryview(bytearray(min(CHUNK, max(path.stat().st_size, 1))))
            while count := stream.readinto(buffer):
                digest.update(buffer[:count])
    except OSError as error:
        raise storage_error(error, path, "read") from error
    return digest.hexdigest()


def find_rows(dataset: Dataset, claim: Claim) -> Iterator[str]:
    """Samples whose bytes differ in a changed file, in words."""
    try:
        if claim.kind == "samples":
            part = next(own for own in dataset.about.parts if own.name == claim.part)
            yield from find_changed_rows(dataset, part)
        elif claim.path.endswith(".tar"):
            yield from find_changed_members(dataset, claim)
    except Gn0Error as error:
        yield str(error.what)


def find_changed_rows(dataset: Dataset, part: DatasetPart) -> Iterator[str]:
    """Rows of a sample table that are not what their episodes give.

    Raises:
        FormatError: the table cannot be read; names the row where it can.
    """
    table = load_sample_table(safe_join(dataset.folder, part.path))
    found = list(decode_rows(table))
    if digest_labels(found) == part.labels:
        yield "poses and labels are whole; hashes of pictures or the file's frame differ"
        return
    if dataset.about.settings.dagger is not None:
        return
    names = (*part.episodes, *(own.id for own in part.skipped))
    plan = PartPlan(str(dataset.folder), part.name, 0, part.scene, names)
    expected, _ = collect_part(dataset, plan)
    yield from _compare(found, sorted(expected, key=lambda b: part.episodes.index(b.episode_id)))


def _compare(found: Sequence[EpisodeRows], expected: Sequence[EpisodeRows]) -> Iterator[str]:
    row = 1
    for one, other in zip(found, expected, strict=False):
        if one.episode_id != other.episode_id or len(one) != len(other):
            yield f"row {row} on (episode {other.episode_id!r})"
            return
        for name in ("poses", "executed", "actions", "waypoints", "pixels", "valid", "distance"):
            same = np.asarray(getattr(one, name) == getattr(other, name)).reshape(len(one), -1)
            for step in np.flatnonzero(~same.all(axis=1)).tolist():
                yield f"row {row + step} (episode {one.episode_id!r}, step {step}), {name}"
        if one.people is not None and not one.people.same_as(other.people):
            yield f"rows {row} to {row + len(one) - 1} (episode {one.episode_id!r}), people"
        row += len(one)


def find_changed_members(dataset: Dataset, claim: Claim) -> Iterator[str]:
    """Members of a shard whose bytes differ, by the shard's index.

    Raises:
        StorageError, FormatError: the index is missing or damaged too.
    """
    folder = cache_folder(dataset.folder, claim.layout)
    places = load_index(safe_join(folder, f"{claim.part}.index.parquet"))
    data = memoryview(read_bytes(safe_join(dataset.folder, claim.path)))
    names = _name_rows(dataset, claim.part)
    any_found = False
    for name, (offset, size, digest) in places.items():
        if file_digest(bytes(data[offset : offset + size])) != digest:
            any_found = True
            key, _, kind = name.partition(".")
            yield f"{kind} of {names.get(key, key)}"
    if not any_found:
        yield "a header between the members"


def _name_rows(dataset: Dataset, part_name: str) -> dict[str, str]:
    """Episode and step of each sample key of a part."""
    part = next(own for own in dataset.about.parts if own.name == part_name)
    names, row = {}, 0
    for block in dataset.part_rows(part):
        for step in range(len(block)):
            names[sample_key(part_name, row)] = (
                f"row {row + 1} (episode {block.episode_id!r}, step {step})"
            )
            row += 1
    return names


def _compare_pixels(
    dataset: Dataset, drawing: str, workers: int, executor: ExecutorName, progress: Progress
) -> tuple[list[Damage], int]:
    """Draw every part again, and compare the pictures with the hashes in the rows."""
    damages: list[Damage] = []
    parts = dataset.about.parts

    def take(index: int, answer: dict[str, list[str]]) -> None:
        if answer["rows"]:
            damages.append(
                Damage(
                    "samples",
                    parts[index].path,
                    "pictures are drawn differently",
                    tuple(answer["rows"]),
                    parts[index].name,
                )
            )

    run_jobs(
        "gn0.data.verify:compare_part",
        [{"folder": str(dataset.folder), "part": p.name, "drawing": drawing} for p in parts],
        workers=workers,
        executor=executor,
        names=[f"part {part.name}" for part in parts],
        done=take,
        what="parts drawn",
        progress=progress,
        steps=progress,
    )
    return damages, dataset.about.rows


def compare_part(payload: dict[str, str], progress: Progress = no_progress) -> dict[str, list[str]]:
    """Samples of a part whose pictures have other hashes when drawn again; runs in a worker."""
    from gn0.data.part_pictures import PartDrawer, sees_otherwise

    dataset = open_building(payload["folder"])
    part = next(own for own in dataset.about.parts if own.name == payload["part"])
    drawer = PartDrawer(
        dataset,
        dataset.part_rows(part),
        dataset.about.settings.pictures,
        check=False,
        drawing=payload.get("drawing", ""),
        files=False,
    )
    rows = []
    for step in told_steps(drawer.steps(), part.rows, progress):
        for name, found in step.hashes.items():
            known = step.block.hashes.get(name)
            if known is None or known[step.step] != found:
                rows.append(
                    f"{name} of row {step.row + 1} (episode {step.episode.id!r}, step {step.step})"
                )
        if sees_otherwise(step):
            rows.append(
                f"people_seen of row {step.row + 1} (episode {step.episode.id!r}, step {step.step})"
            )
    return {"rows": rows}


def count_damages(damages: Iterable[Damage]) -> str:
    """How many files of which kind, in words."""
    words = {
        "source": "of episodes and scenes",
        "samples": "sample tables",
        "cache": "of the cache",
        "journal": "journals",
    }
    counts = dict.fromkeys(words, 0)
    for damage in damages:
        counts[damage.kind] += 1
    return ", ".join(f"{count} {words[kind]}" for kind, count in counts.items() if count)
