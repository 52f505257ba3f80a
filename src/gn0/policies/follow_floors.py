"""Floors of following: what who does nothing scores, and who runs straight at the person."""

from __future__ import annotations

import numpy as np

from gn0.policies.simple import PolicyStraight
from gn0.sim.state import Action, Observation


class PolicyAlwaysStop:
    """Says STOP at every step: it stands, where STOP stands still, and stops where it ends."""

    name = "always_stop"
    sensors: frozenset[str] = frozenset()

    def reset(self, instruction: str, rng: np.random.Generator) -> None:
        """Begin an episode."""

    def act(self, observation: Observation) -> Action:
        """STOP."""
        return Action.STOP


class StraightAtPerson:
    """Turns to the person and walks, and never stops before it touches; knows no map.

    A wall in the way is gone round as `PolicyStraight` does.
    """

    def __init__(self) -> None:
        self._walker = PolicyStraight(stop_distance=0.0)

    def act(self, person: tuple[float, float], collided: bool) -> Action:
        """The next action.

        Args:
            person: where the person is in the agent's frame: (forward, left) [m].
            collided: whether the last move was cut short.
        """
        towards = person if person != (0.0, 0.0) else (1.0, 0.0)
        return self._walker.act(
            Observation(step=0, time=0.0, instruction="", goal_vector=towards, collided=collided)
        )
