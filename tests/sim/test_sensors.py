"""What each sensor shows, and that nothing else is computed."""

from __future__ import annotations

import math

import msgspec
import numpy as np
import pytest

from gn0.errors import ConfigError, SimError
from gn0.geometry import Pose2D, view_from_pose
from gn0.maps.grid import OccupancyGrid
from gn0.maps.navigation import NavigationMap
from gn0.render.bev import BevPicture
from gn0.sim.presets import find_preset
from gn0.sim.sensors import GREEN, RED, MapFrame, SensorConfig, SensorSuite, draw_disc, paint_grid
from gn0.sim.simulator import Simulator
from gn0.sim.state import Action


def test_only_what_is_asked_for_is_computed(make_simulator, make_episode, eye) -> None:
    simulator = make_simulator("ranges", "goal_vector", "occupancy")
    observation = simulator.reset(make_episode())
    simulator.step(Action.FORWARD)
    assert eye.calls == []
    assert observation.rgb is observation.depth is observation.history is observation.bev is None


def test_colour_and_depth_share_one_rendering(make_simulator, make_episode, eye) -> None:
    simulator = make_simulator("rgb", "depth")
    observation = simulator.reset(make_episode())
    assert [call[:2] for call in eye.calls] == [((480, 360), ("rgb", "depth"))]
    assert observation.rgb.shape == (360, 480, 3)
    assert observation.depth.shape == (360, 480)
    assert observation.depth.dtype == np.float32


def test_depth_has_its_own_camera(make_simulator, make_episode, eye) -> None:
    simulator = make_simulator("rgb", "depth", preset=find_preset("vlnce_r2r"))
    observation = simulator.reset(make_episode())
    assert [call[0] for call in eye.calls] == [(224, 224), (256, 256)]
    assert observation.rgb.shape == (224, 224, 3)
    assert observation.depth.shape == (256, 256)


def test_depth_is_clipped_to_its_range(make_simulator, make_episode) -> None:
    preset = msgspec.structs.replace(find_preset("gn_bench"), depth_range=(0.5, 4.0))
    depth = make_simulator("depth", preset=preset).reset(make_episode()).depth
    assert depth[0, 0] == np.float32(0.5)
    assert depth[0, 20] == np.float32(2.0)
    assert (depth[1:] == 4.0).all()  # nothing there: the far end, never infinity


def test_reduced_pictures(make_simulator, make_episode, eye) -> None:
    simulator = make_simulator("rgb", preset=find_preset("gn0_ce"))
    assert simulator.reset(make_episode()).rgb.shape == (360, 480, 3)
    assert eye.calls[0][0] == (640, 480)


def test_the_eye_stands_where_the_body_stands(make_simulator, make_episode, eye) -> None:
    preset = find_preset("n1_60cm_30deg")
    simulator = make_simulator("rgb", preset=preset)
    simulator.reset(make_episode(start=(1.0, 2.5, 0.7)))
    expected = view_from_pose(1.0, 2.5, 0.60, 0.7, math.radians(-30))
    np.testing.assert_array_equal(eye.calls[0][2], [expected])


def test_standing_still_is_not_rendered_again(make_simulator, make_episode, eye) -> None:
    simulator = make_simulator("rgb", "history")
    simulator.reset(make_episode(start=(0.35, 2.5, math.pi)))
    seen = [simulator.step(Action.FORWARD).observation for _ in range(3)]
    blocked = [o for o in seen if o.collided]
    assert len(blocked) >= 2
    assert len(eye.calls) <= 1 + len(seen) - len(blocked) + 1


def test_history_is_every_step_newest_first_current_excluded(make_simulator, make_episode) -> None:
    simulator = make_simulator("rgb", "history")
    first = simulator.reset(make_episode())
    assert not first.history.any()
    seen = [first.rgb[0, 0, 0]]
    for count in range(1, 20):
        observation = simulator.step(Action.LEFT).observation
        for index in range(16):
            row, column = divmod(index, 4)
            value = observation.history[row * 120 + 60, column * 160 + 80, 0]
            assert value == (seen[-1 - index] if index < count else 0)
        seen.append(observation.rgb[0, 0, 0])


def test_occupancy_shows_map_start_and_agent(make_simulator, make_episode) -> None:
    simulator = make_simulator("occupancy")
    simulator.reset(make_episode(start=(1.0, 2.5, 0.0)))
    for _ in range(4):
        result = simulator.step(Action.FORWARD)
    observation = result.observation
    picture = observation.occupancy
    assert picture.shape == (100, 160, 3)
    assert observation.bev_metres_per_pixel == 0.05
    assert observation.map_origin == (0.0, 0.0)
    frame = simulator.suite.map_frame
    for (x, y), colour in (((1.0, 2.5), GREEN), ((2.0, 2.5), RED)):
        row, col = frame.pixel_of(x, y)
        assert (picture[row, col] == colour).all()
        assert (picture[row, col + 3] == colour).all()
        assert (picture[row, col + 4] == 255).all()
    assert (picture == GREEN).all(axis=2).sum() == (picture == RED).all(axis=2).sum() == 29
    assert (picture[:2] == 0).all()  # the wall
    assert (picture[50, 60] == 255).all()


def test_the_agent_is_drawn_over_the_start(make_simulator, make_episode) -> None:
    observation = make_simulator("occupancy").reset(make_episode())
    assert not (observation.occupancy == GREEN).all(axis=2).any()


