"""Foreign episode sets as suites, and suites as foreign episode sets.

An imported suite keeps the rows it came from in `imported/`, in their own format, so exporting it
in that format gives them back value for value.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import msgspec

from gn0.config import load_json
from gn0.errors import BenchError, ConfigError, EpisodeError, SceneError
from gn0.maps.navigation import NavigationMap
from gn0.missions.episode import AgentSpec, Episode
from gn0.missions.sets.episode_set import (
    EpisodeSet,
    Exporter,
    find_placement,
    get_exporter,
    load_set,
    place_task,
)
from gn0.missions.sets.frame_check import FrameCheck, check_frame, why_unfit
from gn0.missions.sets.vlnce import ExporterVlnce
from gn0.missions.sets.vocabulary import are_r2r_words, load_r2r_words
from gn0.progress import Progress, no_progress
from gn0.scenes.folder import load_scene
from gn0.scenes.scene import Scene
from gn0.sim.presets import find_preset
from gn0.storage import plain_path, safe_join, write_json
from gn0.suites.profiles import profile_settings
from gn0.suites.suite import Suite, save_suite

IMPORTED, ABOUT = "imported", "imported.json"
FILE_NAMES = {"gn-matrix": "episodes.parquet", "gn-matrix-json": "tasks", "vlnce": "split.json.gz"}


class ImportedFile(msgspec.Struct, frozen=True, kw_only=True):
    """The content of `imported/imported.json`.

    Attributes:
        format: exporter name.
        name: name of the set.
        file: file or folder beside it that holds the rows.
        placements: name of the placement used in each scene.
        skipped: why episodes were left out, and how many.
    """

    format: str
    name: str
    file: str
    placements: dict[str, str]
    skipped: dict[str, int]


@dataclass(frozen=True, eq=False)
class ImportReport:
    """What became of a set.

    Attributes:
        suite: the suite that was written; None when nothing was.
        checks: how the set lies in each scene.
        missing: scenes of the set that were not given, with their number of episodes.
        skipped: why episodes were left out, and how many.
        unfit: the same of those that were kept anyway.
        kept: episodes in the suite.
    """

    suite: Suite | None
    checks: tuple[FrameCheck, ...]
    missing: dict[str, int]
    skipped: dict[str, int]
    unfit: dict[str, int]
    kept: int


def find_scenes(folders: Sequence[Path | str]) -> dict[str, Path]:
    """Scene folders by scene id: those given, and those one level below.

    Raises:
        SceneError: a folder holds no scene, or two share an id.
    """
    found: dict[str, Path] = {}
    for given in map(Path, folders):
        folders_here = [given] if (given / "scene.json").is_file() else sorted(
            p.parent for p in given.glob("*/scene.json")
        )  # fmt: skip
        if not folders_here:
            raise SceneError(
                "no scene folder (scene.json) here, nor one level below",
                where=given,
                remedy="make one with `gn0 scene import` or `gn0 scene generate`",
            )
        for folder in folders_here:
            scene_id = str(load_json(folder / "scene.json", dict[str, Any]).get("id", ""))
            if scene_id in found and found[scene_id].resolve() != folder.resolve():
                raise SceneError(
                    f"scene {scene_id!r} is given twice",
                    where=folder,
                    remedy=f"the other is {found[scene_id]}",
                )
            found[scene_id] = folder
    return found


def import_set(
    path: Path | str,
    scenes: Sequence[Path | str],
    out: Path | str,
    *,
    format: str = "",
    frame: str = "",
    camera: str = "",
    profile: str = "default",
    split: str = "",
    name: str = "",
    keep: bool = False,
    overwrite: bool = False,
    progress: Progress = no_progress,
) -> ImportReport:
    """Write a suite of a foreign set's episodes in the scenes that are there.

    Args:
        path: the set.
        scenes: scene folders, or folders of scene folders; matched by scene id.
        out: the suite folder.
        format: exporter name; detected from the content when empty.
        frame: placement by name; empty means the documented one. Never chosen automatically.
        camera: preset; empty means the format's own.
        profile: see `SuiteFile`.
        split: written into the episodes; empty means the file's own division, else "test".
        name: name of the suite; empty means the set's.
        keep: keep episodes that do not fit the map; a run will name each of them.
        overwrite: replace an earlier suite.
        progress: progress sink.

    Returns:
        What became of it; `suite` is None when no scene of the set was given or nothing fits.

    Raises:
        StorageError, FormatError, EpisodeError: the set is missing or damaged.
        SceneError: a scene is unreadable or given twice.
        ConfigError: no such format, frame, profile or camera; or profile vlnce for another set.
    """
    episodes = load_set(path, format)
    exporter = get_exporter(episodes.format)
    own = episodes.camera or exporter.camera
    settings = profile_settings(profile, own, camera)
    camera = settings.get("camera", camera or own)
    agent: AgentSpec = settings.get("agent", find_preset(camera).agent)
    given = find_scenes(scenes)
    missing = {s: len(rows) for s, rows in sorted(episodes.rows.items()) if s not in given}
    present = [scene for scene in episodes.scenes if scene in given]
    loaded: list[Scene] = []
    checks: list[FrameCheck] = []
    kept: list[Episode] = []
    skipped: Counter[str] = Counter()
    unfit: Counter[str] = Counter()
    placements: dict[str, str] = {}
    for done, scene_id in enumerate(present):
        progress("scenes", done, len(present))
        scene = load_scene(given[scene_id])
        placement = find_placement(exporter, scene.grid, frame)
        checks.append(check_frame(episodes, exporter, scene.grid, scene_id, placement))
        navigation = NavigationMap(scene.grid, agent.radius)
        fits = 0
        for task in episodes.of_scene(scene_id):
            try:
                episode = place_task(task, placement, agent, split)
            except EpisodeError as error:
                skipped[error.what] += 1
                continue
            reason = why_unfit(episode, navigation)
            if reason and not keep:
                skipped[reason] += 1
                continue
            if reason:
                unfit[reason] += 1
            kept.append(episode)
            fits += 1
        if fits:
            loaded.append(scene)
            placements[scene_id] = placement.name
    progress("scenes", len(present), len(present))
    suite = None
    if kept:
        about = ImportedFile(
            format=episodes.format,
            name=episodes.name,
            file=FILE_NAMES.get(episodes.format, "episodes"),
            placements=placements,
            skipped=dict(sorted(skipped.items())),
        )
        subset = episodes.select([episode.id for episode in kept])
        suite = save_suite(
            out,
            loaded,
            kept,
            name=name or episodes.name,
            camera=camera,
            agent=agent,
            profile=settings["profile"],
            overwrite=overwrite,
            keep_unfit=keep,
            add=lambda folder: _write_imported(folder, exporter, subset, about),
        )
    return ImportReport(
        suite=suite,
        checks=tuple(checks),
        missing=missing,
        skipped=dict(skipped.most_common()),
        unfit=dict(unfit.most_common()),
        kept=len(kept),
    )


def _write_imported(
    folder: Path, exporter: Exporter, episodes: EpisodeSet, about: ImportedFile
) -> None:
    home = folder / IMPORTED
    home.mkdir()
    exporter.save(episodes, safe_join(home, about.file))
    write_json(home / ABOUT, msgspec.to_builtins(about))


def load_imported(suite: Suite) -> tuple[ImportedFile, EpisodeSet] | None:
    """The rows an imported suite came from; None for a suite of our own.

    Raises:
        StorageError, FormatError: they are damaged.
        BenchError: they are not the suite's.
    """
    home = suite.folder / IMPORTED
    if not (home / ABOUT).is_file():
        return None
    about = load_json(home / ABOUT, ImportedFile)
    episodes = get_exporter(about.format).load(safe_join(home, about.file))
    if {task.id for task in episodes.tasks} != {episode.id for episode in suite.episodes}:
        raise BenchError(
            "its rows are not those of the suite", where=home, remedy="import the set again"
        )
    return about, episodes


def export_set(
    suite: Suite,
    format: str,
    out: Path | str,
    *,
    overwrite: bool = False,
    vocabulary: Path | str = "",
) -> EpisodeSet:
    """Write a suite's episodes in a foreign format: the rows they came from, where it is theirs.

    Args:
        suite: the suite.
        format: exporter name.
        out: what to write.
        overwrite: whether a file may be there.
        vocabulary: a file of VLN-CE's R2R whose words the tokens are of (format vlnce).

    Raises:
        ConfigError: no such format, or a vocabulary for tokens that are not made here.
        BenchError, StorageError, FormatError, EpisodeError: the suite is damaged.
        StorageError: `out` exists, or cannot be written.
    """
    exporter = get_exporter(format)
    words = load_r2r_words(vocabulary) if vocabulary else ()
    if words and not isinstance(exporter, ExporterVlnce):
        raise ConfigError(
            f"{format} has no tokens", where="--vocabulary", remedy="leave it out, or write vlnce"
        )
    target = plain_path(out)
    if target.exists() and not (overwrite and target.is_file()):
        from gn0.errors import StorageError

        raise StorageError("exists already", where=target, remedy="choose another --out")
    found = load_imported(suite)
    if found is not None and found[0].format == format:
        episodes = found[1]
        if words and not are_r2r_words(found[1].native.words):
            raise ConfigError(
                "the suite gives back the file it came from, whose words are not R2R's",
                where="--vocabulary",
                remedy="leave it out, or export the suite that this file was made of",
            )
    elif isinstance(exporter, ExporterVlnce):
        episodes = exporter.build(suite.episodes, {}, suite.about.name, words)
    else:
        grids: Mapping[str, Any] = {
            scene.id: load_scene(suite.scene_folder(scene.id)).grid for scene in suite.about.scenes
        }
        episodes = exporter.build(suite.episodes, grids, suite.about.name)
    exporter.save(episodes, target)
    return episodes
