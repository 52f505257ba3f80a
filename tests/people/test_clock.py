"""Ticks finer than a tenth of a second cut what people decide in tenths, and decide nothing."""

from __future__ import annotations

import msgspec
import numpy as np
import pytest

from gn0.errors import SimError
from gn0.geometry import F64
from gn0.maps.grid import OccupancyGrid
from gn0.maps.inflate import inflate
from gn0.maps.navigation import NavigationMap
from gn0.missions.episode import AgentSpec, Episode
from gn0.people.crowd import (
    PACE,
    CrowdState,
    build_walls,
    empty_crowd,
    find_pace,
    place_people,
    step_crowd,
)
from gn0.people.person import EpisodePerson
from gn0.people.plan import PeopleSettings, plan_people
from gn0.people.reach import AGENT, BLOCKED_BY, MODE, ON_PATH, SPEED, WAIT, WAY, Pace
from gn0.people.route import Routes, build_routes
from gn0.people.walk import NO_WALLS
from gn0.testing.scenes import build_floor_plan, build_map_scene, build_point_episodes

CUTS = 3
FINE = find_pace(CUTS * 10)
BODY = AgentSpec(radius=0.25)
SCENE = build_map_scene(build_floor_plan(2, width=7.0, depth=6.0), "plan")
WALLS = build_walls([SCENE.grid])


@pytest.fixture(scope="module")
def episodes() -> list[Episode]:
    """Eight people in few rooms: they meet."""
    ground = NavigationMap(SCENE.grid, BODY.radius)
    return [
        msgspec.structs.replace(bare, people=plan_people(SCENE, bare, PeopleSettings(8, seed=k)))
        for k, bare in enumerate(build_point_episodes(SCENE, ground, 12, agent=BODY))
    ]


def open_crowd(episodes: list[Episode], pace: Pace = PACE) -> tuple[CrowdState, Routes, F64]:
    people = [person for episode in episodes for person in episode.people]
    state, routes, row = empty_crowd(len(episodes), 8, pace=pace), build_routes(people), 0
    state.walls[:] = 0
    for number, episode in enumerate(episodes):
        place_people(state, number, routes, range(row, row + len(episode.people)))
        row += len(episode.people)
    return state, routes, np.array([(*e.start[:2], BODY.radius) for e in episodes])


def test_the_house_s_pace_is_the_clock_itself() -> None:
    assert find_pace() == PACE == Pace(PACE.seconds, PACE.cos, PACE.sin, 10, 3, cuts=1)
    assert PACE._replace(cuts=CUTS) == FINE
    assert find_pace(30, decide_each=True).rate == find_pace(25).rate + 5 == 30
    assert find_pace(25).cuts == find_pace(30, decide_each=True).cuts == 1
    assert find_pace(10, decide_each=True) == PACE


def test_finer_ticks_come_to_the_same_bits_at_every_decision(episodes) -> None:
    coarse, routes, agent = open_crowd(episodes)
    fine, _, _ = open_crowd(episodes, FINE)
    assert coarse.plan.size == 0
    met, between = 0, 0
    for _ in range(300):
        step_crowd(coarse, routes, WALLS, agent)
        seen = []
        for _ in range(CUTS):
            step_crowd(fine, routes, WALLS, agent, pace=FINE)
            seen.append(fine.real[:, :, :2].copy())
        same = np.ones(coarse.real.shape[2], np.bool_)
        same[2:4] = False  # the place a tick ago
        assert fine.real[:, :, same].tobytes() == coarse.real[:, :, same].tobytes()
        assert fine.whole.tobytes() == coarse.whole.tobytes()
        between += int((seen[0] != seen[1]).any(axis=2).sum())
        met += int((coarse.whole[:, :, MODE] == 1).sum() + (coarse.whole[:, :, WAIT] > 0).sum())
    assert met > 2000 and between > 5000  # they wait and go round, and ticks in between are seen


def test_a_crowd_that_was_made_for_other_ticks_is_refused() -> None:
    """It would else stand still, and nobody would say why."""
    person = EpisodePerson(number=1, identity="drawn:0:0", path=((0.0, 0.0), (4.0, 0.0)))
    routes, state = build_routes([person], 10), empty_crowd(1, 1)
    place_people(state, 0, routes, [0])
    with pytest.raises(SimError, match="no room for them"):
        step_crowd(state, routes, NO_WALLS, np.full((1, 3), -1.0), pace=find_pace(30))


def test_deciding_each_tick_is_another_crowd(episodes) -> None:
    """What the clock hides: the same people who look three times as often come elsewhere."""
    pace = find_pace(30, decide_each=True)
    people = [person for episode in episodes for person in episode.people]
    coarse, routes, agent = open_crowd(episodes)
    often, _, _ = open_crowd(episodes)
    finer = build_routes(people, pace.rate)
    for _ in range(200):
        step_crowd(coarse, routes, WALLS, agent)
        for _ in range(3):
            step_crowd(often, finer, WALLS, agent, pace=pace)
    apart = np.linalg.norm(often.real[:, :, :2] - coarse.real[:, :, :2], axis=2)
    assert (apart > 0.05).any()


