"""Goal sets and areas from the oracle to the score: there is where the words fit."""

from __future__ import annotations

import msgspec
import numpy as np
import pytest

from gn0.bench.metrics import compute_metrics
from gn0.data.expert_labels import LabelSettings, label_along, label_states, plan_expert
from gn0.errors import EpisodeError
from gn0.maps.goal_places import GoalSet, GoalSetInner
from gn0.maps.navigation import NavigationMap
from gn0.missions.episode import Episode
from gn0.policies.oracle import PolicyOracle
from gn0.scenes.scene import Scene
from gn0.sim.collision import check_places
from gn0.sim.env import GoalNavEnv
from gn0.sim.open import open_simulator
from gn0.sim.rollout import run_episode
from gn0.testing.scenes import (
    build_floor_plan,
    build_map_scene,
    build_point_episodes,
    with_goal_sets,
)


@pytest.fixture(scope="module")
def plan() -> tuple[Scene, NavigationMap, list[Episode]]:
    scene = build_map_scene(build_floor_plan(4), "plan")
    navigation = NavigationMap(scene.grid, 0.2)
    episodes = build_point_episodes(scene, navigation, 9, seed=2, minimum=2.0)
    changed = with_goal_sets(episodes)
    starts = [navigation.geodesic(e.destination).distance_at(*e.start[:2]) for e in changed]
    return scene, navigation, [e for e, away in zip(changed, starts, strict=True) if away > 0.5]


def test_the_oracle_walks_to_the_nearest_place_and_into_areas(
    plan: tuple[Scene, NavigationMap, list[Episode]],
) -> None:
    scene, navigation, episodes = plan
    assert any(e.in_area for e in episodes)
    assert any(e.goal_set is not None and not e.in_area for e in episodes)
    simulator = open_simulator(scene, sensors=frozenset())
    for episode in episodes:
        trajectory = run_episode(simulator, PolicyOracle(), episode)
        field = navigation.geodesic(episode.destination)
        found = compute_metrics(trajectory, episode, field.distance)
        assert found.success and found.success_euclid and found.spl > 0.9, episode.id
        limit = 0.0 if episode.in_area else 0.25
        assert found.navigation_error_geodesic <= limit


@pytest.mark.parametrize("variant", ["exact", "gn0-release", "mpc", "field"])
def test_labels_lead_to_the_nearest_place_and_stop_inside_areas(
    plan: tuple[Scene, NavigationMap, list[Episode]], variant: str
) -> None:
    _, navigation, episodes = plan
    settings = LabelSettings(variant=variant)  # type: ignore[arg-type]
    for episode in episodes:
        poses, actions = plan_expert(navigation, episode, settings)
        field = navigation.geodesic(episode.destination)
        labels = label_along(navigation, episode, poses, actions, settings)
        stops = np.flatnonzero(labels.actions6[:, 0] == 0)
        assert len(stops), episode.id
        assert (field.straight(poses[stops, :2]) <= (0.0 if episode.in_area else 1.0)).all()
        ends = np.flatnonzero(labels.valid < 13)
        places = labels.waypoints[ends, -1].astype(np.float64)
        cosine, sine = np.cos(poses[ends, 2]), np.sin(poses[ends, 2])
        x = poses[ends, 0] + cosine * places[:, 0] - sine * places[:, 1]
        y = poses[ends, 1] + sine * places[:, 0] + cosine * places[:, 1]
        assert (field.straight(np.column_stack([x, y])) <= 1e-5).all()
        again = label_states(navigation, episode, poses[-1:], settings)
        assert not again.actions6.any(), "who has arrived stays"


@pytest.mark.parametrize("variant", ["exact", "field"])
def test_who_is_taught_to_go_further_in_is_there_even_if_he_stops_a_step_before(
    plan: tuple[Scene, NavigationMap, list[Episode]], variant: str
) -> None:
    """By the goal as it is; at its rim, without, the last step but one is outside."""
    _, navigation, episodes = plan
    settings = LabelSettings(variant=variant)  # type: ignore[arg-type]
    inside: dict[bool, list[bool]] = {False: [], True: []}
    for episode in (e for e in episodes if e.in_area):
        assert episode.goal_set is not None
        field = navigation.geodesic(episode.destination)
        inner = GoalSetInner(areas=episode.goal_set.areas, depth=0.5)
        for deep in inside:
            taught = msgspec.structs.replace(episode, goal_set=inner) if deep else episode
            poses, actions = plan_expert(navigation, taught, settings)
            assert field.is_inside(*poses[-1, :2])
            before = poses[np.flatnonzero(actions == 1)[-1], :2]
            inside[deep].append(field.is_inside(*before))
    assert inside[True] and all(inside[True]) and not any(inside[False])


def test_an_environment_pays_for_stopping_inside_an_area_only(
    plan: tuple[Scene, NavigationMap, list[Episode]],
) -> None:
    scene, _, episodes = plan
    episode = next(e for e in episodes if e.in_area)
    env = GoalNavEnv(scene=scene, episodes=[episode], sensors=())
    _, info = env.reset()
    assert info["distance_to_goal"] > 0.0
    near = GoalNavEnv(scene=scene, episodes=[episode], sensors=(), success_distance=99.0)
    near.reset()
    assert not near.step(0)[4]["success"], "near is not inside"
    there = msgspec.structs.replace(episode, start=(*episode.goal, 0.0))
    env = GoalNavEnv(scene=scene, episodes=[there], sensors=())
    _, info = env.reset()
    assert info["distance_to_goal"] == 0.0
    assert env.step(0)[4]["success"]


def test_a_set_without_a_place_in_reach_is_refused(
    plan: tuple[Scene, NavigationMap, list[Episode]],
) -> None:
    _, navigation, episodes = plan
    nowhere = GoalSet(areas=(((90.0, 0.0), (91.0, 0.0), (91.0, 1.0)),))
    with pytest.raises(EpisodeError, match="goal"):
        check_places(navigation, msgspec.structs.replace(episodes[0], goal_set=nowhere), 0.2)
