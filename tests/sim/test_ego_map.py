"""Ego maps: the map around an agent, heading up, the same bits in all simulators."""

from __future__ import annotations

import math

import msgspec
import numpy as np
import pytest

from gn0.data.codec import EgoFrame, waypoint_pixels
from gn0.errors import ConfigError
from gn0.maps.navigation import NavigationMap
from gn0.render.light import LightCondition
from gn0.sim.ego_map import EgoSquare, MapView, draw_ego_map, find_turn, read_map_view
from gn0.sim.env import GoalNavEnv
from gn0.sim.open import open_simulator
from gn0.sim.sensor.table import find_sensor
from gn0.sim.vector import VectorEnv
from gn0.testing.scenes import build_point_episodes
from gn0.testing.sensor_check import check_sensor

VIEW = MapView(
    squares=(
        EgoSquare(size=48),
        EgoSquare(size=32, metres_per_pixel=0.31, content="bev"),
        EgoSquare(size=40, metres_per_pixel=0.02, ahead=0.5, content="occupancy", marker=3),
    ),
    arrow=True,
)
WALK = (1, 2, 1, 1, 3, 3, 1, 2, 2, 2, 1)


@pytest.fixture(scope="module")
def layers():
    """A map of noise: BEV [60, 90, 3] and grey [60, 90]."""
    rng = np.random.default_rng(5)
    bev = rng.integers(0, 256, (60, 90, 3), np.uint8)
    grey = rng.choice(np.array([0, 127, 255], np.uint8), (60, 90))
    bev.setflags(write=False)
    grey.setflags(write=False)
    return bev, grey


def draw(layers, pose, start=(-99.0, 0.0), **square):
    view = MapView(squares=(EgoSquare(**{"marker": -1} | square),))
    return draw_ego_map(view, *layers, (-1.0, 2.0), 0.05, pose, start)


def pose_at(row: int, col: int, yaw: float) -> tuple[float, float, float]:
    """The middle of a pixel of `layers`."""
    return -1.0 + (col + 0.5) * 0.05, 2.0 + (60 - row - 0.5) * 0.05, yaw


