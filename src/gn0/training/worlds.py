"""Agents in the scenes of suites, on a device: where live streams and evaluations take place."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Protocol, TypedDict

from gn0.counted import counted
from gn0.device.device import Device
from gn0.device.libcuda import CPU
from gn0.device.open import open_device
from gn0.errors import ConfigError, DeviceError, Gn0Error, TrainingError
from gn0.missions.episode import Episode
from gn0.policies.bae.policy_settings import MAPS, SQUARE_NAMES, PolicySettings
from gn0.progress import Progress
from gn0.scenes.scene import Scene
from gn0.sim.device_env import VectorEnvDevice
from gn0.sim.ego_map import MapView
from gn0.sim.maps_ahead import draw_maps_ahead
from gn0.storage import content_hash
from gn0.suites.suite import SUITE_FILE, Suite, load_suite_scene
from gn0.suites.suite_kept import load_suite_kept
from gn0.training.pupil import Pupil

PATIENCE = 3600.0  # s that a suite is waited for
_POLL = 0.5  # s


class Eyes(Protocol):
    """What a policy is shown, as its settings say it; see `PolicySettings`."""

    @property
    def shown(self) -> tuple[str, ...]: ...  # noqa: D102
    @property
    def preset(self) -> str: ...  # noqa: D102
    @property
    def history_tile(self) -> tuple[int, int] | None: ...  # noqa: D102
    @property
    def view(self) -> MapView: ...  # noqa: D102


@dataclass(frozen=True, eq=False)
class Lessons:
    """Episodes of suites to learn from, or to be examined in.

    Attributes:
        suites: where they are from; one body, one map mode.
        splits: those that count; all when empty.
        episodes: of these splits, suite by suite.
    """

    suites: tuple[Suite, ...]
    splits: tuple[str, ...]
    episodes: tuple[Episode, ...]

    @property
    def texts(self) -> tuple[str, ...]:
        """Instructions by episode number."""
        return tuple(episode.instruction for episode in self.episodes)

    @property
    def scene_ids(self) -> tuple[str, ...]:
        """Ids of the scenes in which something takes place, sorted."""
        return tuple(sorted({episode.scene_id for episode in self.episodes}))

    def open_scenes(self) -> list[Scene]:
        """The scenes of `scene_ids`, each the very one that its suite was made for.

        Raises:
            BenchError: another scene lies there, or it changed: the hash would name what nobody
                learned from.
            StorageError, FormatError, SceneError: one cannot be read.
        """
        holds = {scene.id: suite for suite in self.suites for scene in suite.about.scenes}
        return [
            load_suite_scene(holds[name].scene_folder(name), name, holds[name].scene_hash(name))
            for name in self.scene_ids
        ]

    def into_areas(self, depth: float) -> Lessons:
        """The same, but that one is in an area only so far behind its entrance [m]; 0: at once."""
        if not depth:
            return self
        return replace(self, episodes=tuple(one.into_area(depth) for one in self.episodes))

    @property
    def hash(self) -> str:
        """Digest of suites and splits."""
        return content_hash(*(suite.hash for suite in self.suites), *self.splits)


def load_lessons(
    suites: Path | str | Sequence[Path | str],
    splits: Sequence[str] = (),
    otherwise: str = "--split all takes every one",
) -> Lessons:
    """The episodes of one suite or several.

    Args:
        suites: their folders.
        splits: those that count; all when empty.
        otherwise: what to do where a suite has no such split.

    Raises:
        ConfigError: no suite has such a split, two have a scene of the same name, or they differ
            in body or map mode.
        BenchError, FormatError, StorageError: one is no suite, or cannot be read.
    """
    paths = [suites] if isinstance(suites, Path | str) else list(suites)
    opened = tuple(load_suite_kept(path) for path in paths)
    known = sorted({episode.split for suite in opened for episode in suite.episodes})
    for name in splits:
        if name not in known:
            raise ConfigError(
                f"no split {name!r}",
                where=opened[0].folder,
                remedy=f"known: {', '.join(known)}; {otherwise}",
            )
    names = [scene.id for suite in opened for scene in suite.about.scenes]
    twice = sorted({name for name in names if names.count(name) > 1})
    if twice:
        raise ConfigError(
            f"scene {twice[0]!r} is in two suites",
            where=opened[-1].folder,
            remedy="name the parts of corpora differently",
        )
    for suite in opened[1:]:
        if (suite.about.agent, suite.map_mode) != (opened[0].about.agent, opened[0].map_mode):
            raise ConfigError(
                f"another body or map mode than in {opened[0].folder}",
                where=suite.folder,
                remedy="train on suites that were made alike",
            )
    episodes = (e for suite in opened for e in suite.episodes if not splits or e.split in splits)
    return Lessons(opened, tuple(splits), tuple(episodes))


def load_held_out(suite: Path | str, splits: Sequence[str]) -> Lessons:
    """The episodes that a policy is examined in.

    Raises:
        ConfigError, BenchError, FormatError, StorageError: see `load_lessons`.
    """
    return load_lessons(suite, splits, "--held-out '' examines in none")


def is_whole(path: Path | str) -> bool:
    """Whether a suite that is being made beside us is there: its folder comes last."""
    return (Path(path) / SUITE_FILE).is_file()


def wait_for_suites(
    paths: Sequence[Path | str], say: Callable[[str], None], patience: float = PATIENCE
) -> None:
    """Wait until suites that are being made beside us are whole.

    Args:
        paths: their folders.
        say: is told once what is waited for.
        patience: s without any of them becoming whole.

    Raises:
        TrainingError: nothing came for so long.
    """
    told, begun = False, time.monotonic()
    missing = [path for path in paths if not is_whole(path)]
    while missing:
        if not told:
            say(f"waiting for {', '.join(map(str, missing))}")
            told = True
        if time.monotonic() - begun > patience:
            raise TrainingError(
                f"no suite after {patience:.0f} s",
                where=missing[0],
                remedy="make it, and give the same command again: it goes on from what was saved",
            )
        time.sleep(_POLL)
        missing = [path for path in missing if not is_whole(path)]


def open_card(device: Device | str = "auto") -> Device:
    """The device on which agents walk and a policy is asked, by name.

    Raises:
        DeviceError: there is no such device; says how to go on without a card.
    """
    if not isinstance(device, str):
        return device
    try:
        return open_device(device)
    except DeviceError as error:
        if device == "host":
            raise
        remedy = error.remedy.removesuffix(CPU).rstrip("; ")
        without = "--device host computes on the CPU: slow, for small models and trials"
        raise DeviceError(
            error.what, where=error.where, remedy=f"{remedy}; {without}" if remedy else without
        ) from error


def open_world(
    lessons: Lessons,
    settings: Eyes,
    count: int,
    *,
    device: Device | str = "auto",
    max_steps: int | None = None,
    memory: int = 2**34,
    say: Callable[[str], None] = lambda _: None,
    **options: Any,
) -> VectorEnvDevice:
    """Agents that are shown what a policy's prompts show, those of all of its inputs.

    Args:
        lessons: the episodes; agents begin at their starts.
        settings: pictures, squares and cameras.
        count: how many agents.
        device: where.
        max_steps: actions until truncation; the suite's when None.
        memory: bytes that maps and distance fields may take on the device.
        say: is told what is opened: of hundreds of scenes that takes a minute.
        options: further ones of `VectorEnvDevice`.

    Raises:
        DeviceError: no such device. DeviceMemoryError: it is too small.
        BenchError: a scene is not the one that its suite was made for.
    """
    maps = (*SQUARE_NAMES, *MAPS)  # whole ones are drawn of the same pictures, by `EgoAtlas`
    sensors = dict.fromkeys("ego_map" if name in maps else name for name in settings.shown)
    suite = lessons.suites[0]
    say(f"opening {counted(len(lessons.scene_ids), 'scene')} for {counted(count, 'agent')}")
    env = VectorEnvDevice(
        count,
        lessons.open_scenes(),
        episodes=lessons.episodes,
        device=device,
        sensors=tuple(sensors) or ("goal_vector",),
        preset=settings.preset,
        agent=suite.about.agent,
        max_steps=max_steps or suite.about.max_steps,
        success_distance=suite.about.success_radius,
        map_mode=suite.map_mode,
        map_view=settings.view,
        history_tile=settings.history_tile,
        memory=memory,
        host_memory=memory,
        **options,
    )
    watch = OpeningLine(say)
    env.watch_opening(watch)
    if env.device.kind == "cuda":
        _draw_maps(env, say, watch)
    return env


class OpeningLine:
    """How far something is that hundreds of scenes take: said every few seconds, and at its end.

    What is over sooner is not spoken of. Threads may tell it, one at a time.

    Args:
        say: is told.
        every: s from line to line.
    """

    def __init__(self, say: Callable[[str], None], every: float = 5.0) -> None:
        self._say, self._every = say, every
        self._stage, self._due, self._spoke = "", 0.0, False

    def __call__(self, stage: str, done: int, total: int) -> None:
        """A `Progress`: `done` of `total` of a stage."""
        now = time.monotonic()
        if stage != self._stage:
            self._stage, self._due, self._spoke = stage, now + self._every, False
        if now >= self._due or (self._spoke and done == total):
            self._say(f"{stage}: {done:,} of {total:,}")
            self._due, self._spoke = now + self._every, done < total


def _draw_maps(env: VectorEnvDevice, say: Callable[[str], None], watch: Progress) -> None:
    """Let several processes draw what the environment would draw one after another."""
    begun = time.monotonic()
    try:
        drawn = draw_maps_ahead(env, progress=watch)
    except Gn0Error as error:  # of help, not needed: what is wrong with a scene is told in its turn
        say(f"map pictures are drawn one after another: {error}")
        return
    if drawn:
        say(f"drew {drawn:,} map pictures in {time.monotonic() - begun:.0f} s")


def list_squares(settings: PolicySettings) -> list[str]:
    """Names of the squares of a policy's ego maps; none if it is shown none."""
    shown = any(name in SQUARE_NAMES for name in settings.shown)
    return list(SQUARE_NAMES[: len(settings.view.squares)]) if shown else []


