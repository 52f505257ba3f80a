"""Builds or rebuilds the cache of pictures: poses and scenes in, the same bytes out."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

import msgspec

from gn0.data.build_folder import (
    parts_journal,
    read_done,
    run_parts,
    write_journal,
)
from gn0.data.dataset import (
    JOURNAL,
    Dataset,
    DatasetFile,
    DatasetPart,
    open_dataset,
    save_dataset_file,
)
from gn0.data.drawing_process import open_drawing
from gn0.data.part import PartDone, PartPlan, drawn_at
from gn0.data.picture_cache import (
    CACHE_LAYOUT,
    CacheManifest,
    cache_folder,
    check_cache_free,
    load_manifest,
    record_file,
    save_manifest,
)
from gn0.data.settings import PictureSettings
from gn0.errors import DataError
from gn0.jobs import ExecutorName
from gn0.locked_folder import lock_folder, sweep_folder
from gn0.progress import Progress, no_progress
from gn0.storage import Journal, journal_line, safe_join


def render_dataset(
    path: Path | str,
    settings: PictureSettings | None = None,
    *,
    workers: int = 1,
    executor: ExecutorName = "process",
    ray_address: str = "",
    batch: int = 0,
    progress: Progress = no_progress,
    note: Callable[[str], None] = lambda text: None,
) -> CacheManifest:
    """Draw the pictures of a dataset into a cache; an interrupted run goes on.

    Every picture is checked against the hash in its row; a dataset of poses and labels alone gets
    its hashes now.

    Args:
        path: the dataset folder.
        settings: settings of the cache; by default what the dataset was built with.
        workers: processes; never changes a byte.
        executor: where the workers run; never changes a byte.
        ray_address: address of a running Ray cluster; "" starts one on this machine.
        batch: views per call of the GPU's renderer; 0 takes its default; never changes a byte.
        progress: progress sink.
        note: called with each thing that a person should be told, once.

    Raises:
        DataError: another cache of that layout is there, a picture is drawn otherwise than its
            hash says, the backend that drew them is not here, or a run is writing there.
        StorageError: the folder cannot be written, or the disk is full.
    """
    dataset = open_dataset(path)
    wanted = choose_cache(dataset, settings)
    out = dataset.folder
    with lock_folder(out, refuse=DataError):
        sweep_folder(out)
        whole = check_cache_free(out, wanted) and dataset.about.rendered  # both are written last
        if whole and (there := load_manifest(out, wanted.layout)):
            return there
        journal = cache_folder(out, wanted.layout) / JOURNAL
        with open_drawing(wanted, executor=executor, batch=batch, note=note) as server:
            _begin_journal(journal, wanted)
            parts = run_parts(
                "render_part",
                drawn_at(plan_rendering(dataset, wanted), server),
                _still_there(out, wanted, read_done(journal)),
                journal,
                workers=workers,
                executor=executor,
                ray_address=ray_address,
                progress=progress,
                check=check_rendered,
            )
        made = [parts[part.name] for part in dataset.about.parts]
        if not dataset.about.rendered:
            about = _now_drawn(dataset.about, wanted, [m.part for m in made])
            dataset = Dataset(out, about)
        manifest = finish_cache(dataset, wanted, made)
        save_dataset_file(out, dataset.about)
        write_journal(out / JOURNAL, parts_journal(dataset.about))
    return manifest


def choose_cache(dataset: Dataset, settings: PictureSettings | None) -> PictureSettings:
    """The cache that is meant: as the dataset was built, unless told otherwise.

    Raises:
        DataError: no layout, or pictures drawn in another way than the hashes say.
    """
    built = dataset.about.settings.pictures
    wanted = settings or built
    if wanted.layout == "none":
        if settings is not None:
            raise DataError(
                "layout none has no pictures", where="--layout", remedy="webdataset or lerobot"
            )
        wanted = msgspec.structs.replace(built, layout="webdataset")
    if dataset.about.rendered and wanted.backend != built.backend:
        raise DataError(
            f"its pictures were drawn by backend {built.drawn_by!r}; those of "
            f"{wanted.drawn_by!r} differ by rounding",
            where=dataset.folder,
            remedy=f"leave --backend out, or give {built.drawn_by}",
        )
    if dataset.about.rendered and wanted.depth and not built.depth:
        raise DataError(
            "the dataset was made without depth: its rows have no hashes of such pictures",
            where=dataset.folder,
            remedy="leave --depth out, or build another dataset with --depth",
        )
    if wanted.visible_sets != built.visible_sets:
        ways = ("exactly", "from visible sets")
        raise DataError(
            f"the dataset was made to be drawn {ways[built.visible_sets]}",
            where=dataset.folder,
            remedy="leave --visible-sets as it was, or build another dataset",
        )
    return wanted


def _now_drawn(
    about: DatasetFile, settings: PictureSettings, parts: Sequence[DatasetPart]
) -> DatasetFile:
    """A dataset whose rows have the hashes of pictures now, of which kinds, and who drew them."""
    built = about.settings.pictures
    depth = settings.depth or built.depth  # hashed as well where this cache does not keep it
    kind = built.depth_as if built.depth else settings.depth_as
    pictures = msgspec.structs.replace(built, backend=settings.backend, depth=depth, depth_as=kind)
    return msgspec.structs.replace(
        about,
        parts=tuple(parts),
        rendered=True,
        settings=msgspec.structs.replace(about.settings, pictures=pictures),
    )


def plan_rendering(
    dataset: Dataset, settings: PictureSettings, names: Sequence[str] | None = None
) -> list[PartPlan]:
    """Plans to draw all parts again, or those named."""
    return [
        PartPlan(str(dataset.folder), part.name, number, part.scene, part.episodes, settings)
        for number, part in enumerate(dataset.about.parts)
        if names is None or part.name in names
    ]


def check_rendered(plan: PartPlan, made: PartDone) -> None:
    """Refuse a part that is not the planned one.

    Raises:
        DataError: it has other episodes.
    """
    if made.part.name != plan.name or made.part.episodes != plan.episodes:
        raise DataError(
            f"part {made.part.name!r} holds other episodes than planned",
            where=plan.folder,
            remedy="delete the cache and render it again",
        )


def finish_cache(
    dataset: Dataset, settings: PictureSettings, parts: Sequence[PartDone]
) -> CacheManifest:
    """Write what a cache needs beside its parts' files, its journal, and its manifest."""
    files = [record for made in parts for record in made.files]
    if settings.layout == "lerobot":
        from gn0.data.cache_lerobot import write_tables

        files += write_tables(dataset, {made.part.name: made.notes for made in parts}, settings)
    else:
        from gn0.data.webdataset_card import write_card

        files.append(write_card(dataset, settings))
    folder = cache_folder(dataset.folder, settings.layout)
    lines = [_headline(settings), *map(msgspec.to_builtins, parts)]
    journal = b"".join(map(journal_line, lines))
    write_journal(folder / JOURNAL, journal)
    files.append(record_file(JOURNAL, journal))
    return save_manifest(dataset.folder, settings, iter(files))


def _headline(settings: PictureSettings) -> dict[str, object]:
    """The first line of a cache's journal."""
    return {"settings": msgspec.to_builtins(settings), "layout": CACHE_LAYOUT}


def _begin_journal(path: Path, settings: PictureSettings) -> None:
    """Make the journal this cache's own.

    Raises:
        DataError: it belongs to a cache of other settings.
    """
    journal = Journal(path)
    first = next(iter(journal.read()), None)
    ours = _headline(settings)
    if first is None:
        journal.append(ours)
        journal.close()
    elif first != ours:
        raise DataError(
            "a cache of other settings was begun there, or by another version",
            where=path.parent,
            remedy="give the same settings, or delete that folder",
        )


def _still_there(
    out: Path, settings: PictureSettings, done: Mapping[str, PartDone]
) -> dict[str, PartDone]:
    """Those parts of a journal whose files are still there, whole."""
    folder = cache_folder(out, settings.layout)
    found = {}
    for name, made in done.items():
        paths = [(safe_join(folder, record.path), record.size) for record in made.files]
        paths.append((safe_join(out, made.part.path), made.part.size))
        if all(path.is_file() and path.stat().st_size == size for path, size in paths):
            found[name] = made
    return found
