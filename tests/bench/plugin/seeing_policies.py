"""Policies that look: what they do hangs on every pixel, so other pictures are other walks."""

from __future__ import annotations

import zlib

import numpy as np

from gn0.missions.episode import AgentSpec
from gn0.plugins import register
from gn0.render.camera import Camera
from gn0.sim import presets
from gn0.sim.state import Action, Observation

STEPS = 4
SMALL = Camera.from_hfov(48, 36, 90.0)
presets._BY_NAME["small"] = presets.CameraPreset(
    name="small", rgb=SMALL, depth=SMALL, agent=AgentSpec()
)


class PolicySeeing:
    """Does what the checksum of the picture says, a few steps long."""

    sensors: frozenset[str] = frozenset({"rgb"})
    name = "seeing"

    def reset(self, instruction: str, rng: np.random.Generator) -> None:
        """Nothing is kept."""

    def act(self, observation: Observation) -> Action:
        if observation.step >= STEPS:
            return Action.STOP
        assert observation.rgb is not None
        return Action(1 + zlib.crc32(observation.rgb.tobytes()) % 3)


class PolicySeeingLate(PolicySeeing):
    """Says only when it is built what it sees."""

    name = "seeing_late"

    @property
    def sensors(self) -> frozenset[str]:  # type: ignore[override]
        return frozenset({"rgb"})


register("policy", "seeing", PolicySeeing)
register("policy", "seeing_late", PolicySeeingLate)
