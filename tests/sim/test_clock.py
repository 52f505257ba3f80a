"""Simulated time is the body's: observations, moving parts and moves of any length keep to it."""

from __future__ import annotations

import math
import shutil

import numpy as np
import pytest

from gn0.device.host import DeviceHost
from gn0.errors import SimError
from gn0.geometry import Pose2D
from gn0.maps.navigation import NavigationMap
from gn0.missions.episode import AgentSpec
from gn0.sim.collision import move_agent
from gn0.sim.device_env import VectorEnvDevice
from gn0.sim.device_motion import MotionDevice
from gn0.sim.kinematics import plan_journey
from gn0.sim.open import open_simulator
from gn0.sim.policy import PolicyBatchEach
from gn0.sim.presets import find_preset
from gn0.sim.rollout_batch import run_episodes
from gn0.sim.state import Action, Displacement
from gn0.sim.ticks import cut_journey, cut_move, move_in_ticks
from gn0.sim.vector import VectorEnv
from gn0.testing.scenes import build_floor_plan, build_map_scene, build_point_episodes

FOLLOWER = find_preset("follower").agent


@pytest.fixture(scope="module")
def plan():
    return build_map_scene(build_floor_plan(3), "plan")


@pytest.fixture(scope="module")
def navigation(plan):
    return NavigationMap(plan.grid, FOLLOWER.radius)


@pytest.fixture(scope="module")
def episodes(plan, navigation):
    return build_point_episodes(plan, navigation, 20, agent=FOLLOWER)


def test_the_follower_is_quick_enough_to_follow() -> None:
    assert AgentSpec(radius=0.25, step_seconds=0.2) == FOLLOWER
    assert FOLLOWER.forward_step / FOLLOWER.step_seconds == pytest.approx(1.25)  # m/s
    assert FOLLOWER.turn_degrees / FOLLOWER.step_seconds == pytest.approx(75.0)  # degrees/s
    assert find_preset("follower").rgb == find_preset("gn_bench").rgb


def test_a_follower_walks_a_metre_and_a_quarter_in_a_second(room_scene, make_episode) -> None:
    simulator = open_simulator(room_scene, "follower")
    assert simulator.reset(make_episode(start=(1.0, 2.3, 0.0))).time == 0.0 == simulator.time
    times = [simulator.step(Action.FORWARD).observation.time for _ in range(5)]
    assert times == [0.2, 0.4, 0.6, 0.8, 1.0]  # not 0.6000000000000001
    assert simulator.pose == pytest.approx((2.25, 2.3, 0.0)) and simulator.time == 1.0


@pytest.mark.parametrize("one_step", [False, True])
def test_a_displacement_lasts_as_many_actions_as_it_is_worth(
    room_scene, make_episode, one_step: bool
) -> None:
    """Whatever its steps count as, a metre takes the time of four strides."""
    simulator = open_simulator(room_scene, "follower", one_step_moves=one_step)
    simulator.reset(make_episode(start=(1.0, 2.3, 0.0)))
    result = simulator.step(Displacement(1.0, 0.0, math.radians(30)))
    assert result.steps == (1 if one_step else 6)
    assert result.observation.time == 1.2 and result.observation.step == result.steps
    kept = simulator.save_state()
    assert simulator.step(Action.LEFT).observation.time == 1.4
    simulator.restore_state(kept)
    assert simulator.time == 1.2 and simulator.observe_at(Pose2D(1.0, 2.3, 0.0)).time == 1.2
    cut = simulator.step(Displacement(50.0, 0.0, 0.0))  # the strides to the wall, not the 200
    assert cut.collided
    strides = math.floor(cut.moved / 0.25 + 1e-9) + 1
    assert simulator.time == FOLLOWER.time_after(6 + strides)


class MotionAsked:
    """Nothing moves; it keeps what times it was asked for."""

    def __init__(self) -> None:
        self.clouds: dict = {}
        self.times: list[float] = []

    def at(self, time: float) -> tuple:
        self.times.append(time)
        return ()


def test_what_moves_is_asked_for_the_bodys_times(plan, episodes) -> None:
    motion = MotionAsked()
    simulator = open_simulator(plan, "follower", "cpu", {"history"}, motion=motion)
    simulator.reset(episodes[0])
    simulator.step(Action.LEFT)
    simulator.step(Displacement(0.0, 0.0, math.radians(45)))
    simulator.step(Action.LEFT)
    assert sorted(set(motion.times)) == [0.0, 0.2, 0.8]