def test_a_copy_goes_on_within_a_decision(episodes) -> None:
    """Saved at every part of a move, restored, and played again to the same bits."""
    state, routes, agent = open_crowd(episodes, FINE)
    for _ in range(100):
        step_crowd(state, routes, WALLS, agent, pace=FINE)
        kept = state.copy()
        ends = []
        for start in (kept.copy(), kept):
            for _ in range(7):
                step_crowd(start, routes, WALLS, agent, pace=FINE)
            ends.append(start.real.tobytes() + start.whole.tobytes() + start.plan.tobytes())
        assert ends[0] == ends[1]
    for _ in range(7):
        step_crowd(state, routes, WALLS, agent, pace=FINE)
    assert state.real.tobytes() + state.whole.tobytes() + state.plan.tobytes() == ends[0]


def test_a_new_episode_begins_with_a_decision(episodes) -> None:
    state, routes, agent = open_crowd(episodes, FINE)
    fresh, *_ = open_crowd(episodes, FINE)
    for _ in range(31):
        step_crowd(state, routes, WALLS, agent, pace=FINE)
    row = 0
    for number, episode in enumerate(episodes):
        place_people(state, number, routes, range(row, row + len(episode.people)))
        row += len(episode.people)
    for _ in range(31):
        for one in (state, fresh):
            step_crowd(one, routes, WALLS, agent, pace=FINE)
    assert state.real.tobytes() == fresh.real.tobytes()


def in_walls(places: F64, mask: OccupancyGrid) -> int:
    cells = np.floor((places - mask.origin) / mask.resolution).astype(int)
    return int(mask.blocked[cells[..., 1], cells[..., 0]].sum())


def test_nobody_is_touched_where_the_agent_moves_within_a_decision(episodes) -> None:
    """The agent goes for people between decisions, as fast as one follows."""
    state, routes, agent = open_crowd(episodes, FINE)
    scripted = np.zeros(state.route.shape, np.bool_)
    for row, episode in enumerate(episodes):
        scripted[row, : len(episode.people)] = [p.behaviour == "script" for p in episode.people]
    free, mask = NavigationMap(SCENE.grid, BODY.radius), inflate(SCENE.grid, 0.30)
    rng = np.random.default_rng(0)
    here, moved = state.route >= 0, 0
    yaw = rng.uniform(-np.pi, np.pi, len(episodes))
    pairs = np.triu_indices(state.route.shape[1], 1)
    for tick in range(900):
        step_crowd(state, routes, WALLS, agent, pace=FINE)
        places = state.real[:, :, :2]
        apart = np.linalg.norm(places[:, pairs[0]] - places[:, pairs[1]], axis=2)
        assert apart[here[:, pairs[0]] & here[:, pairs[1]]].min() >= 0.5
        near = np.linalg.norm(places - agent[:, None, :2], axis=2)
        assert near[here].min() >= 0.5 - 1e-12
        assert in_walls(places[scripted], mask) == 0
        for row in range(len(agent)):  # towards the nearest person, as fast as one follows
            x, y = agent[row, :2]
            if tick % 60 == 0:
                aim = places[row, np.argmin(np.where(here[row], near[row], 9e9))] - (x, y)
                yaw[row] = np.arctan2(aim[1], aim[0]) + rng.normal(0.0, 0.3)
            to = np.array([x + np.cos(yaw[row]) * 1.25 / 30, y + np.sin(yaw[row]) * 1.25 / 30])
            clear = np.linalg.norm(places[row] - to, axis=1)[here[row]].min(initial=9.0) >= 0.5
            if clear and free.is_free(*to):
                agent[row, :2], moved = to, moved + 1
    assert moved > 1000


@pytest.mark.parametrize("after", ["end", "back", "loop"])
@pytest.mark.parametrize("part", range(1, CUTS))
def test_a_move_is_let_go_of_where_the_agent_comes_in_its_way(after, part) -> None:
    """It stops within the decision, short of the agent, and is on its path again afterwards."""
    path = ((0.0, 0.0), (3.0, 0.0), (3.0, 2.0), (0.0, 0.0))
    walker = EpisodePerson(number=1, identity="drawn:0:0", path=path, after=after)
    routes, nobody = build_routes([walker]), np.array([[0.0, 0.0, -1.0]])
    state = empty_crowd(1, 1, pace=FINE)
    place_people(state, 0, routes, [0])
    for _ in range(20 * CUTS + part):
        step_crowd(state, routes, NO_WALLS, nobody, pace=FINE)
    x, y = state.real[0, 0, :2]
    assert 1.0 < x < 2.0 and state.real[0, 0, SPEED] > 0.9
    for _ in range(CUTS - part):
        step_crowd(state, routes, NO_WALLS, np.array([[x + 0.51, y, 0.25]]), pace=FINE)
        assert tuple(state.real[0, 0, :2]) == (x, y) and state.real[0, 0, SPEED] == 0.0
    assert state.whole[0, 0, BLOCKED_BY] == AGENT and abs(state.real[0, 0, WAY] - x) < 1e-9
    for _ in range(10 * CUTS):
        step_crowd(state, routes, NO_WALLS, nobody, pace=FINE)
    assert state.whole[0, 0, MODE] == ON_PATH and state.real[0, 0, 1] == y
    assert state.real[0, 0, 0] == pytest.approx(state.real[0, 0, WAY]) and state.real[0, 0, 0] > x
