"""Agents of a rollout on a device go the way that they go on the CPU; on the host emulation."""

from __future__ import annotations

import shutil
import zlib
from dataclasses import replace

import msgspec
import numpy as np
import pytest

from gn0.device.host import DeviceHost
from gn0.errors import EpisodeError, PlanError
from gn0.maps.navigation import NavigationMap
from gn0.missions.episode import AgentSpec, Episode
from gn0.policies.explorer import PolicyExplorer
from gn0.policies.simple import PolicyRandom, PolicyWallFollower
from gn0.render.camera import Camera
from gn0.render.light import LightCondition
from gn0.sim import presets
from gn0.sim.device_env import VectorEnvDevice
from gn0.sim.open import open_simulator
from gn0.sim.policy import PolicyBatchEach
from gn0.sim.rollout import run_episode
from gn0.sim.rollout_batch import RolloutBatch, open_agents, run_episodes, why_on_host
from gn0.sim.state import Action
from gn0.sim.vector import VectorEnv
from gn0.sim.walkers import WalkersHost
from gn0.testing.scenes import (
    build_floor_plan,
    build_map_scene,
    build_point_episodes,
    build_room_scene,
)

pytestmark = pytest.mark.skipif(not shutil.which("g++"), reason="the host emulation needs g++")


class PolicySeeing:
    """Turns every byte that it sees into an action, so that any other byte is another way."""

    name = "seeing"

    def __init__(self, *sensors: str, steps: int = 99) -> None:
        self.sensors, self.steps = frozenset(sensors), steps

    def reset(self, instruction, rng) -> None:
        self.rng, self.sum, self.length = rng, 0, int(rng.integers(3, 3 + self.steps))

    def act(self, seen) -> Action:
        if seen.step >= self.length:
            return Action.STOP
        for name in sorted(self.sensors):
            value = np.ascontiguousarray(
                seen.read(name) if name in seen.more else getattr(seen, name)
            )
            self.sum = zlib.crc32(f"{name} {value.dtype} {value.shape}".encode(), self.sum)
            self.sum = zlib.crc32(value.tobytes(), self.sum)
        self.sum = zlib.crc32(repr(seen.map_origin).encode(), self.sum)
        self.sum += seen.step + seen.collided + int((seen.bev_metres_per_pixel or 0) * 1e6)
        return Action(1 + (self.sum + int(self.rng.integers(3))) % 3)


@pytest.fixture(scope="module")
def plans():
    scenes = [build_map_scene(build_floor_plan(k), f"plan-{k}") for k in range(2)]
    listed = [build_point_episodes(s, NavigationMap(s.grid, 0.2), 6, seed=1) for s in scenes]
    return scenes, [e for group in zip(*listed, strict=True) for e in group]


BLIND = {
    "random": PolicyRandom,
    "wall_follower": PolicyWallFollower,
    "explorer": PolicyExplorer,
    "seeing": lambda: PolicySeeing("occupancy", "goal_vector", "ranges", "pose", steps=20),
}


@pytest.mark.parametrize(
    ("name", "count"),
    [
        ("random", 1), ("random", 20), ("wall_follower", 5), ("seeing", 5), ("seeing", 20),
        pytest.param("explorer", 5, marks=pytest.mark.slow),
    ],
)  # fmt: skip
def test_trajectories_are_those_of_single_episodes(plans, name: str, count: int) -> None:
    """Fewer agents than episodes, and more; two scenes, of maps of two sizes; poses to the bit."""
    scenes, episodes = plans
    build = BLIND[name]
    batch = PolicyBatchEach(build)
    env = VectorEnvDevice(
        count, scenes, episodes=episodes, device=DeviceHost(2), sensors=batch.sensors, max_steps=40
    )
    found = run_episodes(env, batch, episodes)
    for episode, got in zip(episodes, found, strict=True):
        scene = next(s for s in scenes if s.id == episode.scene_id)
        twin = open_simulator(scene, sensors=build().sensors, max_steps=40)
        assert got == run_episode(twin, build(), episode)


@pytest.mark.parametrize("agent", [AgentSpec(sliding=True), AgentSpec(turn_degrees=30.0)])
def test_bodies_go_as_on_the_cpu(plans, agent: AgentSpec) -> None:
    scenes, episodes = plans
    settings = {"episodes": episodes, "sensors": ("ranges",), "agent": agent, "max_steps": 60}
    one, other = (
        run_episodes(env, PolicyBatchEach(PolicyRandom), episodes)
        for env in (
            VectorEnvDevice(4, scenes, device=DeviceHost(1), **settings),
            VectorEnv(4, scenes, **settings),
        )
    )
    assert one == other and any(any(walk.collided) for walk in one)


@pytest.fixture
def tiny(monkeypatch: pytest.MonkeyPatch) -> str:
    small = Camera.from_hfov(32, 24, 90.0)
    preset = presets.CameraPreset(name="tiny", rgb=small, depth=small, agent=AgentSpec())
    monkeypatch.setitem(presets._BY_NAME, "tiny", preset)
    return "tiny"


def rooms() -> tuple[list, list[Episode]]:
    flat = build_room_scene()
    scenes = [flat, replace(flat, id="second flat")]
    dim = LightCondition(name="dusk", exposure=-1.5)
    episodes = [
        e for s in scenes for e in build_point_episodes(s, NavigationMap(s.grid, 0.2), 2, seed=5)
    ]
    return scenes, [msgspec.structs.replace(episodes[0], id="dim", light=dim), *episodes[1:]]


