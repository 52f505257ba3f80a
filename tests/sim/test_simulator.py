"""Actions, ends, errors and secrets of the simulator."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from gn0.errors import ConfigError, EpisodeError, PolicyError, SceneError, SimError
from gn0.geometry import Pose2D
from gn0.maps.grid import OccupancyGrid
from gn0.maps.navigation import NavigationMap
from gn0.missions.episode import AgentSpec
from gn0.sim.open import open_simulator
from gn0.sim.rollout import run_episode
from gn0.sim.simulator import STEP_SECONDS, Simulator
from gn0.sim.state import Action, Observation, Teleport
from gn0.testing.scenes import build_map_scene, build_point_episodes

FORWARD, LEFT, RIGHT, STOP = Action.FORWARD, Action.LEFT, Action.RIGHT, Action.STOP


def same(a: Observation, b: Observation) -> bool:
    return all(
        np.array_equal(getattr(a, f.name), getattr(b, f.name))
        for f in dataclasses.fields(Observation)
    )


# Motion.


def test_twenty_four_lefts_come_back_to_the_bit(make_simulator, make_episode) -> None:
    simulator = make_simulator()
    simulator.reset(make_episode(start=(1.0, 2.5, 0.1234)))
    before = simulator.pose
    for _ in range(24):
        simulator.step(LEFT)
    assert simulator.pose == before
    for _ in range(240):
        simulator.step(RIGHT)
    assert simulator.pose == before


def test_forward_and_turn_follow_the_kinematics(make_simulator, make_episode) -> None:
    simulator = make_simulator()
    simulator.reset(make_episode(start=(1.0, 2.5, 0.0)))
    result = simulator.step(FORWARD)
    assert simulator.pose == (1.25, 2.5, 0.0)
    assert (result.moved, result.collided, result.terminated) == (0.25, False, False)
    result = simulator.step(LEFT)
    assert simulator.pose.yaw == pytest.approx(math.radians(15))
    assert result.moved == 0
    assert result.info == {"pose": simulator.pose}
    assert result.observation.step == 2
    assert result.observation.time == 2 * STEP_SECONDS


def test_a_wall_truncates_and_never_slides(make_simulator, make_episode) -> None:
    simulator = make_simulator()
    simulator.reset(make_episode(start=(1.0, 2.5, math.pi)))
    results = [simulator.step(FORWARD) for _ in range(6)]
    assert [r.collided for r in results[:2]] == [False, False]
    assert results[-1].collided
    assert results[-1].moved == 0
    assert results[-1].observation.collided
    assert simulator.pose.y == pytest.approx(2.5, abs=0.026)  # centre of its own row of cells
    assert simulator.navigation.is_free(simulator.pose.x, simulator.pose.y)
    assert not simulator.step(LEFT).collided


def test_teleport_goes_along_the_ray(make_simulator, make_episode) -> None:
    simulator = make_simulator()
    simulator.reset(make_episode(start=(1.0, 2.3, 0.0)))
    result = simulator.step(Teleport(6.0, 2.3, 1.0))  # through the door
    assert simulator.pose == (6.0, 2.3, 1.0)
    assert result.moved == 5.0
    result = simulator.step(Teleport(1.0, 0.5, 7.0))  # into the wall
    assert result.collided
    assert simulator.pose.x > 4.0
    assert simulator.pose.yaw == pytest.approx(7.0 - 2 * math.pi)
    simulator.step(LEFT)
    assert simulator.pose.yaw == pytest.approx(7.0 - 2 * math.pi + math.radians(15))


def test_steps_and_turns_are_the_agent_s(room_scene, make_episode) -> None:
    agent = AgentSpec(forward_step=0.1, turn_degrees=30.0)
    simulator = open_simulator(room_scene, agent=agent)
    simulator.reset(make_episode(start=(1.0, 2.5, 0.0)))
    simulator.step(FORWARD)
    simulator.step(RIGHT)
    assert simulator.pose == pytest.approx((1.1, 2.5, -math.radians(30)))


@settings(max_examples=40, deadline=None)
@given(st.integers(0, 2**32), st.floats(0.0, 0.4))
def test_no_walk_on_any_map_enters_a_blocked_cell(seed: int, density: float) -> None:
    rng = np.random.default_rng(seed)
    cells = (rng.random((40, 50)) < density).astype(np.uint8)
    scene = build_map_scene(OccupancyGrid(cells, 0.1, (-3.0, 1.0)), "noise")
    navigation = NavigationMap(scene.grid, 0.1)
    try:
        episode = build_point_episodes(scene, navigation, 1, seed, minimum=0.0)[0]
    except EpisodeError:
        return
    simulator = Simulator(
        scene, navigation=navigation, agent=AgentSpec(radius=0.1), max_steps=10_000
    )
    simulator.reset(episode)
    region = navigation.region_of(*simulator.pose[:2])
    for _ in range(150):
        before = simulator.pose
        draw = rng.random()
        action = (
            Teleport(*rng.uniform(-5, 8, 2), rng.uniform(-9, 9))
            if draw < 0.2
            else Action(int(rng.choice([1, 2, 3], p=[0.6, 0.2, 0.2])))
        )
        result = simulator.step(action)
        pose = simulator.pose
        assert navigation.region_of(pose.x, pose.y) == region
        assert -math.pi <= pose.yaw < math.pi
        assert result.moved == math.hypot(pose.x - before.x, pose.y - before.y)
        if not result.collided and isinstance(action, Teleport):
            assert pose[:2] == action[:2]


@pytest.mark.parametrize("count", [100_000, pytest.param(1_000_000, marks=pytest.mark.slow)])
def test_random_steps_never_enter_an_inflated_cell(plan_scene, count: int) -> None:
    simulator = open_simulator(plan_scene, max_steps=count + 1)
    simulator.reset(build_point_episodes(plan_scene, simulator.navigation, 1)[0])
    rng = np.random.default_rng(5)
    points = np.empty((count, 2))
    for i, code in enumerate(rng.choice([1, 1, 1, 2, 3], size=count).tolist()):
        simulator.step(code)
        points[i] = simulator.pose[:2]
    cells = simulator.navigation.inflated.cells_of(points)
    assert (simulator.navigation.inflated.cells[cells[:, 0], cells[:, 1]] == 0).all()
    assert len(np.unique(cells, axis=0)) > 2000  # it did walk about


# Ends.


def test_stop_terminates_and_is_not_truncation(make_simulator, make_episode) -> None:
    simulator = make_simulator(max_steps=3)
    simulator.reset(make_episode())
    simulator.step(LEFT)
    simulator.step(LEFT)
    result = simulator.step(STOP)  # the last allowed action
    assert (result.terminated, result.truncated) == (True, False)
    with pytest.raises(SimError, match="over"):
        simulator.step(LEFT)


def test_running_out_of_steps_is_not_stop(make_simulator, make_episode) -> None:
    simulator = make_simulator(max_steps=3)
    simulator.reset(make_episode())
    results = [simulator.step(LEFT) for _ in range(3)]
    assert [(r.terminated, r.truncated) for r in results] == [(False, False)] * 2 + [(False, True)]
    with pytest.raises(SimError):
        simulator.step(STOP)


# Refusals.


def test_nothing_works_before_reset(make_simulator) -> None:
    simulator = make_simulator()
    for use in (
        lambda: simulator.step(LEFT),
        lambda: simulator.pose,
        lambda: simulator.episode,
        lambda: simulator.heading,
        simulator.save_state,
        lambda: simulator.observe_at(Pose2D(1, 1, 0)),
    ):
        with pytest.raises(SimError, match=r"reset\(episode\)"):
            use()


@pytest.mark.parametrize("action", [4, -1, 1.0, "FORWARD", None, True, np.float64(1)])
def test_no_action_is_refused_and_changes_nothing(make_simulator, make_episode, action) -> None:
    simulator = make_simulator()
    simulator.reset(make_episode())
    before = simulator.pose
    with pytest.raises(SimError, match="not an action"):
        simulator.step(action)
    assert simulator.pose == before
    assert simulator.steps == 0


@pytest.mark.parametrize("code", [1, np.int64(1), np.uint8(1), Action.FORWARD])
def test_codes_are_actions(make_simulator, make_episode, code) -> None:
    simulator = make_simulator()
    simulator.reset(make_episode())
    assert simulator.step(code).moved == 0.25


@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf])
def test_nan_is_refused(make_simulator, make_episode, bad: float) -> None:
    simulator = make_simulator("goal_vector")
    simulator.reset(make_episode())
    for index in range(3):
        values = [1.0, 2.5, 0.0]
        values[index] = bad
        with pytest.raises(SimError, match="NaN or infinity"):
            simulator.step(Teleport(*values))
        with pytest.raises(SimError, match="NaN or infinity"):
            simulator.observe_at(Pose2D(*values))
        with pytest.raises(EpisodeError, match="NaN"):
            simulator.reset(make_episode(start=tuple(values)))
    assert simulator.steps == 0


def test_an_episode_of_another_scene_is_refused(make_simulator, make_episode) -> None:
    with pytest.raises(EpisodeError, match=r"'elsewhere'.*'example-flat'"):
        make_simulator().reset(make_episode(scene_id="elsewhere"))


def test_blocked_and_unreachable_places_are_refused(make_simulator, make_episode) -> None:
    simulator = make_simulator()
    with pytest.raises(EpisodeError, match=r"start .* is blocked"):
        simulator.reset(make_episode(start=(0.02, 2.5, 0.0)))
    with pytest.raises(EpisodeError, match=r"goal .* is blocked"):
        simulator.reset(make_episode(goal=(6.3, 0.6)))  # the middle of the sofa
    with pytest.raises(EpisodeError, match=r"start .* is blocked"):
        simulator.reset(make_episode(start=(99.0, 2.5, 0.0)))
    cells = np.zeros((20, 60), np.uint8)
    cells[:, 30] = 1
    scene = build_map_scene(OccupancyGrid(cells, 0.1, (0.0, 0.0)), "halves")
    divided = open_simulator(scene, agent=AgentSpec(radius=0.1))
    with pytest.raises(EpisodeError, match="no path"):
        divided.reset(make_episode(scene_id="halves", start=(1, 1, 0), goal=(5, 1)))


def test_a_scene_without_ground_is_refused() -> None:
    scene = build_map_scene(OccupancyGrid(np.ones((9, 9), np.uint8), 0.1, (0, 0)), "solid")
    with pytest.raises(SceneError, match="nothing is walkable"):
        open_simulator(scene)


def test_wrong_settings_are_refused(room_scene) -> None:
    with pytest.raises(ConfigError, match="sonar"):
        open_simulator(room_scene, sensors={"sonar"})
    with pytest.raises(ConfigError, match="camera preset"):
        open_simulator(room_scene, "kinect")
    with pytest.raises(ConfigError, match="renderer"):
        open_simulator(room_scene, backend="opengl", sensors={"rgb"})
    for steps in (0, 2.5, math.nan, math.inf, True, "5", None):
        with pytest.raises(ConfigError, match=r"max_steps is .*whole number of at least 1"):
            open_simulator(room_scene, max_steps=steps)
        with pytest.raises(ConfigError, match="max_steps is"):
            Simulator(room_scene, navigation=NavigationMap(room_scene.grid), max_steps=steps)
    for renderer in ("gpu", 3):
        with pytest.raises(ConfigError, match=r"renderer is .*DrawnScene.*backend='cpu'"):
            open_simulator(room_scene, sensors={"rgb"}, renderer=renderer)
    with pytest.raises(SimError, match=r"inflated by 0.5 m"):
        Simulator(room_scene, navigation=NavigationMap(room_scene.grid, 0.5))


# Secrets and state.


def test_an_observation_tells_nothing_that_was_not_asked_for(make_simulator, make_episode) -> None:
    """Two worlds that differ only in the goal look the same to whoever is not told the goal."""
    sensors = ("rgb", "depth", "occupancy", "history", "ranges")
    simulator = make_simulator(*sensors, "goal_vector")
    episodes = [make_episode(goal=goal) for goal in ((6.0, 2.5), (2.5, 1.0))]
    runs = []
    for episode in episodes:
        seen = [simulator.reset(episode, sensors=frozenset(sensors))]
        seen += [simulator.step(a).observation for a in (FORWARD, LEFT, FORWARD)]
        runs.append(seen)
    fields = {f.name for f in dataclasses.fields(Observation)} - {"rgb", "history"}
    for a, b in zip(*runs, strict=True):  # the fake eye counts its pictures: left out
        assert all(np.array_equal(getattr(a, f), getattr(b, f)) for f in fields)
        assert a.goal_vector is None
        assert a.rgb.shape == b.rgb.shape


def test_the_observation_has_no_privileged_field() -> None:
    assert {f.name for f in dataclasses.fields(Observation)} == {
        *("step", "time", "instruction", "collided", "rgb", "depth", "bev"),
        *("bev_metres_per_pixel", "map_origin", "occupancy", "history", "ranges", "goal_vector"),
        *("goal_picture", "pose", "more"),
    }


def test_nothing_survives_a_reset(room_scene, make_episode) -> None:
    sensors = frozenset({"rgb", "depth", "occupancy", "history", "ranges", "goal_vector"})
    actions = [FORWARD, FORWARD, LEFT, FORWARD, RIGHT]

    def play(simulator: Simulator) -> list[Observation]:
        seen = [simulator.reset(make_episode())]
        return seen + [simulator.step(action).observation for action in actions]

    used = open_simulator(room_scene, "vlnce", sensors=sensors)
    used.reset(make_episode(start=(2.0, 1.0, 1.0), goal=(1.0, 2.5)))
    for _ in range(20):
        used.step(FORWARD)
    fresh = open_simulator(room_scene, "vlnce", sensors=sensors)
    assert all(same(a, b) for a, b in zip(play(used), play(fresh), strict=True))


def test_saved_states_come_back_to_the_bit(room_scene, make_episode) -> None:
    simulator = open_simulator(room_scene, "vlnce", sensors={"rgb", "history", "ranges"})
    simulator.reset(make_episode(start=(1.0, 2.5, 0.3)))
    for action in (FORWARD, LEFT, FORWARD):
        simulator.step(action)
    kept = simulator.save_state()
    first = [simulator.step(a).observation for a in (LEFT, FORWARD, STOP)]
    simulator.restore_state(kept)
    assert simulator.steps == 3
    second = [simulator.step(a).observation for a in (LEFT, FORWARD, STOP)]
    assert all(same(a, b) for a, b in zip(first, second, strict=True))


def test_a_saved_state_knows_whether_it_had_bumped(room_scene, make_episode) -> None:
    simulator = open_simulator(room_scene, sensors={"ranges"})
    simulator.reset(make_episode())
    free = simulator.save_state()
    while not simulator.step(FORWARD).collided:
        pass
    bumped = simulator.save_state()
    for state, collided in ((free, False), (bumped, True), (free, False)):
        simulator.restore_state(state)
        assert simulator.observe_at(simulator.pose).collided is collided


def test_a_state_is_restored_in_its_own_scene_alone(room_scene, plan_scene, make_episode) -> None:
    here = open_simulator(room_scene, sensors={"pose", "ranges"})
    here.reset(make_episode())
    state = here.save_state()
    elsewhere = open_simulator(plan_scene, sensors={"pose", "ranges"})
    with pytest.raises(EpisodeError, match=r"belongs to scene .*not to 'plan'"):
        elsewhere.restore_state(state)
    with pytest.raises(SimError, match=r"ranges.*not carried"):
        open_simulator(room_scene, sensors={"pose"}).restore_state(state)
    before = here.step(FORWARD).info["pose"]
    for wrong in ({}, None, "state"):
        with pytest.raises(SimError, match="is not a saved state"):
            here.restore_state(wrong)
    assert here.pose == before and here.steps == 1


def test_looking_from_elsewhere_moves_nobody(room_scene, make_episode) -> None:
    simulator = open_simulator(room_scene, "vlnce", sensors={"rgb", "history", "goal_vector"})
    simulator.reset(make_episode())
    simulator.step(LEFT)
    before, heading = simulator.pose, simulator.heading
    there = simulator.observe_at(Pose2D(6.0, 2.0, 2.0))
    assert (simulator.pose, simulator.heading, simulator.steps) == (before, heading, 1)
    here = simulator.observe_at(before)
    assert not np.array_equal(here.rgb, there.rgb)
    assert here.goal_vector == simulator.step(STOP).observation.goal_vector


# run_episode.


class PolicyScript:
    """Plays a list of actions."""

    name = "script"
    sensors = frozenset({"goal_vector"})

    def __init__(self, actions) -> None:
        self.actions = list(actions)
        self.seen: list[Observation] = []

    def reset(self, instruction, rng) -> None:
        self.draw = rng.random()
        self.queue = list(self.actions)

    def act(self, observation):
        self.seen.append(observation)
        return self.queue.pop(0)


def test_a_run_is_written_down_whole(make_simulator, make_episode) -> None:
    simulator = make_simulator("goal_vector", "ranges")
    policy = PolicyScript([FORWARD, Teleport(2.0, 2.5, 0.0), LEFT, STOP])
    watched = []
    trajectory = run_episode(
        simulator, policy, make_episode(), watch=lambda o, r: watched.append((o.step, r))
    )
    assert trajectory.actions == (1, -1, 2, 0)
    assert len(trajectory.poses) == 5
    assert trajectory.collided == (False,) * 4
    assert trajectory.stopped
    assert trajectory.costs == (1, 3, 1, 1)  # the teleport is three strides long
    assert [step for step, _ in watched] == [0, 1, 4, 5, 6]
    assert watched[0][1] is None
    assert watched[-1][1].terminated


def test_a_policy_sees_only_what_it_declares(make_simulator, make_episode) -> None:
    simulator = make_simulator("goal_vector", "ranges", "rgb")
    policy = PolicyScript([STOP])
    run_episode(simulator, policy, make_episode())
    assert policy.seen[0].goal_vector is not None
    assert policy.seen[0].ranges is None
    assert policy.seen[0].rgb is None
    policy.sensors = frozenset({"bev"})
    with pytest.raises(PolicyError, match="bev"):
        run_episode(simulator, policy, make_episode())


def test_a_policy_s_chance_is_the_episode_s(make_simulator, make_episode) -> None:
    simulator = make_simulator("goal_vector")
    draws = []
    for episode in (make_episode(), make_episode(id="e1"), make_episode(seed=1), make_episode()):
        policy = PolicyScript([STOP])
        run_episode(simulator, policy, episode)
        draws.append(policy.draw)
    assert draws[0] == draws[3]
    assert len(set(draws)) == 3


def test_a_broken_policy_is_named(make_simulator, make_episode) -> None:
    with pytest.raises(PolicyError, match=r"'script'.*'forward'"):
        run_episode(make_simulator("goal_vector"), PolicyScript(["forward"]), make_episode())


def test_running_out_of_steps_is_written_down(make_simulator, make_episode) -> None:
    simulator = make_simulator("goal_vector", max_steps=4)
    trajectory = run_episode(simulator, PolicyScript([LEFT] * 9), make_episode())
    assert len(trajectory.actions) == 4
    assert not trajectory.stopped
