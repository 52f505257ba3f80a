"""The oracle on its way to a goal among people: in a hallway it and a walker pass each other."""

from __future__ import annotations

import numpy as np
import pytest

from gn0.bench.company_watch import CompanyWatch
from gn0.maps.grid import OccupancyGrid
from gn0.maps.navigation import NavigationMap
from gn0.missions.episode import AgentSpec, Episode, MissionGoal
from gn0.people.person import EpisodePerson
from gn0.policies.oracle import PolicyOracle
from gn0.sim.rollout import run_episode
from gn0.sim.simulator import Simulator
from gn0.sim.state import Trajectory
from gn0.testing.scenes import build_map_scene

BODY = AgentSpec()
LIMIT = 150  # actions, as in `gn0 demo`; the way alone takes 40


def hallway(*rooms: tuple[float, float, float, float]) -> Simulator:
    """A hallway of 0.9 m between two rooms, and other rooms (x0, y0, x1, y1) m."""
    cells = np.ones((120, 240), np.uint8)
    free = ((0.2, 1.5, 2.7, 4.5), (9.3, 1.5, 11.8, 4.5), (2.7, 2.55, 9.3, 3.45), *rooms)
    for x0, y0, x1, y1 in free:
        cells[round(y0 / 0.05) : round(y1 / 0.05), round(x0 / 0.05) : round(x1 / 0.05)] = 0
    scene = build_map_scene(OccupancyGrid(cells, 0.05, (0.0, 0.0)), "hallway")
    navigation = NavigationMap(scene.grid, BODY.radius)
    return Simulator(scene, navigation=navigation, agent=BODY, max_steps=LIMIT)


def walk(simulator: Simulator, person: EpisodePerson) -> tuple[Trajectory, CompanyWatch]:
    """From the room in the west to the one in the east."""
    mission = MissionGoal(goal=(11.0, 2.0), object_id="", category="bed", instruction="Go.")
    episode = Episode(
        id="e", scene_id="hallway", mission=mission, start=(1.0, 3.0, 0.0),
        path=((1.0, 3.0), mission.goal), agent=BODY, people=(person,),
    )  # fmt: skip
    watch = CompanyWatch(simulator)
    return run_episode(simulator, PolicyOracle(), episode, watch=watch), watch


NICHE = (6.0, 3.45, 7.2, 5.0)
CASES = [
    (rooms, speed, x)
    for rooms in ((), (NICHE,))
    for speed, x in ((0.5, 10.0), (0.7, 8.0), (1.2, 10.5), (0.4, 5.0))
]


@pytest.mark.parametrize(("rooms", "speed", "x"), CASES)
def test_the_two_of_a_hallway_get_past_each_other(
    rooms: tuple[tuple[float, float, float, float], ...], speed: float, x: float
) -> None:
    """Somebody walks to and fro where two have no room beside each other."""
    person = EpisodePerson(
        number=1, identity="drawn:0:1", path=((x, 3.0), (1.5, 3.0)), speed=speed, after="back"
    )
    trajectory, watch = walk(hallway(*rooms), person)
    assert trajectory.stopped, f"{len(trajectory.actions)} actions, at {trajectory.poses[-1]}"
    assert np.hypot(*np.subtract(trajectory.poses[-1][:2], (11.0, 2.0))) <= 0.25
    assert watch.touches == [] and len(trajectory.actions) < LIMIT
