"""Drives an exporter over a dataset: plans, writes, goes on after a crash, and leaves a card.

The folder holds `export.json` from the first moment, and `journal.jsonl` until all is written. A
folder of another dataset, format or setting is refused; the same command again goes on where it
stopped. What the journal names was written whole.
"""

from __future__ import annotations

import json
import shutil
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import msgspec

from gn0.errors import DataError, Gn0Error, StorageError, brief
from gn0.export.export_card import write_card
from gn0.export.export_file import EXPORT_FILE, EXPORT_LAYOUT, ExportFile, load_export_file
from gn0.export.exporter import (
    DatasetExporter,
    ExportSettings,
    Job,
    Place,
    Record,
    get_dataset_exporter,
)
from gn0.export.trips import ExportSource, EyesTold, Trip
from gn0.locked_folder import LOCK, holds_leftovers_only, lock_folder, sweep_folder
from gn0.missions.episode import AgentSpec
from gn0.missions.sets.lost_goals import AREA_LOST, FOLLOW_LOST, OTHERS_LOST, PEOPLE_LOST
from gn0.progress import Progress, no_progress
from gn0.storage import (
    Journal,
    check_contained,
    content_hash,
    plain_path,
    storage_error,
    write_json,
)

JOURNAL = "journal.jsonl"
SAME_PATH = "another mission of a path that is there: the format has no use for words"
NO_FOLLOWING = "a mission to follow somebody: the format cannot say that the agent stands still"


@dataclass(frozen=True)
class Planned:
    """A trip that will be written, and where it stands."""

    id: str
    split: str
    place: Place
    frames: int


@dataclass(frozen=True)
class Plan:
    """What will be written, in order, and why the rest will not."""

    trips: tuple[Planned, ...]
    skipped: dict[str, int]
    agent: AgentSpec | None = None

    @property
    def frames(self) -> int:
        """Frames of all trips."""
        return sum(trip.frames for trip in self.trips)


def plan_export(exporter: DatasetExporter, job: Job, progress: Progress = no_progress) -> Plan:
    """Choose and number the trips; split by split, in the dataset's order within each."""
    kept: list[tuple[str, str, str, int]] = []
    skipped: Counter[str] = Counter()
    ways: set[str] = set()
    agent: AgentSpec | None = None
    for done, trip in enumerate(job.source.trips()):
        progress("reading", done, 0)
        why = _why_not(exporter, trip, job.settings)
        if not why and exporter.one_a_path and trip.episode.path_id:
            way = trip.way
            why = SAME_PATH if way in ways else ""
            ways.add(way)
        if why:
            skipped[why] += 1
            continue
        episode = trip.episode
        agent = agent or episode.agent
        frames = len(exporter.poses(trip, job.settings)) if exporter.pictures else 0
        kept.append((episode.split, episode.scene_id, episode.id, frames))
    kept.sort(key=lambda item: item[0])  # stable: the dataset's order within a split
    limit = job.settings.limit
    if limit and len(kept) > limit:
        skipped[f"beyond the limit of {limit} episodes"] = len(kept) - limit
        kept = kept[:limit]
    trips, total = [], 0
    in_scene: dict[str, tuple[int, int]] = {}
    for number, (split, scene, name, frames) in enumerate(kept):
        scene_number, scene_first = in_scene.get(scene, (0, 0))
        trips.append(Planned(name, split, Place(number, total, scene_number, scene_first), frames))
        in_scene[scene] = scene_number + 1, scene_first + frames
        total += frames
    return Plan(tuple(trips), dict(sorted(skipped.items())), agent)


def _why_not(exporter: DatasetExporter, trip: Trip, settings: ExportSettings) -> str:
    if settings.split and trip.episode.split != settings.split:
        return f"not of the split {settings.split!r}"
    if trip.source == "dagger" and not exporter.dagger:
        return "a walk of a policy, not of the expert"
    if trip.follows and not getattr(exporter, "follows", False):
        return NO_FOLLOWING
    return exporter.why_not(trip, settings)


