"""Suites: scenes, episodes, and everything that must be equal for two numbers to be compared.

A suite is a folder that stands on its own:

    suite.json          name, version, scenes and their hashes, camera, agent, profile, map mode
    episodes.parquet    one row an episode
    scenes/<id>/        the scene folders (hard links where the file system allows: no extra bytes)
"""

from __future__ import annotations

import os
import shutil
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Annotated, Literal, cast

import msgspec

from gn0.config import Config, load_json
from gn0.errors import BenchError, ConfigError, EpisodeError, SceneError, StorageError
from gn0.maps.navigation import NavigationMap
from gn0.missions.episode import AgentSpec, Episode, mission_kind
from gn0.missions.episode_files import (
    check_unique,
    episodes_digest_bytes,
    load_episodes,
    save_episodes,
)
from gn0.missions.goal import MINIMUM_LENGTH, check_episode_fits, sample_goal_episodes
from gn0.paper import MAX_STEPS, SUCCESS_RADIUS
from gn0.people.plan import add_people
from gn0.people.settings import PeopleSettings
from gn0.progress import Progress, no_progress
from gn0.remote import local_path
from gn0.scenes.folder import load_scene
from gn0.scenes.scene import Scene
from gn0.sim.presets import find_preset
from gn0.sim.sensors import check_map_mode
from gn0.sim.state import MapMode
from gn0.storage import (
    cache_dir,
    check_contained,
    check_replaceable,
    content_hash,
    folder_atomic,
    plain_path,
    safe_join,
    write_json,
)
from gn0.suites.profiles import (
    PROFILES,
    RELEASE,
    VLNCE,
    Profile,
    profile_settings,
    release_order,
)
from gn0.suites.track import Track, choose_track

SUITE_FILE, EPISODE_FILE, SCENE_FOLDER = "suite.json", "episodes.parquet", "scenes"
SUITE_VERSION = 1  # layout of suite.json

_OLDER_PRIOR = "unknown_is_occupied"  # how suites called map mode prior before there were others


class SuiteScene(Config, frozen=True):
    """A scene of a suite: its id, its folder inside the suite, its content hash."""

    id: str
    folder: str
    hash: str


class SuiteFile(Config, frozen=True):
    """The content of `suite.json`.

    Attributes:
        layout: version of this file's layout.
        name: what people call it.
        version: version of the suite's content.
        scenes: where the episodes take place.
        camera: camera preset by name.
        agent: the body that moves.
        episodes: how many rows `episodes.parquet` has.
        profile: "default"; "paper", where NE means the straight distance; "gn0-release", the
            official harness; "vlnce", where the body is that of the VLN-CE task; or "evt", where
            following is judged by EVT-Bench's numbers.
        map_mode: what the maps shown to a policy hold, see `gn0.sim.state.MapMode`.
        max_steps: actions until an episode is truncated.
        success_radius: walking distance [m] below which STOP is a success.
        track: what a policy may be told; suites of before there were tracks have none.
    """

    layout: int
    name: str
    version: str
    scenes: tuple[SuiteScene, ...]
    camera: str
    agent: AgentSpec
    episodes: Annotated[int, msgspec.Meta(ge=1)]
    profile: Profile = "default"
    map_mode: MapMode | Literal["unknown_is_occupied"] = "prior"
    max_steps: Annotated[int, msgspec.Meta(ge=1, le=1_000_000)] = MAX_STEPS
    success_radius: Annotated[float, msgspec.Meta(gt=0, le=100)] = SUCCESS_RADIUS
    track: Track | msgspec.UnsetType = msgspec.UNSET

    def __post_init__(self) -> None:
        if self.map_mode == _OLDER_PRIOR:
            msgspec.structs.force_setattr(self, "map_mode", "prior")


