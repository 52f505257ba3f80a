"""Agents in the scenes of a suite, on a device: where live streams and evaluations take place."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from gn0.device.device import Device
from gn0.errors import ConfigError
from gn0.missions.episode import Episode
from gn0.policies.bae.policy_settings import SQUARE_NAMES, PolicySettings
from gn0.sim.device_env import VectorEnvDevice
from gn0.suites.suite import Suite, load_suite


@dataclass(frozen=True, eq=False)
class Lessons:
    """Episodes of a suite to learn from, or to be examined in.

    Attributes:
        suite: the suite.
        splits: those that count; all when empty.
        episodes: of these splits, in the suite's order.
    """

    suite: Suite
    splits: tuple[str, ...]
    episodes: tuple[Episode, ...]

    @property
    def texts(self) -> tuple[str, ...]:
        """Instructions by episode number."""
        return tuple(episode.instruction for episode in self.episodes)

    @property
    def scene_ids(self) -> tuple[str, ...]:
        """Scenes in which something takes place, sorted."""
        return tuple(sorted({episode.scene_id for episode in self.episodes}))


def load_lessons(suite: Suite | Path | str, splits: Sequence[str] = ()) -> Lessons:
    """The episodes of a suite's splits.

    Raises:
        ConfigError: it has no such split, or no episodes in it.
        BenchError, FormatError, StorageError: it is no suite, or cannot be read.
    """
    opened = suite if isinstance(suite, Suite) else load_suite(suite)
    known = sorted({episode.split for episode in opened.episodes})
    for name in splits:
        if name not in known:
            raise ConfigError(
                f"no split {name!r}",
                where=opened.folder,
                remedy=f"it has {', '.join(known)}",
            )
    chosen = tuple(e for e in opened.episodes if not splits or e.split in splits)
    return Lessons(opened, tuple(splits), chosen)


def open_world(
    lessons: Lessons,
    settings: PolicySettings,
    count: int,
    *,
    device: Device | str = "auto",
    max_steps: int | None = None,
    memory: int = 2**34,
    **options: Any,
) -> VectorEnvDevice:
    """Agents that are shown what a policy's prompt shows.

    Args:
        lessons: the episodes; agents begin at their starts.
        settings: pictures, squares and cameras.
        count: how many agents.
        device: where.
        max_steps: actions until truncation; the suite's when None.
        memory: bytes that maps and distance fields may take on the device.
        options: further ones of `VectorEnvDevice`.

    Raises:
        DeviceError: no such device. DeviceMemoryError: it is too small.
    """
    sensors = dict.fromkeys(
        "ego_map" if name in SQUARE_NAMES else name for name in settings.pictures
    )
    suite = lessons.suite
    return VectorEnvDevice(
        count,
        [suite.scene_folder(name) for name in lessons.scene_ids],
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


def list_squares(settings: PolicySettings) -> list[str]:
    """Names of the squares of a policy's ego maps; none if it is shown none."""
    shown = any(name in SQUARE_NAMES for name in settings.pictures)
    return list(SQUARE_NAMES[: len(settings.view.squares)]) if shown else []
