"""The way ahead of labels goes round people who stand or sit."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from gn0.data.expert_labels import LabelSettings
from gn0.data.expert_people import walk_to_goal
from gn0.data.waypoints import sample_way_points
from gn0.data.ways_round import lead_round
from gn0.geometry import F64
from gn0.maps.navigation import NavigationMap
from gn0.missions.episode import Episode
from gn0.people.person import EpisodePerson
from gn0.scenes import build_example_scene
from gn0.sim.simulator import Simulator
from gn0_trials.people_samples import BODY, goal_episode

FLAT = replace(build_example_scene(), id="flat")
GROUND = NavigationMap(FLAT.grid, BODY.radius)
HERE = np.array([[1.3, 2.5, 0.0], [1.75, 2.4, 0.3]])


def person(x: float, y: float, behaviour: str = "stand") -> EpisodePerson:
    path = ((x, y),) if behaviour != "script" else ((x, y), (x, y - 0.5))
    return EpisodePerson(number=1, identity="drawn:0:1", path=path, behaviour=behaviour)


def nearest(
    poses: F64, waypoints: np.ndarray, valid: np.ndarray, place: tuple[float, float]
) -> float:
    """How near the ways of all poses come to a place [m]."""
    found = []
    for (x, y, yaw), points, count in zip(poses, waypoints, valid, strict=True):
        turn = np.array([[np.cos(yaw), -np.sin(yaw)], [np.sin(yaw), np.cos(yaw)]])
        found.append(np.hypot(*((points[:count] @ turn.T + (x, y)) - place).T).min())
    return float(min(found))


def lead(episode: Episode, poses: F64 = HERE) -> tuple[np.ndarray, np.ndarray]:
    plain = sample_way_points(GROUND.geodesic(episode.destination), poses)
    return lead_round(GROUND, episode, poses, 0.25, plain)


@pytest.mark.parametrize("behaviour", ["stand", "sit"])
def test_it_keeps_off_whoever_keeps_a_place(behaviour: str) -> None:
    alone, among = goal_episode("a"), goal_episode("b", person(2.3, 2.5, behaviour))
    assert nearest(HERE, *lead(alone), (2.3, 2.5)) < 0.2
    points, valid = lead(among)
    assert nearest(HERE, points, valid, (2.3, 2.5)) >= 0.5 - 0.08  # to a cell
    assert (valid > lead(alone)[1]).all()  # a longer way


def test_walkers_and_who_cannot_be_gone_round_change_nothing() -> None:
    wanted = lead(goal_episode("a"))
    for one in (person(2.3, 2.5, "script"), person(3.3, 2.5)):  # and who stands at the goal
        for got, want in zip(lead(goal_episode("b", one)), wanted, strict=True):
            assert np.array_equal(got, want)
    inside = np.array([[2.2, 2.4, 0.0], [1.3, 2.5, 0.0]])  # one as near as nobody comes
    plain = lead(goal_episode("a"), inside)
    points, valid = lead(goal_episode("b", person(2.3, 2.5)), inside)
    assert np.array_equal(points[0], plain[0][0]) and valid[1] > plain[1][1]


def test_samples_have_it_where_labels_are_exact() -> None:
    episode = goal_episode("b", person(2.3, 2.5))
    simulator = Simulator(FLAT, navigation=GROUND, agent=BODY, max_steps=200)
    rows = walk_to_goal(simulator, episode, LabelSettings())
    assert nearest(rows.poses, rows.waypoints, rows.valid, (2.3, 2.5)) >= 0.5 - 0.08
    other = walk_to_goal(simulator, episode, LabelSettings(variant="mpc"))
    assert nearest(other.poses[:1], other.waypoints[:1], other.valid[:1], (2.3, 2.5)) < 0.2
