"""The oracle: always there, never longer than it must be, never wiggling."""

from __future__ import annotations

import math
from itertools import pairwise
from typing import Any

import numpy as np
import pytest

from gn0.errors import PlanError, PolicyError
from gn0.geometry import polyline_length
from gn0.maps.grid import OccupancyGrid
from gn0.maps.navigation import NavigationMap
from gn0.maps.pose_astar import plan_actions
from gn0.missions.episode import AgentSpec, Episode, MissionInstruction
from gn0.policies.oracle import PolicyOracle
from gn0.seeds import random_stream
from gn0.sim.open import open_simulator
from gn0.sim.rollout import run_episode
from gn0.sim.simulator import Simulator
from gn0.sim.state import Action, Observation, Teleport, Trajectory
from gn0.testing.policy_check import check_policy
from gn0.testing.scenes import build_floor_plan, build_map_scene, build_point_episodes


def judge(simulator: Simulator, trajectory: Trajectory) -> tuple[float, float]:
    """(SPL with success at 0.25 m, geodesic distance at the end)."""
    episode = simulator.episode
    field = simulator.navigation.geodesic(episode.goal)
    points = np.array(trajectory.poses)[:, :2]
    shortest = field.distance_at(*episode.start[:2])
    end = field.distance_at(*points[-1])
    success = trajectory.stopped and end <= 0.25
    return success * shortest / max(shortest, polyline_length(points)), end


def wiggles(actions: tuple[int, ...]) -> int:
    return sum(a != b and a > 1 and b > 1 for a, b in pairwise(actions))


@pytest.mark.parametrize("seed", range(5))
def test_it_reaches_every_goal_at_the_geodesic(seed: int) -> None:
    scene = build_map_scene(build_floor_plan(seed), f"plan-{seed}")
    simulator = open_simulator(scene)
    spl = []
    for episode in build_point_episodes(scene, simulator.navigation, 8, seed, minimum=5.0):
        trajectory = run_episode(simulator, PolicyOracle(), episode)
        quality, end = judge(simulator, trajectory)
        assert end <= 0.25
        assert not any(trajectory.collided)
        assert wiggles(trajectory.actions) == 0
        spl.append(quality)
    assert np.mean(spl) >= 0.97
    assert min(spl) >= 0.95


@pytest.mark.parametrize(
    "agent",
    [
        AgentSpec(turn_degrees=30.0),
        AgentSpec(turn_degrees=10.0),
        AgentSpec(radius=0.1, forward_step=0.1, turn_degrees=45.0),
        AgentSpec(turn_degrees=90.0),
    ],
    ids=lambda a: f"{a.forward_step}m{a.turn_degrees}",
)
def test_other_bodies_get_there_too(agent: AgentSpec) -> None:
    scene = build_map_scene(build_floor_plan(1), "plan")
    simulator = open_simulator(scene, agent=agent)
    for episode in build_point_episodes(scene, simulator.navigation, 4, 2, minimum=3.0):
        quality, end = judge(simulator, run_episode(simulator, PolicyOracle(), episode))
        assert end <= 0.25
        assert quality >= (0.9 if agent.turn_degrees <= 30 else 0.6)


def test_near_the_goal_it_just_stops(plan: Simulator) -> None:
    episode = build_point_episodes(plan.scene, plan.navigation, 1, 4)[0]
    start = (episode.goal[0], episode.goal[1], 1.0)
    trajectory = run_episode(plan, PolicyOracle(), replace(episode, start=start))
    assert trajectory.actions == (0,)


def test_a_smaller_stop_distance_is_kept(plan: Simulator) -> None:
    for episode in build_point_episodes(plan.scene, plan.navigation, 3, 6, minimum=4.0):
        _, end = judge(plan, run_episode(plan, PolicyOracle(stop_distance=0.1), episode))
        assert end <= 0.1


def test_it_plans_once_when_nobody_moves_the_agent(
    plan: Simulator, monkeypatch: pytest.MonkeyPatch
) -> None:
    plans: list[Any] = []

    def count(*given: Any, **more: Any) -> Any:
        plans.append(given)
        return plan_actions(*given, **more)

    monkeypatch.setattr("gn0.policies.oracle.plan_actions", count)
    for episode in build_point_episodes(plan.scene, plan.navigation, 3, 8, minimum=5.0):
        plans.clear()
        run_episode(plan, PolicyOracle(), episode)
        assert len(plans) == 1


