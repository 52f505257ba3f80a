"""Many people at once: none overlap, none is in a wall, nothing hangs on order or number."""

from __future__ import annotations

import msgspec
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from gn0.maps.navigation import NavigationMap
from gn0.missions.episode import Episode, MissionGoal, check_episode
from gn0.missions.people import check_people_walls
from gn0.people.crowd import CrowdState, build_walls, empty_crowd, place_people, step_crowd
from gn0.people.person import EpisodePerson, PersonStop
from gn0.people.plan import find_seat, plan_people
from gn0.people.reach import HOLD_LEFT, MODE
from gn0.people.route import Routes, build_routes
from gn0.people.settings import PeopleSettings
from gn0.people.walk import walk_alone
from gn0.scenes import build_example_scene

FLAT = build_example_scene()
AGENT = 0.25  # m, radius


def draw_episode(seed: int, people: int = 5) -> Episode:
    navigation = NavigationMap(FLAT.grid, AGENT)
    free = np.argwhere(navigation.regions == 0)
    stream = np.random.default_rng(seed)
    (a, b), (c, d) = navigation.inflated.centres_of(free[stream.integers(len(free), size=2)])
    goal = MissionGoal(goal=(float(c), float(d)), object_id="", category="bed", instruction="Go.")
    episode = Episode(
        id=f"e{seed}", scene_id=FLAT.id, mission=goal, start=(float(a), float(b), 0.0),
        path=((float(a), float(b)), goal.goal),
    )  # fmt: skip
    settings = PeopleSettings(count=people, seed=seed)
    return msgspec.structs.replace(episode, people=plan_people(FLAT, episode, settings))


@pytest.fixture(scope="module")
def episodes() -> list[Episode]:
    return [draw_episode(seed) for seed in range(40)]


def open_crowd(episodes: list[Episode]) -> tuple[CrowdState, Routes, np.ndarray]:
    people = [person for episode in episodes for person in episode.people]
    state, routes, row = empty_crowd(len(episodes), 5), build_routes(people), 0
    state.walls[:] = 0
    for number, episode in enumerate(episodes):
        place_people(state, number, routes, range(row, row + len(episode.people)))
        row += len(episode.people)
    agent = np.array([(*episode.start[:2], AGENT) for episode in episodes])
    return state, routes, agent


WALLS = build_walls([FLAT.grid])


def run(state: CrowdState, routes: Routes, agent: np.ndarray, ticks: int) -> None:
    for _ in range(ticks):
        step_crowd(state, routes, WALLS, agent)


def test_planned_people_fit_their_episode_and_scene(episodes) -> None:
    kinds = set()
    for episode in episodes:
        check_episode(episode)
        check_people_walls(episode.people, FLAT.grid)
        assert len(episode.people) == 5
        assert len({person.identity for person in episode.people}) == 5
        kinds |= {person.behaviour for person in episode.people}
    assert kinds == {"script", "stand", "sit"}
    assert draw_episode(3).people == episodes[3].people  # the same seed, the same people
    assert draw_episode(4).people != episodes[3].people


def test_a_seat_is_found_on_a_sofa_with_its_back_to_the_wall() -> None:
    sofa = next(thing for thing in FLAT.objects if thing.category == "sofa")
    seat = find_seat(FLAT, sofa)
    assert seat is not None
    assert abs(seat[0] - sofa.box.centre[0]) <= sofa.box.size[0] / 2
    assert seat[2] == pytest.approx(np.pi / 2)  # it stands at the wall of least y
    table = next(thing for thing in FLAT.objects if thing.category == "table")
    assert find_seat(FLAT, table) is None


def test_nobody_overlaps_and_nobody_is_in_a_wall(episodes) -> None:
    """For 60 s around an agent that stands in the way; who walks never stands still for long."""
    state, routes, agent = open_crowd(episodes)
    near = NavigationMap(FLAT.grid, 0.30)
    there = state.route >= 0
    walks = there & (routes.table[np.maximum(state.route, 0), 5] == 0)
    last, still = state.real[:, :, :2].copy(), np.zeros(walks.shape, int)
    worst = still.copy()
    for _ in range(600):
        step_crowd(state, routes, WALLS, agent)
        places = state.real[:, :, :2]
        for k in range(5):
            for m in range(k):
                apart = np.linalg.norm(places[:, k] - places[:, m], axis=1)
                assert (apart[there[:, k] & there[:, m]] >= 0.5).all()
        away = np.linalg.norm(places - agent[:, None, :2], axis=2)
        assert (away[walks] >= 0.25 + AGENT).all()
        rest = (state.real[:, :, HOLD_LEFT] > 0) | (state.whole[:, :, MODE] == 2) | ~walks
        moved = (np.linalg.norm(places - last, axis=2) > 0.05) | rest
        still = np.where(moved, 0, still + 1)
        last = np.where(moved[:, :, None], places, last)
        worst = np.maximum(worst, still)
        cells = np.floor((places[walks] - near.inflated.origin) / near.inflated.resolution)
        assert not near.blocked[cells[:, 1].astype(int), cells[:, 0].astype(int)].any()
    assert (worst > 100).sum() <= 1  # 10 s; see docs/people.md