@dataclass(frozen=True, eq=False)
class Suite:
    """A suite in memory.

    Attributes:
        folder: where it lives.
        about: its `suite.json`.
        episodes: in order of their ids; under gn0-release in that harness's order.
    """

    folder: Path
    about: SuiteFile
    episodes: tuple[Episode, ...]

    @property
    def name(self) -> str:
        """Its name, with the map mode where that is not `prior`: "flat", "flat+explored"."""
        mode = self.map_mode
        return self.about.name if mode == "prior" else f"{self.about.name}+{mode}"

    @property
    def map_mode(self) -> MapMode:
        """What the maps shown to a policy hold."""
        return cast(MapMode, self.about.map_mode)

    @property
    def track(self) -> Track | None:
        """What a policy may be told; None where the suite does not say."""
        return None if self.about.track is msgspec.UNSET else self.about.track

    @cached_property
    def task_hash(self) -> str:
        """The hash without the map mode: equal for runs that differ in nothing but their maps."""
        return self.with_map_mode("prior").hash

    def with_map_mode(self, mode: str) -> Suite:
        """The same scenes and episodes with another map mode: another name, another hash.

        Raises:
            ConfigError: no such mode.
        """
        if mode == self.map_mode:
            return self
        about = msgspec.structs.replace(self.about, map_mode=check_map_mode(mode, ()))
        return Suite(self.folder, about, self.episodes)

    def with_track(self, track: Track | None) -> Suite:
        """The same scenes and episodes in another track: another hash."""
        if track == self.track:
            return self
        about = msgspec.structs.replace(self.about, track=track or msgspec.UNSET)
        return Suite(self.folder, about, self.episodes)

    def with_profile(self, profile: str) -> Suite:
        """The same scenes and episodes under another profile: another hash.

        The official harness decides camera, body, step limit and order of the episodes as well,
        vlnce the body; leaving vlnce gives back the camera's own body.

        Raises:
            ConfigError: no such profile, or vlnce for a suite that is not of VLN-CE.
        """
        if profile == self.about.profile:
            return self
        if profile not in PROFILES:
            raise ConfigError(f"no profile {profile!r}", remedy="known: " + ", ".join(PROFILES))
        settings = profile_settings(profile, self.about.camera)
        if self.about.profile == VLNCE:
            own = find_preset(settings.get("camera", self.about.camera)).agent
            settings = {"agent": own, **settings}
        about = msgspec.structs.replace(self.about, **settings)
        return Suite(self.folder, about, _ordered(self.episodes, profile))

    @cached_property
    def hash(self) -> str:
        """Digest of settings, scene hashes and episodes: equal hash, comparable numbers."""
        return content_hash(
            msgspec.json.encode(self.about, order="deterministic"),
            episodes_digest_bytes(self.episodes),
        )

    def scene_folder(self, scene_id: str) -> Path:
        """Folder of a scene.

        Raises:
            BenchError: the suite has no such scene.
            StorageError: the path climbs out of the suite.
        """
        for scene in self.about.scenes:
            if scene.id == scene_id:
                return safe_join(self.folder, scene.folder)
        raise BenchError(
            f"no scene {scene_id!r} in the suite", where=self.folder, remedy="rebuild the suite"
        )

    def scene_hash(self, scene_id: str) -> str:
        """Recorded content hash of a scene."""
        return next(s.hash for s in self.about.scenes if s.id == scene_id)


def load_suite_scene(folder: Path, scene_id: str, expected_hash: str) -> Scene:
    """A scene of a suite, checked to be the very one that the episodes were made for.

    Raises:
        BenchError: it is another scene, or it changed.
        StorageError, FormatError, SceneError: it cannot be read.
    """
    scene = load_scene(folder)
    if scene.id != scene_id or scene.content_hash != expected_hash:
        raise BenchError(
            f"scene {scene.id!r} is not the {scene_id!r} that this suite was built for",
            where=folder,
            remedy="restore the scene, or build the suite again",
        )
    return scene


