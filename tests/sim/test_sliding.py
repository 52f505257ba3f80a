"""Bodies that slide along walls, as Habitat's do; nobody slides unless its body says so."""

from __future__ import annotations

import math
import shutil

import numpy as np
import pytest

from gn0.device.host import DeviceHost
from gn0.maps.grid import OccupancyGrid
from gn0.maps.navigation import NavigationMap
from gn0.missions.episode import AgentSpec
from gn0.missions.episode_files import load_episodes, save_episodes
from gn0.sim.device_env import VectorEnvDevice
from gn0.sim.open import open_simulator
from gn0.sim.state import Action
from gn0.sim.vector import VectorEnv
from gn0.testing.scenes import build_map_scene, build_point_episodes

SLIDER = AgentSpec(radius=0.10, camera_height=1.25, sliding=True)
STRIDER = AgentSpec(radius=0.10, camera_height=1.25, forward_step=0.6, sliding=True)


def half_plane(degrees: float) -> tuple[NavigationMap, tuple[float, float], float]:
    """A wall that runs in any direction; a place at it, and the wall's direction [rad]."""
    a = math.radians(degrees)
    y, x = np.mgrid[0:240, 0:240] * 0.05 + 0.025
    behind = (x - 6) * math.sin(a) - (y - 6) * math.cos(a)
    navigation = NavigationMap(OccupancyGrid((behind > 0).astype(np.uint8), 0.05, (0, 0)), 0.10)
    place = (
        6 - 0.3 * math.sin(a) - 2 * math.cos(a),
        6 + 0.3 * math.cos(a) - 2 * math.sin(a),
    )
    return navigation, place, a


@pytest.mark.parametrize("degrees", [0.0, 7.0, 15.0, 30.0, 45.0, 63.0, 90.0, 171.0, 250.0, 315.0])
@pytest.mark.parametrize("into", [15, 45, 60])
def test_a_body_goes_along_walls_of_any_direction(degrees: float, into: int) -> None:
    """Twelve FORWARDs into a wall: what is along it is kept, though it is a stair of cells."""
    navigation, (x, y), wall = half_plane(degrees)
    heading = wall - math.radians(into)
    dx, dy = 0.25 * math.cos(heading), 0.25 * math.sin(heading)
    while not navigation.slide(x, y, x + dx, y + dy)[2]:
        x, y = x + dx, y + dy
    x0, y0 = x, y
    for _ in range(12):
        qx, qy, _ = navigation.slide(x, y, x + dx, y + dy)
        assert navigation.is_free(qx, qy)
        assert math.hypot(qx - x, qy - y) <= 0.25 + 0.05, "never further than it wanted"
        x, y = qx, qy
    along = (x - x0) * math.cos(wall) + (y - y0) * math.sin(wall)
    ideal = 12 * 0.25 * math.cos(math.radians(into))
    assert 0.85 * ideal <= along <= 1.05 * ideal


def test_a_body_that_walks_straight_into_a_wall_or_a_corner_stands() -> None:
    cells = np.zeros((100, 100), np.uint8)
    cells[:, 60:] = 1
    navigation = NavigationMap(OccupancyGrid(cells, 0.05, (0.0, 0.0)), 0.10)
    x, y, _ = navigation.move(1.0, 2.5, 9.0, 2.5)
    assert navigation.slide(x, y, x + 0.25, y)[:2] == pytest.approx((x, y), abs=1e-9)
    cells[60:, :] = 1
    corner = NavigationMap(OccupancyGrid(cells, 0.05, (0.0, 0.0)), 0.10)
    x, y = x0, y0 = 2.875, 2.875
    for _ in range(40):
        x, y, hit = corner.slide(x, y, x + 0.2, y + 0.15)
        assert hit and math.hypot(x - x0, y - y0) < 0.1, "it stays within two cells of the corner"


def test_no_slide_on_any_map_enters_a_blocked_cell_or_another_region() -> None:
    rng = np.random.default_rng(3)
    for density in (0.05, 0.2, 0.4):
        cells = (rng.random((60, 60)) < density).astype(np.uint8)
        navigation = NavigationMap(OccupancyGrid(cells, 0.1, (-2.0, 1.0)), 0.05)
        free = np.argwhere(~navigation.blocked)
        for _ in range(400):
            x, y = navigation.grid.centres_of(free[rng.integers(len(free))][None])[0]
            dx, dy = rng.normal(0, 0.6, 2)
            qx, qy, hit = navigation.slide(x, y, x + dx, y + dy)
            cut = navigation.move(x, y, x + dx, y + dy)
            assert hit == cut[2] and (hit or (qx, qy) == cut[:2])
            assert navigation.region_of(qx, qy) == navigation.region_of(x, y)