def test_order_and_company_of_other_episodes_cannot_show(episodes) -> None:
    state, routes, agent = open_crowd(episodes)
    run(state, routes, agent, 200)
    for number in (0, 7, 31):
        episode = episodes[number]
        alone, own, place = open_crowd([episode])
        run(alone, own, place, 200)
        assert alone.real[0].tobytes() == state.real[number].tobytes()
        turned = msgspec.structs.replace(episode, people=episode.people[::-1])
        back, own, place = open_crowd([turned])
        run(back, own, place, 200)
        count = len(episode.people)
        assert np.array_equal(back.real[0, :count][::-1], alone.real[0, :count])


def test_a_copy_goes_on_as_the_crowd_does(episodes) -> None:
    state, routes, agent = open_crowd(episodes[:6])
    run(state, routes, agent, 120)
    kept = state.copy()
    run(state, routes, agent, 80)
    run(kept, routes, agent, 80)
    assert kept.real.tobytes() == state.real.tobytes()
    assert kept.whole.tobytes() == state.whole.tobytes()


def test_with_nobody_in_its_way_a_person_walks_as_alone(episodes) -> None:
    person = next(p for p in episodes[0].people if p.behaviour == "script")
    state, routes = empty_crowd(1, 3), build_routes([person])
    state.walls[0] = 0
    place_people(state, 0, routes, [0])
    track = walk_alone(person, 30)
    for tick in range(1, 301):
        step_crowd(state, routes, WALLS, np.array([[0.0, 0.0, -1.0]]))
        assert tuple(state.real[0, 0, :2]) == tuple(track.place[tick])


@settings(max_examples=60, deadline=None)
@given(
    speed=st.integers(40, 100),
    after=st.sampled_from(["end", "back"]),
    stop=st.integers(0, 3),
    beside=st.lists(
        st.tuples(st.integers(-50, 550), st.integers(60, 130), st.sampled_from([-1, 1])),
        min_size=1, max_size=4,
    ),
    agent=st.tuples(st.integers(-50, 550), st.integers(60, 130)),
)  # fmt: skip
def test_company_beside_its_way_changes_no_bit(speed, after, stop, beside, agent) -> None:
    """People and an agent who stand 10 to 80 cm off the bodies' way, but never on it."""
    stops = (PersonStop(at=1.0 * stop, seconds=1.2, look=40.0),) if stop else ()
    walker = EpisodePerson(
        number=1, identity="drawn:0:0", path=((0.0, 0.0), (2.0, 0.0), (5.0, 0.0)),
        speed=speed / 100, after=after, stops=stops,
    )  # fmt: skip
    others = [
        EpisodePerson(
            number=2 + k, identity="drawn:0:1", path=((x / 100, s * y / 100),), behaviour="stand"
        )
        for k, (x, y, s) in enumerate(beside)
    ]
    track = walk_alone(walker, 20)
    people = [walker, *others]
    state, routes = empty_crowd(1, len(people)), build_routes(people)
    place_people(state, 0, routes, range(len(people)))
    near = np.array([[agent[0] / 100, agent[1] / 100, AGENT]])
    for tick in range(1, 201):
        step_crowd(state, routes, WALLS, near)
        assert state.real[0, 0, :2].tobytes() == track.place[tick].tobytes()
        assert state.real[0, 0, 4:6].tobytes() == track.face[tick].tobytes()


def test_patience_ends_at_the_same_time_at_any_rate(episodes) -> None:
    """Who waits goes round a tick after its patience: in the same tenth of a second."""
    people = [person for episode in episodes for person in episode.people]
    tenths, thirtieths = (build_routes(people, rate).table[:, 6] + 1 for rate in (10, 30))
    assert np.array_equal(thirtieths, 3 * tenths) and len(np.unique(tenths)) > 5


def test_who_is_in_the_way_is_gone_round() -> None:
    """Somebody stands on the path in an open room: the walker waits, passes it and arrives."""
    path = ((1.5, 2.5), (5.0, 2.5))
    walker = EpisodePerson(number=1, identity="drawn:0:0", path=path)
    stander = EpisodePerson(number=2, identity="drawn:0:1", path=((3.2, 2.5),), behaviour="stand")
    state, routes = empty_crowd(1, 2), build_routes([walker, stander])
    place_people(state, 0, routes, [0, 1])
    least, waited = 9.0, 0
    for _ in range(300):
        step_crowd(state, routes, WALLS, np.array([[0.0, 0.0, -1.0]]))
        least = min(least, float(np.linalg.norm(state.real[0, 0, :2] - state.real[0, 1, :2])))
        waited += state.real[0, 0, 6] == 0.0
    assert tuple(state.real[0, 0, :2]) == path[1]
    assert 0.5 <= least < 0.8 and waited > 5
