"""Rebuilds what is damaged in a dataset, and nothing else.

Labels come from the episodes, pictures from poses and scenes; both are made by the same code as in
the beginning, and must have the same digest. Episodes and scenes themselves come from the suite.
"""

from __future__ import annotations

import contextlib
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import msgspec

from gn0.data.build_folder import parts_journal, read_done, write_journal
from gn0.data.dataset import (
    BANK_FOLDER,
    JOURNAL,
    Dataset,
    FileRecord,
    file_digest,
    open_dataset,
)
from gn0.data.drawing_process import open_drawing
from gn0.data.part import PartDone, PartPlan, collect_part, drawn_at
from gn0.data.part_pictures import PartDrawer
from gn0.data.picture_build import check_rendered, finish_cache, plan_rendering, render_dataset
from gn0.data.picture_cache import MANIFEST, CacheManifest, cache_folder, load_manifest
from gn0.data.sample_table import encode_rows, encode_table
from gn0.data.settings import PictureSettings
from gn0.data.verify import Damage, verify_dataset
from gn0.errors import DataError, Gn0Error, brief
from gn0.jobs import run_jobs
from gn0.locked_folder import lock_folder, sweep_folder
from gn0.progress import Progress, no_progress
from gn0.storage import Journal, read_bytes, safe_join, write_bytes
from gn0.suites.suite import load_suite

# policies that a dataset may name and have run: they dial nobody, import nothing, open no file
DRIVERS = ("oracle", "straight", "wall_follower", "random", "explorer")


@dataclass(frozen=True)
class RepairReport:
    """What was damaged, and what still is with the reason.

    Attributes:
        found: what was damaged.
        left: what still is.
        reasons: why, by path.
    """

    found: tuple[Damage, ...]
    left: tuple[Damage, ...]
    reasons: dict[str, str]

    @property
    def ok(self) -> bool:
        """Whether everything is whole now."""
        return not self.left


def repair_dataset(
    path: Path | str,
    *,
    suite: Path | str | None = None,
    bank: Path | str | None = None,
    workers: int = 1,
    progress: Progress = no_progress,
) -> RepairReport:
    """Find what is damaged and make exactly that again.

    Args:
        path: the dataset folder.
        suite: the suite that it was built from, for damaged episodes and scenes.
        bank: the bank of people that it was built with, for damaged people.
        workers: processes that draw.
        progress: progress sink.

    Raises:
        StorageError, FormatError, DataError: `dataset.json` is missing or damaged, or a run is
            writing there.
    """
    dataset = open_dataset(path)
    with lock_folder(dataset.folder, refuse=DataError):
        sweep_folder(dataset.folder)
        found = verify_dataset(path, workers=0, progress=progress).damages
        reasons: dict[str, str] = {}
        for damage in found:
            try:
                if damage.kind == "source":
                    _restore(dataset, damage, suite, bank)
                elif damage.kind == "journal":
                    write_journal(dataset.folder / JOURNAL, parts_journal(dataset.about))
            except Gn0Error as error:
                reasons[damage.path] = str(error)
        for damage in found:
            if damage.kind == "samples" and not reasons:
                try:
                    _rewrite(dataset, damage)
                except Gn0Error as error:
                    reasons[damage.path] = str(error)
        layouts = sorted({damage.layout for damage in found if damage.kind == "cache"})
        for layout in layouts if not reasons else ():
            own = [damage for damage in found if damage.layout == layout]
            try:
                _redraw(dataset, layout, own, workers, progress)
            except Gn0Error as error:
                reasons |= {damage.path: str(error) for damage in own}
    for layout in layouts if not reasons else ():
        if _manifest_of(dataset.folder, layout) is None:  # as much as is whole is kept
            settings = _settings_of(dataset, layout)
            render_dataset(dataset.folder, settings, workers=workers, progress=progress)
    left = verify_dataset(path, workers=0, progress=progress).damages if found else ()
    for damage in left:
        reasons.setdefault(damage.path, "not tried: what it is made from is damaged")
    return RepairReport(found, left, reasons)


def _restore(
    dataset: Dataset, damage: Damage, suite: Path | str | None, bank: Path | str | None
) -> None:
    """Copy a file of episodes, scenes or people again, if it is the very same where it is from.

    Raises:
        DataError: no suite or bank is given, or its file is another one.
    """
    record = next(own for own in dataset.about.files if own.path == damage.path)
    folder, _, name = damage.path.partition("/")
    if folder == BANK_FOLDER:
        if bank is None:
            raise DataError(
                "people cannot be made again from the dataset",
                where=damage.path,
                remedy="give the bank that it was built with: --bank",
            )
        _copy_same(safe_join(Path(bank), name), record, dataset.folder, "bank")
        return
    if suite is None:
        raise DataError(
            "episodes and scenes cannot be made again from the dataset",
            where=damage.path,
            remedy="give the suite that it was built from: --suite",
        )
    source = load_suite(suite)
    parts = damage.path.split("/")
    known = {scene.id for scene in source.about.scenes}
    if len(parts) > 2 and parts[1] in known:
        origin = source.scene_folder(parts[1]) / "/".join(parts[2:])
    else:
        origin = safe_join(source.folder, damage.path)
    _copy_same(origin, record, dataset.folder, "suite")