def test_north_is_up_and_unknown_is_grey() -> None:
    cells = np.array([[0, 1], [2, 0], [0, 0]], np.uint8)  # row 0 has the least y
    grid = OccupancyGrid(cells, 0.5, (-1.0, 2.0))
    frame = MapFrame.of_grid(grid)
    picture = paint_grid(grid, frame)[:, :, 0]
    assert picture.tolist() == [[255, 255], [127, 255], [255, 0]]
    assert frame.pixel_of(-0.99, 2.01) == (2, 0)
    assert frame.pixel_of(-0.01, 3.49) == (0, 1)


def test_occupancy_takes_the_frame_of_the_bev(room_scene, make_episode, eye) -> None:
    bev = BevPicture(np.full((60, 90, 3), 9, np.uint8), 0.1, (-0.5, -0.5))
    simulator = Simulator(
        room_scene,
        navigation=NavigationMap(room_scene.grid, 0.2),
        sensors=SensorConfig(active=frozenset({"bev", "occupancy"})),
        renderer=eye,
        bev=bev,
    )
    observation = simulator.reset(make_episode())
    assert observation.occupancy.shape == observation.bev.shape == (60, 90, 3)
    assert observation.bev_metres_per_pixel == 0.1
    assert (observation.occupancy[:, 0] == 0).all()  # outside the grid
    u, v = np.floor(bev.pixel_from_world(np.array([1.0, 2.5]))).astype(int)
    assert (observation.occupancy[v, u] == RED).all()
    with pytest.raises(ValueError, match="read-only"):
        observation.bev[0] = 0  # shared between steps


def test_discs_are_clipped_to_the_picture() -> None:
    picture = np.zeros((5, 5, 3), np.uint8)
    draw_disc(picture, 0, 0, 3, RED)
    assert (picture[:, :, 0] > 0).sum() == 11
    draw_disc(picture, -20, 3, 3, GREEN)
    assert not (picture == GREEN).all(axis=2).any()


def test_ranges_reach_the_padded_walls(make_simulator, make_episode) -> None:
    simulator = make_simulator("ranges", range_rays=4)
    ranges = simulator.reset(make_episode(start=(1.025, 2.525, math.pi / 2))).ranges
    grid = simulator.navigation.inflated
    row, col = grid.cell_of(1.025, 2.525)
    ahead = next(k for k in range(200) if grid.cells[row + k, col]) - 0.5
    behind = next(k for k in range(200) if grid.cells[row - k, col]) - 0.5
    assert ranges.dtype == np.float32
    assert ranges[0] == pytest.approx(ahead * 0.05, abs=1e-5)
    assert ranges[2] == pytest.approx(behind * 0.05, abs=1e-5)


def test_goal_vector_is_forward_and_left(make_simulator, make_episode) -> None:
    simulator = make_simulator("goal_vector")
    observation = simulator.reset(make_episode(start=(1.0, 2.5, math.pi / 2), goal=(3.0, 2.5)))
    assert observation.goal_vector == pytest.approx((0.0, -2.0))


def test_pictures_need_their_makers(room_scene) -> None:
    navigation = NavigationMap(room_scene.grid, 0.2)
    for sensor, match in (("rgb", "renderer"), ("history", "renderer"), ("bev", "BEV")):
        with pytest.raises(SimError, match=match):
            SensorSuite(SensorConfig(active=frozenset({sensor})), navigation, 1.3)


@pytest.mark.parametrize(
    "settings",
    [{"active": frozenset({"sonar"})}, {"range_rays": 0}, {"range_limit": -1.0}],
)
def test_settings_without_meaning_are_refused(settings: dict) -> None:
    with pytest.raises(ConfigError):
        SensorConfig(**settings)


def test_ring_and_frame_agree_with_the_pose() -> None:
    frame = MapFrame(10, 10, 0.1, 0.0, 0.0)
    assert frame.pixel_of(*Pose2D(0.05, 0.95, 0.0)[:2]) == (0, 0)


def test_pose_is_the_pose_and_given_only_when_asked_for(make_simulator, make_episode) -> None:
    simulator = make_simulator("pose", "ranges")
    assert simulator.reset(make_episode()).pose == simulator.pose
    simulator.step(1)
    assert simulator.step(2).observation.pose == simulator.pose
    assert simulator.reset(make_episode(), sensors=frozenset({"ranges"})).pose is None


def test_the_goal_picture_is_the_view_from_the_goal(make_simulator, make_episode, eye) -> None:
    """Drawn once an episode, by the episode's own seed, from where the goal is."""
    simulator = make_simulator("goal_picture")
    first = simulator.reset(make_episode()).goal_picture
    assert first is not None and first.dtype == np.uint8 and not first.flags.writeable
    drawn = len(eye.calls)
    view = np.asarray(eye.calls[-1][2]).reshape(4, 4)
    eye_at = -view[:3, :3].T @ view[:3, 3]
    np.testing.assert_allclose(eye_at[:2], make_episode().goal, atol=1e-5)
    assert simulator.step(2).observation.goal_picture is first
    assert len(eye.calls) == drawn
    simulator.reset(make_episode())
    again = np.asarray(eye.calls[-1][2]).reshape(4, 4)
    np.testing.assert_array_equal(again, view)
