"""A person's way in time: bounds at every tick, stops and looks, where both begin, what falls."""

from __future__ import annotations

import math
from itertools import pairwise

import numpy as np
import pytest

from gn0.errors import ConfigError
from gn0.maps.navigation import NavigationMap
from gn0.missions.generate.follow_settings import FollowSettings
from gn0.missions.generate.follow_spawn import draw_offsets, spawn_behind
from gn0.missions.generate.human_path import (
    HumanPath,
    cut_way,
    draw_category,
    draw_speed,
    find_way,
    invalid_path,
    least_seconds,
    retime_path,
    walk_path,
)
from gn0_trials.follow_hall import BODY, build_hall, hall_paths

FOLLOW = FollowSettings()
HALL = build_hall()
WALLS = np.argwhere(HALL.grid.cells > 0)[:, ::-1] * 0.05 + 0.025
WAYS = [find_way(HALL.grid, record.array) for record in hall_paths(HALL).records]


def walked(way: np.ndarray, category: str, seed: int) -> HumanPath:
    rng = np.random.default_rng(seed)
    length = float(np.hypot(*np.diff(way, axis=0).T).sum())
    speed = draw_speed(length, FOLLOW, BODY, rng)
    assert speed is not None
    path = walk_path(retime_path(way, category, speed, rng), category, FOLLOW)  # type: ignore[arg-type]
    assert path is not None
    return path


@pytest.mark.parametrize("category", ["cruise", "turn", "stop-and-go"])
def test_what_is_accepted_keeps_its_bounds_at_every_tick(category: str) -> None:
    kept = 0
    for k, way in enumerate(WAYS):
        for seed in range(4):
            path = walked(way, category, 10 * k + seed)
            if invalid_path(path, HALL.grid, FOLLOW, BODY):
                continue
            kept += 1
            track, last = path.track, round(10 * path.seconds)
            speeds = np.hypot(*np.diff(track.place, axis=0).T) / 0.1
            assert 0.4 <= path.person.speed <= 1.0 and speeds.max() <= path.person.speed + 1e-6
            assert np.abs(np.diff(track.speed)).max() / 0.1 <= 0.8 + 1e-6
            turns = np.degrees(np.diff(np.unwrap(track.yaw)))
            assert np.abs(turns).max() / 0.1 <= 90 + 1e-4
            near = [np.hypot(*(WALLS - place).T).min() for place in track.place[:last:5]]
            assert min(near) >= 0.30 - 0.025 * math.sqrt(2)  # from the centres of cells
            assert path.person.length >= 6.0 and 12.0 <= path.seconds <= 60.0
            assert tuple(track.place[last]) == pytest.approx(path.person.path[-1], abs=0.01)
    assert kept >= len(WAYS)


def test_stops_and_looks_are_as_many_and_as_long_as_they_may_be() -> None:
    for k, way in enumerate(WAYS * 4):
        stops = walked(way, "stop-and-go", k).person.stops
        assert 1 <= len(stops) <= 4 and all(1 <= s.seconds <= 4 and s.look == 0 for s in stops)
        assert all(b.at - a.at >= 2.0 - 1e-3 for a, b in pairwise(stops))
        looks = walked(way, "turn", k).person.stops
        assert 1 <= len(looks) <= 3 and all(abs(s.look) >= 40 for s in looks)
        assert not walked(way, "cruise", k).person.stops


def test_categories_are_as_often_as_they_should_be() -> None:
    rng = np.random.default_rng(0)
    drawn = [draw_category(FOLLOW, rng) for _ in range(2000)]
    shares = [drawn.count(c) / 2000 for c in ("cruise", "turn", "stop-and-go")]
    assert shares == pytest.approx([0.5, 0.25, 0.25], abs=0.04)


