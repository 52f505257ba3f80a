"""Arguments of environments, refused where they are given, with what would do instead.

Learners hand over what their own settings say, so much of it is a word, a float or a value of
another library: each is named here, and nothing that is not understood is quietly left out.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np

from gn0.config import as_index
from gn0.errors import ConfigError, SimError, brief
from gn0.missions.episode import AgentSpec
from gn0.render.open import choose_backend
from gn0.sim.noise import Noise
from gn0.sim.simulator import action_code


def check_settings(
    *,
    backend: Any = "auto",
    agent: Any = None,
    noise: Any = None,
    success_distance: Any = 3.0,
    history_tile: Any = None,
) -> None:
    """Refuse settings of an environment that are of another type or out of range.

    Raises:
        ConfigError: one is, by name, or there is no such backend.
    """
    if not isinstance(backend, str):
        raise ConfigError(f"backend is {brief(backend)}", remedy="give its name, as 'cpu'")
    if backend != "auto":  # which would look for a card
        choose_backend(backend)
    for name, value, kind in (("agent", agent, AgentSpec), ("noise", noise, Noise)):
        if value is not None and not isinstance(value, kind):
            raise ConfigError(f"{name} is {brief(value)}", remedy=f"give {kind.__name__}(…)")
    if not _is_real(success_distance) or not 0 < success_distance < math.inf:
        raise ConfigError(
            f"success_distance is {brief(success_distance)}", remedy="give metres above 0"
        )
    if history_tile is not None and (
        not isinstance(history_tile, Sequence | np.ndarray)
        or len(history_tile) != 2
        or any(as_index(side) is None for side in history_tile)
    ):
        raise ConfigError(
            f"history_tile is {brief(history_tile)}", remedy="give (width, height) in pixels"
        )


def check_motions(motions: Any, scene_ids: Iterable[str]) -> dict[str, Any]:
    """What moves in each scene, by its id; nothing when None.

    Raises:
        ConfigError: it is no mapping, or names a scene that is not here, where nothing would move.
    """
    if not isinstance(motions, Mapping | None):
        raise ConfigError(
            f"motions are {brief(motions)}", remedy="give a dict from scene ids to Motion"
        )
    here = set(scene_ids)
    for name in motions or {}:
        if name not in here:
            raise ConfigError(
                f"motions name scene {brief(name)}, which is not here",
                remedy="known: " + ", ".join(sorted(here)),
            )
    return dict(motions or {})


def read_options(options: Any, known: Sequence[str]) -> dict[str, Any]:
    """The options of a reset; none when None.

    Raises:
        ConfigError: they are no mapping, or one has a name that is not known.
    """
    if not isinstance(options, Mapping | None):
        raise ConfigError(f"options are {brief(options)}", remedy="give a dict or None")
    for name in options or {}:
        if name not in known:
            raise ConfigError(
                f"reset takes no option {brief(name)}", remedy="known: " + ", ".join(known)
            )
    return dict(options or {})


def read_seeds(seed: Any, count: int) -> list[int | None] | None:
    """A seed for each of `count` environments: s + i of one integer s; None goes on.

    Raises:
        ConfigError: no integer, or another number of them; negative ones are named.
    """
    if seed is None:
        return None
    first = as_index(seed)
    if first is not None:
        seeds: list[int | None] = [first + i for i in range(count)]
    elif isinstance(seed, list | tuple | range | np.ndarray):
        if len(seed) != count:
            raise ConfigError(
                f"{len(seed)} seeds for {count} environments",
                remedy="give one each, or one integer for all",
            )
        seeds = [None if value is None else as_index(value) for value in seed]
        for i, value in enumerate(seed):
            if value is not None and seeds[i] is None:
                raise ConfigError(
                    f"seed {i} is {brief(value)}", remedy="give integers of at least 0, or None"
                )
    else:
        raise ConfigError(
            f"seed is {brief(seed)}", remedy="give one integer for all, a list of one each, or None"
        )
    return seeds


def episode_index(value: Any) -> int:
    """An index that names an episode, or −1 for what is none, so that it is refused by name."""
    number = as_index(value)
    return -1 if number is None else number


def read_code(action: Any) -> int:
    """The code 0..3 of one discrete action.

    Raises:
        SimError: it is not one; a float is none, nor a text, nor an array of one.
    """
    try:
        return action_code(action)
    except SimError:
        raise SimError(
            f"{brief(action)} is not an action",
            remedy="give an integer: STOP 0, FORWARD 1, LEFT 2 or RIGHT 3",
        ) from None


def _is_real(value: Any) -> bool:
    return isinstance(value, int | float | np.integer | np.floating) and not isinstance(value, bool)
