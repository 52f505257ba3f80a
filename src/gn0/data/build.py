"""Builds a dataset from a suite of episodes: in parallel, resumable, the same bytes every time.

The unit of work is a part: a chunk of one scene's episodes. A worker writes the files of its part;
the parent then names the part in the journal. What the journal names is done, whatever happens.
"""

from __future__ import annotations

import contextlib
import os
import shutil
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import IO, Any, Literal

import msgspec

from gn0.bench.runner import check_room
from gn0.bench.suite import EPISODE_FILE, Suite, copy_folder, load_suite
from gn0.data.dataset import (
    DATASET_FILE,
    DATASET_LAYOUT,
    JOURNAL,
    SCENE_FOLDER,
    Dataset,
    DatasetFile,
    DatasetPart,
    DatasetScene,
    SuiteOrigin,
    load_dataset_file,
    open_dataset,
)
from gn0.data.part import PartPlan, build_part, check_plan
from gn0.data.samples import SAMPLE_LAYOUT
from gn0.data.settings import BuildSettings
from gn0.errors import DataError
from gn0.progress import Progress, no_progress
from gn0.storage import (
    TEMPORARY_PREFIX,
    Journal,
    folder_atomic,
    read_bytes,
    safe_join,
    storage_error,
    write_bytes,
    write_json,
)

ExecutorName = Literal["process", "ray"]


def build_dataset(
    episodes: Path | str | Suite,
    out: Path | str,
    settings: BuildSettings | None = None,
    *,
    workers: int = 1,
    executor: ExecutorName = "process",
    progress: Progress = no_progress,
) -> Dataset:
    """Walk, label and draw the episodes of a suite; an interrupted build there goes on.

    Args:
        episodes: a suite, or its folder, as `gn0 missions generate` and `gn0 bench suite` write.
        out: the dataset folder.
        settings: labels, pictures, parts.
        workers: processes; never changes a byte.
        executor: where the workers live; never changes a byte.
        progress: progress sink.

    Raises:
        DataError: `out` holds another dataset or something else, or a run is writing there.
        BenchError: a scene is missing or changed.
        StorageError: `out` cannot be written, or the disk is full.
    """
    suite = episodes if isinstance(episodes, Suite) else load_suite(episodes)
    out = Path(out)
    about = describe_dataset(suite, settings or BuildSettings())
    plans = plan_parts(suite, out, about.settings.chunk)
    check_room(out, len(suite.episodes))
    with lock_folder(out):
        done = _resume(out, about)
        if done is None:
            return open_dataset(out)
        _lay_out(out, suite, about, progress)
        parts = _run(out, plans, done, workers, executor, progress)
        _finish(out, about, [parts[plan.name] for plan in plans])
    return open_dataset(out)


def describe_dataset(suite: Suite, settings: BuildSettings) -> DatasetFile:
    """What a dataset is, before any of it is made: what decides its bytes."""
    from gn0 import __version__

    scenes = []
    for scene in sorted(suite.about.scenes, key=lambda scene: scene.id):
        own = [episode for episode in suite.episodes if episode.scene_id == scene.id]
        scenes.append(
            DatasetScene(
                id=scene.id,
                folder=f"{SCENE_FOLDER}/{scene.id}",
                hash=scene.hash,
                splits=tuple(sorted({episode.split for episode in own})),
                episodes=len(own),
            )
        )
    return DatasetFile(
        layout=DATASET_LAYOUT,
        samples=SAMPLE_LAYOUT,
        suite=SuiteOrigin(name=suite.name, version=suite.about.version, hash=suite.hash),
        camera=suite.about.camera,
        agent=suite.about.agent,
        settings=settings,
        scenes=tuple(scenes),
        software=f"gn0 {__version__}",
    )


def plan_parts(suite: Suite, out: Path, chunk: int) -> list[PartPlan]:
    """The parts of a dataset, sorted by name: chunks of each scene's episodes.

    Missions of one path and light follow each other, so that their pictures are drawn once.
    """
    plans = []
    for scene in sorted(suite.about.scenes, key=lambda scene: scene.id):
        own = [episode for episode in suite.episodes if episode.scene_id == scene.id]
        own.sort(key=lambda episode: (episode.path_id, episode.id))
        for number, begin in enumerate(range(0, len(own), chunk)):
            names = tuple(episode.id for episode in own[begin : begin + chunk])
            plans.append(PartPlan(str(out), f"{scene.id}-{number:04d}", scene.id, names))
    return plans


