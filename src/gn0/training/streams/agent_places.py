"""Where the agents of an environment stand, as JSON, and agents put back there."""

from __future__ import annotations

import base64
import zlib
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import DTypeLike, NDArray

from gn0.errors import ConfigError, FormatError
from gn0.sim.device_env import VectorEnvDevice

Places = Mapping[str, NDArray[Any]]
_FIELDS: tuple[tuple[str, DTypeLike, tuple[int, ...]], ...] = (
    ("episode", np.int32, ()),
    ("pose", np.float64, (3,)),
    ("steps", np.int32, ()),
    ("collided", np.bool_, ()),
    ("begun", np.int32, ()),
)


def read_places(env: VectorEnvDevice) -> dict[str, NDArray[Any]]:
    """Where all agents stand, and how many episodes each has begun; waits for the device."""
    simulator = env.simulator
    simulator.catch_up()
    outputs = simulator.outputs
    return {
        "episode": outputs["episode"].numpy(),
        "pose": outputs["pose"].numpy(),
        "steps": simulator.state["steps"].numpy(),
        "collided": outputs["collided"].numpy() != 0,
        "begun": simulator.queue.begun.copy(),
    }


def place_agents(env: VectorEnvDevice, seeds: Sequence[int], places: Places) -> None:
    """Put agents of an environment that was reset with `seeds` where they stood."""
    env.simulator.catch_up()
    env.simulator.queue.begin_at(list(seeds), places["begun"])
    numbers = env.simulator.numbers
    index = np.zeros(numbers.max() + 1, np.int64)  # equal episodes share a number
    index[numbers] = np.arange(len(numbers))
    env.place(
        index[places["episode"]],
        places["pose"],
        steps=places["steps"],
        collided=places["collided"],
    )


def pack_places(places: Places) -> dict[str, str]:
    """Places as text, by name."""
    return {name: pack_array(places[name], kind) for name, kind, _ in _FIELDS}


def unpack_places(packed: Mapping[str, str], agents: int) -> Places:
    """Places of `pack_places`.

    Raises:
        KeyError, TypeError, ValueError, zlib.error: they are none, or of other agents.
    """
    return {
        name: unpack_array(packed[name], kind, (agents, *shape)) for name, kind, shape in _FIELDS
    }


def note_agents(env: VectorEnvDevice) -> dict[str, Any]:
    """`read_places` as JSON."""
    return {"agents": env.num_envs, **pack_places(read_places(env))}


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
        there = unpack_places(noted, count)
    except (KeyError, TypeError, ValueError, zlib.error) as error:
        raise FormatError(f"not the places of agents: {error}", where="agents") from None
    env.reset(seed=list(seeds))
    place_agents(env, seeds, there)


def pack_array(array: NDArray[Any], kind: DTypeLike) -> str:
    """The bytes of an array as text."""
    raw = np.ascontiguousarray(array, kind).tobytes()
    return base64.b64encode(zlib.compress(raw)).decode()


def unpack_array(text: str, kind: DTypeLike, shape: tuple[int, ...] | None) -> NDArray[Any]:
    """An array of `pack_array`; flat without a shape.

    Raises:
        ValueError, zlib.error: it is none, or of another shape.
    """
    found = np.frombuffer(zlib.decompress(base64.b64decode(text)), kind)
    return found if shape is None else found.reshape(shape)