def test_nobody_walks_faster_than_a_fifth_less_than_the_agent() -> None:
    from gn0.missions.episode import AgentSpec

    slow = AgentSpec(forward_step=0.25, step_seconds=0.5)  # 0.5 m/s
    for seed in range(20):
        rng = np.random.default_rng(seed)
        assert draw_speed(10.0, FOLLOW, slow, rng) == 0.4
        speed = draw_speed(12.0, FOLLOW, BODY, rng)
        assert speed is not None and 0.4 <= speed <= 1.0
    assert draw_speed(61.0, FOLLOW, BODY, np.random.default_rng(0)) is None


def test_the_agent_begins_behind_at_the_ways_start_else_behind_the_person() -> None:
    navigation = NavigationMap(HALL.grid, BODY.radius)
    way = np.array([(1.5, 3.5), (12.0, 3.5)])
    spawn = spawn_behind(navigation, way, 1.5, 0.3, FOLLOW, BODY.radius)
    assert spawn is not None
    assert spawn.way[0] == pytest.approx((3.0, 3.5)) and spawn.start[:2] == pytest.approx(
        (1.5, 3.2)
    )
    assert spawn.start[2] == pytest.approx(math.atan2(0.3, 1.5))
    short = np.array([(3.5, 3.5), (10.0, 3.5)])  # 6.5 m: nothing to give away
    spawn = spawn_behind(navigation, short, 1.5, 0.0, FOLLOW, BODY.radius)
    assert spawn is not None
    assert spawn.way[0] == pytest.approx((3.5, 3.5)) and spawn.start[:2] == pytest.approx(
        (2.0, 3.5)
    )
    wall = np.array([(0.9, 3.5), (7.4, 3.5)])  # a wall is 0.4 m behind: no 0.8 m are left
    assert spawn_behind(navigation, wall, 1.5, 0.0, FOLLOW, BODY.radius) is None
    beside = np.array([(8.0, 3.0), (8.0 + 8.0, 3.0)])  # ℓ would be in the wall: straight behind
    spawn = spawn_behind(navigation, beside, 1.0, 0.5, FOLLOW, BODY.radius)
    assert spawn is not None and spawn.start[:2] == pytest.approx((8.0, 3.0))


def test_offsets_are_drawn_within_their_bounds() -> None:
    rng = np.random.default_rng(1)
    drawn = np.array([draw_offsets(FOLLOW, rng) for _ in range(400)])
    assert drawn[:, 0].min() >= 1.0 and drawn[:, 0].max() <= 2.0
    assert np.abs(drawn[:, 1]).max() <= 0.5 and np.abs(drawn[:, 1]).max() > 0.45


def test_what_cannot_be_walked_is_refused_with_the_reason() -> None:
    rng = np.random.default_rng(0)
    through = np.array([(3.0, 3.5), (3.0, 9.0)])
    person = retime_path(np.array([(3.0, 3.5), (3.0, 10.5)]), "cruise", 0.5, rng)
    path = walk_path(person, "cruise", FOLLOW)
    assert path is not None and invalid_path(path, HALL.grid, FOLLOW, BODY) == "walls"
    path = walk_path(retime_path(through, "cruise", 0.4, rng), "cruise", FOLLOW)
    assert path is not None and invalid_path(path, HALL.grid, FOLLOW, BODY) == "short"
    straight = np.array([(1.5, 3.5), (9.5, 3.5)])
    path = walk_path(retime_path(straight, "cruise", 1.0, rng), "cruise", FOLLOW)
    assert path is not None and invalid_path(path, HALL.grid, FOLLOW, BODY) == "too quick"
    assert least_seconds(path.person, BODY) == pytest.approx(8.0 / 1.25)
    assert len(cut_way(straight, 8.5)) == 0 and cut_way(straight, 2.0)[0, 0] == 3.5


def test_settings_that_contradict_themselves_are_refused() -> None:
    for wrong in (
        {"cruise": 0.8, "turn": 0.3}, {"levels": ()}, {"speeds": (0.9, 0.5)}, {"count": 5},
    ):  # fmt: skip
        with pytest.raises(ConfigError):
            FollowSettings(**wrong)  # type: ignore[arg-type]
