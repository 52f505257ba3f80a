"""Followers: boxes and what they say, two controllers, the oracle, and the floors below them."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from gn0.bench.follow_metrics import compute_follow_metrics, score_steps, summarize_following
from gn0.data.follow import TargetTrack
from gn0.data.follow_oracle import FollowOracle, FollowTask, choose_following, people_map
from gn0.errors import PolicyError
from gn0.geometry import Pose2D
from gn0.maps.navigation import NavigationMap
from gn0.policies.box_follower import BoxFollower, BoxGains, PolicyBoxFollower, steer
from gn0.policies.follow_floors import PolicyAlwaysStop, StraightAtPerson
from gn0.policies.person_boxes import PersonBox, PictureView, find_boxes, looks_apart
from gn0.policies.person_tracker import PersonTracker, Sighting
from gn0.sim.state import Action, Observation
from gn0_trials.follow_stage import (
    BODY,
    HEIGHT,
    HFOV,
    WIDTH,
    Stage,
    corridor_stage,
    flat_map,
    walked,
)

RED = ((200, 40, 40), (40, 40, 120))
GREEN = ((40, 150, 60), (90, 80, 70))
VIEW = PictureView(WIDTH, HEIGHT, HFOV, 1.3)
SPEEDS = (0.4, 0.6, 0.8, 1.0)
Choose = Callable[[Stage], Action]


def follow_boxes() -> Choose:
    follower = BoxFollower(VIEW, BODY)
    return lambda stage: follower.act(
        find_boxes(*stage.look()), stage.pose, stage.time, stage.ranges(), stage.collided
    )


def follow_all_knowing(stage: Stage) -> Choose:
    oracle = FollowOracle(stage.navigation, FollowTask(stage.tracks[0]))
    return lambda now: oracle.act(now.pose, now.time, now.places(now.time)[1:])


def run_at_person(navigation: NavigationMap | None = None) -> Choose:
    runner = StraightAtPerson(navigation)
    return lambda stage: runner.act(stage.pose, stage.places(stage.time)[0], stage.collided)


def somebody(ahead: float, left: float, look: tuple = RED) -> Stage:  # type: ignore[type-arg]
    """One who stands there, seen by an agent in the middle of a room."""
    place = [(3.0 + ahead, 3.5 + left)]
    stage = Stage(
        flat_map(), [TargetTrack(np.zeros(1), np.array(place))], Pose2D(3, 3.5, 0), [look]
    )
    stage.pose, stage.time, stage.collided = stage.start, 0.0, False
    return stage


def test_boxes_are_around_people_and_do_not_say_who_they_are() -> None:
    people = np.zeros((20, 30), np.uint8)
    people[2:12, 20:26] = 3
    people[5:15, 4:8] = 9
    people[18, 28] = 5  # a speck
    rgb = np.zeros((20, 30, 3), np.uint8)
    rgb[:7, 20:26], rgb[7:, 20:26] = (200, 0, 0), (0, 0, 100)
    left, right = find_boxes(people, rgb)
    assert (left.left, left.top, left.right, left.bottom, left.pixels) == (4, 5, 8, 15, 40)
    assert (right.left, right.right) == (20, 26)
    # CIE L*a*b* (D65) of sRGB (200, 0, 0) and (0, 0, 100), by hand
    assert right.look == pytest.approx((41.7, 66.7, 56.0, 8.3, 39.8, -54.3), abs=0.1)
    darker = (30.0, 64.1, 54.3, 9.9, 37.1, -54.3)
    assert looks_apart(right.look, darker) < looks_apart(right.look, (41.9, 0, 54.3, 9.9, 37, -54))
    renamed = np.array([0, 1, 2, 1, 0, 7, 0, 0, 0, 2], np.uint8)[people]
    assert find_boxes(renamed, rgb) == [left, right]
    assert find_boxes(np.zeros((4, 4), np.uint8)) == []


@given(st.floats(1.0, 2.8), st.floats(-0.35, 0.35))
@settings(deadline=None, max_examples=40)
def test_a_box_says_where_somebody_stands(ahead: float, part: float) -> None:
    stage = somebody(ahead, ahead * part)
    (box,) = find_boxes(*stage.look())
    away = math.hypot(ahead, ahead * part)
    assert VIEW.bearing(box) == pytest.approx(math.atan(part), abs=0.03)
    assert VIEW.distance(box, stage.tall) == pytest.approx(away, rel=0.15)
    tall = VIEW.tall(box)
    assert (tall is None) == (ahead < 1.86) or abs(ahead - 1.86) < 0.1  # feet below the picture
    assert tall is None or tall == pytest.approx(stage.tall, abs=0.06)


def test_the_controllers_turn_walk_and_stand() -> None:
    def at(degrees: float, distance: float) -> Action:
        seen = Sighting((0, 0), 0.0, (), (), bearing=math.radians(degrees), distance=distance)
        return steer(seen, BoxGains(distance=1.5), BODY)

    assert at(0, 1.5) == at(7, 1.6) == at(0, 0.6) == Action.STOP
    assert at(8, 1.5) == at(30, 3.0) == Action.LEFT and at(-8, 1.5) == Action.RIGHT
    assert at(0, 1.7) == Action.FORWARD
    assert at(20, 3.0) == Action.FORWARD, "far off it walks first"
    leaving = Sighting((0, 0), 0.0, (), (), distance=1.5, leaving=1.0)
    assert steer(leaving, BoxGains(distance=1.5), BODY) == Action.FORWARD, (
        "before the distance has grown"
    )


def box_at(left: int, look: tuple[float, ...]) -> PersonBox:
    return PersonBox(left, 40, left + 20, 110, 900, look)


def test_it_takes_who_is_ahead_then_who_is_where_it_was_then_who_looks_like_it() -> None:
    red, green = (42.0, 62, 40, 20, 20, -40), (55.0, -45, 35, 35, 2, 5)
    here = Pose2D(0, 0, 0)
    ahead, aside = box_at(70, red), box_at(10, green)
    tracker = PersonTracker(VIEW)
    assert tracker.choose([aside, ahead], here, 0.0) == ahead
    assert tracker.look([ahead], here, 0.0) == ahead
    assert tracker.choose([box_at(10, red), box_at(72, red)], here, 0.2) == box_at(72, red)
    assert tracker.choose([box_at(70, green)], here, 0.2) is None, "somebody else stepped in"
    assert tracker.choose([box_at(70, green), box_at(10, red)], here, 3.0) == box_at(10, red)
    assert tracker.choose([], here, 0.2) is None
    turned = Pose2D(0, 0, math.radians(15))  # the agent turned left: the box moves to the right
    moved = box_at(70 + round(WIDTH / 2 / math.tan(math.radians(HFOV / 2)) * math.tan(0.262)), red)
    assert tracker.choose([box_at(70, red), moved], turned, 0.2) == moved


def test_after_a_loss_it_cannot_tell_look_alikes_apart() -> None:
    """Boxes and colours, no numbers: whoever looks the same is taken, wherever that is."""
    red = (42.0, 62, 40, 20, 20, -40)
    tracker = PersonTracker(VIEW)
    tracker.look([box_at(70, red)], Pose2D(0, 0, 0), 0.0)
    stranger = box_at(120, red)
    assert tracker.choose([stranger], Pose2D(0, 0, 0), 0.2) is None, "nobody is so quick"
    assert tracker.choose([stranger], Pose2D(9, 9, 3), 5.0) == stranger


def test_clothes_are_its_person_s_in_another_light() -> None:
    """As from a bedroom by day into a hallway by lamps; after a loss in either light."""
    tracker, here = PersonTracker(VIEW), Pose2D(0.0, 0.0, 0.0)

    def lit(warm: float) -> PersonBox:
        return box_at(70, (40.0, 0.0, warm - 10.0) * 2)

    for k in range(31):
        assert tracker.look([lit(k)], here, 0.2 * k) is not None, k
    for warm, found in ((0.0, True), (30.0, True), (60.0, False)):
        assert (tracker.choose([lit(warm)], here, 20.0) is not None) == found


def test_it_looks_for_who_went_round_a_corner_where_it_was_last_seen() -> None:
    """The person has left for good: the agent goes to where it was, and turns to where it went."""
    stage = corridor_stage(1.0)
    gone = stage.tracks[0]
    corner = next(k for k, place in enumerate(gone.places) if place[1] > 5.0)
    follower, seen = BoxFollower(VIEW, BODY), []

    def choose(now: Stage) -> Action:
        boxes = find_boxes(*now.look()) if now.places(now.time)[0][1] < 4.2 else []
        seen.append(bool(boxes))
        return follower.act(boxes, now.pose, now.time, now.ranges(), now.collided)

    record = stage.play(choose)
    assert corner and seen[5] and not seen[-1]
    last = record.people[0][max(k for k, there in enumerate(seen) if there)]
    near = np.hypot(*(record.poses[:, :2] - last).T).min()
    assert near < 0.6, "it went there"
    assert record.poses[:, 1].max() > last[1] + 0.5, "and on, up the corridor"


@pytest.mark.parametrize("speed", SPEEDS)
def test_the_box_follower_keeps_to_somebody_round_two_bends(speed: float) -> None:
    m = compute_follow_metrics(corridor_stage(speed).play(follow_boxes()))
    assert m.success and not m.touched and m.following_rate >= 0.8
    assert m.distance_error < 0.6 and m.recoveries == m.losses


def test_the_oracle_follows_all_speeds_and_touches_nobody() -> None:
    scores = []
    for seed, speed in enumerate((0.6, 1.0)):
        for others in (0, 3):
            stage = corridor_stage(speed, others, seed=seed)
            scores.append(compute_follow_metrics(stage.play(follow_all_knowing(stage))))
    found = summarize_following(scores)
    assert found["SR"].mean == 1.0 and found["CR"].mean == 0.0
    assert found["TR_pooled"].mean >= 0.95 and found["distance_error"].mean < 0.25
    alone = summarize_following(scores[::2])
    assert alone["TR_pooled"].mean >= 0.98


def test_the_oracle_goes_round_somebody_who_stands_in_the_corridor() -> None:
    stage = corridor_stage(0.8)
    standing = TargetTrack(np.zeros(1), np.array([[8.0, 3.25]]))
    stage.tracks.append(standing)
    stage.tracks[0] = walked([(3.0, 3.5), (7.0, 3.5), (8.0, 3.95), (9.0, 3.9), (10.2, 4.2),
                              (10.2, 9.0), (14.0, 9.4)], 0.8)  # fmt: skip
    stage.looks.append(GREEN)
    record = stage.play(follow_all_knowing(stage))
    m = compute_follow_metrics(record)
    assert m.success and m.following_rate >= 0.9
    assert np.hypot(*(record.poses[:, :2] - [8.0, 3.25]).T).min() >= 0.5


def test_the_floors() -> None:
    """Who stands is left behind in both profiles' terms; who runs touches, every time."""
    for seed, speed in enumerate(SPEEDS):
        stage = corridor_stage(speed, 2, seed=seed)
        stood = compute_follow_metrics(stage.play(lambda _: Action.STOP))
        assert not stood.success and stood.following_rate < 0.2
        for navigation in (None, stage.navigation):
            ran = compute_follow_metrics(stage.play(run_at_person(navigation)))
            assert ran.touched and not ran.success
    assert PolicyAlwaysStop().act(Observation(step=0, time=0.0, instruction="")) == Action.STOP


