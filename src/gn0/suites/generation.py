"""Generates missions over many scenes: in parallel, resumable, the same bytes every time.

The output is a suite folder with three more files:

    manifest.json           what was asked, how many candidates fell at which filter, hashes
    paths.parquet           the path pool: a row a path
    instructions.parquet    every text of every path
    tracks.parquet          only with people to follow: who was where when

The unit of work is a scene. A worker fills a folder of its own under `.work/` and renames it when
it is whole: what is there is done. The parent puts the parts together and removes `.work/`.
"""

from __future__ import annotations

import os
import shutil
from collections import Counter
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import IO, Any, NamedTuple

import msgspec
import pyarrow.parquet as pq

from gn0.config import load_json
from gn0.errors import EpisodeError
from gn0.jobs import ExecutorName, run_jobs
from gn0.maps.navigation import NavigationMap
from gn0.missions.episode import AgentSpec, Episode
from gn0.missions.episode_files import fill_rare_columns, read_table, save_episodes
from gn0.missions.follow_rules import FOLLOW
from gn0.missions.generate.follow_settings import FOLLOW_REASONS
from gn0.missions.generate.follow_tracks import TRACKS, FollowTrackRow, tracks_table
from gn0.missions.generate.judge import REASONS
from gn0.missions.generate.path_missions import build_missions, count_missions
from gn0.missions.generate.path_pool import (
    PathText,
    load_paths,
    paths_table,
    save_table,
    texts_table,
)
from gn0.missions.generate.scene_paths import ScenePaths, SceneReport, generate_paths
from gn0.missions.generate.settings import MissionSettings
from gn0.missions.generate.texts import count_texts, write_path_texts
from gn0.missions.language.providers import open_provider
from gn0.paper import MAX_STEPS
from gn0.people.plan import add_people
from gn0.progress import Progress, no_progress
from gn0.scenes.scene import Scene
from gn0.sim.presets import find_preset
from gn0.storage import (
    TEMPORARY_PREFIX,
    content_hash,
    folder_atomic,
    plain_path,
    read_bytes,
    storage_error,
    write_atomic,
    write_json,
)
from gn0.suites.earlier_paths import EarlierPaths, load_earlier, save_earlier
from gn0.suites.generation_folder import (
    LAYOUT,
    MANIFEST,
    PARTS,
    PATHS,
    REPORT,
    TEXTS,
    GenerationRequest,
    Manifest,
    RequestScene,
    Totals,
    clear_folder,
    find_finished,
    list_tables,
    open_work,
)
from gn0.suites.scene_list import SceneEntry, list_scenes
from gn0.suites.suite import (
    EPISODE_FILE,
    SCENE_FOLDER,
    SUITE_FILE,
    SUITE_VERSION,
    Suite,
    SuiteFile,
    SuiteScene,
    copy_folder,
    load_suite,
    load_suite_scene,
)
from gn0.suites.track import choose_track
from gn0.version import source_version

# what decides the bytes: half a generation is not gone on with by other code
_DECIDING = (
    "geometry.py", "paper.py", "seeds.py", "maps", "missions", "people", "avatars/identity.py",
    "render/light.py", "sim/presets.py", "suites/generation.py", "suites/generation_folder.py",
)  # fmt: skip
_DECIDING_FOLLOW = (
    "avatars", "gaussians/film.py",
    "data/expert_labels.py", "data/follow.py", "data/follow_judge.py", "data/follow_missions.py",
    "data/follow_oracle.py", "data/follow_reference.py", "render/cpu.py", "sim/collision.py",
    "sim/kinematics.py", "sim/people.py", "sim/simulator.py", "sim/ticks.py",
)  # fmt: skip
# units of work by what is made; data is a floor above, and known by name as plug-ins are
_UNIT = "gn0.suites.generation:generate_scene"
_FOLLOW_UNIT = "gn0.data.follow_missions:generate_scene"