@contextlib.contextmanager
def lock_folder(folder: Path) -> Iterator[None]:
    """One writer at a time in a dataset; the lock goes with the process, however it ends.

    Raises:
        DataError: somebody else is writing there.
        StorageError: the folder cannot be written.
    """
    try:
        import fcntl
    except ImportError:  # no such lock on this system
        yield
        return
    path = folder / ".lock"
    try:
        stream: IO[bytes] = open(path, "ab")  # noqa: SIM115
    except OSError as error:
        raise storage_error(error, path, "lock the dataset folder") from error
    with stream:
        try:
            fcntl.flock(stream, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError:
            raise DataError(
                "another run is writing to this folder", where=folder,
                remedy="wait for it, or choose another --out",
            ) from None  # fmt: skip
        try:
            yield
        finally:
            with contextlib.suppress(OSError):
                path.unlink()


def sweep(folder: Path) -> None:
    """Remove what a killed run left half-written; call it with the folder locked."""
    for path in sorted(folder.rglob(f"{TEMPORARY_PREFIX}*")):
        with contextlib.suppress(OSError):
            shutil.rmtree(path) if path.is_dir() else path.unlink()


def _resume(out: Path, about: DatasetFile) -> dict[str, DatasetPart] | None:
    """Parts that are done already; None when all is.

    Raises:
        DataError: the folder holds something else.
    """
    if not (out / DATASET_FILE).is_file():
        others = sorted(p.name for p in out.iterdir() if p.name not in (".lock", SCENE_FOLDER))
        others = [name for name in others if not name.startswith(TEMPORARY_PREFIX)]
        if others:
            raise DataError(
                f"the folder is not empty and holds no dataset: {others[0]}", where=out,
                remedy="choose another --out",
            )  # fmt: skip
        return {}
    found = load_dataset_file(out)
    started = msgspec.structs.replace(found, parts=(), complete=False, rendered=False)
    if started != about:
        raise DataError(
            f"the folder holds another dataset: {_difference(started, about)}", where=out,
            remedy="choose another --out, or delete that folder",
        )  # fmt: skip
    if found.complete:
        return None
    sweep(out)
    parts = [msgspec.convert(r["part"], DatasetPart) for r in Journal(out / JOURNAL).read()]
    return {part.name: part for part in parts if safe_join(out, part.path).is_file()}


def _difference(found: Any, wanted: Any) -> str:
    """The first field in which two structs differ, in words."""
    for name in wanted.__struct_fields__:
        ours, theirs = getattr(wanted, name), getattr(found, name)
        if ours == theirs:
            continue
        if isinstance(ours, msgspec.Struct) and type(ours) is type(theirs):
            return f"{name}.{_difference(theirs, ours)}"
        if isinstance(ours, tuple):
            return f"its {name} differ"
        return f"{name} is {theirs!r} there and {ours!r} here"
    return "it differs"


def _lay_out(out: Path, suite: Suite, about: DatasetFile, progress: Progress) -> None:
    """Scenes, episodes, and the description that makes the folder ours."""
    if (out / DATASET_FILE).is_file():
        return
    for number, scene in enumerate(about.scenes):
        progress("scenes", number, len(about.scenes))
        target = safe_join(out, scene.folder)
        if target.exists():  # of a build that was killed before it could say what it is
            shutil.rmtree(target)
        with folder_atomic(target) as folder:
            folder.rmdir()
            copy_folder(suite.scene_folder(scene.id), folder)
    progress("scenes", len(about.scenes), len(about.scenes))
    write_bytes(out / EPISODE_FILE, read_bytes(suite.folder / EPISODE_FILE))
    write_json(out / DATASET_FILE, msgspec.to_builtins(about))


def _run(
    out: Path,
    plans: Sequence[PartPlan],
    done: Mapping[str, DatasetPart],
    workers: int,
    executor: ExecutorName,
    progress: Progress,
) -> dict[str, DatasetPart]:
    parts = dict(done)
    left = [plan for plan in plans if plan.name not in parts]
    with Journal(out / JOURNAL) as journal:

        def take(index: int, answer: dict[str, Any]) -> None:
            part = msgspec.convert(answer["part"], DatasetPart)
            check_plan(left[index], part)
            journal.append(answer)
            parts[part.name] = part
            progress("parts", len(parts), len(plans))

        progress("parts", len(parts), len(plans))
        run_parts("build_part", left, take, workers=workers, executor=executor)
    return parts


def run_parts(
    function: str,
    plans: Sequence[PartPlan],
    take: Callable[[int, dict[str, Any]], None],
    *,
    workers: int,
    executor: ExecutorName,
) -> None:
    """Run a function of `gn0.data.part` on each plan, in workers or here."""
    for index, plan in enumerate(plans):
        take(index, build_part(msgspec.to_builtins(plan)))


def _finish(out: Path, about: DatasetFile, parts: Sequence[DatasetPart]) -> None:
    """Write what was made, and the journal in the order of the parts."""
    whole = msgspec.structs.replace(about, parts=tuple(parts), complete=True)
    temporary = out / f"{TEMPORARY_PREFIX}journal"
    with contextlib.suppress(FileNotFoundError):
        temporary.unlink()
    journal = Journal(temporary)
    for part in parts:
        journal.append({"part": msgspec.to_builtins(part)})
    journal.close()
    try:
        os.replace(temporary, out / JOURNAL)
    except OSError as error:
        raise storage_error(error, out / JOURNAL, "write") from error
    write_json(out / DATASET_FILE, msgspec.to_builtins(whole))
