"""Builds a dataset from a suite of episodes: in parallel, resumable, the same bytes every time.

The unit of work is a part: a chunk of one scene's episodes. A worker writes the files of its part;
the parent then names the part in the journal. What the journal names is done, whatever happens.
"""

from __future__ import annotations

import shutil
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import msgspec

from gn0.avatars.bank import BANK_FILE, AvatarBank
from gn0.config import check_config
from gn0.data.build_folder import (
    parts_journal,
    read_done,
    run_parts,
    write_journal,
)
from gn0.data.dataset import (
    BANK_FOLDER,
    DATASET_FILE,
    DATASET_LAYOUT,
    JOURNAL,
    SCENE_FOLDER,
    Dataset,
    DatasetFile,
    DatasetScene,
    FileRecord,
    SuiteOrigin,
    file_digest,
    load_dataset_file,
    open_dataset,
    save_dataset_file,
)
from gn0.data.drawing_process import open_drawing
from gn0.data.part import PartDone, PartPlan, check_plan, drawn_at
from gn0.data.picture_build import finish_cache
from gn0.data.picture_cache import check_cache_free
from gn0.data.sample_table import PEOPLE_LAYOUT, SAMPLE_LAYOUT
from gn0.data.settings import BuildSettings
from gn0.data.shard import (
    SHARD_FILE,
    ShardFile,
    ShardName,
    find_damage,
    load_shard,
    part_records,
    save_shard,
)
from gn0.errors import DataError
from gn0.jobs import ExecutorName
from gn0.locked_folder import LOCK, PROBE, check_room, lock_folder, sweep_folder
from gn0.missions.episode import Episode
from gn0.people.person import drawn_identity
from gn0.progress import Progress, no_progress
from gn0.render.share.server_process import DrawServer
from gn0.storage import (
    TEMPORARY_PREFIX,
    folder_atomic,
    read_bytes,
    safe_join,
    write_bytes,
)
from gn0.suites.generation_folder import MANIFEST
from gn0.suites.run_files import BYTES_PER_EPISODE
from gn0.suites.scene_drawing import find_agents_card
from gn0.suites.suite import EPISODE_FILE, Suite, copy_folder, load_suite, load_suite_scene


def build_dataset(
    episodes: Path | str | Suite,
    out: Path | str,
    settings: BuildSettings | None = None,
    *,
    workers: int = 1,
    executor: ExecutorName = "process",
    ray_address: str = "",
    gpus: float = 0,
    batch: int = 0,
    agents: int = 1,
    bank: Path | str | None = None,
    server: DrawServer | None = None,
    progress: Progress = no_progress,
    note: Callable[[str], None] = lambda text: None,
) -> Dataset:
    """Walk, label and draw the episodes of a suite; an interrupted build there goes on.

    Args:
        episodes: a suite, or its folder, as `gn0 missions generate` and `gn0 bench suite` write.
        out: the dataset folder.
        settings: labels, pictures, parts.
        workers: processes; never changes a byte.
        executor: where the workers run; never changes a byte.
        ray_address: address of a running Ray cluster; "" starts one on this machine.
        gpus: cards that Ray sets aside for each worker, which then draws for itself.
        batch: views per call of the GPU's renderer; 0 takes its default; never changes a byte.
        agents: episodes that a policy is driven through side by side; never changes a byte.
        bank: folder of the bank of people whom episodes name; those named are copied. It is not
            needed for drawn people ("drawn:0:7").
        server: a drawing process with that backend, when one is running already.
        progress: progress sink.
        note: called with each thing that a person should be told, once.

    Raises:
        DataError: `out` holds another dataset or something else, a run is writing there, or the
            backend that is to draw is not here.
        EpisodeError: an episode names somebody of a bank that is not given, or of another one.
        BenchError: a scene is missing or changed.
        StorageError: `out` cannot be written, or the disk is full.
    """
    _build(
        _load(episodes), Path(out), settings or BuildSettings(), None, workers=workers,
        executor=executor, ray_address=ray_address, gpus=gpus, batch=batch, agents=agents,
        bank=bank, server=server, progress=progress, note=note,
    )  # fmt: skip
    return open_dataset(out)