class Workforce(NamedTuple):
    """Who works: how many processes, and where; of no effect on what is made."""

    workers: int = 1
    executor: ExecutorName = "process"
    ray_address: str = ""


def generate_missions(
    scenes: Sequence[Path | str],
    out: Path | str,
    settings: MissionSettings | None = None,
    *,
    seed: int = 0,
    split: str = "test",
    name: str = "",
    camera: str = "",
    agent: str = "",
    against: Sequence[Path | str] = (),
    language_options: Mapping[str, Any] | None = None,
    workers: int = 1,
    executor: ExecutorName = "process",
    ray_address: str = "",
    overwrite: bool = False,
    progress: Progress = no_progress,
) -> tuple[Suite, Manifest]:
    """Generate missions in many scenes; an interrupted generation there goes on.

    Args:
        scenes: scene folders, folders of them, or folders of `gn0 scene corpus`, which say the
            split of each scene.
        out: the folder to write.
        settings: counts and measures.
        seed: root seed.
        split: split of scenes whose folder does not say it.
        name: name of the suite; by default the folder's name.
        camera: camera preset by name, which decides the body too; "" means the agent's own, else
            gn_bench, or follower where people are followed and nothing else is done.
        agent: preset by name whose body walks; "" means the camera's.
        against: earlier generations (or suites) whose paths are not to come again.
        language_options: for the language provider.
        workers: processes; never changes a byte.
        executor: where the workers run; never changes a byte.
        ray_address: address of a running Ray cluster.
        overwrite: replace an earlier generation that was another one.
        progress: progress sink.

    Raises:
        StorageError: a scene is missing, or `out` holds something else or cannot be written.
        BenchError: `out` holds another generation, or one is running there.
        EpisodeError: no scene has a single path.
        ConfigError: an unknown camera or language provider.
    """
    out = plain_path(out)
    settings = settings or MissionSettings()
    entries = list_scenes(scenes, split, progress)
    options = dict(language_options or {})
    open_provider(settings.language, **options)  # a wrong option is told before the work begins
    earlier = load_earlier(against, {entry.id: entry.hash for entry in entries})
    only_follow = settings.missions == ("follow",)
    camera = camera or agent or ("follower" if only_follow else "gn_bench")
    body = find_preset(agent or camera).agent
    request = _describe(entries, out, settings, seed, name, camera, body, options, earlier)
    if overwrite:
        clear_folder(out, request)
    manifest = find_finished(out, request)
    if manifest is not None:
        return load_suite(out), manifest
    with open_work(out, request) as work:
        where = Workforce(workers, executor, ray_address)
        _run_units(work, entries, request, options, earlier, where, progress)
        return _put_together(out, work, entries, request, earlier, progress)


def _describe(
    entries: Sequence[SceneEntry],
    out: Path,
    settings: MissionSettings,
    seed: int,
    name: str,
    camera: str,
    body: AgentSpec,
    options: Mapping[str, Any],
    earlier: EarlierPaths,
) -> GenerationRequest:
    return GenerationRequest(
        layout=LAYOUT,
        software=f"gn0 {source_version(_deciding(settings))}",
        name=name or out.resolve().name,
        seed=int(seed),
        camera=camera,
        agent=body,
        settings=settings,
        language_options={
            k: Path(str(v)).name if k == "path" else str(v)
            for k, v in sorted(options.items())
            if k in _TELLING
        },
        scenes=tuple(
            RequestScene(id=e.id, hash=e.hash, split=e.split, val_seen=e.val_seen) for e in entries
        ),
        earlier=earlier.digest,
    )


def _deciding(settings: MissionSettings) -> tuple[str, ...]:
    return _DECIDING + _DECIDING_FOLLOW if "follow" in settings.missions else _DECIDING


# options of a language provider that decide its texts, and are no secrets
_TELLING = ("model", "temperature", "seed", "answer_tokens", "path")