def list_whole(settings: PolicySettings) -> list[str]:
    """Names of the whole maps that a policy's prompts show."""
    return [name for name in MAPS if name in settings.shown]


class ShownMaps(TypedDict):
    """Which maps samples have: arguments of `StepRing` and `StreamUniform`."""

    names: list[str]
    whole: list[str]
    map_size: tuple[int, int]


def list_maps(settings: PolicySettings) -> ShownMaps:
    """The maps that a policy's prompts show, those of all of its inputs."""
    return ShownMaps(
        names=list_squares(settings), whole=list_whole(settings), map_size=settings.map_size
    )


def leave_out_long(lessons: Lessons, pupil: Pupil, say: Callable[[str], None]) -> Lessons:
    """The lessons without those whose text is too long for the policy's prompt; `say` is told.

    Raises:
        ConfigError: none is short enough.
    """
    longest, words = max(pupil.longest_text, 0), pupil.words
    lengths = [len(words.encode(episode.instruction)) for episode in lessons.episodes]
    kept = tuple(e for e, n in zip(lessons.episodes, lengths, strict=True) if n <= longest)
    if not kept:
        wanted = pupil.settings.text_length + max(lengths, default=0) - pupil.longest_text
        raise ConfigError(
            f"all {counted(len(lengths), 'episode')} say more than {longest} tokens, for which the "
            "policy's prompt has room",
            where=", ".join(suite.name for suite in lessons.suites),
            remedy=f"--text-length {wanted} has room for all of them (a policy that is trained "
            "already learns it by `gn0 train dagger --text-length`)",
        )
    if len(kept) < len(lessons.episodes):
        left = counted(len(lessons.episodes) - len(kept), "episode")
        say(f"left out {left} of more than {longest} tokens")
    return replace(lessons, episodes=kept)


def pick_evenly(count: int, most: int) -> list[int]:
    """At most so many of `count` numbers, evenly; all when `most` is 0."""
    wanted = min(most, count) if most else count
    return [k * count // wanted for k in range(wanted)]
