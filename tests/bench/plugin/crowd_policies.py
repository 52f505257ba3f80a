"""A policy that takes many agents at once, and counts how often it is asked."""

from __future__ import annotations

import os
from pathlib import Path

from gn0.plugins import register
from gn0.sim.state import Action


class PolicyCrowd:
    """Turns where the picture is dark, walks where it is not; agents know nothing of each other."""

    name = "crowd"
    sensors = frozenset({"rgb"})

    def __init__(self, counts: str = "") -> None:
        self.counts = counts
        self.left: dict[int, int] = {}

    def reset_batch(self, slots, instructions, rngs):  # type: ignore[no-untyped-def]
        self.left.update(
            {slot: int(rng.integers(3, 30)) for slot, rng in zip(slots, rngs, strict=True)}
        )

    def act_batch(self, slots, observations):  # type: ignore[no-untyped-def]
        if self.counts:
            with (Path(self.counts) / f"asked-{os.getpid()}").open("a") as file:
                file.write(f"{len(slots)}\n")
        answers = []
        for slot, seen in zip(slots, observations, strict=True):
            self.left[slot] -= 1
            bright = seen.rgb.mean() > 90 + seen.step % 40
            answers.append(
                Action.STOP if self.left[slot] < 0 else Action.FORWARD if bright else Action.LEFT
            )
        return answers


register("policy", "crowd", PolicyCrowd)