@pytest.mark.parametrize(("yaw", "turns"), [(90, 0), (0, 1), (-90, 2), (180, 3)])
def test_at_the_maps_own_scale_it_is_the_map_turned(layers, yaw, turns) -> None:
    bev, grey = layers
    pose = pose_at(30, 40, math.radians(yaw))
    cut = np.s_[30 - 12 : 30 + 13, 40 - 12 : 40 + 13]
    square = {"size": 25, "metres_per_pixel": 0.05, "ahead": 0.5}
    np.testing.assert_array_equal(
        draw(layers, pose, content="bev", **square), np.rot90(bev[cut], turns)
    )
    found = draw(layers, pose, content="occupancy", **square)
    np.testing.assert_array_equal(found[:, :, 1], np.rot90(grey[cut], turns))
    assert (found == found[:, :, :1]).all()
    tint = np.where(grey[:, :, None] == 0, (0, 0, 255), grey[:, :, None])
    merged = np.where(grey[:, :, None] == 255, bev, (bev.astype(int) + tint) // 2)
    np.testing.assert_array_equal(
        draw(layers, pose, content="merged", **square), np.rot90(merged[cut], turns)
    )


def test_a_coarse_square_is_the_mean_of_the_map(layers) -> None:
    bev, _ = layers
    found = draw(
        layers, pose_at(30, 40, math.pi / 2), size=7, metres_per_pixel=0.15, ahead=0.5,
        content="bev",
    )  # fmt: skip
    blocks = bev[20:41, 30:51].reshape(7, 3, 7, 3, 3).astype(int).sum(axis=(1, 3))
    np.testing.assert_array_equal(found, (blocks + 4) // 9)


def test_a_turned_coarse_square_has_the_mean_of_what_it_covers(layers) -> None:
    bev = np.full((60, 90, 3), 200, np.uint8)
    bev.setflags(write=False)
    found = draw(
        (bev, layers[1]), pose_at(30, 40, 0.7), size=6, metres_per_pixel=0.3, ahead=0.5,
        content="bev",
    )  # fmt: skip
    assert (found[2:4, 2:4] == 200).all()  # nothing is lost or added


def test_what_lies_outside_the_map_is_black_and_cannot_be_walked(layers) -> None:
    away = (-50.0, 50.0, 1.0)
    assert not draw(layers, away, content="bev").any()
    assert not draw(layers, away, content="occupancy").any()
    assert (draw(layers, away) == (0, 0, 127)).all()


def test_sines_are_those_of_the_heading() -> None:
    for yaw in np.random.default_rng(0).uniform(-7, 7, 500).tolist():
        cosine, sine = find_turn(yaw)
        assert abs(cosine / 2**30 - math.cos(yaw)) < 5e-9
        assert abs(sine / 2**30 - math.sin(yaw)) < 5e-9
    quarters = [find_turn(k * math.pi / 2) for k in range(-2, 3)]
    one = 2**30
    np.testing.assert_allclose(
        quarters, [(-one, 0), (0, -one), (one, 0), (0, one), (-one, 0)], atol=4
    )


@pytest.mark.parametrize("seed", range(20))
def test_waypoints_are_where_the_codec_says(layers, seed) -> None:
    """A place in the agent's frame is drawn at the pixel of `EgoFrame`."""
    rng = np.random.default_rng(seed)
    x, y, yaw = rng.uniform((-1, 2, -3), (3, 5, 3)).tolist()
    forward, left = rng.uniform((-2.0, -3.5), (4.5, 3.5)).tolist()
    c, s = math.cos(yaw), math.sin(yaw)
    place = (x + c * forward - s * left, y + s * forward + c * left)
    near = EgoSquare()
    frame = EgoFrame(near.size, near.metres_per_pixel, near.ahead)
    (((right, down),),) = waypoint_pixels(frame, np.array([[[forward, left]]]), np.zeros((1, 3)))
    found = draw(layers, (x, y, yaw), place, marker=0)
    dot = np.argwhere(
        (found == (0, 255, 0)).all(axis=2) & (draw(layers, (x, y, yaw)) != found).any(axis=2)
    )
    assert dot.tolist() == [[math.floor(down + 0.5), math.floor(right + 0.5)]]


def test_the_near_square_holds_three_metres_ahead_and_to_the_sides() -> None:
    near = MapView().squares[0]
    frame = EgoFrame(near.size, near.metres_per_pixel, near.ahead)
    bend = np.radians(np.arange(-90, 91, 5))
    places = 3.0 * np.stack([np.cos(bend), np.sin(bend)], axis=-1)[None]
    pixels = waypoint_pixels(frame, places, np.zeros((1, 3)))
    assert (pixels >= 0).all() and (pixels <= near.size - 1).all()


def test_the_arrow_stands_where_the_agent_is_and_points_up(layers) -> None:
    red = (draw(layers, pose_at(30, 40, 0.3), marker=2) == (255, 0, 0)).all(axis=2)
    rows, cols = np.nonzero(red)
    assert rows.min() == 80 and rows.max() == 85  # it is at 83.2: longer before than behind
    assert cols.min() + cols.max() == 127
    width = red.sum(axis=1)[80:86]
    assert (np.diff(width) >= 0).all() and width[0] <= 2


def test_squares_stand_side_by_side_and_come_apart(layers) -> None:
    found = draw_ego_map(VIEW, *layers, (-1.0, 2.0), 0.05, (0.5, 3.0, 0.4), (0.0, 3.0))
    assert found.shape == (48, 120, 3) and not found.flags.writeable
    parts = VIEW.split(found)
    assert [part.shape for part in parts] == [(48, 48, 3), (32, 32, 3), (40, 40, 3)]
    assert not found[32:, 48:80].any() and not found[40:, 80:].any()
    for part, square in zip(parts, VIEW.squares, strict=True):
        one = draw_ego_map(
            MapView(squares=(square,)), *layers, (-1.0, 2.0), 0.05, (0.5, 3.0, 0.4), (0.0, 3.0)
        )
        np.testing.assert_array_equal(part, one)
    np.testing.assert_array_equal(VIEW.split(found[None])[1][0], parts[1])


@pytest.mark.parametrize(
    "changes",
    [{"size": 0}, {"size": 1025}, {"metres_per_pixel": 0.001}, {"metres_per_pixel": math.nan},
     {"ahead": 1.1}, {"content": "depth"}, {"marker": 101}],
)  # fmt: skip
def test_squares_without_meaning_are_refused(changes) -> None:
    with pytest.raises(ConfigError, match="ego map of"):
        EgoSquare(**changes)


def test_no_square_and_too_many_are_refused() -> None:
    for count in (0, 9):
        with pytest.raises(ConfigError, match=f"ego map of {count} squares"):
            MapView(squares=(EgoSquare(),) * count)


def test_a_view_may_be_given_by_its_fields() -> None:
    assert read_map_view(None) == MapView()
    own = {"squares": [{"size": 64, "ahead": 1}, {"content": "bev"}], "arrow": True}
    assert read_map_view(own) == MapView(
        squares=(EgoSquare(size=64, ahead=1.0), EgoSquare(content="bev")), arrow=True
    )
    for wrong, says in (
        ({"square": []}, "square"),
        ({"squares": [{"size": "64"}]}, "squares"),
        ({"squares": [{"content": "depth"}]}, "depth"),
        ({"squares": []}, "0 squares"),
    ):
        with pytest.raises(ConfigError, match=says):
            read_map_view(wrong)


def test_it_keeps_the_protocol_of_sensors() -> None:
    check_sensor(find_sensor("ego_map"))


def check_engines(scene, episodes, **settings) -> None:
    """One agent alone and each of many see the same, on a walk with the ends of episodes in it."""
    settings |= {"sensors": ("ego_map", "occupancy"), "episodes": episodes, "max_steps": 9}
    one, many = GoalNavEnv(scene, **settings), VectorEnv(2, scene, **settings)
    mine, theirs = one.reset(seed=2)[0], many.reset(seed=2)[0]
    for action in WALK:
        for name, value in mine.items():
            np.testing.assert_array_equal(value, theirs[name][0], err_msg=name)
        assert mine in one.observation_space
        assert theirs["ego_map"].shape == many.observation_space["ego_map"].shape
        mine, _, _, ended, _ = one.step(action)
        theirs, _, _, _, infos = many.step([action, 1])
        if ended:
            last = infos["final_obs"][0]
            np.testing.assert_array_equal(mine["ego_map"], last["ego_map"])
            mine, _ = one.reset()


@pytest.mark.parametrize("view", [None, VIEW], ids=["homes", "own"])
@pytest.mark.parametrize("mode", ["prior", "explored"])
def test_one_agent_and_many_see_the_same(room_scene, view, mode) -> None:
    episodes = build_point_episodes(room_scene, NavigationMap(room_scene.grid, 0.2), 3, seed=5)
    dim = LightCondition(name="dusk", exposure=-1.5)
    episodes[1] = msgspec.structs.replace(episodes[1], light=dim)
    check_engines(
        room_scene, episodes, backend="cpu", preset="vlnce_r2r", map_view=view, map_mode=mode
    )


def test_an_explored_map_shows_what_was_seen_and_a_prior_one_all(room_scene, make_episode) -> None:
    views = {"preset": "vlnce_r2r", "backend": "cpu", "sensors": {"ego_map"}}
    prior = open_simulator(room_scene, **views)
    own = open_simulator(room_scene, map_mode="explored", **views)
    everything = prior.reset(make_episode()).read("ego_map")
    begun = own.reset(make_episode()).read("ego_map")
    for _ in range(24):
        seen = own.step(2).observation.read("ego_map")
    unseen = [(p == 127).all(axis=2).mean() for p in (everything, seen, begun)]
    assert unseen[0] < 0.01 < unseen[1] < 0.75 * unseen[2]
    with pytest.raises(ConfigError, match="has no ego_map"):
        open_simulator(room_scene, map_mode="none", **views)


def test_without_colours_nothing_is_drawn(room_scene, make_episode) -> None:
    view = MapView(squares=(EgoSquare(content="occupancy"),))
    simulator = open_simulator(room_scene, "vlnce_r2r", sensors={"ego_map"}, map_view=view)
    assert simulator.suite.renderer is None
    assert simulator.reset(make_episode()).read("ego_map").shape == (128, 128, 3)
    assert not simulator.config.carried.bev
    assert simulator.config.carried.explored == {"depth"}


def test_the_occupancy_picture_has_an_arrow_if_asked_for(room_scene, make_episode) -> None:
    for yaw in (0.0, 1.0, -2.5, math.pi):
        seen = [
            open_simulator(room_scene, "vlnce_r2r", sensors={"occupancy"}, map_view=view)
            .reset(make_episode(start=(3.0, 2.5, yaw)))
            .occupancy
            for view in (MapView(), MapView(arrow=True))
        ]
        red = [np.argwhere((picture == (255, 0, 0)).all(axis=2)) for picture in seen]
        assert len(red[0]) == 29 and 15 < len(red[1]) < 60
        down, right = red[1].mean(axis=0) - red[0].mean(axis=0)
        assert np.hypot(down, right) < 1.5
        spread = red[1] - red[1].mean(axis=0)
        tip = spread[np.hypot(*spread.T).argmax()]
        assert np.cos(math.atan2(-tip[0], tip[1]) - yaw) > 0.9  # it points where the agent looks