def build_shard(
    episodes: Path | str | Suite,
    out: Path | str,
    shard: ShardName | str,
    settings: BuildSettings | None = None,
    *,
    workers: int = 1,
    executor: ExecutorName = "process",
    ray_address: str = "",
    gpus: float = 0,
    batch: int = 0,
    agents: int = 1,
    bank: Path | str | None = None,
    progress: Progress = no_progress,
    note: Callable[[str], None] = lambda text: None,
) -> ShardFile:
    """Build one shard of a dataset by itself; `merge_shards` joins them. See `build_dataset`.

    A shard that is there already is read again, and what is damaged in it is made again.

    Args:
        episodes: see `build_dataset`; the same for all shards.
        out: the shard's own folder.
        shard: "i/n", i from 1 to n.
        settings: see `build_dataset`; the same for all shards.
        workers: see `build_dataset`.
        executor: see `build_dataset`.
        ray_address: see `build_dataset`.
        gpus: see `build_dataset`.
        batch: see `build_dataset`.
        agents: see `build_dataset`.
        bank: see `build_dataset`.
        progress: progress sink.
        note: called with each thing that a person should be told, once.

    Raises:
        ConfigError: there is no such shard.
        DataError, EpisodeError, BenchError, StorageError: see `build_dataset`.
    """
    name = ShardName.parse(shard) if isinstance(shard, str) else shard
    _build(
        _load(episodes), Path(out), settings or BuildSettings(), name, workers=workers,
        executor=executor, ray_address=ray_address, gpus=gpus, batch=batch, agents=agents,
        bank=bank, server=None, progress=progress, note=note,
    )  # fmt: skip
    return load_shard(out)


def _load(episodes: Path | str | Suite) -> Suite:
    return episodes if isinstance(episodes, Suite) else load_suite(episodes)


def _build(
    suite: Suite,
    out: Path,
    settings: BuildSettings,
    shard: ShardName | None,
    *,
    workers: int,
    executor: ExecutorName,
    ray_address: str,
    gpus: float,
    batch: int,
    agents: int,
    bank: Path | str | None,
    server: DrawServer | None,
    progress: Progress,
    note: Callable[[str], None],
) -> None:
    named = find_bank(suite.episodes, bank)
    about = describe_dataset(suite, settings, named)
    every = plan_parts(suite, out, about.settings.chunk)
    plans = every
    if shard is not None:
        about = msgspec.structs.replace(about, shard=str(shard))
        plans = shard.choose(every)
    place = None
    if about.settings.dagger is not None:
        place = find_agents_card(
            "cuda" if about.settings.pictures.drawn_by == "cuda" else "auto",
            "auto",  # what it sees, if anything, is known when it is built
            agents=agents,
            workers=workers,
            executor=executor,
        )
    there = {"agents": agents, "on_device": place is not None}
    plans = [msgspec.structs.replace(plan, **there) for plan in plans]
    check_target(out, about)
    check_room(out, sum(len(plan.episodes) for plan in plans) * BYTES_PER_EPISODE)
    with lock_folder(out, refuse=DataError):
        found = check_target(out, about)
        sweep_folder(out)
        if found is not None and found.complete:
            write_journal(out / JOURNAL, parts_journal(found))
            return
        if (out / SHARD_FILE).is_file() and not find_damage(out, load_shard(out).records()):
            return
        pictures = about.settings.pictures  # a device that is not here is said before any work
        with open_drawing(
            pictures, executor=executor, gpus=gpus, batch=batch, server=server, note=note
        ) as drawing:
            if found is None:
                needed = {plan.scene for plan in plans}
                found = _lay_out(out, suite, about, needed, named, progress)
            done = read_done(out / JOURNAL)
            parts = run_parts(
                "build_part",
                drawn_at(plans, drawing),
                {
                    name: made
                    for name, made in done.items()
                    if _is_there(out, made, shard, pictures.layout)
                },
                out / JOURNAL,
                workers=workers,
                executor=executor,
                ray_address=ray_address,
                gpus=gpus,
                progress=progress,
                check=check_plan,
            )
        made = [parts[plan.name] for plan in plans]
        if shard is None:
            finish_dataset(out, found, made)
        else:
            save_shard(out, shard, found, every, made)


