"""One person on its way: bounds of speed and turning, stops, the grid of ticks."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from gn0.errors import EpisodeError
from gn0.people.person import EpisodePerson, PersonStop
from gn0.people.route import unit_of
from gn0.people.walk import walk_alone


def walker(*path: tuple[float, float], **more: object) -> EpisodePerson:
    return EpisodePerson(number=1, identity="drawn:0:1", path=path, **more)  # type: ignore[arg-type]


CORNER = walker(
    (0, 0), (3, 0), (3, 2), (3.5, 4), speed=1.0,
    stops=(PersonStop(at=1.5, seconds=2, look=60), PersonStop(at=1.5, seconds=2.5, look=-60)),
)  # fmt: skip

coordinate = st.integers(-400, 400).map(lambda cm: cm / 100)
corners = st.lists(st.tuples(coordinate, coordinate), min_size=2, max_size=6, unique=True)


def off_path(person: EpisodePerson, places: np.ndarray) -> float:
    """The farthest that places are from a path [m]."""
    worst = 0.0
    for point in places:
        near = math.inf
        for a, b in zip(person.path, person.path[1:], strict=False):
            step = np.subtract(b, a)
            share = np.clip(np.dot(point - a, step) / np.dot(step, step), 0, 1)
            near = min(near, float(np.linalg.norm(a + share * step - point)))
        worst = max(worst, near)
    return worst


@settings(max_examples=25, deadline=None)
@given(corners, st.floats(0.4, 1.6), st.sampled_from(["end", "back"]))
def test_nobody_leaves_its_path_or_its_bounds(path, speed, after) -> None:
    """Acceleration at most 0.8 m/s², turning at most 90°/s, never faster than it walks."""
    try:
        person = walker(*path, speed=speed, after=after)
    except EpisodeError:
        return  # too short
    track = walk_alone(person, 40)
    assert off_path(person, track.place[::7]) < 1e-9
    assert track.speed.max() <= speed + 1e-12
    assert np.abs(np.diff(track.speed)).max() <= 0.08 + 1e-9
    turned = np.arccos(np.clip((track.face[1:] * track.face[:-1]).sum(axis=1), -1, 1))
    assert np.degrees(turned).max() <= 9.0 + 1e-5
    assert np.allclose(np.linalg.norm(track.face, axis=1), 1.0)
    gone = np.linalg.norm(np.diff(track.place, axis=0), axis=1)
    assert gone.max() <= speed * 0.1 + 1e-9
    assert track.walked[-1] == pytest.approx(gone.sum())


def test_it_arrives_and_stays() -> None:
    track = walk_alone(CORNER, 40)
    assert tuple(track.place[-1]) == CORNER.path[-1]
    assert track.arrived[-1] and not track.arrived[0] and track.speed[-1] == 0.0


def test_it_stops_for_as_long_as_is_said_and_looks_round() -> None:
    track = walk_alone(CORNER, 40)
    there = np.flatnonzero((track.place == (1.5, 0.0)).all(axis=1))
    assert 45 <= len(there) <= 50  # 2 s and 2.5 s in ticks of 0.1 s, and turning back
    yaws = np.degrees(track.yaw[there])
    assert yaws.max() == pytest.approx(60) and yaws.min() == pytest.approx(-60)


def test_ticks_of_a_thirtieth_of_a_second_lead_the_same_way() -> None:
    """Less than 5 cm apart in the first ten seconds, deciding each tick; else not at all."""
    for path in (CORNER.path, ((0, 0), (2, 0.5), (2.5, 2), (1, 3)), ((0, 0), (5, 0))):
        for speed in (0.4, 1.0, 1.6):
            person = walker(*path, speed=speed, stops=CORNER.stops)
            coarse = walk_alone(person, 10)
            shown = walk_alone(person, 10, ticks_a_second=30)
            assert shown.place[::3].tobytes() == coarse.place.tobytes()
            fine = walk_alone(person, 10, ticks_a_second=30, decide_each=True)
            apart = np.linalg.norm(fine.place[::3] - coarse.place, axis=1)
            assert apart.max() < 0.05, (path, speed)


def test_a_loop_is_walked_again_and_a_way_back_ends_where_it_began() -> None:
    square = ((0, 0), (2, 0), (2, 2), (0, 2), (0, 0))
    around = walk_alone(walker(*square, after="loop"), 60)
    assert around.walked[-1] > 16
    back = walk_alone(walker((0, 0), (2, 0), after="back"), 60)
    assert back.place[:, 0].max() == 2.0 and (back.place[100:, 0] == 0.0).any()


def test_who_stands_or_sits_does_not_move() -> None:
    for behaviour in ("stand", "sit"):
        person = walker((1, 2), behaviour=behaviour, yaw=0.5)
        track = walk_alone(person, 5)
        assert (track.place == (1, 2)).all() and np.allclose(track.yaw, 0.5)


@given(st.floats(-1000, 1000))
def test_unit_vectors_of_angles_need_no_sines(degrees: float) -> None:
    x, y = unit_of(degrees)
    assert math.isclose(x, math.cos(math.radians(degrees)), abs_tol=1e-12)
    assert math.isclose(y, math.sin(math.radians(degrees)), abs_tol=1e-12)