def _copy_same(origin: Path, record: FileRecord, folder: Path, what: str) -> None:
    data = read_bytes(origin)
    if file_digest(data) != record.digest:
        raise DataError(
            f"the {what} has another file there",
            where=origin,
            remedy=f"find the {what} of this dataset",
        )
    write_bytes(safe_join(folder, record.path), data)


def _rewrite(dataset: Dataset, damage: Damage) -> None:
    """Walk and label the episodes of a part again.

    Raises:
        DataError: they come out otherwise, or another policy than one of ours drove them.
    """
    part = next(own for own in dataset.about.parts if own.name == damage.part)
    dagger = dataset.about.settings.dagger
    if dagger is not None and (dagger.plugins or dagger.policy not in DRIVERS):
        raise DataError(
            f"its steps are those of policy {brief(dagger.policy)}, which dataset.json names and "
            "nobody here asked for: it is not run",
            where=damage.path,
            remedy="collect the dataset again with `gn0 data dagger`",
        )
    names = (*part.episodes, *(own.id for own in part.skipped))
    plan = PartPlan(str(dataset.folder), part.name, 0, part.scene, names)
    blocks, _ = collect_part(dataset, plan)
    blocks.sort(key=lambda block: part.episodes.index(block.episode_id))
    if dataset.about.rendered:
        drawer = PartDrawer(dataset, blocks, dataset.about.settings.pictures)
        for _ in drawer.steps():
            pass
        blocks = drawer.hashed_blocks()
    data = encode_table(encode_rows(blocks))
    if file_digest(data) != part.file:
        raise DataError(
            "made again, the table comes out different",
            where=damage.path,
            remedy=f"repair it with {dataset.about.software}, which wrote it",
        )
    write_bytes(safe_join(dataset.folder, part.path), data)
    dataset.kept.pop("part", None)


def _redraw(
    dataset: Dataset,
    layout: str,
    damages: Sequence[Damage],
    workers: int,
    progress: Progress,
) -> None:
    """Draw the parts that damaged files of a cache belong to.

    Raises:
        DataError: a part comes out otherwise.
    """
    folder = cache_folder(dataset.folder, layout)
    done = read_done(folder / JOURNAL)
    names = {part.name for part in dataset.about.parts}
    if set(done) != names or _manifest_of(dataset.folder, layout) is None:
        with contextlib.suppress(FileNotFoundError):
            (folder / MANIFEST).unlink()  # `render_dataset` goes on from what is there
        _forget_damaged(folder, done)
        return
    settings = _settings_of(dataset, layout)
    broken = {damage.path.split("/", 2)[2] for damage in damages}
    chosen: list[str] = []
    covered: set[str] = set()
    for name, made in done.items():
        own = {record.path for record in made.files}
        if (own & broken) - covered:
            chosen.append(name)
            covered |= own
    for relative in sorted(broken):
        with contextlib.suppress(FileNotFoundError):
            safe_join(folder, relative).unlink()
    plans = plan_rendering(dataset, settings, chosen)

    def take(index: int, answer: dict[str, object]) -> None:
        made = msgspec.convert(answer, PartDone)
        check_rendered(plans[index], made)
        if made.files != done[made.part.name].files:
            raise DataError(
                "drawn again, the pictures are encoded differently",
                where=f"part {made.part.name!r}",
                remedy="delete the cache and render all of it: the pixels are the same",
            )

    with open_drawing(settings) as server:
        run_jobs(
            "gn0.data.part:render_part",
            [msgspec.to_builtins(plan) for plan in drawn_at(plans, server)],
            workers=workers,
            names=[f"part {plan.name}" for plan in plans],
            done=take,
            what="parts drawn again",
            progress=progress,
            steps=progress,
        )
    if broken - covered:  # what the parts have in common
        finish_cache(dataset, settings, [done[part.name] for part in dataset.about.parts])


def _manifest_of(folder: Path, layout: str) -> CacheManifest | None:
    """The manifest of a cache; None where it is missing or damaged."""
    try:
        return load_manifest(folder, layout)
    except Gn0Error:
        return None


def _forget_damaged(folder: Path, done: dict[str, PartDone]) -> None:
    """Delete files that are not what the cache's journal says, so that they are made again."""
    for made in done.values():
        for record in made.files:
            path = safe_join(folder, record.path)
            if path.is_file() and file_digest(read_bytes(path)) != record.digest:
                path.unlink()


def _settings_of(dataset: Dataset, layout: str) -> PictureSettings:
    """How a cache was made, by its manifest, its journal, or the dataset.

    Raises:
        DataError: nothing says.
    """
    with contextlib.suppress(Gn0Error):
        manifest = load_manifest(dataset.folder, layout)
        if manifest is not None:
            return manifest.settings
    for record in Journal(cache_folder(dataset.folder, layout) / JOURNAL).read():
        with contextlib.suppress(msgspec.ValidationError, KeyError, TypeError):
            return msgspec.convert(record["settings"], PictureSettings)
    built = dataset.about.settings.pictures
    if built.layout == layout:
        return built
    raise DataError(
        "nothing says how this cache was made",
        where=cache_folder(dataset.folder, layout),
        remedy="delete it and run `gn0 data render`",
    )
