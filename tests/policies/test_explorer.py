"""The explorer walks on the map it is shown, whichever that is."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from gn0.geometry import Pose2D
from gn0.maps.navigation import NavigationMap
from gn0.policies.explorer import MapOrigin, PolicyExplorer, find_way
from gn0.sim.open import open_simulator
from gn0.sim.rollout import run_episode
from gn0.testing.policy_check import check_policy
from gn0.testing.scenes import build_floor_plan, build_map_scene, build_point_episodes


@pytest.mark.slow
def test_it_keeps_the_contract() -> None:
    check_policy(PolicyExplorer)


@pytest.mark.parametrize("seed", [1, 2])
def test_on_a_prior_map_it_arrives_by_nearly_the_shortest_way(seed: int) -> None:
    scene = build_map_scene(build_floor_plan(seed), f"plan-{seed}")
    simulator = open_simulator(scene, sensors=PolicyExplorer.sensors)
    for episode in build_point_episodes(scene, simulator.navigation, 4, seed, minimum=3.0):
        trajectory = run_episode(simulator, PolicyExplorer(), episode)
        field = simulator.navigation.geodesic(episode.goal)
        poses = np.array(trajectory.poses)[:, :2]
        walked = np.hypot(*np.diff(poses, axis=0).T).sum()
        assert trajectory.stopped and field.distance_at(*poses[-1]) < 0.5
        assert walked < 1.25 * field.distance_at(*poses[0]) + 0.5


@given(st.lists(st.tuples(st.floats(-3, 3), st.floats(-3, 3)), min_size=1, max_size=40),
       st.floats(-9, 9), st.floats(-9, 9))  # fmt: skip
def test_the_origin_of_the_map_is_narrowed_down(points, x0: float, y0: float) -> None:
    origin, scale = MapOrigin(), 0.05
    for x, y in points:
        row, col = int(np.floor((y - y0) / scale)), int(np.floor((x - x0) / scale))
        origin.narrow(Pose2D(x, y, 0.0), row, col, scale)
    assert np.abs(np.array(origin.best) - (x0, y0)).max() <= scale / 2 + 1e-9


def test_a_way_ends_beside_a_goal_that_is_blocked_or_not_at_all() -> None:
    navigation = NavigationMap(build_floor_plan(1), 0.2)
    free = np.argwhere(navigation.regions == 0)
    start = navigation.grid.centre_of(*free[0])
    goal = navigation.grid.centre_of(*free[-1])
    assert find_way(navigation, start, goal, 0.3) is not None
    x, y = navigation.grid.bounds[:2]
    assert find_way(navigation, start, (x - 9.0, y), 0.3) is None
