"""The policy protocol. A policy sees observations; an oracle declares that it needs more."""

from __future__ import annotations

from typing import TYPE_CHECKING, Protocol, runtime_checkable

import numpy as np

from gn0.sim.state import Action, Observation, Sensor, Teleport

if TYPE_CHECKING:
    from gn0.sim.simulator import Simulator


@runtime_checkable
class Policy(Protocol):
    """Chooses an action from an observation.

    Attributes:
        name: written to results and to the protocol card.
        sensors: which observation fields it reads; nothing else is rendered.
    """

    name: str
    sensors: frozenset[Sensor]

    def reset(self, instruction: str, rng: np.random.Generator) -> None:
        """Begin an episode; `rng` is the only randomness allowed."""
        ...

    def act(self, observation: Observation) -> Action | Teleport:
        """Choose the next action."""
        ...


@runtime_checkable
class PolicyPrivileged(Policy, Protocol):
    """A policy that is handed the simulator after each reset: an oracle, and named as one."""

    def reset_privileged(self, simulator: Simulator) -> None:
        """Look at what no robot knows: map, pose, goal."""
        ...
