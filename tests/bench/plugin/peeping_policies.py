"""Policies that look round where they are, and that answer with all that was shown to them."""

from __future__ import annotations

import dataclasses
import gc
import hashlib
import json
import os
import sys
from pathlib import Path

import numpy as np

from gn0.plugins import register
from gn0.sim.state import Action, Displacement, Observation, Teleport

if "PEEP_LOG" in os.environ:
    with open(os.environ["PEEP_LOG"], "a") as log:
        print(*sys.orig_argv, file=log)


class PolicyPeeping:
    """Writes down what of the harness it can see from inside, and stops."""

    name = "peeping"
    sensors: frozenset[str] = frozenset()

    def __init__(self, marks: str) -> None:
        self.marks = Path(marks)

    def reset(self, instruction: str, rng: np.random.Generator) -> None:
        """Nothing is kept."""

    def act(self, observation: Observation) -> Action:
        names = {type(thing).__name__ for thing in gc.get_objects()}
        seen = {
            "found": sorted(names & {"Simulator", "Episode", "Scene", "NavigationMap"}),
            "here": os.listdir(),
            "told": [*sys.orig_argv, *os.environ.values(), os.getcwd()],
            "variables": sorted(os.environ),
        }
        self.marks.write_text(json.dumps(seen))
        return Action.STOP


class PolicyEcho:
    """What it does hangs on every bit that it is shown, and on its chance."""

    name = "echo"
    sensors: frozenset[str] = frozenset({"rgb", "depth", "pose"})
    card_rows = (("echo", "loud"),)

    def __init__(self, answers: str = "action") -> None:
        self.answers = answers

    def reset(self, instruction: str, rng: np.random.Generator) -> None:
        self.rng, self.steps = rng, 0

    def notes(self) -> dict[str, int]:
        return {"steps": self.steps}

    def identity(self) -> dict[str, str]:
        return {"checkpoint": "c0ffee"}

    def act(self, observation: Observation) -> object:
        self.steps += 1
        digest = hashlib.sha256(self.rng.bytes(8))
        for field in dataclasses.fields(observation):
            value = getattr(observation, field.name)
            digest.update(
                value.tobytes() if isinstance(value, np.ndarray) else repr(value).encode()
            )
        heard = digest.digest()
        if self.answers == "moves":
            x, y, z = (b / 99 for b in heard[:3])
            return Teleport(x, y, z) if heard[3] % 2 else Displacement(x, y, z)
        if self.answers == "nonsense":
            return "onwards"
        return int(heard[0] % 4) if heard[1] % 2 else Action(heard[0] % 4)


register("policy", "peeping", PolicyPeeping)
register("policy", "echo", PolicyEcho)
