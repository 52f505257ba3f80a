"""Which agents on a device somebody means, and which episodes they are asked to play."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
from gymnasium.error import ResetNeeded
from numpy.typing import NDArray

from gn0.errors import ConfigError, EpisodeError, brief
from gn0.missions.episode import Episode
from gn0.sim.env_arguments import episode_index


def choose_episodes(
    wanted: Any,
    count: int,
    own: NDArray[np.integer],
    known: Callable[[], Mapping[str, int]],
    add: Callable[[Episode], int],
) -> NDArray[np.int64]:
    """The simulator's numbers [count] of episodes.

    Args:
        wanted: an id, an index or an Episode, or a list of as many as there are agents, or of one.
        count: agents.
        own: the simulator's number of each episode of the environment.
        known: gives the index of each id.
        add: gives the number of an Episode, after it was brought to the device if need be.

    Raises:
        EpisodeError: no such episode, or another number of them.
    """
    many = wanted if isinstance(wanted, list | tuple | np.ndarray) else [wanted]
    if len(many) not in (1, count):
        raise EpisodeError(
            f"{len(many)} episodes for {count} environments",
            remedy="give one each, or one for all",
        )
    if isinstance(wanted, np.ndarray) and wanted.dtype.kind in "iu" and wanted.ndim == 1:
        wrong = np.flatnonzero((wanted < 0) | (wanted >= len(own)))[:1]
        if not len(wrong):
            return np.resize(own[wanted].astype(np.int64), count)
        many = wanted[wrong]
    ids = known() if any(isinstance(value, str) for value in many) else {}
    numbers = []
    for value in many:
        if isinstance(value, Episode):
            numbers.append(add(value))
            continue
        index = ids.get(value, -1) if isinstance(value, str) else episode_index(value)
        if not 0 <= index < len(own):
            raise EpisodeError(
                f"no episode {brief(value)}",
                remedy=f"give an id, an Episode or 0..{len(own) - 1}",
            )
        numbers.append(int(own[index]))
    return np.resize(np.array(numbers, np.int64), count)


def choose_masked(mask: Any, count: int, *, begun: bool) -> NDArray[np.int64]:
    """Numbers [K] of the agents that a reset is for; all of `count` without a mask.

    Raises:
        ConfigError: the mask is not `count` booleans, or all of them are False.
        ResetNeeded: not all were reset before (`begun`), and now only some should be.
    """
    if mask is None:
        return np.arange(count)
    mask = np.asarray(mask)
    if mask.shape != (count,) or mask.dtype != np.bool_ or not mask.any():
        raise ConfigError(
            f"reset_mask is {mask.dtype} {mask.shape}",
            remedy=f"give {count} booleans, at least one of them True",
        )
    if not begun and not mask.all():
        raise ResetNeeded("reset all environments before some of them")
    return np.flatnonzero(mask)