def _part_name(entry: SceneEntry | RequestScene) -> str:
    return content_hash(entry.id, entry.hash)[:16]


def _run_units(
    work: Path,
    entries: Sequence[SceneEntry],
    request: GenerationRequest,
    options: Mapping[str, Any],
    earlier: EarlierPaths,
    where: Workforce,
    progress: Progress,
) -> None:
    """Every scene that has no part yet."""
    settings = request.settings
    todo = [e for e in entries if not (work / PARTS / _part_name(e) / REPORT).is_file()]
    save_earlier(work, earlier, [entry.id for entry in todo])
    payloads = [
        {
            "folder": str(entry.folder.resolve()),
            "scene": entry.id,
            "hash": entry.hash,
            "split": entry.split,
            "held_out": settings.val_seen if entry.val_seen else 0.0,
            "out": str((work / PARTS / _part_name(entry)).resolve()),
            "earlier": str(earlier.file(work, entry.id).resolve())
            if entry.id in earlier.paths
            else "",
            "request": msgspec.to_builtins(request),
            "options": dict(options),
        }
        for entry in todo
    ]
    done = len(entries) - len(todo)
    run_jobs(
        _FOLLOW_UNIT if "follow" in settings.missions else _UNIT,
        payloads,
        workers=where.workers,
        executor=where.executor,
        ray_address=where.ray_address,
        names=[entry.id for entry in todo],
        what="scenes",
        progress=lambda stage, now, _total: progress(stage, done + now, len(entries)),
        steps=progress,
    )


class ScenePart(msgspec.Struct, frozen=True):
    """All that is made of a scene: a part of the suite to be.

    Attributes:
        request: what was asked.
        scene: the scene.
        navigation: its map for the agent.
        paths: its paths.
        texts: what is told of them.
        episodes: their missions.
        report: the count.
        tracks: of its follow missions.
    """

    request: GenerationRequest
    scene: Scene
    navigation: NavigationMap
    paths: ScenePaths
    texts: Sequence[PathText]
    episodes: Sequence[Episode]
    report: SceneReport
    tracks: tuple[FollowTrackRow, ...] = ()


def generate_scene(payload: dict[str, Any], progress: Progress = no_progress) -> dict[str, Any]:
    """One unit of work: a scene's paths, texts and episodes in a folder of their own.

    Raises:
        BenchError: the scene changed under the generation.
        StorageError, FormatError, SceneError: it cannot be read, or the part not written.
    """
    return save_part(payload["out"], build_part(payload, progress))


def build_part(payload: dict[str, Any], progress: Progress = no_progress) -> ScenePart:
    """A scene's paths, with the missions to go somewhere.

    Raises:
        BenchError: the scene changed under the generation.
        StorageError, FormatError, SceneError: it cannot be read.
    """
    request = msgspec.convert(payload["request"], GenerationRequest)
    settings, agent = request.settings, request.agent
    scene = load_suite_scene(Path(payload["folder"]), payload["scene"], payload["hash"])
    known = load_paths(payload["earlier"]) if payload["earlier"] else []
    navigation = NavigationMap(scene.grid, agent.radius)
    paths = generate_paths(
        scene,
        settings,
        request.seed,
        radius=agent.radius,
        split=payload["split"],
        held_out=payload["held_out"],
        earlier=[record.array for record in known],
        progress=progress,
    )
    texts: list[PathText] = []
    fallbacks: dict[str, int] = {}
    if settings.missions != ("follow",):
        provider = open_provider(settings.language, **payload["options"])
        texts, fallbacks = write_path_texts(
            scene, navigation, paths, settings, provider, request.seed, eye=agent.camera_height,
            progress=progress,
        )  # fmt: skip
    episodes = build_missions(
        scene,
        navigation,
        paths,
        texts,
        settings,
        request.seed,
        agent=agent,
        camera=find_preset(request.camera).rgb,
        progress=progress,
    )
    if settings.people:
        episodes = add_people(scene, episodes, settings.people, progress=progress)
    report = msgspec.structs.replace(paths.report, fallbacks=fallbacks)
    return ScenePart(request, scene, navigation, paths, texts, episodes, report)