def test_look_alikes_lead_the_box_follower_astray() -> None:
    """Others who wear the same are taken for the person more often than others who do not."""
    wrong = [
        [
            compute_follow_metrics(
                corridor_stage(SPEEDS[s % 4], 3, alike=alike, seed=s).play(follow_boxes())
            ).wrong_person
            for s in (0, 2, 3, 6)
        ]
        for alike in (False, True)
    ]
    assert np.mean(wrong[1]) > np.mean(wrong[0]) + 0.1


def test_the_oracle_steps_on_nobody_and_follows_on_when_they_have_passed() -> None:
    """The person walks off along x; another stands in the way, or beside it, or walks off."""
    navigation = flat_map()
    task = FollowTask(walked([(3.5, 3.5), (6.0, 3.5)], 0.9))
    here = Pose2D(2.0, 3.5, 0.0)

    def says(*others: tuple[float, float, float, float]) -> Action:
        return choose_following(navigation, task, here, 1.0, others)

    assert says() == Action.FORWARD
    assert says((2.62, 3.5, 0.0, 0.0)) != Action.FORWARD
    assert says((2.4, 4.0, 0.0, 0.0)) != Action.FORWARD
    assert says((2.4, 4.0, 0.0, 1.0)) == Action.FORWARD, "who leaves makes room"
    assert says((1.3, 3.5, 0.0, 0.0)) == Action.FORWARD, "behind it"
    barred = choose_following(navigation, task, here, 1.0, barred=True)
    assert barred != Action.FORWARD