def run_export(
    source: ExportSource,
    format: str | DatasetExporter,
    out: Path | str,
    settings: ExportSettings | None = None,
    *,
    progress: Progress = no_progress,
) -> ExportFile:
    """Write a dataset in a format; the same call again goes on after a crash.

    Args:
        source: the dataset.
        format: exporter, or its name.
        out: the folder to write.
        settings: how to export.
        progress: progress sink.

    Returns:
        What was written, and what was not and why.

    Raises:
        ConfigError: no such format or camera.
        StorageError: `out` holds something else, or cannot be written.
        DataError: nothing is left to write, or another run is writing to `out`.
    """
    exporter = get_dataset_exporter(format) if isinstance(format, str) else format
    settings = settings or ExportSettings()
    folder = plain_path(out)
    job = Job(source, settings, folder)
    exporter.cameras(source, settings)  # an unknown camera is told before anything is written
    told = msgspec.structs.replace(settings, vocabulary=exporter.reads(settings))  # not its path
    about = ExportFile(
        layout=EXPORT_LAYOUT,
        format=exporter.name,
        dataset=source.name,
        digest=content_hash(
            source.digest, exporter.name, msgspec.json.encode(told, order="deterministic")
        ),
        settings=told,
    )
    check_contained(folder)
    earlier = _claim(folder, about)
    if earlier is not None and earlier.complete:
        _tidy(folder, exporter)
        return earlier
    plan = plan_export(exporter, job, progress)
    if not plan.trips:
        raise DataError(
            "no episode is left to write" + _told(plan.skipped),
            where=source.name,
            remedy="choose another --split or --limit, or another format",
        )
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise storage_error(error, folder, "make the folder") from error
    with lock_folder(folder, refuse=DataError):
        earlier = _claim(folder, about)  # somebody may have been quicker
        if earlier is not None and earlier.complete:
            return earlier
        sweep_folder(folder)
        done = _write_all(exporter, job, plan, about, progress)
    return done


def _write_all(
    exporter: DatasetExporter, job: Job, plan: Plan, about: ExportFile, progress: Progress
) -> ExportFile:
    folder = job.folder
    write_json(folder / EXPORT_FILE, msgspec.to_builtins(about))
    told = replace(job, source=replace(job.source, eyes=EyesTold(job.source.eyes, progress)))
    records = _write_trips(exporter, told, plan, progress)
    exporter.finish(records, job)
    notes: Counter[str] = Counter()
    for record in records:
        notes.update(record.get("notes", {}))
    done = msgspec.structs.replace(
        about,
        written=len(plan.trips),
        frames=plan.frames,
        skipped=plan.skipped,
        notes=dict(sorted(notes.items())),
        splits=dict(sorted(Counter(trip.split for trip in plan.trips).items())),
        agent=plan.agent,
        complete=True,
    )
    write_card(folder, exporter, job.source, done)
    write_json(folder / EXPORT_FILE, msgspec.to_builtins(done))
    _tidy(folder, exporter)
    return done


def _tidy(folder: Path, exporter: DatasetExporter) -> None:
    """Remove what a finished export needs no more."""
    for name in (JOURNAL, LOCK):
        (folder / name).unlink(missing_ok=True)
    if exporter.scratch:
        shutil.rmtree(folder / exporter.scratch, ignore_errors=True)


def _told(skipped: dict[str, int]) -> str:
    return "".join(f"; {count} × {why}" for why, count in skipped.items())


def _claim(folder: Path, about: ExportFile) -> ExportFile | None:
    """The earlier run in this folder, if it is this very export; None for an empty place."""
    if not folder.exists():
        return None
    if holds_leftovers_only(folder):
        return None
    if not (folder / EXPORT_FILE).is_file():
        raise StorageError(
            f"the folder is not empty and holds no export: it has no {EXPORT_FILE}",
            where=folder,
            remedy="choose another --out",
        )
    earlier = load_export_file(folder)
    if earlier.digest != about.digest or earlier.format != about.format:
        raise StorageError(
            f"the folder holds another export: {_tell_other(earlier, about)}",
            where=folder,
            remedy="choose another --out, or give --fresh to forget it",
        )
    return earlier


def _tell_other(earlier: ExportFile, about: ExportFile) -> str:
    """What an earlier export is, and in what it differs from this one."""
    what = f"{earlier.format} of {earlier.dataset!r}"
    if earlier.format != about.format:
        return f"{what}, not {about.format}"
    there, here = msgspec.to_builtins(earlier.settings), msgspec.to_builtins(about.settings)
    changed = [
        f"{name} is {brief(there[name])} there and {brief(here[name])} here"
        for name in here
        if there[name] != here[name]
    ]
    return f"{what}, {'; '.join(changed)}" if changed else f"{what}, with other data"