def test_simulator_and_vector_env_slide_alike_and_others_stop_as_ever(plan_scene) -> None:
    navigation = NavigationMap(plan_scene.grid, 0.10)
    episodes = build_point_episodes(plan_scene, navigation, 3, agent=SLIDER)
    env = VectorEnv(
        3, plan_scene, episodes=episodes, sensors=("goal_vector",), agent=SLIDER, max_steps=500
    )
    numbers = env.batch.table.add(episodes)
    env.batch.place(np.arange(3), numbers)
    simulators = [open_simulator(plan_scene, agent=SLIDER) for _ in episodes]
    stopper = open_simulator(plan_scene, agent=AgentSpec(radius=0.10, camera_height=1.25))
    stopper.reset(episodes[0])
    for simulator, episode in zip(simulators, episodes, strict=True):
        simulator.reset(episode)
    rng = np.random.default_rng(8)
    slid = 0
    for _ in range(150):
        actions = rng.choice([1, 2, 3], size=3, p=[0.8, 0.1, 0.1])
        env.batch.step(actions)
        for i, simulator in enumerate(simulators):
            result = simulator.step(Action(int(actions[i])))
            assert tuple(env.batch.poses()[i]) == simulator.pose
            assert env.batch.state.collided[i] == result.collided
            slid += result.collided and result.moved > 0.06
        before = stopper.pose
        if stopper.step(Action(int(actions[0]))).collided:
            x, y = before.x + 0.25 * math.cos(before.yaw), before.y + 0.25 * math.sin(before.yaw)
            assert stopper.pose[:2] == navigation.move(before.x, before.y, x, y)[:2]
    assert slid > 10


@pytest.mark.skipif(not shutil.which("g++"), reason="the host emulation needs g++")
def test_bodies_on_a_device_slide_to_the_bit_as_those_on_the_cpu(plan_scene) -> None:
    """In a flat and in a thicket, where every way along a wall is tried, corners included."""
    rng = np.random.default_rng(5)
    cells = (rng.random((90, 70)) < 0.12).astype(np.uint8)
    cells[[0, -1]] = cells[:, [0, -1]] = 1
    thicket = build_map_scene(OccupancyGrid(cells, 0.07, (-2.0, 1.0)), "thicket")
    scenes = [plan_scene, thicket]
    episodes = [
        episode
        for scene in scenes
        for episode in build_point_episodes(
            scene, NavigationMap(scene.grid, STRIDER.radius), 4, agent=STRIDER
        )
    ]
    settings = {
        "episodes": episodes, "sensors": ("goal_vector",), "agent": STRIDER, "max_steps": 40
    }  # fmt: skip
    there = VectorEnvDevice(60, scenes, device=DeviceHost(3), **settings)
    here = VectorEnv(60, scenes, **settings)
    there.reset(seed=4)
    here.reset(seed=4)
    slid = 0
    for _ in range(120):
        before = here.batch.poses()[:, :2].copy()
        actions = rng.choice([1, 2, 3], size=60, p=[0.7, 0.2, 0.1])
        seen, rewards, _, _, infos = there.step(actions)
        want, gains, _, cut, facts = here.step(actions)
        assert infos["pose"].numpy().tobytes() == facts["pose"].tobytes()
        assert rewards.numpy().tobytes() == gains.tobytes()
        assert seen["collided"].numpy().tobytes() == want["collided"].tobytes()
        moved = np.linalg.norm(facts["pose"][:, :2] - before, axis=1)
        slid += int((want["collided"].astype(bool) & ~cut & (moved > 0.08)).sum())
    assert slid > 300


def test_sliding_is_kept_with_an_episode(plan_scene, tmp_path) -> None:
    episodes = build_point_episodes(plan_scene, NavigationMap(plan_scene.grid, 0.1), 2,
                                    agent=SLIDER)  # fmt: skip
    save_episodes(tmp_path / "e.parquet", episodes, {plan_scene.id: plan_scene.grid})
    again = load_episodes(tmp_path / "e.parquet")
    assert again == episodes and again[0].agent.sliding is True
    assert AgentSpec(sliding=False) == AgentSpec(), "there is one way to say no"