def test_people_on_a_map_are_obstacles_for_the_agents_disc() -> None:
    bare = flat_map()
    crowded = people_map(bare, [(3.0, 3.5)], 0.3)
    assert bare.is_free(3.0, 3.5) and bare.is_free(3.5, 3.5)
    assert not crowded.is_free(3.5, 3.5) and crowded.is_free(3.65, 3.5)
    assert people_map(bare, [], 0.3).inflated.cells.tobytes() == bare.inflated.cells.tobytes()


def test_the_policy_reads_pictures_and_refuses_what_does_not_fit() -> None:
    stage = somebody(2.4, 0.0)
    people, rgb = stage.look()
    policy = PolicyBoxFollower("follower_small")
    policy.reset("Follow her.", np.random.default_rng(0))
    more = {"pose": stage.pose, "ranges": stage.ranges().astype(np.float32)}
    seen = Observation(step=0, time=0.0, instruction="", rgb=rgb, more={"who": people}, **more)
    assert policy.act(seen) == Action.FORWARD
    blank = Observation(step=0, time=0.0, instruction="", rgb=rgb)
    with pytest.raises(PolicyError, match="person picture"):
        policy.act(blank)
    bare = Observation(step=0, time=0.0, instruction="", rgb=rgb, more={"who": people})
    with pytest.raises(PolicyError, match="pose and ranges"):
        policy.act(bare)
    policy.reset("Follow her.", np.random.default_rng(0))
    nobody = Observation(
        step=0, time=0.0, instruction="", rgb=rgb, more={"who": np.zeros_like(people)}, **more
    )
    assert policy.act(nobody) == Action.STOP