def find_bank(episodes: Sequence[Episode], bank: Path | str | None) -> AvatarBank | None:
    """The bank of the people whom episodes name; None where they name nobody.

    A bank that is given is opened in any case, so that a wrong folder is said.

    Raises:
        EpisodeError: somebody is not in it, or is of another bank; or there is none.
        StorageError, FormatError: it cannot be read.
    """
    found = None if bank is None else AvatarBank(bank)
    if any(episode.people for episode in episodes):
        from gn0.people.cast import Cast  # bodies are needed only where there are people

        cast = Cast(found)
        for episode in episodes:
            cast.check(episode.people, f"episode {episode.id!r}")
    people = (person for episode in episodes for person in episode.people)
    return found if any(drawn_identity(one.identity) is None for one in people) else None


def describe_dataset(
    suite: Suite, settings: BuildSettings, bank: AvatarBank | None = None
) -> DatasetFile:
    """What a dataset is, before any of it is made: what decides its bytes.

    Raises:
        ConfigError: a setting is of the wrong type or out of range.
    """
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
        samples=PEOPLE_LAYOUT if any(e.people for e in suite.episodes) else SAMPLE_LAYOUT,
        suite=SuiteOrigin(name=suite.name, version=suite.about.version, hash=suite.hash),
        camera=suite.about.camera,
        agent=suite.about.agent,
        settings=check_config(settings),
        scenes=tuple(scenes),
        software=f"gn0 {__version__}",
        bank=msgspec.UNSET if bank is None else bank.content_hash,
    )


def plan_parts(suite: Suite, out: Path, chunk: int) -> list[PartPlan]:
    """The parts of a dataset, in order: chunks of each scene's episodes.

    Missions of one path follow each other, so that their pictures are drawn once.
    """
    plans: list[PartPlan] = []
    for scene in sorted(suite.about.scenes, key=lambda scene: scene.id):
        own = [episode for episode in suite.episodes if episode.scene_id == scene.id]
        own.sort(key=lambda episode: (episode.path_id, episode.id))
        for number, begin in enumerate(range(0, len(own), chunk)):
            names = tuple(episode.id for episode in own[begin : begin + chunk])
            name = f"{scene.id}-{number:04d}"
            plans.append(PartPlan(str(out), name, len(plans), scene.id, names))
    return plans


def check_target(out: Path, about: DatasetFile) -> DatasetFile | None:
    """The description that is in the folder; None where there is none yet.

    Raises:
        DataError: the folder holds something else.
    """
    if not (out / DATASET_FILE).is_file():
        ours = {LOCK, SCENE_FOLDER, BANK_FOLDER, EPISODE_FILE, MANIFEST, PROBE}
        names = sorted(path.name for path in out.iterdir()) if out.is_dir() else []
        others = [n for n in names if n not in ours and not n.startswith(TEMPORARY_PREFIX)]
        if others or (SCENE_FOLDER in names and LOCK not in names):
            raise DataError(
                f"the folder is not empty and holds no dataset: {(others or names)[0]}",
                where=out,
                remedy="choose another --out",
            )
        return None
    found = load_dataset_file(out)
    started = msgspec.structs.replace(found, files=(), parts=(), complete=False, rendered=False)
    if about.settings.pictures.layout == "none":  # drawn later, by what was there then
        drawn_by = about.settings.pictures.backend
        if about.settings.dagger is not None and not found.rendered:
            drawn_by = found.settings.pictures.backend  # it drew what the policy saw, already
        pictures = msgspec.structs.replace(found.settings.pictures, backend=drawn_by)
        if found.rendered and not about.settings.pictures.depth:
            pictures = msgspec.structs.replace(pictures, depth=msgspec.UNSET)
        settings = msgspec.structs.replace(found.settings, pictures=pictures)
        started = msgspec.structs.replace(started, settings=settings)
    if started != about:
        raise DataError(
            f"the folder holds another dataset: {tell_difference(started, about)}",
            where=out,
            remedy="choose another --out, or delete that folder",
        )
    return found


