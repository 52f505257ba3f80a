"""What an environment plays: scenes and episodes, from values, a scene folder or a suite folder."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import msgspec

from gn0.config import decode_json, whole_number
from gn0.errors import ConfigError, EpisodeError, FormatError, StorageError, brief
from gn0.maps.navigation import NavigationMap
from gn0.missions.episode import AgentSpec, Episode
from gn0.missions.episode_files import load_episodes
from gn0.missions.goal import sample_goal_episodes
from gn0.scenes.example import build_example_scene
from gn0.scenes.folder import load_scene
from gn0.scenes.scene import Scene
from gn0.sim.presets import find_preset
from gn0.sim.sensors import check_map_mode
from gn0.sim.state import MapMode
from gn0.storage import plain_path, read_bytes, safe_join

SUITE_LIMIT = 2**26  # bytes of suite.json
EXAMPLE_EPISODES = 12


class _SuiteScene(msgspec.Struct, frozen=True):
    id: str
    folder: str


class _SuiteView(msgspec.Struct, frozen=True):
    """The part of `suite.json` that an environment needs; `gn0.suites.suite` owns the file."""

    scenes: tuple[_SuiteScene, ...]
    camera: str
    agent: AgentSpec
    max_steps: int = 500
    map_mode: str = "prior"


@dataclass(frozen=True, eq=False)
class TaskSet:
    """Episodes, and the scenes they belong to.

    Attributes:
        scenes: scene id → how to get the scene.
        episodes: in a fixed order; never empty.
        preset: camera preset by name.
        agent: the body.
        max_steps: actions until truncation.
        map_mode: what bev and occupancy show, see `gn0.sim.state.MapMode`.
    """

    scenes: dict[str, Callable[[], Scene]]
    episodes: tuple[Episode, ...]
    preset: str
    agent: AgentSpec
    max_steps: int
    map_mode: MapMode = "prior"

    def __post_init__(self) -> None:
        if not self.episodes:
            raise EpisodeError("no episodes to play", remedy="give at least one")
        for episode in self.episodes:
            if episode.scene_id not in self.scenes:
                raise EpisodeError(
                    f"scene {episode.scene_id!r} is not among {sorted(self.scenes)}",
                    where=f"episode {episode.id!r}",
                    remedy="give the episodes of these scenes",
                )


def load_tasks(
    scene: Scene | Path | str | Sequence[Scene | Path | str] | None = None,
    suite: Path | str | None = None,
    episodes: Sequence[Episode] | Path | str | None = None,
    *,
    preset: str | None = None,
    agent: AgentSpec | None = None,
    max_steps: int | None = None,
    count: int | None = None,
    seed: int = 0,
) -> TaskSet:
    """Scenes and episodes to play.

    Args:
        scene: a Scene or the path of a scene folder, or several of them; the built-in flat when
            neither this nor `suite` is given.
        suite: a suite folder, instead of a scene.
        episodes: episodes, or a Parquet file of them; sampled from the scene when absent.
        preset: camera preset; the suite's, else gn_bench.
        agent: the body; the suite's, else the preset's.
        max_steps: actions until truncation; the suite's, else 500.
        count: how many episodes to sample a scene (50, or 12 in the built-in flat).
        seed: seed of the sampling.

    Raises:
        ConfigError: scene and suite both given, an unknown preset, a setting of another type, or
            max_steps below 1.
        StorageError, FormatError: a file is missing or broken.
        EpisodeError: no episode, or one of a scene that is not here.
    """
    if max_steps is not None:
        max_steps = whole_number(max_steps, "max_steps")
    given = load_episodes(episodes) if isinstance(episodes, str | Path) else episodes
    if isinstance(given, Episode) or not isinstance(given, Iterable | None):
        raise ConfigError(
            f"episodes are {brief(given)}", remedy="give a list of Episode, or a Parquet file"
        )
    if suite is not None:
        if scene is not None:
            raise ConfigError("both scene and suite are given", remedy="give one of them")
        folder = plain_path(suite)
        file = folder / "suite.json"
        if folder.is_dir() and not file.exists():
            remedy = "make one with `gn0 bench suite` or `gn0 missions generate`"
            if (folder / "scene.json").exists():
                remedy = "it is a scene: give it as scene="
            raise StorageError("not a suite: it has no suite.json", where=folder, remedy=remedy)
        view = decode_json(read_bytes(file, SUITE_LIMIT), _SuiteView, file=file)
        paths = {entry.id: safe_join(folder, entry.folder) for entry in view.scenes}
        chosen = preset or view.camera
        return TaskSet(
            scenes={name: partial(load_scene, path) for name, path in paths.items()},
            episodes=tuple(given or load_episodes(folder / "episodes.parquet")),
            preset=chosen,
            agent=agent or (find_preset(chosen).agent if preset else view.agent),
            max_steps=max_steps or view.max_steps,
            map_mode=read_map_mode(view.map_mode, file),
        )
    if scene is None:
        places, default_count = [build_example_scene()], EXAMPLE_EPISODES
    else:
        several = [scene] if isinstance(scene, Scene | Path | str) else scene
        if not isinstance(several, Iterable):
            raise ConfigError(f"scene is {brief(scene)}", remedy="give a Scene, a folder or a list")
        places = [open_place(place) for place in several]
        default_count = 50
    chosen = preset or "gn_bench"
    body = agent or find_preset(chosen).agent
    if given is None:
        given = [
            episode
            for place in places
            for episode in sample_goal_episodes(
                place, NavigationMap(place.grid, body.radius), count or default_count, seed,
                agent=body,
            )
        ]  # fmt: skip
    return TaskSet(
        scenes=_by_id(places),
        episodes=tuple(given),
        preset=chosen,
        agent=body,
        max_steps=max_steps or 500,
    )


def read_map_mode(word: str, file: Path) -> MapMode:
    """The map mode that a `suite.json` names; an older word for `prior` is understood.

    Raises:
        FormatError: there is no such mode.
    """
    if word == "unknown_is_occupied":
        return "prior"
    try:
        return check_map_mode(word, ())
    except ConfigError as error:
        raise FormatError(error.what, file=file, field="map_mode", remedy=error.remedy) from None


def _by_id(places: Sequence[Scene]) -> dict[str, Callable[[], Scene]]:
    """How to get each scene: they are here already.

    Raises:
        ConfigError: two of them have the same id.
    """
    scenes: dict[str, Callable[[], Scene]] = {}
    for place in places:
        if place.id in scenes:
            raise ConfigError(
                f"two scenes are called {place.id!r}", remedy="give each an id of its own"
            )
        scenes[place.id] = partial(_itself, place)
    return scenes


def open_place(place: Scene | Path | str) -> Scene:
    """A scene, read where it is the path of a scene folder.

    Raises:
        ConfigError: it is neither.
    """
    if isinstance(place, Scene):
        return place
    if not isinstance(place, Path | str) or not str(place):
        raise ConfigError(f"a scene is {brief(place)}", remedy="give a Scene or its folder")
    return load_scene(Path(place))


def _itself(scene: Scene) -> Scene:
    return scene
