"""Agents of a rollout on the device: who walks beside whom changes nothing that they see or do."""

from __future__ import annotations

import zlib

import numpy as np
import pytest

from gn0.maps.navigation import NavigationMap
from gn0.missions.episode import AgentSpec
from gn0.render.camera import Camera
from gn0.sim import presets
from gn0.sim.device_env import VectorEnvDevice
from gn0.sim.open import open_simulator
from gn0.sim.policy import PolicyBatchEach
from gn0.sim.rollout import run_episode
from gn0.sim.rollout_batch import run_episodes
from gn0.sim.state import Action
from gn0.testing.scenes import build_point_episodes, build_room_scene

SENSORS = ("rgb", "depth", "history", "occupancy", "ranges", "pose")


class PolicyOfBytes:
    """Turns every byte that it sees into an action, so that any other byte is another way."""

    name = "bytes"
    sensors = frozenset(SENSORS)

    def reset(self, instruction, rng) -> None:
        self.sum, self.length = 0, int(rng.integers(2, 9))

    def act(self, seen) -> Action:
        if seen.step >= self.length:
            return Action.STOP
        for name in SENSORS:
            self.sum = zlib.crc32(np.ascontiguousarray(seen.read(name)).tobytes(), self.sum)
        return Action(1 + self.sum % 3)


@pytest.mark.slow
def test_any_company_goes_the_way_of_one(device, scale, monkeypatch) -> None:
    """One agent with the CPU's engine and the device's renderer; groups of several sizes there."""
    monkeypatch.setenv("GN0_DEVICE", "host" if device.kind == "host" else "cuda")
    eye = Camera.from_hfov(scale.pixels, scale.pixels, 90.0)
    preset = presets.CameraPreset(name="here", rgb=eye, depth=eye, agent=AgentSpec())
    monkeypatch.setitem(presets._BY_NAME, "here", preset)
    flat = build_room_scene()
    count, groups = (64, (1, 7, 64)) if device.kind == "cuda" else (4, (3,))
    episodes = build_point_episodes(flat, NavigationMap(flat.grid, 0.2), count, seed=2)
    twin = open_simulator(flat, "here", "cuda", SENSORS, max_steps=6)
    want = [run_episode(twin, PolicyOfBytes(), episode) for episode in episodes]
    for agents in groups:
        env = VectorEnvDevice(
            agents, flat, episodes=episodes, device=device, sensors=SENSORS, preset="here",
            max_steps=6,
        )  # fmt: skip
        assert run_episodes(env, PolicyBatchEach(PolicyOfBytes), episodes) == want