def tell_difference(found: Any, wanted: Any) -> str:
    """The first field in which two structs differ, in words."""
    for name in wanted.__struct_fields__:
        ours, theirs = getattr(wanted, name), getattr(found, name)
        if ours == theirs:
            continue
        if isinstance(ours, msgspec.Struct) and type(ours) is type(theirs):
            return f"{name}.{tell_difference(theirs, ours)}"
        if isinstance(ours, tuple):
            return f"its {name} differ"
        words = ["unset" if own is msgspec.UNSET else repr(own) for own in (theirs, ours)]
        return f"{name} is {words[0]} there and {words[1]} here"
    return "it differs"


def _lay_out(
    out: Path,
    suite: Suite,
    about: DatasetFile,
    needed: set[str],
    bank: AvatarBank | None,
    progress: Progress,
) -> DatasetFile:
    """Scenes, people, episodes, and the description that makes the folder ours.

    A shard is given the scenes that its parts need; the first one also those without episodes.
    """
    first = about.shard is msgspec.UNSET or about.shard.startswith("1/")
    here = [s for s in about.scenes if s.id in needed or (first and not s.episodes)]
    records = []
    for number, scene in enumerate(here):
        progress("scenes", number, len(here))
        source = suite.scene_folder(scene.id)
        load_suite_scene(source, scene.id, scene.hash)  # not the one of the episodes: say it now
        target = safe_join(out, scene.folder)
        if target.exists():  # of a build that was killed before it could say what it is
            shutil.rmtree(target)
        with folder_atomic(target) as folder:
            folder.rmdir()
            copy_folder(source, folder)
        for path in sorted(target.rglob("*")):
            if path.is_file():
                records.append(record_path(out, path))
    progress("scenes", len(here), len(here))
    if bank is not None:
        for path in _copy_bank(bank, suite.episodes, out / BANK_FOLDER):
            records.append(record_path(out, path))
    for name in (EPISODE_FILE, MANIFEST):  # generated missions say how they came about
        if (suite.folder / name).is_file():
            write_bytes(out / name, read_bytes(suite.folder / name))
            records.append(record_path(out, out / name))
    found = msgspec.structs.replace(about, files=tuple(sorted(records, key=lambda r: r.path)))
    save_dataset_file(out, found)
    return found


def _copy_bank(bank: AvatarBank, episodes: Sequence[Episode], folder: Path) -> list[Path]:
    """The list of a bank, and the files of those of its people whom episodes name."""
    named = {person.identity for episode in episodes for person in episode.people}
    names = [BANK_FILE, *(f"{name}.npz" for name in bank.names if name in named)]
    paths = [safe_join(folder, name) for name in names]
    for name, path in zip(names, paths, strict=True):
        write_bytes(path, read_bytes(safe_join(bank.folder, name)))
    return paths


def record_path(root: Path, path: Path) -> FileRecord:
    """Size and digest of a file, its path relative to `root`."""
    data = read_bytes(path)
    relative = path.relative_to(root).as_posix()
    return FileRecord(path=relative, size=len(data), digest=file_digest(data))


def _is_there(out: Path, made: PartDone, shard: ShardName | None, layout: str) -> bool:
    """Whether the sample table that a journal names is still there, whole.

    Of a shard, which nobody will verify until it is merged, every byte is read.
    """
    if shard is not None:
        return not find_damage(out, part_records(made, layout))
    path = safe_join(out, made.part.path)
    return path.is_file() and path.stat().st_size == made.part.size


def finish_dataset(out: Path, about: DatasetFile, parts: list[PartDone]) -> None:
    """Write the cache's last files, and say that the dataset is whole."""
    pictures = about.settings.pictures
    whole = msgspec.structs.replace(
        about,
        parts=tuple(made.part for made in parts),
        complete=True,
        rendered=pictures.layout != "none",
    )
    if pictures.layout != "none" and not check_cache_free(out, pictures):
        finish_cache(Dataset(out, whole), pictures, parts)
    save_dataset_file(out, whole)
    write_journal(out / JOURNAL, parts_journal(whole))
