"""A policy of many agents that costs nothing, a plug-in of the runs that are measured."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from gn0.plugins import register
from gn0.sim.state import Action, Observation


class PolicyCrowd:
    """Walks at random with its eyes open, so that all costs but its own are measured."""

    name = "crowd"
    sensors = frozenset({"rgb", "depth"})

    def __init__(self) -> None:
        self._draws: dict[int, np.random.Generator] = {}

    def reset_batch(
        self,
        slots: Sequence[int],
        instructions: Sequence[str],
        rngs: Sequence[np.random.Generator],
    ) -> None:
        """Begin episodes."""
        self._draws.update(zip(slots, rngs, strict=True))

    def act_batch(self, slots: Sequence[int], observations: Sequence[Observation]) -> list[Action]:
        """Mostly forward, never STOP."""
        return [Action(int(self._draws[s].choice(4, p=(0, 0.6, 0.2, 0.2)))) for s in slots]


register("policy", "crowd", PolicyCrowd)
