"""A policy whose walk hangs on what it is told and shown, and which says so in its notes."""

from __future__ import annotations

import zlib
from typing import Any

from gn0.plugins import register
from gn0.sim.ego_map import MapView


class PolicyListening:
    """Turns as often as its text says, and stops."""

    name = "listening"
    card_rows = ()

    def __init__(self, painted: bool = False) -> None:
        self.sensors = frozenset({"ego_map" if painted else "occupancy"})
        self.map_view = MapView(paint="categories")

    def reset(self, instruction: str, rng: Any) -> None:
        self.text, self.light = instruction, 0
        self.left = 1 + zlib.crc32(instruction.encode()) % 7

    def act(self, observation: Any) -> int:
        self.light = max(self.light, int(observation.read(*self.sensors).max()))
        self.left -= 1
        return 2 if self.left else 0

    def notes(self) -> dict[str, int]:
        return {f"told {self.text}": 1, "light": self.light}


register("policy", "listening", PolicyListening)
