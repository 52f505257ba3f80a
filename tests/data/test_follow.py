"""Labels towards somebody who moves: where a follower should be, and how it gets there."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from gn0.data.expert_labels import walk_actions
from gn0.data.follow import TargetTrack, desired_state, label_follow, reference_state
from gn0.errors import EpisodeError, PlanError
from gn0.maps.grid import OccupancyGrid
from gn0.maps.navigation import NavigationMap
from gn0.missions.episode import AgentSpec

AGENT = AgentSpec()


def corner_map() -> NavigationMap:
    """An L of two corridors, 2 m wide: along x, then along y."""
    cells = np.ones((200, 200), np.uint8)
    cells[20:60, 20:180] = 0
    cells[20:180, 140:180] = 0
    return NavigationMap(OccupancyGrid(cells, 0.05, (0.0, 0.0)), 0.2)


def round_the_corner(speed: float = 1.0) -> TargetTrack:
    places = np.array([[2.0, 2.0], [8.0, 2.0], [8.0, 8.0]])
    return TargetTrack(np.array([0.0, 6.0, 12.0]) / speed, places)


def test_a_track_is_walked_from_point_to_point_in_time() -> None:
    track = round_the_corner()
    assert track.place_at(-5.0) == (2.0, 2.0)
    assert track.place_at(3.0) == pytest.approx((5.0, 2.0))
    assert track.place_at(9.0) == pytest.approx((8.0, 5.0))
    assert track.place_at(99.0) == (8.0, 8.0)
    assert track.arc_at(9.0) == pytest.approx(9.0)
    np.testing.assert_allclose(track.trail(5.0, 7.0), [[7, 2], [8, 2], [8, 3]])


@settings(deadline=None)
@given(st.floats(-2, 20), st.floats(0.3, 4.0))
def test_the_desired_place_is_on_the_trail_behind_the_person(time: float, distance: float) -> None:
    """Round the corner as well, where straight behind the person would be a wall."""
    navigation, track = corner_map(), round_the_corner()
    wanted = desired_state(navigation, track, time, distance)
    assert navigation.is_free(wanted.x, wanted.y)
    walked = track.arc_at(time)
    assert wanted.arc == pytest.approx(max(walked - distance, 0.0))
    assert math.dist((wanted.x, wanted.y), track.place_on(wanted.arc)) < 1e-9
    px, py = track.place_at(time)
    if math.dist((px, py), (wanted.x, wanted.y)) > 1e-6:
        assert wanted.yaw == pytest.approx(math.atan2(py - wanted.y, px - wanted.x))


def test_a_desired_place_in_a_wall_moves_to_walkable_ground() -> None:
    navigation = corner_map()
    track = TargetTrack(np.array([0.0, 6.0]), np.array([[2.0, 0.6], [8.0, 0.6]]))
    wanted = desired_state(navigation, track, 4.0)
    assert navigation.is_free(wanted.x, wanted.y)
    assert math.dist((wanted.x, wanted.y), track.place_on(wanted.arc)) < 0.7


def test_labels_change_with_the_time_and_not_with_the_end_of_the_track() -> None:
    navigation, track = corner_map(), round_the_corner()
    here = np.array([[4.0, 2.0, 0.0]])
    early = label_follow(navigation, track, here, np.array([0.0]))  # the person is behind
    late = label_follow(navigation, track, here, np.array([4.0]))  # and ahead
    assert early.waypoints[0, 1, 0] < 0 < late.waypoints[0, 1, 0]
    assert early.actions6[0].tolist() in ([2] * 6, [3] * 6)
    assert late.actions6[0].tolist() == [1, 1, 0, 0, 0, 0]  # desired: (4.5, 2)
    longer = TargetTrack(np.r_[track.times, 30.0], np.vstack([track.places, [3.0, 3.0]]))
    again = label_follow(navigation, longer, here, np.array([4.0]))
    assert again.actions6.tolist() == late.actions6.tolist()
    assert again.waypoints.tobytes() == late.waypoints.tobytes()


def test_the_way_goes_on_along_the_trail_towards_the_person() -> None:
    """1 m to the desired place, 1.5 m of trail to the person, who is round the corner."""
    navigation, track = corner_map(), round_the_corner()
    labels = label_follow(navigation, track, np.array([[6.5, 2.0, 0.0]]), np.array([7.0]))
    points = labels.waypoints[0]
    assert points[-1] == pytest.approx([1.5, 1.0], abs=1e-5)  # the person: (8, 3)
    assert labels.valid[0] in (9, 10, 11)  # a little less than 2.5 m: the corner is cut
    assert (points[labels.valid[0] :] == points[labels.valid[0] - 1]).all()


def test_at_the_desired_place_the_follower_turns_to_the_person_and_waits() -> None:
    navigation, track = corner_map(), round_the_corner()
    facing = label_follow(navigation, track, np.array([[4.5, 2.0, 0.0]]), np.array([4.0]))
    assert facing.actions6[0].tolist() == [0] * 6
    aside = label_follow(navigation, track, np.array([[4.5, 2.0, -math.pi / 4]]), np.array([4.0]))
    assert aside.actions6[0].tolist() == [2, 2, 2, 0, 0, 0]


def test_a_follower_that_obeys_keeps_up_with_a_slow_person() -> None:
    """One action of each label, half a second each, behind somebody at 0.35 m/s."""
    navigation, track = corner_map(), round_the_corner(speed=0.35)
    pose = np.array([2.0, 1.4, math.pi])
    gaps = []
    for step in range(70):
        time = 0.5 * step
        action = label_follow(navigation, track, pose[None], np.array([time])).actions6[0, :1]
        poses, cut = walk_actions(navigation, AGENT, pose, action)
        assert not cut.any()
        pose = poses[-1]
        gaps.append(math.dist(pose[:2], track.place_at(time + 0.5)))
    assert max(gaps[30:]) < 3.0 and min(gaps[30:]) > 0.5


def test_tracks_and_states_without_meaning_are_refused() -> None:
    navigation, track = corner_map(), round_the_corner()
    for times, places in (
        ([0.0, 1.0], [[0.0, 0.0]]),
        ([], np.empty((0, 2))),
        ([0.0, math.nan], [[0.0, 0.0], [1.0, 1.0]]),
        ([1.0, 0.0], [[0.0, 0.0], [1.0, 1.0]]),
    ):
        with pytest.raises(EpisodeError):
            TargetTrack(np.array(times), np.array(places))
    with pytest.raises(PlanError) as caught:
        label_follow(navigation, track, np.array([[2.0, 2.0, 0], [9.0, 0.2, 0]]), np.array([1, 2]))
    assert caught.value.where == "state 1"
    with pytest.raises(EpisodeError, match="one time"):
        label_follow(navigation, track, np.array([[2.0, 2.0, 0.0]]), np.array([1.0, 2.0]))
    walled = NavigationMap(OccupancyGrid(np.ones((9, 9), np.uint8), 0.1, (0.0, 0.0)), 0.1)
    with pytest.raises(PlanError, match="nothing is walkable"):
        desired_state(walled, track, 0.0)


def test_a_person_faces_the_way_it_walks_unless_the_track_says_where() -> None:
    track = round_the_corner()
    assert track.yaw_at(3.0) == 0.0 and track.yaw_at(6.0) == 0.0
    assert track.yaw_at(6.1) == pytest.approx(math.pi / 2) == track.yaw_at(99.0)
    turning = TargetTrack(track.times, track.places, np.radians([170.0, -170.0, 0.0]))
    assert math.degrees(turning.yaw_at(3.0)) % 360 == pytest.approx(180.0)
    assert turning.yaw_at(-1.0) == pytest.approx(math.radians(170.0))
    assert turning.yaw_at(99.0) == pytest.approx(0.0)
    assert TargetTrack(np.zeros(1), np.zeros((1, 2))).yaw_at(5.0) == 0.0
    with pytest.raises(EpisodeError, match="3 times and 2 headings"):
        TargetTrack(track.times, track.places, np.zeros(2))


@settings(deadline=None)
@given(st.floats(0, 2 * math.pi), st.floats(1.0, 2.0), st.floats(-0.5, 0.5))
def test_the_reference_is_behind_and_to_the_right_of_where_the_person_faces(
    yaw: float, distance: float, lateral: float
) -> None:
    """In open space; to the right is −90° from the front."""
    navigation = NavigationMap(
        OccupancyGrid(np.zeros((200, 200), np.uint8), 0.05, (0.0, 0.0)), 0.25
    )
    track = TargetTrack(np.zeros(1), np.array([[5.0, 5.0]]), np.array([yaw]))
    agent = (2.0, 3.0)
    wanted = reference_state(navigation, track, 0.0, agent, distance, lateral)
    off = complex(wanted.x - 5.0, wanted.y - 5.0) * complex(math.cos(-yaw), math.sin(-yaw))
    assert (off.real, off.imag) == pytest.approx((-distance, -lateral), abs=1e-9)
    assert wanted.yaw == pytest.approx(math.atan2(5.0 - 3.0, 5.0 - 2.0))


def test_a_reference_in_a_wall_or_behind_one_is_the_place_on_the_trail() -> None:
    navigation, track = corner_map(), round_the_corner()
    agent = (6.0, 2.0)
    # just past the bend: straight behind the person is the wall below the corridor
    blocked = reference_state(navigation, track, 6.5, agent, 1.5)
    assert (blocked.x, blocked.y) == pytest.approx((7.0, 2.0))
    # far to the side: free, but the inner corner stands between
    sidestep = reference_state(navigation, track, 9.0, agent, 2.0, -4.0)
    trail = desired_state(navigation, track, 9.0, 2.0)
    assert (sidestep.x, sidestep.y) == (trail.x, trail.y)
    open_way = reference_state(navigation, track, 4.0, agent, 1.5, 0.4)
    assert (open_way.x, open_way.y) == pytest.approx((4.5, 1.6))
