"""What agents on a device see by, put together: a renderer, what moves in scenes, and people."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

from gn0.device.device import Device
from gn0.errors import ConfigError, EpisodeError
from gn0.missions.episode import Episode
from gn0.render.open import open_renderer
from gn0.render.renderer import Renderer
from gn0.sim.device_eyes import EyesDevice, draws_people
from gn0.sim.device_motion import MotionDevice
from gn0.sim.motion import Motion
from gn0.sim.sensors import SensorConfig
from gn0.sim.tasks import TaskSet

if TYPE_CHECKING:
    from pathlib import Path

    from gn0.avatars.bank import AvatarBank
    from gn0.sim.device_people_eyes import PeopleEyesDevice


def open_eyes(
    config: SensorConfig,
    tasks: TaskSet,
    device: Device,
    count: int,
    renderer: Renderer | str,
    map_shape: tuple[int, int] | None,
    *,
    visible_sets: bool,
    motions: Mapping[str, Motion] | None,
    bank: AvatarBank | Path | str | None,
    people_memory: int | None,
    last: bool,
) -> EyesDevice | None:
    """The eyes of `count` agents; None where no sensor makes pictures.

    Args:
        config: their sensors.
        tasks: what they play.
        device: where they are.
        count: agents.
        renderer: draws, itself or its name.
        map_shape: (H, W) [px] that holds every map picture.
        visible_sets: draw from the splats visible near each place.
        motions: what moves, by scene.
        bank: of named people.
        people_memory: bytes of people in poses; 512 MB when None.
        last: whether last pictures are drawn as well.

    Raises:
        ConfigError: see `EyesDevice`, people beside what is not drawn with them, or no memory for
            them.
    """
    carried = config.carried
    peopled = draws_people(tasks.episodes, carried.sensors)
    if peopled and (motions or last):
        raise ConfigError(
            "motions and last pictures are not drawn beside people on a device",
            remedy="leave out motions and final_pictures, or use VectorEnv",
        )
    if all(s.many is not None for s in carried.sensors):
        return None
    chosen: Renderer | None
    if isinstance(renderer, str):
        needed = carried.needs_renderer(False)
        chosen = open_renderer(renderer, device=device) if needed else None
    else:
        chosen = renderer
    motion = None
    if motions:
        motion = MotionDevice(
            device, motions, sorted(tasks.scenes), count, tasks.agent, tasks.max_steps
        )
    people: PeopleEyesDevice | None = None
    if peopled:
        from gn0.avatars.posed_bank import BUDGET  # bodies are needed here
        from gn0.people.sight import find_sight
        from gn0.sim.device_people_eyes import PeopleEyesDevice

        preset = config.preset
        cameras, pitch = (preset.rgb, preset.depth), math.radians(preset.pitch_degrees)
        people = PeopleEyesDevice(
            *(tasks.scenes, chosen, preset.rgb.fx, bank),
            budget=BUDGET if people_memory is None else people_memory,
            sight=find_sight(cameras, tasks.agent.camera_height, pitch),
        )
    return EyesDevice(
        config, tasks.scenes, tasks.agent, chosen, map_shape, visible_sets, motion, people
    )


def admit_people(
    episodes: Sequence[Episode], config: SensorConfig, eyes: EyesDevice | None
) -> None:
    """Refuse people who cannot be drawn.

    Raises:
        EpisodeError: nobody plays one of them, or eyes were made for episodes without people.
    """
    if eyes is not None and eyes.people is not None:
        for episode in episodes:
            eyes.people.check(episode)
    elif draws_people(episodes, config.carried.sensors):
        raise EpisodeError(
            "has people, and no episode had any when their eyes were made",
            where=f"episode {next(e.id for e in episodes if e.people)!r}",
            remedy="give episodes with people to the environment when you make it",
        )
