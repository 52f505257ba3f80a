"""A sample's pictures are the simulator's own, on the same states, in the same light."""

from __future__ import annotations

import numpy as np
import pytest

from gn0.data.codec import waypoint_pixels
from gn0.data.episode_frames import read_frames
from gn0.data.lerobot_schema import Film
from gn0.data.part_pictures import bare_map, eyes_of
from gn0.data.sample_pictures import SENSORS, build_eyes, draw_episode
from gn0.data.sample_table import PICTURES
from gn0.data.settings import TokenSettings
from gn0.errors import DataError
from gn0.maps.navigation import NavigationMap
from gn0.sim.open import open_simulator
from gn0.sim.presets import find_preset
from gn0.sim.sensors import MapFrame
from gn0.storage import content_hash
from gn0.testing.scenes import build_point_episodes, build_room_scene


@pytest.fixture(scope="module")
def watched(webdataset):
    """What the simulator shows along each rollout, by episode."""
    seen = {}
    for name in webdataset.sampled:
        rollout = webdataset.rollout(name)
        simulator = open_simulator(
            webdataset.scene(rollout.episode.scene_id), sensors=SENSORS,
            light=rollout.episode.light, preset=webdataset.about.camera,
        )  # fmt: skip
        observations = [simulator.reset(rollout.episode)]
        poses = [simulator.pose]
        for action in rollout.actions.tolist():
            observations.append(simulator.step(action).observation)
            poses.append(simulator.pose)
        assert simulator.over
        seen[name] = (observations, np.array(poses))
    return seen


def test_poses_are_the_simulators_bit_for_bit(webdataset, watched) -> None:
    for name, (_, poses) in watched.items():
        np.testing.assert_array_equal(webdataset.rollout(name).poses, poses)


def test_hashes_are_those_of_what_the_simulator_shows(webdataset, watched) -> None:
    for name, (observations, _) in watched.items():
        rows = webdataset.rows(name)
        for step, observation in enumerate(observations[:-1]):
            for picture in PICTURES:
                shown = np.asarray(getattr(observation, picture))
                assert rows.hashes[picture][step] == content_hash(shown), (name, step, picture)


def test_frames_drawn_again_are_what_the_simulator_shows(webdataset, watched) -> None:
    name = webdataset.sampled[0]
    observations, _ = watched[name]
    frames = list(read_frames(webdataset, name, SENSORS, exact=True))
    assert len(frames) == len(webdataset.rows(name))
    for frame, observation in zip(frames, observations, strict=False):
        for sensor in SENSORS:
            np.testing.assert_array_equal(frame[sensor], getattr(observation, sensor))


def test_small_eyes_have_small_mosaics() -> None:
    scene, preset = build_room_scene(), find_preset("tiny_160")
    navigation = NavigationMap(scene.grid, preset.agent.radius)
    (episode,) = build_point_episodes(scene, navigation, 1, seed=5)
    simulator = open_simulator(scene, preset, "cpu", {"rgb", "history"})
    seen, poses = [simulator.reset(episode)], [simulator.pose]
    for action in (1, 2, 1):
        seen.append(simulator.step(action).observation)
        poses.append(simulator.pose)
    eyes = build_eyes(scene, navigation, preset, preset.agent)
    for mine, theirs in zip(draw_episode(eyes, episode, np.array(poses)), seen, strict=True):
        assert mine.history.shape == mine.rgb.shape == (160, 160, 3)
        assert mine.history.tobytes() == theirs.history.tobytes()
    assert mine.history.any()
    film = Film.of(preset.picture_size, tile=preset.history_tile)
    assert film.sizes["history"] == (160, 160)
    assert Film.of((480, 360)).sizes["history"] == (640, 480)


def test_light_changes_view_and_map_alike_and_nothing_else(webdataset) -> None:
    lit = [e for e in webdataset.episodes if e.light is not None]
    plain = [e for e in webdataset.episodes if e.light is None]
    hashes = {e.id: webdataset.rows(e.id).hashes for e in webdataset.episodes}
    assert hashes[lit[0].id]["bev"][0] == hashes[lit[1].id]["bev"][0]
    assert hashes[lit[0].id]["bev"][0] != hashes[plain[0].id]["bev"][0]
    frames = [next(read_frames(webdataset, e.id, ("rgb",), exact=True)) for e in (lit[0], plain[0])]
    assert frames[0]["rgb"].mean() < frames[1]["rgb"].mean()