@pytest.mark.skipif(not shutil.which("g++"), reason="the host emulation needs g++")
def test_many_followers_keep_the_time_of_one(plan, episodes) -> None:
    class PolicyWatch:
        name, sensors = "watch", frozenset({"pose"})

        def __init__(self) -> None:
            self.times: list[float] = []

        def reset(self, instruction, rng) -> None:
            self.left = 4

        def act(self, seen) -> Action:
            self.times.append(seen.time)
            self.left -= 1
            return Action.STOP if not self.left else Action.LEFT

    one, many = PolicyWatch(), []

    def open_policy() -> PolicyWatch:
        many.append(PolicyWatch())
        return many[-1]

    simulator = open_simulator(plan, "follower", sensors={"pose"})
    one.reset("", None)
    seen = simulator.reset(episodes[0])
    while (action := one.act(seen)) != Action.STOP:
        seen = simulator.step(action).observation
    assert one.times == [0.0, 0.2, 0.4, 0.6]
    settings = {"episodes": episodes, "sensors": ("pose",), "preset": "follower"}
    for env in (
        VectorEnv(2, plan, **settings),
        VectorEnvDevice(2, plan, device=DeviceHost(1), **settings),
    ):
        many.clear()
        run_episodes(env, PolicyBatchEach(open_policy), episodes[:2])
        assert {tuple(policy.times) for policy in many if hasattr(policy, "left")} == {
            tuple(one.times)
        }


@pytest.mark.skipif(not shutil.which("g++"), reason="the host emulation needs g++")
def test_agents_on_a_device_are_shown_the_same_moments(plan, episodes) -> None:
    motion = MotionAsked()
    MotionDevice(DeviceHost(1), {"plan": motion}, ["plan"], 2, FOLLOWER, 4)
    assert motion.times == [0.0, 0.2, 0.4, 0.6, 0.8]


def test_a_move_in_ticks_is_the_uncut_move(navigation, episodes) -> None:
    """Cut by walls or not, sliding or not: the same bits."""
    rng = np.random.default_rng(2)
    cut = 0
    for agent in (FOLLOWER, AgentSpec(radius=0.25, sliding=True)):
        for _ in range(300):
            x, y, _ = episodes[int(rng.integers(20))].start
            yaw, length = rng.uniform(-math.pi, math.pi), rng.uniform(0.05, 2.0)
            x1, y1 = x + length * math.cos(yaw), y + length * math.sin(yaw)
            whole = move_agent(navigation, x, y, x1, y1, agent)
            for ticks in (1, 2, 5, 17):
                places = cut_move(x, y, x1, y1, ticks)
                assert len(places) == ticks and places[-1] == (x1, y1)
                free = move_in_ticks(navigation, x, y, places, agent, lambda *_: False)
                assert free == whole == move_in_ticks(navigation, x, y, places, agent)
            cut += whole.collided
    assert 50 < cut < 550


def test_a_move_stops_at_the_tick_before_it_would_touch(navigation, episodes) -> None:
    x, y, _ = episodes[0].start
    for yaw in np.linspace(0.0, 6.0, 25):
        x1, y1 = x + 0.25 * math.cos(yaw), y + 0.25 * math.sin(yaw)
        places = cut_move(x, y, x1, y1, 5)
        if not move_agent(navigation, x, y, x1, y1).collided:
            break
    asked = []

    def touches(tick: int, x: float, y: float) -> bool:
        asked.append((tick, x, y))
        return tick == 4

    stopped = move_in_ticks(navigation, x, y, places, FOLLOWER, touches)
    assert stopped.collided and (stopped.x, stopped.y) == places[2]
    assert stopped.moved == pytest.approx(0.15)
    assert asked == [(k + 1, *places[k]) for k in range(4)]
    at_once = move_in_ticks(navigation, x, y, places, FOLLOWER, lambda *_: True)
    assert at_once == (x, y, 0.0, True), "who would be touched at once is not walked into"
    with pytest.raises(SimError, match="0 ticks"):
        cut_move(x, y, x1, y1, 0)


def test_no_tick_lies_in_a_wall_and_each_is_as_long_as_the_others(navigation, episodes) -> None:
    rng = np.random.default_rng(4)
    for agent in (FOLLOWER, AgentSpec(radius=0.25, sliding=True)):
        for _ in range(100):
            x, y, _ = episodes[int(rng.integers(20))].start
            yaw = rng.uniform(-math.pi, math.pi)
            places = cut_move(x, y, x + math.cos(yaw), y + math.sin(yaw), 10)
            steps = np.diff(np.array([(x, y), *places]), axis=0)
            assert np.allclose(np.hypot(*steps.T), 0.1)

            def stands(tick: int, x: float, y: float) -> bool:
                assert navigation.region_of(x, y) >= 0
                return False

            move_in_ticks(navigation, x, y, places, agent, stands)


def test_a_displacement_turns_walks_and_turns_in_its_ticks() -> None:
    """6 turns, 4 strides, 6 turns of 0.2 s: it stands for 12 ticks, walks for 8, and stands."""
    journey = plan_journey(Pose2D(0.0, 0.0, 0.0), 0.0, 1.0, 0.0, FOLLOWER)
    places = np.array(cut_journey(journey, 0.0, 0.0, 0.0, 1.0))
    assert len(places) == journey.steps * FOLLOWER.step_ticks == 32
    np.testing.assert_allclose(places[:12], 0.0)
    np.testing.assert_allclose(places[12:20, 1], np.arange(1, 9) * 0.125)
    assert (places[19:] == (0.0, 1.0)).all()