def save_part(out: Path | str, part: ScenePart) -> dict[str, Any]:
    """Write a part into a folder of its own, whole or not at all.

    Raises:
        StorageError: it cannot be written.
    """
    scene = part.scene
    report = msgspec.structs.replace(
        part.report, episodes=count_missions(part.episodes), texts=count_texts(part.texts)
    )
    with folder_atomic(out) as folder:
        save_episodes(folder / EPISODE_FILE, part.episodes, {scene.id: scene.grid})
        save_table(folder / PATHS, paths_table(part.paths.records))
        save_table(folder / TEXTS, texts_table(part.texts))
        if "follow" in part.request.settings.missions:
            save_table(folder / TRACKS, tracks_table(part.tracks))
        write_json(folder / REPORT, msgspec.to_builtins(report))
    return {"scene": scene.id, "paths": report.paths}


def _put_together(
    out: Path,
    work: Path,
    entries: Sequence[SceneEntry],
    request: GenerationRequest,
    earlier: EarlierPaths,
    progress: Progress,
) -> tuple[Suite, Manifest]:
    """The suite from its parts; `manifest.json` last, as the mark of completion."""
    parts = [work / PARTS / _part_name(entry) for entry in entries]
    reports = [load_json(part / REPORT, SceneReport) for part in parts]
    if not any(report.paths for report in reports):
        shutil.rmtree(work, ignore_errors=True)  # another try has other settings
        raise EpisodeError(
            f"not a single path was accepted in {len(entries)} scenes: {_why_none(reports)}",
            where=out,
            remedy="lower --minimum-length, raise --attempts, name other --categories, or see "
            "`gn0 scene check`",
        )
    if not any(report.episodes for report in reports):
        shutil.rmtree(work, ignore_errors=True)
        raise EpisodeError(
            f"nobody can be followed along any of {sum(r.paths for r in reports)} paths in "
            f"{len(entries)} scenes: {_why_nobody(reports)}",
            where=out,
            remedy=what_then(reports),
        )
    used = [(e, p) for e, p, r in zip(entries, parts, reports, strict=True) if r.episodes]
    for number, (entry, _) in enumerate(used):
        progress("laying out scenes", number, len(used))
        _link_scene(entry, out / SCENE_FOLDER)
    tables = list_tables(request.settings)
    for table in tables:
        _join_tables(out / table, [part / table for _, part in used])
    episodes = read_table(out / EPISODE_FILE)
    splits = Counter(episodes.column("split").to_pylist())
    about = SuiteFile(
        layout=SUITE_VERSION,
        name=request.name,
        version="1",
        scenes=tuple(
            SuiteScene(id=e.id, folder=f"{SCENE_FOLDER}/{e.id}", hash=e.hash) for e, _ in used
        ),
        camera=request.camera,
        agent=request.agent,
        episodes=sum(splits.values()),
        max_steps=FOLLOW.max_steps if request.settings.missions == ("follow",) else MAX_STEPS,
        track=choose_track(set(episodes.column("mission").to_pylist())),
    )
    write_json(out / SUITE_FILE, msgspec.to_builtins(about))
    suite = load_suite(out)
    manifest = Manifest(
        request=request,
        totals=_add_up(reports, splits),
        scenes=tuple(reports),
        reasons={**REASONS, **(FOLLOW_REASONS if TRACKS in tables else {})},
        notes=tuple(_notes(reports, earlier)),
        suite=suite.hash,
        files={name: content_hash(read_bytes(out / name)) for name in tables},
    )
    write_json(out / MANIFEST, msgspec.to_builtins(manifest))
    progress("laying out scenes", len(used), len(used))
    return suite, manifest