def test_it_plans_again_when_somebody_moves_the_agent(plan: Simulator) -> None:
    episode = build_point_episodes(plan.scene, plan.navigation, 1, 8, minimum=5.0)[0]
    policy = PolicyOracle()
    observation = plan.reset(episode)
    policy.reset(episode.instruction, random_stream(0))
    policy.reset_privileged(plan)
    for step in range(200):
        action: Action | Teleport = policy.act(observation)
        if step == 5:
            action = Teleport(*episode.start)  # carried back
        result = plan.step(action)
        observation = result.observation
        if result.terminated:
            break
    assert judge(plan, Trajectory((plan.pose,) * 2, (), (), True))[1] <= 0.25


def test_it_bumps_its_way_out_of_a_slit_that_no_whole_step_leads_out_of() -> None:
    """Behind a sofa 45 cm from the wall the agent's centre has one row of cells."""
    cells = np.zeros((80, 80), np.uint8)
    cells[0], cells[-1], cells[:, 0], cells[:, -1] = 1, 1, 1, 1
    cells[20:60, 10:30] = 1
    scene = build_map_scene(OccupancyGrid(cells, 0.05, (0.0, 0.0)), "slit")
    navigation = NavigationMap(scene.grid, 0.2)
    assert navigation.is_free(0.275, 2.0) and not navigation.is_free(0.325, 2.0)
    episode = Episode(
        id="slit",
        scene_id="slit",
        mission=MissionInstruction(goal=(3.0, 2.0), instruction="Come out."),
        start=(0.275, 2.0, 2.0166),
        path=((0.275, 2.0), (3.0, 2.0)),
    )
    simulator = open_simulator(scene, sensors=frozenset())
    trajectory = run_episode(simulator, PolicyOracle(), episode)
    assert trajectory.stopped
    assert navigation.geodesic((3.0, 2.0)).distance_at(*trajectory.poses[-1][:2]) <= 0.25
    assert sum(trajectory.collided) <= 8


def test_without_the_simulator_it_says_so() -> None:
    policy = PolicyOracle()
    policy.reset("Go.", random_stream(0))
    with pytest.raises(PolicyError, match="not handed the simulator"):
        policy.act(Observation(0, 0.0, "Go."))


def test_it_keeps_the_contract() -> None:
    check_policy(PolicyOracle)


def test_no_plan_is_an_error_not_a_loop(plan: Simulator) -> None:
    from gn0.maps.pose_astar import plan_actions

    field = plan.navigation.geodesic(build_point_episodes(plan.scene, plan.navigation, 1)[0].goal)
    with pytest.raises(PlanError, match="no plan of actions"):
        plan_actions(field, (99.0, 99.0), [0.0])
    with pytest.raises(PlanError):  # an agent that cannot turn, facing the wrong way
        far = next(
            e.start[:2] for e in build_point_episodes(plan.scene, plan.navigation, 9, 1, minimum=4)
        )
        plan_actions(field, far, [0.1])


@pytest.fixture
def plan() -> Simulator:
    return open_simulator(build_map_scene(build_floor_plan(7), "seven"))


def replace(episode, **changes):
    import msgspec

    return msgspec.structs.replace(episode, **changes)


def test_it_stops_a_hair_within_the_limit_and_never_on_it(plan: Simulator) -> None:
    """0.2495 m away a metric may round to 0.25: it goes on; 0.2485 m is near enough."""
    episode = build_point_episodes(plan.scene, plan.navigation, 1, 4)[0]
    x, y = episode.goal
    field = plan.navigation.geodesic(episode.goal)
    for yaw in np.linspace(0.0, 6.0, 40):  # a direction in which the goal is in plain sight
        away = (x - math.cos(yaw), y - math.sin(yaw))
        if plan.navigation.is_free(*away) and field.distance_at(*away) < 1.0 + 1e-9:
            break
    for distance, stops in ((0.2495, False), (0.2485, True)):
        start = (x - distance * math.cos(yaw), y - distance * math.sin(yaw), float(yaw))
        trajectory = run_episode(plan, PolicyOracle(0.25), replace(episode, start=start))
        assert (trajectory.actions == (0,)) is stops
