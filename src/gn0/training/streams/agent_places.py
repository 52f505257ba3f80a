"""Where the agents of an environment stand, as JSON, and agents put back there."""

from __future__ import annotations

import zlib
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import DTypeLike

from gn0.errors import ConfigError, FormatError
from gn0.sim.device_env import VectorEnvDevice
from gn0.training.streams.stream_live import pack_array, unpack_array

_FIELDS: tuple[tuple[str, DTypeLike, tuple[int, ...]], ...] = (
    ("episode", np.int32, ()),
    ("pose", np.float64, (3,)),
    ("steps", np.int32, ()),
    ("collided", np.bool_, ()),
    ("begun", np.int32, ()),
)


def note_agents(env: VectorEnvDevice) -> dict[str, Any]:
    """Where all agents stand, and how many episodes each has begun; waits for the device."""
    simulator = env.simulator
    simulator.catch_up()
    outputs = simulator.outputs
    found = {
        "episode": outputs["episode"].numpy(),
        "pose": outputs["pose"].numpy(),
        "steps": simulator.state["steps"].numpy(),
        "collided": outputs["collided"].numpy() != 0,
        "begun": simulator.queue.begun,
    }
    packed = {name: pack_array(found[name], kind) for name, kind, _ in _FIELDS}
    return {"agents": env.num_envs, **packed}


def put_agents(env: VectorEnvDevice, seeds: Sequence[int], noted: Mapping[str, Any]) -> None:
    """Put agents where they stood; episodes to come are those of `seeds`, as they would have come.

    Args:
        env: of as many agents and the same episodes.
        seeds: that `env.reset` was given.
        noted: by `note_agents`.

    Raises:
        ConfigError: of another number of agents.
        FormatError: it is no note.
    """
    count = env.num_envs
    if noted.get("agents") != count:
        raise ConfigError(
            f"places of {noted.get('agents')} agents, here are {count}",
            remedy="resume with the settings of the run",
        )
    try:
        there = {
            name: unpack_array(noted[name], kind, (count, *shape)) for name, kind, shape in _FIELDS
        }
    except (KeyError, TypeError, ValueError, zlib.error) as error:
        raise FormatError(f"not the places of agents: {error}", where="agents") from None
    env.reset(seed=list(seeds))
    env.simulator.catch_up()
    env.simulator.queue.begin_at(list(seeds), there["begun"])
    numbers = env.simulator.numbers
    index = np.zeros(numbers.max() + 1, np.int64)  # equal episodes share a number
    index[numbers] = np.arange(len(numbers))
    env.place(
        index[there["episode"]], there["pose"], steps=there["steps"], collided=there["collided"]
    )