def _link_scene(entry: SceneEntry, scenes: Path) -> None:
    """A scene's folder inside the suite: whole or not there."""
    target = scenes / entry.id
    if target.is_dir():
        return
    temporary = scenes / f"{TEMPORARY_PREFIX}{_part_name(entry)}"
    try:
        copy_folder(entry.folder, temporary)
        os.replace(temporary, target)
    except OSError as error:
        raise storage_error(error, target, "copy the scene") from error


def _join_tables(target: Path, parts: Sequence[Path]) -> None:
    """Tables one after the other, a row group each, in one file."""
    names = {name for part in parts for name in read_table(part).column_names}
    schema = fill_rare_columns(read_table(parts[0]), sorted(names)).schema

    def write(stream: IO[bytes]) -> None:
        with pq.ParquetWriter(stream, schema, compression="zstd", store_schema=True) as writer:
            for part in parts:
                table = fill_rare_columns(read_table(part), sorted(names))
                writer.write_table(table)

    write_atomic(target, write)


def _add_up(reports: Sequence[SceneReport], splits: Mapping[str, int]) -> Totals:
    def sums(field: str) -> dict[str, int]:
        total: Counter[str] = Counter()
        for report in reports:
            total.update(getattr(report, field))
        return dict(sorted(total.items()))

    return Totals(
        scenes=len(reports),
        asked=sum(r.asked for r in reports),
        paths=sum(r.paths for r in reports),
        candidates=sum(r.candidates for r in reports),
        fell=sums("fell"),
        targets=sum(r.targets for r in reports),
        targets_fell=sums("targets_fell"),
        unreachable=sum(len(r.unreachable) for r in reports),
        episodes=sums("episodes"),
        splits=dict(sorted(splits.items())),
        texts=sums("texts"),
        fallbacks=sums("fallbacks"),
        follow_candidates=sum(r.follow_candidates for r in reports),
        follow_fell=sums("follow_fell"),
    )


def _notes(reports: Sequence[SceneReport], earlier: EarlierPaths) -> list[str]:
    notes = [f"{report.scene}: {report.note}" for report in reports if report.note]
    for report in reports:
        if report.paths < report.asked:
            notes.append(
                f"{report.scene}: {report.paths} of {report.asked} paths: {report.ended} after "
                f"{report.candidates} candidates for {report.targets} targets"
            )
    return notes + list(earlier.notes)


def _why_none(reports: Sequence[SceneReport]) -> str:
    fell: Counter[str] = Counter()
    for report in reports:
        fell.update({f"candidates {name}": n for name, n in report.fell.items()})
        fell.update({f"targets: {name}": n for name, n in report.targets_fell.items()})
    told = ", ".join(f"{n} {name}" for name, n in fell.most_common(4))
    notes = "; ".join(sorted({report.note for report in reports if report.note})[:2])
    return told or notes or "there are no targets"


def what_then(reports: Sequence[SceneReport]) -> str:
    """What to try where nobody can be followed; first of all what most of them fell by."""
    words = (
        "ask for more paths, longer ones, or other --levels; a body of 0.5 m/s follows nobody "
        "faster than 0.4 m/s: try --agent follower"
    )
    fell = _count_fell(reports)
    if fell and max(fell, key=fell.__getitem__) == "walls":
        return (
            "people keep 0.3 m off walls, and paths of a thin body come nearer: try "
            "--safety-margin 0.12; or " + words
        )
    return words


def _count_fell(reports: Sequence[SceneReport]) -> Counter[str]:
    fell: Counter[str] = Counter()
    for report in reports:
        fell.update(report.follow_fell)
    return fell


def _why_nobody(reports: Sequence[SceneReport]) -> str:
    fell = _count_fell(reports)
    return ", ".join(f"{n} {name}" for name, n in fell.most_common(4)) or "nobody was drawn"
