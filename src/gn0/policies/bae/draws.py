"""Drawn answers: what a policy says where its most probable answer gets it nowhere.

A policy that remembers nothing and always says what is most probable may turn left, and back, for
ever. So after some actions without getting anywhere (`PolicySettings.draw_after`) answers are
drawn, each as probable as the policy holds it, until it moves again. Numbers of an episode come
from its own stream alone: the same whoever walks beside it, whatever computes.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from gn0.errors import ConfigError
from gn0.sim.state import Action

COUNT = 64  # answers of an episode that have numbers of their own; then they come again
NEVER = np.float32(-1)  # in place of a number: the most probable one
MOST = 10_000


def make_draws(rng: np.random.Generator, slots: int) -> NDArray[np.float32]:
    """Numbers [COUNT, slots] in [0, 1) of an episode's drawn answers."""
    return rng.random((COUNT, slots), np.float32)


def count_idle(idle: int, last: int, cut_short: bool) -> int:
    """Actions since an agent got anywhere, with the last one (-1: it has done nothing yet)."""
    if last < 0 or (last == Action.FORWARD and not cut_short):
        return 0
    return idle + 1


def check_draw_after(wanted: int, own: int) -> int:
    """After how many actions without getting anywhere answers are drawn.

    Args:
        wanted: by an option; -1: as the checkpoint says.
        own: of the checkpoint.

    Raises:
        ConfigError: fewer than -1, or more than 10,000.
    """
    if not -1 <= wanted <= MOST:
        raise ConfigError(
            f"answers drawn after {wanted} actions",
            where="draw_after",
            remedy=f"give 1 to {MOST}, 0 for never, or -1 for {own}, as the checkpoint says",
        )
    return own if wanted < 0 else wanted
