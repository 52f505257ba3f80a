"""A policy that hangs on purpose: register it by importing this module (`--plugin`)."""

from __future__ import annotations

import time

import numpy as np

from gn0.plugins import register
from gn0.sim.state import Action, Observation


class PolicyHung:
    """Stops at once, but sleeps for ever in episodes whose instruction holds a word.

    Args:
        word: which episodes hang.
    """

    name = "hung"
    sensors: frozenset[str] = frozenset()

    def __init__(self, word: str = "sofa") -> None:
        self.word = word
        self._hangs = False

    def reset(self, instruction: str, rng: np.random.Generator) -> None:
        """Look whether this is such an episode."""
        self._hangs = self.word in instruction

    def act(self, observation: Observation) -> Action:
        """Stop, or hang."""
        if self._hangs:
            time.sleep(3600)
        return Action.STOP


register("policy", PolicyHung.name, PolicyHung)