@pytest.mark.parametrize("distance", [0.1, -1, 1e9, float("nan"), "nan", None, True])
def test_a_distance_that_nobody_keeps_is_refused(distance: object) -> None:
    with pytest.raises(PolicyError, match="keeps a distance of") as caught:
        PolicyBoxFollower(distance=distance)  # type: ignore[arg-type]
    assert "0.5 to 5" in caught.value.remedy


def test_the_same_walk_twice() -> None:
    a, b = (corridor_stage(0.8, 3, seed=1).play(follow_boxes()) for _ in range(2))
    np.testing.assert_array_equal(a.poses, b.poses)
    assert score_steps(a).follows.tolist() == score_steps(b).follows.tolist()


def test_the_oracle_waits_with_a_person_who_is_held_up() -> None:
    """The person stands for 4 s in the middle of its way; its track knows nothing of that."""
    stage = corridor_stage(0.8)
    track = stage.tracks[0]
    late = TargetTrack(
        np.r_[track.times[:1], 3.0, 7.0, track.times[1:] + 4.0],
        np.vstack([track.places[:1], track.place_at(3.0), track.place_at(3.0), track.places[1:]]),
    )
    stage.tracks[0] = late
    oracle = FollowOracle(stage.navigation, FollowTask(track))
    m = compute_follow_metrics(
        stage.play(lambda now: oracle.act(now.pose, now.time, [], now.places(now.time)[0]))
    )
    assert m.success and m.following_rate >= 0.98 and m.distance_error < 0.3