def _write_trips(
    exporter: DatasetExporter, job: Job, plan: Plan, progress: Progress
) -> list[Record]:
    """Write what the journal does not name yet; the records of all, in order."""
    known = _journalled(job.folder / JOURNAL, plan)
    records: list[Record] = []
    with Journal(job.folder / JOURNAL) as journal:
        for done, (planned, trip) in enumerate(_matched(job.source, plan, known)):
            progress("episodes", done, len(plan.trips))
            record = known.get(planned.place.number)
            if record is None:
                if trip is None:
                    raise DataError(
                        f"episode {planned.id!r} is no longer there",
                        where=job.source.name,
                        remedy="export to another folder",
                    )
                record = _as_journalled(exporter.write(trip, planned.place, job))
                job.shelf.sync()
                journal.append({"id": planned.id, "number": planned.place.number, "of": record})
            records.append(record)
    progress("episodes", len(plan.trips), len(plan.trips))
    return records


def _as_journalled(record: Record) -> Record:
    """A record as the journal would give it back: the same after a crash and without one."""
    found: Record = json.loads(json.dumps(record, sort_keys=True, allow_nan=False))
    return found


def _journalled(path: Path, plan: Plan) -> dict[int, Record]:
    known: dict[int, Any] = {}
    for line in Journal(path).read():
        number = line["number"]
        if number >= len(plan.trips) or plan.trips[number].id != line["id"]:
            raise StorageError(
                "the journal names an episode that this export does not have",
                where=path,
                remedy="delete the folder and export again",
            )
        known[number] = line["of"]
    return known


def _matched(
    source: ExportSource, plan: Plan, known: dict[int, Record]
) -> Iterator[tuple[Planned, Trip | None]]:
    """The planned trips in order with their values, those already written without."""
    splits = [trip.split for trip in plan.trips]
    for split in dict.fromkeys(splits):
        wanted = {t.id: t for t in plan.trips if t.split == split}
        missing = {t.id for t in wanted.values() if t.place.number not in known}
        trips: Iterator[Trip] = iter(source.trips()) if missing else iter(())
        found = (t for t in trips if t.episode.id in missing and t.episode.split == split)
        for planned in wanted.values():
            yield planned, next(found, None) if planned.id in missing else None


def remark_export(folder: Path | str, format: str = "") -> list[str]:
    """What the reader of an export takes and its models would misread, in words.

    Raises:
        ConfigError, StorageError, FormatError: as `check_export`.
    """
    name = format or load_export_file(folder).format
    lost: list[str] = []
    if (Path(folder) / EXPORT_FILE).is_file():
        notes = load_export_file(folder).notes
        known = (OTHERS_LOST, AREA_LOST, FOLLOW_LOST, PEOPLE_LOST)
        lost = [f"{notes[what]:,} × {what}" for what in known if what in notes]
    return get_dataset_exporter(name).remarks(Path(folder)) + lost


def check_export(folder: Path | str, format: str = "") -> list[str]:
    """Faults of an export, in words: what its reader would stumble over, and what is missing.

    Args:
        folder: an export.
        format: exporter name; by default what `export.json` says. With a name, a folder that
            somebody else wrote is checked as well.

    Raises:
        ConfigError: no such format.
        StorageError: no such folder, or no export and no format given.
    """
    folder = plain_path(folder)
    if not folder.is_dir():
        raise StorageError("no such folder", where=folder, remedy="check the path")
    check_contained(folder)
    about = None
    if not format or (folder / EXPORT_FILE).is_file():
        about = load_export_file(folder)
    exporter = get_dataset_exporter(format or (about.format if about else ""))
    faults = exporter.check(folder)
    if about is None or about.format != exporter.name:
        return faults
    if not about.complete:
        faults.append("the export has not ended: give the same `gn0 export` command again")
    try:
        found = len(exporter.load(folder))
        if found != about.written:
            faults.append(f"{found} episodes, export.json says {about.written}")
    except Gn0Error as error:
        if str(error) not in faults:
            faults.append(str(error))
    return faults
