"""Agents through the real driver's calls are those of VectorEnv, and a step is two launches."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from gn0.device.driver import DeviceCuda
from gn0.errors import DeviceError, SimError
from gn0.maps.navigation import NavigationMap
from gn0.missions.episode import Episode
from gn0.render.camera import Camera
from gn0.scenes.scene import Scene
from gn0.sim import presets
from gn0.sim.device_env import VectorEnvDevice
from gn0.sim.device_rollout import RolloutCollector
from gn0.sim.presets import CameraPreset
from gn0.sim.vector import VectorEnv
from gn0.testing.scenes import (
    build_floor_plan,
    build_map_scene,
    build_point_episodes,
    build_room_scene,
)

WAITING = (
    b"cuStreamSynchronize", b"cuCtxSynchronize", b"cuEventSynchronize", b"cuMemcpyDtoH_v2",
    b"cuMemcpyHtoD_v2",
)  # fmt: skip


@pytest.fixture(scope="module")
def plans() -> tuple[list[Scene], list[Episode]]:
    grids = [build_floor_plan(i, width=6.0 + i, depth=5.0) for i in range(2)]
    scenes = [build_map_scene(grid, f"plan-{i}") for i, grid in enumerate(grids)]
    return scenes, [
        episode
        for scene in scenes
        for episode in build_point_episodes(scene, NavigationMap(scene.grid, 0.2), 5)
    ]


@pytest.mark.parametrize("memory", [2**24, 300_000])
def test_all_floats_are_those_of_the_cpu(device: DeviceCuda, plans: Any, memory: int) -> None:
    scenes, episodes = plans
    settings = {"episodes": episodes, "sensors": ("goal_vector", "ranges"), "max_steps": 12}
    there = VectorEnvDevice(4, scenes, device=device, memory=memory, ahead=3, **settings)
    here = VectorEnv(4, scenes, **settings)
    there.reset(seed=2)
    here.reset(seed=2)
    rng = np.random.default_rng(0)
    for t in range(120):
        actions = rng.choice(4, 4, p=[0.1, 0.5, 0.2, 0.2])
        seen, rewards, *_, infos = there.step(device.upload(actions) if t % 2 else actions)
        want, gains, *_, facts = here.step(actions)
        assert rewards.numpy().tobytes() == gains.tobytes()
        assert infos["pose"].numpy().tobytes() == facts["pose"].tobytes()
        for name in ("goal_vector", "ranges"):
            assert seen[name].numpy().tobytes() == want[name].tobytes()
    assert (there.simulator.store.dropped > 0) == (memory < 2**20)


def test_a_step_waits_for_nothing(device: DeviceCuda, fake: Any, plans: Any) -> None:
    """Every few steps one copy begins that nobody waits for; else two launches, nothing more."""
    scenes, episodes = plans
    env = VectorEnvDevice(64, scenes, episodes=episodes, device=device, max_steps=500)
    env.reset(seed=0)
    actions = device.upload(np.full(64, 2))
    for _ in range(20):
        env.step(actions)
    before = {name: fake.fake_calls(name) for name in (*WAITING, b"cuLaunchKernel")}
    for _ in range(100):
        env.step(actions)
    counts = {name: fake.fake_calls(name) - n for name, n in before.items()}
    assert counts.pop(b"cuLaunchKernel") == 200
    assert counts.pop(b"cuEventSynchronize") <= 26, "asked only when the event has passed"
    assert not any(counts.values()), counts


def test_rollouts_and_bad_actions(device: DeviceCuda, plans: Any) -> None:
    scenes, episodes = plans
    env = VectorEnvDevice(8, scenes, episodes=episodes, device=device, max_steps=9)
    env.reset(seed=0)
    rollouts = RolloutCollector(env, 20, ("goal_vector",))
    actions = device.upload(np.full(8, 1))
    first = rollouts.collect(lambda seen: actions).rewards.numpy()
    assert np.isfinite(first).all()
    env.reset(seed=0)
    again = rollouts.collect(lambda seen: actions)
    assert again.rewards.numpy().tobytes() == first.tobytes()
    env.step(device.upload(np.array([1, 1, 1, 5, 1, 1, 1, 1])))
    with pytest.raises(SimError, match="agent 3"):
        env.synchronize()


def test_a_lost_card_is_an_error(device: DeviceCuda, fake: Any, plans: Any) -> None:
    scenes, episodes = plans
    env = VectorEnvDevice(8, scenes, episodes=episodes, device=device)
    env.reset(seed=0)
    fake.fake_fail(b"cuLaunchKernel", 719, 1)
    with pytest.raises(DeviceError):
        for _ in range(4):
            env.step(np.ones(8, np.int64))


def test_a_step_with_pictures_waits_once(
    device: DeviceCuda, fake: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    """For two words of the lists, copied before the blending begins; of three looks, too."""
    camera = Camera.from_hfov(20, 16, 90)
    monkeypatch.setitem(presets._BY_NAME, "tiny", CameraPreset("tiny", camera, camera))
    flats = [replace(build_room_scene(), id=f"flat {k}") for k in range(3)]
    episodes = [
        episode
        for flat in flats
        for episode in build_point_episodes(flat, NavigationMap(flat.grid, 0.2), 3)
    ]
    env = VectorEnvDevice(
        4, flats, episodes=episodes, device=device, sensors=("rgb", "depth"), preset="tiny",
        max_steps=5, ahead=4,
    )  # fmt: skip
    env.reset(seed=0)
    actions = device.upload(np.full(4, 1))
    for _ in range(3):
        env.step(actions)
    before = {name: fake.fake_calls(name) for name in (*WAITING, b"cuMemcpyDtoHAsync_v2")}
    for _ in range(8):
        env.step(actions)
    counts = {name: fake.fake_calls(name) - n for name, n in before.items()}
    assert counts.pop(b"cuEventSynchronize") <= 8 + 4, "every few steps for the queues"
    assert counts.pop(b"cuMemcpyDtoHAsync_v2") <= 8 + 4
    assert not any(counts.values()), counts
