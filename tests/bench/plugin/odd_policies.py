"""Policies that misbehave, registered as a stranger's package would register its own."""

from __future__ import annotations

import ctypes
import os
import resource
import signal
import time
from pathlib import Path

import numpy as np

from gn0.plugins import register
from gn0.sim.state import Action, Observation, Teleport


class PolicyOdd:
    """Walks at random, and does something odd when the instruction contains `when`."""

    sensors: frozenset[str] = frozenset()

    def __init__(self, odd: str = "", when: str = "", marks: str = "", pause: float = 0.0) -> None:
        if odd == "unbuildable":
            raise RuntimeError("weights are missing")
        self.name = "odd"
        self.odd, self.when, self.pause = odd, when, pause
        self.marks = Path(marks) if marks else None
        if odd == "stillborn" and self.first_time():
            os._exit(7)

    def reset(self, instruction: str, rng: np.random.Generator) -> None:
        self.rng, self.acts = rng, 0
        self.now = bool(self.odd) and self.when in instruction

    def act(self, observation: Observation) -> Action | Teleport:
        time.sleep(self.pause)
        if self.now and observation.step == 3:
            self.misbehave()
        if self.now and self.odd == "nan":
            return Teleport(float("nan"), 0.0, 0.0)
        self.acts += 1
        if self.odd == "jump" and self.acts <= 12:  # often into a wall
            return Teleport(*self.rng.uniform((0, 0, -9), (12, 8, 9)))
        return Action(int(self.rng.choice(4, p=(0.02, 0.58, 0.2, 0.2))))

    def first_time(self) -> bool:
        """Whether this is the first misdeed, for those who commit only one."""
        if self.marks is None:
            return True
        if self.marks.exists():
            return False
        self.marks.write_text("here")
        return True

    def misbehave(self) -> None:
        if not self.first_time():
            return
        if self.odd == "raise":
            raise ValueError("the policy lost its mind")
        if self.odd == "die":
            os.kill(os.getpid(), signal.SIGKILL)
        if self.odd == "bereave":  # kill the Ray actor that hosts us; never anybody else
            parent = os.getppid()
            assert b"ray::" in Path(f"/proc/{parent}/cmdline").read_bytes()
            os.kill(parent, signal.SIGKILL)
            time.sleep(3600)
        if self.odd == "grip":  # a long call into C that never lets go of the interpreter
            ctypes.PyDLL(None).sleep(3600)
        if self.odd == "gorge":  # more memory than this process may have
            resource.setrlimit(resource.RLIMIT_AS, (2**30, 2**30))
            self.hoard = [bytearray(2**26) for _ in range(10_000)]
        if self.odd == "exit":
            os._exit(7)
        if self.odd == "hang":
            time.sleep(3600)
        if self.odd == "print":
            os.write(1, b"this is no message\n")
            print("neither is this")


register("policy", "odd", PolicyOdd)
