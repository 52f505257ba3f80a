"""Policies that only a test would write."""

from __future__ import annotations

import numpy as np

from gn0.plugins import register
from gn0.sim.state import Action, Displacement, Observation


class PolicyScript:
    """Says what it is told to, then FORWARD for ever."""

    name = "script"
    sensors: frozenset[str] = frozenset()

    def __init__(self, actions: str = "") -> None:
        self.actions = [int(code) for code in actions]
        self.asked = 0

    def reset(self, instruction: str, rng: np.random.Generator) -> None:
        """Begin again."""
        self.asked = 0

    def act(self, observation: Observation) -> Action | Displacement:
        """The next of the script."""
        self.asked += 1
        left = self.actions[self.asked - 1 :]
        return Action(left[0]) if left else Action.FORWARD


class PolicyGlides(PolicyScript):
    """Answers with a displacement."""

    name = "glides"

    def act(self, observation: Observation) -> Displacement:
        """A fifth of a metre."""
        return Displacement(0.2, 0.0, 0.0)


register("policy", "script", PolicyScript)
register("policy", "glides", PolicyGlides)