def _no_suite(folder: Path) -> StorageError:
    """What lies there instead, and how a suite is made of it."""
    if (folder / "scene.json").is_file() or (folder / "corpus.json").is_file():
        remedy = f"these are scenes: gn0 missions generate {folder} --out SUITE makes a suite"
    elif (folder / "dataset.json").is_file():
        remedy = (
            "this is a dataset: give the suite that it was made of; gn0 train sft and "
            "gn0 train dagger learn from datasets with --source dataset"
        )
    elif folder.is_file():
        remedy = "a file: give the folder that gn0 missions generate, or gn0 bench suite, wrote"
    elif folder.is_dir():
        remedy = "give the folder that gn0 missions generate, or gn0 bench suite, wrote"
    else:
        remedy = "check that the path exists"
    return StorageError(f"no suite there: no {SUITE_FILE}", where=folder, remedy=remedy)


def load_suite(path: Path | str) -> Suite:
    """Read a suite folder, or the URL of one, and check that its parts belong together.

    Raises:
        StorageError: a file is missing, or a path climbs out of the suite.
        FormatError: a file is damaged; names the field, or the row and column.
        BenchError: episodes of a scene or agent that the suite does not have.
        EpisodeError: an episode that makes no sense, or a repeated id.
        ConfigError: an unknown camera.
    """
    folder = local_path(path)
    check_contained(folder)
    about_path = safe_join(folder, SUITE_FILE)
    if not about_path.exists():
        raise _no_suite(folder)
    about = load_json(about_path, SuiteFile)
    if about.layout != SUITE_VERSION:
        raise BenchError(
            f"layout {about.layout}, this version reads {SUITE_VERSION}",
            where=about_path,
            remedy="build the suite again",
        )
    try:
        find_preset(about.camera)
    except ConfigError as error:
        raise ConfigError(
            error.what, where=f"{about_path}, field 'camera'", remedy=error.remedy
        ) from None
    ids = [scene.id for scene in about.scenes]
    if len(set(ids)) != len(ids) or not ids:
        raise BenchError("scenes are missing or named twice", where=about_path, remedy="rebuild it")
    for scene in about.scenes:
        try:
            inside = safe_join(folder, scene.folder)
        except StorageError as error:
            where = f"{about_path}, folder of scene {scene.id!r}"
            raise StorageError(error.what, where=where, remedy=error.remedy) from None
        if not (inside / "scene.json").is_file():
            raise StorageError(
                f"scene {scene.id!r} is missing",
                where=folder / scene.folder,
                remedy="copy the scene folder there, or build the suite again",
            )
    episodes = load_episodes(safe_join(folder, EPISODE_FILE))
    if len(episodes) != about.episodes:
        raise BenchError(
            f"{len(episodes)} rows, suite.json says {about.episodes}",
            where=folder / EPISODE_FILE,
            remedy="build the suite again",
        )
    for row, episode in enumerate(episodes, 1):
        where = f"{folder / EPISODE_FILE}, row {row}, episode {episode.id!r}"
        if episode.scene_id not in ids:
            raise BenchError(
                f"belongs to scene {episode.scene_id!r}, which the suite does not have",
                where=where,
                remedy="remove the row, or add the scene",
            )
        if episode.agent != about.agent:
            raise BenchError(
                "was planned for another agent than the suite's", where=where, remedy="rebuild it"
            )
    return Suite(folder, about, _ordered(episodes, about.profile))


def _ordered(episodes: Sequence[Episode], profile: str) -> tuple[Episode, ...]:
    if profile == RELEASE:
        return tuple(sorted(episodes, key=lambda e: release_order(e.seed, e.id)))
    return tuple(sorted(episodes, key=lambda e: e.id))


