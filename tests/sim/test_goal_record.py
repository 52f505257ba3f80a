"""Goal pictures by record: rendered when asked for, the same bits wherever they are asked for."""

from __future__ import annotations

import math

import msgspec
import numpy as np
import pytest

from gn0.maps.navigation import NavigationMap
from gn0.missions.episode import Episode, GoalPicture, MissionGoal
from gn0.sim.open import open_simulator
from gn0.sim.vector import VectorEnv
from gn0.testing.scenes import build_point_episodes

VIEW = GoalPicture(kind="view", eye=(6.0, 2.5, 1.3), yaw=-1.2)
CROP = GoalPicture(kind="crop", eye=(6.0, 2.5, 1.3), yaw=-1.4, pitch=-0.3, hfov=40.0)


def with_picture(episode: Episode, picture: GoalPicture | None) -> Episode:
    mission = MissionGoal(
        goal=episode.goal, object_id="sofa_0", category="sofa", instruction="Go.", picture=picture
    )
    return msgspec.structs.replace(episode, mission=mission)


@pytest.fixture(scope="module")
def episodes(room_scene) -> list[Episode]:
    navigation = NavigationMap(room_scene.grid, 0.2)
    plain = build_point_episodes(room_scene, navigation, 3)
    return [with_picture(e, p) for e, p in zip(plain, (VIEW, CROP, None), strict=True)]


def test_the_camera_stands_where_the_record_says(make_simulator, make_episode, eye) -> None:
    simulator = make_simulator("goal_picture")
    simulator.reset(with_picture(make_episode(), CROP))
    view = np.asarray(eye.calls[-1][2]).reshape(4, 4)
    np.testing.assert_allclose(-view[:3, :3].T @ view[:3, 3], CROP.eye, atol=1e-9)
    forward = view[2, :3]
    assert math.atan2(forward[1], forward[0]) == pytest.approx(CROP.yaw)
    assert math.asin(forward[2]) == pytest.approx(CROP.pitch)
    drawn = len(eye.calls)
    simulator.step(1)
    simulator.step(2)
    goal_calls = [c for c in eye.calls[drawn:] if np.allclose(np.asarray(c[2]), view)]
    assert not goal_calls, "drawn once an episode"


def test_simulator_and_batch_show_the_same_bits(room_scene, episodes: list[Episode]) -> None:
    simulator = open_simulator(room_scene, "vlnce", sensors=("goal_picture", "rgb"))
    alone = [np.array(simulator.reset(e).goal_picture) for e in episodes]
    again = [np.array(simulator.reset(e).goal_picture) for e in reversed(episodes)]
    env = VectorEnv(
        3, [room_scene], episodes=episodes, sensors=("goal_picture", "rgb"), preset="vlnce"
    )
    seen, _ = env.reset(options={"episode": [0, 1, 2]})
    for k, picture in enumerate(alone):
        np.testing.assert_array_equal(picture, again[2 - k])
        assert picture.shape == alone[0].shape, "a crop has the size of any picture"
        np.testing.assert_array_equal(picture, seen["goal_picture"][k])
    assert not np.array_equal(alone[0], alone[1]), "the crop is another picture"


def test_a_crop_without_a_field_of_view_is_the_agents_own_eye(room_scene, episodes) -> None:
    simulator = open_simulator(room_scene, "vlnce", sensors=("goal_picture", "rgb"))
    record = GoalPicture(kind="view", eye=(*episodes[0].start[:2], 1.25), yaw=episodes[0].start[2])
    seen = simulator.reset(with_picture(episodes[0], record))
    assert simulator.agent.camera_height == 1.25
    np.testing.assert_array_equal(seen.goal_picture, seen.rgb)