def test_missions_of_one_path_show_the_same(webdataset) -> None:
    twin = webdataset.episode("zwilling")
    other = next(e for e in webdataset.episodes if e.path_id == twin.path_id and e is not twin)
    assert webdataset.rows(twin.id).hashes == webdataset.rows(other.id).hashes


def test_map_tokens_count_over_the_picture_that_is_shown(webdataset) -> None:
    name = webdataset.sampled[0]
    rollout = webdataset.rollout(name)
    eyes = eyes_of(webdataset).of(rollout.episode)
    grid = webdataset.scene(rollout.episode.scene_id).grid
    assert TokenSettings().of_grid(grid) == eyes.map_frame == MapFrame.of_grid(grid)
    pixels = waypoint_pixels(eyes.map_frame, rollout.rows.waypoints, rollout.rows.poses)
    picture, _ = bare_map(eyes)
    for x, y in np.rint(pixels.reshape(-1, 2)).astype(int).tolist():
        assert picture[y, x].min() == 255  # every waypoint is on free ground


def test_the_cache_shows_what_is_drawn_as_well_as_jpg_can(webdataset_once) -> None:
    for name in (webdataset_once.sampled[0], "zwilling"):
        cached = list(read_frames(webdataset_once, name, PICTURES))
        drawn = list(read_frames(webdataset_once, name, PICTURES, exact=True))
        assert len(cached) == len(drawn) == len(webdataset_once.rows(name))
        for one, other in zip(cached, drawn, strict=True):
            for sensor in ("bev", "occupancy"):  # png
                np.testing.assert_array_equal(one[sensor], other[sensor])
            for sensor in ("rgb", "history"):
                error = one[sensor].astype(float) - other[sensor]
                assert np.sqrt((error**2).mean()) < 6, sensor


def test_videos_show_what_is_drawn_as_well_as_av1_can(lerobot) -> None:
    name = lerobot.sampled[-1]
    cached = list(read_frames(lerobot, name, PICTURES))
    drawn = list(read_frames(lerobot, name, PICTURES, exact=True))
    for one, other in zip(cached, drawn, strict=True):
        np.testing.assert_array_equal(one["occupancy"], other["occupancy"])
        for sensor in ("rgb", "history"):
            error = one[sensor].astype(float) - other[sensor]
            assert np.sqrt((error**2).mean()) < 10, sensor


def test_depth_comes_with_colour_from_the_cache(webdataset) -> None:
    frame = next(read_frames(webdataset, webdataset.sampled[0], ("rgb", "depth")))
    assert frame["depth"].dtype == np.float32 and frame["depth"].shape == frame["rgb"].shape[:2]


def test_goal_pictures_are_the_simulators_and_are_kept(webdataset_once, lerobot) -> None:
    for name in (webdataset_once.sampled[0], webdataset_once.sampled[1]):
        episode = webdataset_once.episode(name)
        simulator = open_simulator(
            webdataset_once.scene(episode.scene_id), sensors={"goal_picture"},
            light=episode.light, preset=webdataset_once.about.camera,
        )  # fmt: skip
        shown = simulator.reset(episode).goal_picture
        drawn = next(read_frames(webdataset_once, name, ("goal_picture",), exact=True))[
            "goal_picture"
        ]
        np.testing.assert_array_equal(drawn, shown)
        cached = next(read_frames(webdataset_once, name, ("goal_picture", "rgb")))["goal_picture"]
        assert np.sqrt(((cached.astype(float) - drawn) ** 2).mean()) < 6
    # two missions of one path have goals of their own: the seed and the id turn the view
    for dataset in (webdataset_once, lerobot):
        shown = [next(read_frames(dataset, name, ("goal_picture",))) for name in dataset.sampled]
        assert len({one["goal_picture"].tobytes() for one in shown}) == 6


def test_an_unknown_picture_is_refused_with_the_known_ones(webdataset) -> None:
    with pytest.raises(DataError, match="no picture 'sonar'") as caught:
        read_frames(webdataset, webdataset.sampled[0], ("sonar",))
    assert "history" in caught.value.remedy