def save_suite(
    out: Path | str,
    scenes: Sequence[Scene],
    episodes: Sequence[Episode],
    *,
    name: str,
    version: str = "1",
    camera: str = "gn_bench",
    agent: AgentSpec | None = None,
    profile: Profile = "default",
    max_steps: int = MAX_STEPS,
    map_mode: str = "prior",
    overwrite: bool = False,
    keep_unfit: bool = False,
    track: Track | None = None,
    add: Callable[[Path], None] | None = None,
) -> Suite:
    """Write a suite folder of given scenes and episodes, whole or not at all.

    Every episode is checked against its scene: walkable start and goal, and a way between them;
    but with `keep_unfit` (a run will name those episodes). `add` may write more into the folder.
    Without a `track` it is in the one that its missions ask for.

    Raises:
        EpisodeError: an episode that cannot be done, or a repeated id.
        BenchError: two scenes of one id, or an episode of another agent.
        StorageError: `out` exists, or cannot be written.
    """
    body = agent or find_preset(camera).agent
    by_id = {scene.id: scene for scene in scenes}
    if len(by_id) != len(scenes):
        raise BenchError("two scenes share an id", where=out, remedy="import one under another id")
    check_unique(episodes)
    maps = {scene.id: NavigationMap(scene.grid, body.radius) for scene in scenes}
    for episode in episodes:
        if episode.scene_id not in by_id:
            raise EpisodeError(
                f"belongs to scene {episode.scene_id!r}, which is not given",
                where=f"episode {episode.id!r}",
                remedy="give the folder of that scene too",
            )
        if episode.agent != body:
            raise BenchError(
                "was planned for another agent",
                where=f"episode {episode.id!r}",
                remedy="sample the episodes for the suite's agent",
            )
        if not keep_unfit:
            check_episode_fits(episode, episode.scene_id, maps[episode.scene_id])
    about = SuiteFile(
        layout=SUITE_VERSION,
        name=name,
        version=version,
        scenes=tuple(
            SuiteScene(id=s.id, folder=f"{SCENE_FOLDER}/{s.id}", hash=s.content_hash)
            for s in sorted(scenes, key=lambda s: s.id)
        ),
        camera=camera,
        agent=body,
        profile=profile,
        max_steps=max_steps,
        map_mode=check_map_mode(map_mode, ()),
        episodes=len(episodes),
        track=track or choose_track(mission_kind(e.mission) for e in episodes),
    )
    with folder_atomic(out, overwrite=overwrite, marker=SUITE_FILE) as folder:
        for scene in scenes:
            if scene.path is None:
                raise SceneError(
                    "the scene does not live on disk",
                    where=f"scene {scene.id!r}",
                    remedy="save it with save_scene first",
                )
            copy_folder(scene.path, safe_join(folder, f"{SCENE_FOLDER}/{scene.id}"))
        save_episodes(folder / EPISODE_FILE, episodes, {s.id: s.grid for s in scenes})
        if add is not None:
            add(folder)
        write_json(folder / SUITE_FILE, msgspec.to_builtins(about))
    return load_suite(out)