@pytest.mark.slow
def test_what_they_see_is_what_one_agent_sees(tiny, tmp_path, monkeypatch) -> None:
    """All pictures, by the same renderer; more episodes than agents, two lights, two scenes."""
    monkeypatch.setenv("GN0_CACHE", str(tmp_path))
    monkeypatch.setenv("GN0_DEVICE", "host")
    sensors = ("rgb", "depth", "bev", "occupancy", "history", "goal_picture", "goal_vector", "pose")
    scenes, episodes = rooms()
    env = VectorEnvDevice(
        3, scenes, episodes=episodes, sensors=sensors, preset=tiny, max_steps=5, copy=True,
        channels_first=True,
    )  # fmt: skip
    found = run_episodes(env, PolicyBatchEach(lambda: PolicySeeing(*sensors, steps=5)), episodes)
    for episode, got in zip(episodes, found, strict=True):
        scene = next(s for s in scenes if s.id == episode.scene_id)
        twin = open_simulator(
            scene, tiny, "cuda", sensors=sensors, max_steps=5, light=episode.light
        )
        assert got == run_episode(twin, PolicySeeing(*sensors, steps=5), episode)


def test_the_environment_can_be_used_again(plans) -> None:
    scenes, episodes = plans
    settings = {"episodes": episodes, "sensors": ("goal_vector",), "max_steps": 5}
    env = VectorEnvDevice(3, scenes, device=DeviceHost(1), **settings)
    twin = VectorEnv(3, scenes, **settings)
    run_episodes(env, PolicyBatchEach(PolicyRandom), episodes[:4])
    import gymnasium

    with pytest.raises(gymnasium.error.ResetNeeded):
        env.step(np.array([1, 1, 1]))
    env.reset(seed=3)
    twin.reset(seed=3)
    for _ in range(12):  # episodes end after five steps again
        told, infos = env.step(np.array([1, 2, 1]))[-1], twin.step(np.array([1, 2, 1]))[-1]
        np.testing.assert_array_equal(told["pose"].numpy(), infos["pose"])


def test_an_episode_that_cannot_begin_disturbs_nobody(plans) -> None:
    scenes, episodes = plans
    lost = msgspec.structs.replace(episodes[0], id="lost", start=(-90.0, 0.0, 0.0))
    rollouts = []
    for env in (
        VectorEnvDevice(3, scenes, episodes=[lost], device=DeviceHost(1), sensors=()),
        VectorEnv(3, scenes, episodes=[lost], sensors=()),
    ):
        rollout = RolloutBatch(env.claim(), PolicyBatchEach(PolicyRandom))
        rollouts.append(rollout)
        with pytest.raises((EpisodeError, PlanError), match="blocked"):
            rollout.begin([lost])
        assert not rollout.walks
        rollout.begin(episodes[:1])
        rollout.advance(rollout.ask())
        with pytest.raises((EpisodeError, PlanError), match="blocked"):
            rollout.begin([episodes[1], lost])
        rollout.begin(episodes[1:3])
        for _ in range(9):
            rollout.advance(rollout.ask())
    mine, theirs = ({s: w.poses for s, w in rollout.walks.items()} for rollout in rollouts)
    assert mine == theirs


def test_the_field_of_a_walk_is_left_with_the_map(plans) -> None:
    """Who scores a walk asks the same map for the distance, and finds it there."""
    scenes, episodes = plans
    ground = NavigationMap(scenes[0].grid, 0.2)
    env = VectorEnvDevice(2, scenes[0], episodes=episodes[:1], device=DeviceHost(1), sensors=())
    walkers = env.claim({scenes[0].id: ground})
    own = [e for e in episodes if e.scene_id == scenes[0].id]
    walkers.begin(np.arange(2), own[:2])
    assert env.simulator.store.ground.open(scenes[0].id) is ground


@pytest.mark.parametrize(
    ("sensors", "mode", "backend", "word"),
    [
        ({"occupancy"}, "explored", "cuda", "maps for themselves"),
        ({"rgb"}, "prior", "cpu", "backend 'cpu'"),
        ({"rgb"}, "prior", "cuda", ""),
        ({"rgb"}, "prior", "cuda-visible", ""),
        ({"occupancy", "ranges"}, "prior", "auto", ""),
    ],
)
def test_it_says_why_agents_stay_on_the_cpu(sensors, mode, backend, word, monkeypatch) -> None:
    why = why_on_host(frozenset(sensors), mode, backend)
    assert word in why and bool(word) == bool(why)
    if not why:
        return
    monkeypatch.setenv("GN0_DEVICE", "none")  # is not asked
    flat = build_room_scene()
    (episode,) = build_point_episodes(flat, NavigationMap(flat.grid, 0.2), 1)
    walkers = open_agents(
        2,
        lambda light, carried: open_simulator(flat, "vlnce", "cpu", carried, map_mode=mode),
        episode,
        sensors=frozenset(sensors),
        preset="vlnce",
        map_mode=mode,
        backend=backend,
        max_steps=5,
        on_device=True,
    )
    assert isinstance(walkers, WalkersHost)
