"""`info["top_down_map"]`, as code written for Habitat's measure of that name reads it."""

from __future__ import annotations

import numpy as np
import pytest

from gn0.errors import ConfigError
from gn0.geometry import Pose2D
from gn0.maps.navigation import NavigationMap
from gn0.sim.env import GoalNavEnv
from gn0.sim.top_down_map import TopDownMap, colorize_top_down_map, draw_top_down_map

# habitat-lab 0c0743e, habitat/utils/visualizations/maps.py, lines 32 to 50
INVALID, VALID, BORDER, SOURCE, TARGET, SHORTEST_PATH = 0, 1, 2, 4, 6, 7
COLOURS = {INVALID: (255, 255, 255), VALID: (150, 150, 150), BORDER: (50, 50, 50),
           SOURCE: (0, 0, 200), TARGET: (200, 0, 0), SHORTEST_PATH: (0, 200, 0)}  # fmt: skip


@pytest.fixture
def navigation(room_scene) -> NavigationMap:
    return NavigationMap(room_scene.grid, 0.2)


@pytest.fixture
def walked(room_scene, make_episode) -> tuple[GoalNavEnv, list[dict]]:
    env = GoalNavEnv(
        room_scene, episodes=[make_episode()], sensors=("pose",), max_steps=50, top_down_map=True
    )
    infos = [env.reset(seed=0)[1]]
    infos += [env.step(action)[4] for action in (1, 1, 1, 2, 2)]
    return env, [info["top_down_map"] for info in infos]


def test_it_has_the_keys_and_types_of_habitats(walked, room_scene) -> None:
    for shown in walked[1]:
        assert list(shown) == ["map", "fog_of_war_mask", "agent_map_coord", "agent_angle"]
        for name in ("map", "fog_of_war_mask"):
            assert (shown[name].dtype, shown[name].shape) == (np.uint8, room_scene.grid.shape)
        ((row, col),) = shown["agent_map_coord"]
        assert type(row) is type(col) is int and shown["map"][row, col] != INVALID
        (angle,) = shown["agent_angle"]
        assert isinstance(angle, np.ndarray) and angle.shape == ()
    assert set(np.unique(walked[1][-1]["fog_of_war_mask"])) == {0, 1}


def test_it_shows_walls_start_goal_way_and_trail(walked, navigation) -> None:
    _, (first, *_, last) = walked
    assert {INVALID, VALID, BORDER, SOURCE, TARGET, SHORTEST_PATH} == set(np.unique(first["map"]))
    free = navigation.inflated.cells[::-1] == 0
    marks = (first["map"] == SOURCE) | (first["map"] == TARGET) | (first["map"] == SHORTEST_PATH)
    np.testing.assert_array_equal(first["map"][~marks] != INVALID, free[~marks])
    origin, size = navigation.grid.origin, navigation.grid.resolution
    height = navigation.grid.shape[0]
    for (x, y), code in (((1.0, 2.5), SOURCE), ((6.0, 2.5), TARGET)):
        row = height - 1 - int((y - origin[1]) / size)
        beside = first["map"][row + 2, int((x - origin[0]) / size)]  # the way leads to the middle
        assert beside == code
    trail = last["map"][last["map"] >= 10]
    # the fifth step of fifty, a turn on the spot
    assert len(trail) and trail.max() == 10 + 5 * 245 // 50
    assert (first["map"] < 10).all(), "what was given before has changed"


@pytest.mark.parametrize(
    ("yaw", "angle"), [(0.0, np.pi / 2), (np.pi / 2, np.pi), (-np.pi / 2, 0.0)]
)
def test_an_angle_points_down_the_rows_at_nought_and_along_them_at_a_right_one(
    navigation, make_episode, yaw, angle
) -> None:
    """As `reveal_fog_of_war` of habitat-lab 947f3e4 uses it: (row, col) += (cos, sin)."""
    shown = TopDownMap(navigation)
    shown.reset(make_episode())
    found = shown.update(Pose2D(1.0, 2.5, yaw), 0)
    assert found["agent_angle"][0] == pytest.approx(angle)
    row, col = found["agent_map_coord"][0]
    ahead = np.rint([row + 6 * np.cos(angle), col + 6 * np.sin(angle)]).astype(int)
    behind = np.rint([row - 6 * np.cos(angle), col - 6 * np.sin(angle)]).astype(int)
    assert found["fog_of_war_mask"][tuple(ahead)] == 1
    assert found["fog_of_war_mask"][tuple(behind)] == 0


def test_no_fog_is_lifted_behind_a_wall_or_far_away(navigation, make_episode) -> None:
    shown = TopDownMap(navigation, view_angle=360.0, view_distance=1.0)
    shown.reset(make_episode())
    found = shown.update(Pose2D(1.0, 2.5, 0.0), 0)
    lifted = np.argwhere(found["fog_of_war_mask"])
    away = np.hypot(*(lifted - found["agent_map_coord"][0]).T) * navigation.grid.resolution
    assert 0.9 < away.max() < 1.05
    assert (found["map"][tuple(lifted.T)] != INVALID).all()
    wide = TopDownMap(navigation, view_angle=360.0, view_distance=50.0)
    wide.reset(make_episode())
    found = wide.update(Pose2D(1.0, 2.5, 0.0), 0)
    assert (found["fog_of_war_mask"] == 0)[found["map"] != INVALID].mean() > 0.1


def test_a_picture_has_habitats_colours_darker_in_the_fog(walked) -> None:
    shown = walked[1][-1]
    bright = colorize_top_down_map(shown["map"])
    for code, colour in COLOURS.items():
        assert (bright[shown["map"] == code] == colour).all()
    foggy = colorize_top_down_map(shown["map"], shown["fog_of_war_mask"])
    dark = (shown["fog_of_war_mask"] == 0) & (shown["map"] == VALID)
    assert (foggy[dark] == 75).all() and (foggy[shown["map"] == INVALID] == 255).all()


def test_the_agent_is_drawn_where_it_is(walked) -> None:
    shown = walked[1][-1]
    picture = draw_top_down_map(shown, 400)
    rows, cols = shown["map"].shape
    assert picture.shape == (400, round(cols * 400 / rows), 3)
    row, col = shown["agent_map_coord"][0]
    plain = draw_top_down_map({**shown, "agent_map_coord": [], "agent_angle": []}, 400)
    differs = np.argwhere((picture != plain).any(axis=2)).mean(axis=0) * rows / 400
    np.testing.assert_allclose(differs, (row + 0.5, col + 0.5), atol=2)
    assert draw_top_down_map(shown).shape == (rows, cols, 3)


def test_it_is_off_unless_asked_for(room_scene, make_episode) -> None:
    env = GoalNavEnv(room_scene, episodes=[make_episode()], sensors=("pose",))
    assert "top_down_map" not in env.reset(seed=0)[1]
    assert "top_down_map" not in env.step(1)[4] and env._map is None


def test_what_is_no_map_is_refused(navigation) -> None:
    with pytest.raises(ConfigError, match="not a top-down map"):
        draw_top_down_map({"map": np.zeros((3, 3), np.uint8)})
    with pytest.raises(ConfigError, match=r"fog of \(2, 2\)"):
        colorize_top_down_map(np.zeros((3, 3), np.uint8), np.zeros((2, 2), np.uint8))
    with pytest.raises(ConfigError, match="float64"):
        colorize_top_down_map(np.zeros((3, 3)))
    for wrong in ({"max_steps": 0}, {"view_angle": 0.0}, {"view_distance": -1.0}):
        with pytest.raises(ConfigError, match="top-down map of"):
            TopDownMap(navigation, **wrong)