def build_suite(
    scene_paths: Sequence[Path | str],
    out: Path | str,
    count: int = 50,
    seed: int = 0,
    *,
    minimum_length: float = MINIMUM_LENGTH,
    camera: str = "gn_bench",
    agent: AgentSpec | None = None,
    name: str = "",
    profile: Profile = "default",
    max_steps: int = MAX_STEPS,
    map_mode: str = "prior",
    track: Track | None = None,
    people: PeopleSettings | None = None,
    overwrite: bool = False,
    progress: Progress = no_progress,
) -> Suite:
    """Sample `count` goal episodes in each scene and write the suite.

    Args:
        scene_paths: scene folders.
        out: the suite folder to write.
        count: episodes per scene.
        seed: root seed of the sampler.
        minimum_length: least geodesic length from start to goal [m].
        camera: camera preset by name.
        agent: the body; the preset's when None.
        name: what people call it; by default the scene's id, or the folder's name for several.
        profile: see `SuiteFile`.
        max_steps: actions until an episode is truncated.
        map_mode: see `SuiteFile`.
        track: what a policy may be told; the object alone when None.
        people: who walks, stands and sits in each episode; nobody when None.
        overwrite: replace an existing folder.
        progress: progress sink.

    Raises:
        EpisodeError: a scene has too few tasks of that length.
        StorageError: a scene is missing, or `out` exists or cannot be written.
    """
    body = agent or find_preset(camera).agent
    check_replaceable(out, overwrite=overwrite, marker=SUITE_FILE)
    for given in map(plain_path, scene_paths):  # a scene would be copied into itself
        if Path(out).resolve().is_relative_to(given.resolve()):
            raise StorageError(
                f"lies inside the scene folder {given}", where=out, remedy="choose another --out"
            )
    scenes: list[Scene] = []
    episodes: list[Episode] = []
    for number, path in enumerate(scene_paths):
        scene = load_scene(path)
        scenes.append(scene)
        sampled = sample_goal_episodes(
            scene,
            NavigationMap(scene.grid, body.radius),
            count,
            seed,
            minimum_length=minimum_length,
            agent=body,
            progress=lambda _, done, total, n=number: progress(  # type: ignore[misc]
                "episodes", n * total + done, total * len(scene_paths)
            ),
        )
        episodes += sampled if people is None else add_people(scene, sampled, people)
    return save_suite(
        out,
        scenes,
        episodes,
        name=name or (scenes[0].id if len(scenes) == 1 else Path(out).name),
        camera=camera,
        agent=body,
        profile=profile,
        max_steps=max_steps,
        map_mode=map_mode,
        track=track,
        overwrite=overwrite,
    )


def open_suite(path: Path | str, beside: Path | str | None = None) -> Suite:
    """A suite folder, or a scene folder as the suite of its own fifty goal episodes (seed 0).

    Args:
        path: a suite or a scene folder.
        beside: the results folder; the sampled suite is written to `beside/suite`, or without one
            to the cache folder.

    Raises:
        StorageError: neither a suite nor a scene.
        BenchError: `beside/suite` is of another scene.
    """
    folder = plain_path(path)
    if (folder / SUITE_FILE).is_file():
        return load_suite(folder)
    if not (folder / "scene.json").is_file():
        if any((folder / name).is_file() for name in ("corpus.json", "dataset.json")):
            raise _no_suite(folder)
        raise StorageError(
            "neither a suite (suite.json) nor a scene (scene.json)",
            where=folder,
            remedy="make one with `gn0 scene import`, `gn0 scene generate` or `gn0 bench suite`",
        )
    scene = load_scene(folder)
    if beside is None:  # sampled anew: what lies there may be of older code
        home = cache_dir() / "suites" / content_hash(scene.id, scene.content_hash)
        return build_suite([folder], home, name=scene.id, overwrite=True)
    target = Path(beside) / "suite"
    if not (target / SUITE_FILE).is_file():
        return build_suite([folder], target, name=scene.id)
    suite = load_suite(target)
    if [s.hash for s in suite.about.scenes] != [scene.content_hash]:
        raise BenchError(
            f"holds the episodes of another scene than {folder}",
            where=target,
            remedy="choose another --out, or give --fresh to sample it again",
        )
    return suite


def copy_folder(source: Path, target: Path) -> None:
    """Copy the plain files of a folder, as hard links where the file system allows.

    Files of a scene are replaced, never written in place, so a link is as good as a copy.

    Raises:
        StorageError: a link or special file is in the way.
        OSError: the system refuses.
    """
    target.mkdir(parents=True)
    for entry in sorted(source.iterdir()):
        if entry.is_symlink() or not (entry.is_file() or entry.is_dir()):
            raise StorageError(
                "a link or special file in a scene folder", where=entry, remedy="remove it"
            )
        if entry.is_dir():
            copy_folder(entry, target / entry.name)
            continue
        try:
            os.link(entry, target / entry.name)
        except OSError:
            shutil.copyfile(entry, target / entry.name)
