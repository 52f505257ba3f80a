"""Measures of following against an implementation that shares no code and no library with ours."""

from __future__ import annotations

import math
import random
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest

from gn0.bench.follow_metrics import (
    FOLLOW_METRICS,
    FollowMetrics,
    compute_follow_metrics,
    score_steps,
    summarize_following,
)
from gn0.bench.follow_record import FollowRecord
from gn0.bench.follow_recorder import FollowRecorder, count_pixels
from gn0.errors import EpisodeError
from gn0.geometry import Pose2D
from gn0.missions.follow_rules import FOLLOW, FOLLOW_EVT, FollowRules, follow_rules
from gn0_trials.judge_following import JudgedWalk, judge_following, random_walk

PAGE = Path(__file__).resolve().parents[2] / "docs" / "following.md"


def record_of(walk: JudgedWalk) -> FollowRecord:
    """The judge's walk in our own form, the person to follow last of all."""
    people = [*walk.others, walk.person]
    return FollowRecord(
        poses=np.column_stack([walk.agent, walk.heading]),
        people=np.array(people),
        actions=np.array([0 if stop else 1 for stop in walk.stops]),
        target=len(people) - 1,
        hits=np.array([0 if hit else -1 for hit in walk.hits]),
        costs=np.array(walk.costs),
        pixels=None if walk.pixels is None else np.array([*walk.other_pixels, walk.pixels]),
        picture=walk.picture,
        in_sight=None if walk.clear is None else np.array([*walk.other_clear, walk.clear]),
        step_seconds=walk.delta,
        over_at=walk.over,
        preferred=walk.preferred,
        reference_steps=walk.reference,
    )


def agree(walks: int, seed: int) -> dict[str, int]:
    """Compare both profiles on random walks to 1e-9; how often each end and value came up."""
    seen: dict[str, int] = {}
    for number in range(walks):
        walk = random_walk(random.Random(f"{seed}/{number}"))
        record = record_of(walk)
        for profile in ("default", "evt"):
            judged = judge_following(walk, profile)
            rules = follow_rules(profile)
            if judged["end"] == "":
                with pytest.raises(EpisodeError, match="the episode goes on"):
                    compute_follow_metrics(record, rules)
                seen["unfinished"] = seen.get("unfinished", 0) + 1
                continue
            ours = msgspec.structs.asdict(compute_follow_metrics(record, rules))
            assert ours.keys() == judged.keys()
            for name, value in judged.items():
                if isinstance(value, float) and isinstance(ours[name], float):
                    assert abs(ours[name] - value) <= 1e-9, (number, profile, name)
                else:
                    assert ours[name] == value, (number, profile, name)
            for key in (f"{profile} {judged['end']} {judged['success']}", *(
                name for name in ("losses", "recoveries", "wrong_person") if judged[name]
            )):  # fmt: skip
                seen[key] = seen.get(key, 0) + 1
    return seen


def test_a_thousand_random_walks_agree_to_1e_9() -> None:
    agree(1000, seed=20261126)


@pytest.mark.slow
def test_ten_thousand_random_walks_agree_to_1e_9_and_meet_every_rule() -> None:
    seen = agree(10_000, seed=20261127)
    for profile in ("default", "evt"):
        for end in ("touch False", "lost False", "over True", "over False", "steps False"):
            assert seen[f"{profile} {end}"] >= 10, seen
        assert seen[f"{profile} steps True"] >= 10, seen
    assert seen["evt stop True"] >= 10 and seen["evt stop False"] >= 10, seen
    assert min(seen["losses"], seen["recoveries"], seen["wrong_person"]) >= 1000, seen


def behind(
    distances: list[float], *, share: float | list[float] = 0.02, **more: Any
) -> FollowRecord:
    """An agent that looks along x at a person so far ahead of it; steps of 0.2 s."""
    rows = len(distances)
    poses = np.zeros((rows, 3))
    people = np.array([[(d, 0.0) for d in distances]])
    shares = np.full(rows, share) if isinstance(share, float) else np.array(share)
    given = {
        "actions": np.ones(rows - 1, np.int64),
        "pixels": np.round(shares * 10_000).astype(np.int64)[None],
        "picture": 10_000,
        "step_seconds": 0.2,
    }
    return FollowRecord(poses, people, **{**given, **more})


def test_exactly_three_metres_follow_and_more_do_not() -> None:
    scored = score_steps(behind([1.5, 3.0, 3.0001]))
    assert scored.follows.tolist() == [True, True, False] and scored.end is None


@pytest.mark.parametrize(
    ("pixels", "picture", "ours", "theirs"),
    [
        (40, 10_000, True, False),  # 0.4 %
        (39, 10_000, False, False),
        (2999, 10_000, True, False),
        (3000, 10_000, False, False),  # 30 %
        (3000, 307_200, True, False),  # EVT's is "more than"
        (3001, 307_200, True, True),
        (92_159, 307_200, True, True),
        (92_160, 307_200, False, False),
        (0, 0, False, False),
    ],
)
def test_how_large_a_person_is_faced(pixels: int, picture: int, ours: bool, theirs: bool) -> None:
    assert FOLLOW.is_faced(pixels, picture) is ours
    assert FOLLOW_EVT.is_faced(pixels, picture) is theirs


def test_twenty_far_steps_are_not_yet_lost() -> None:
    """Steps count since the last that followed, in a row or not."""
    held = compute_follow_metrics(behind([1.5] + [5.0] * 20 + [2.0] * 5, over_at=1.0))
    assert (held.end, held.success, held.steps) == ("over", False, 20)
    gone = compute_follow_metrics(behind([1.5] + [5.0] * 30))
    assert (gone.end, gone.lost, gone.steps) == ("lost", True, 21)
    # nearer than 4 m but not faced between: the count goes on
    broken = behind([1.5] + [5.0] * 10 + [3.5] * 5 + [5.0] * 30)
    assert compute_follow_metrics(broken).steps == 26
    # a step that follows between: it begins anew
    begun = behind([1.5] + [5.0] * 20 + [2.0] + [5.0] * 30)
    assert compute_follow_metrics(begun).steps == 42


def test_an_episode_ends_three_seconds_after_the_track_and_succeeds_while_following() -> None:
    good = compute_follow_metrics(behind([1.5] * 100, over_at=2.0, reference_steps=25))
    assert (good.end, good.success, good.steps) == ("over", True, 25)
    assert good.following_rate == 1.0 and good.losses == 0 and good.first_loss is None
    late = compute_follow_metrics(behind([1.5] * 20 + [3.5] * 80, over_at=2.0))
    assert (late.end, late.success) == ("over", False)


def test_three_hundred_steps_are_the_last_whatever_they_cost() -> None:
    m = compute_follow_metrics(behind([1.5] * 400))
    assert (m.end, m.success, m.steps) == ("steps", True, 300)
    long = compute_follow_metrics(behind([1.5] * 101, costs=np.full(100, 7)))
    assert (long.end, long.steps, long.following_steps) == ("steps", 301, 301)


def test_stop_ends_in_evt_alone_and_never_early() -> None:
    actions = np.ones(99, np.int64)
    actions[4] = 0
    early = behind([1.5] * 100, actions=actions, share=0.2, picture=100_000, over_at=2.0,
                   pixels=np.full((1, 100), 20_000))  # fmt: skip
    assert compute_follow_metrics(early).end == "over"
    theirs = compute_follow_metrics(early, FOLLOW_EVT)
    assert (theirs.end, theirs.steps, theirs.success) == ("stop", 5, False)
    actions = np.ones(99, np.int64)
    actions[10] = 0  # said at 2.0 s, when the track is over
    ripe = msgspec_replace(early, actions=actions)
    theirs = compute_follow_metrics(ripe, FOLLOW_EVT)
    assert (theirs.end, theirs.steps, theirs.success) == ("stop", 11, True)
    near = msgspec_replace(ripe, people=ripe.people * (0.9 / 1.5))
    assert not compute_follow_metrics(near, FOLLOW_EVT).success, "EVT wants 1.0 m"
    assert compute_follow_metrics(near).success


def msgspec_replace(record: FollowRecord, **more: Any) -> FollowRecord:
    return FollowRecord(**{**vars(record), **more})


def test_always_stop_succeeds_in_neither_profile() -> None:
    """The person walks away at 0.8 m/s from 1.5 m ahead."""
    gone = behind(
        [1.5 + 0.16 * t for t in range(100)], actions=np.zeros(99, np.int64), over_at=15.0
    )
    for rules in (FOLLOW, FOLLOW_EVT):
        m = compute_follow_metrics(gone, rules)
        assert not m.success
    assert compute_follow_metrics(gone, FOLLOW_EVT).steps == 1


def test_a_touch_is_a_cut_move_here_and_half_a_metre_in_evt() -> None:
    hits = np.full(30, -1)
    hits[9] = 0
    bumped = compute_follow_metrics(behind([1.0] * 31, hits=hits))
    assert (bumped.end, bumped.touched, bumped.success, bumped.steps) == ("touch", True, False, 10)
    near = behind([1.0] * 5 + [0.49] + [1.0] * 25, over_at=1.0)
    assert compute_follow_metrics(near).end == "over"
    theirs = compute_follow_metrics(near, FOLLOW_EVT)
    assert (theirs.end, theirs.steps) == ("touch", 5)


def test_losses_last_a_second_and_recoveries_are_timed() -> None:
    """Hidden for 0.8 s, then for 2 s, then to the end."""
    seen = [True] * 6 + [False] * 4 + [True] * 5 + [False] * 10 + [True] * 5 + [False] * 15
    record = behind(
        [1.7] * len(seen), share=[0.02 if s else 0.0 for s in seen], over_at=5.8, preferred=1.5
    )
    m = compute_follow_metrics(record)
    assert (m.losses, m.recoveries) == (2, 1)
    assert m.first_loss == pytest.approx(14 * 0.2)  # row 14 is the last before it that follows
    assert m.recovery_seconds == pytest.approx(2.0)
    assert m.distance_error == pytest.approx(0.2)
    assert m.visible_share == pytest.approx(0.02 * 15 / 44)
    never = compute_follow_metrics(behind([1.5] * 40, share=0.0, over_at=2.0))
    assert never.first_loss == 0.0 and never.recoveries == 0


def test_who_follows_somebody_else_follows_the_wrong_person() -> None:
    people = np.zeros((2, 21, 2))
    people[0, :, 0], people[1, :, 0] = 1.5, 2.0
    pixels = np.zeros((2, 21), np.int64)
    pixels[0, :6], pixels[1, 3:11] = 200, 200  # rows 6 to 10 show the other one alone
    record = FollowRecord(
        np.zeros((21, 3)), people, np.ones(20, np.int64), pixels=pixels, picture=10_000,
        step_seconds=0.2, over_at=1.0,
    )  # fmt: skip
    assert compute_follow_metrics(record).wrong_person == pytest.approx(5 / 20)
    assert compute_follow_metrics(msgspec_replace(record, target=1)).wrong_person > 0


def test_without_pictures_the_heading_and_the_walls_decide() -> None:
    people = np.tile([1.0, 1.001], (1, 21, 1))  # a hair beyond 45°
    record = FollowRecord(
        np.zeros((21, 3)), people, np.ones(20, np.int64), step_seconds=0.2, over_at=1.0
    )
    m = compute_follow_metrics(record)
    assert (m.following_steps, m.visible_share, m.by_pictures) == (0, None, False)
    assert m.bearing == pytest.approx(45.0, abs=0.1)
    ahead = msgspec_replace(record, people=np.tile([1.0, 0.5], (1, 21, 1)))
    assert compute_follow_metrics(ahead).following_steps == 20
    hidden = msgspec_replace(ahead, in_sight=np.zeros((1, 21), np.bool_))
    assert compute_follow_metrics(hidden).following_steps == 0


def test_what_comes_after_the_end_changes_nothing() -> None:
    record = behind([1.5] * 26, over_at=2.0)
    longer = behind([1.5] * 26 + [9.0] * 50, over_at=2.0)
    assert compute_follow_metrics(record) == compute_follow_metrics(longer)


def test_a_recorder_writes_down_what_a_record_holds() -> None:
    """People by their numbers, which begin anywhere; who cut the agent short, and when one came."""
    recorder = FollowRecorder(7, step_seconds=0.2, preferred=1.5, reference_steps=9, picture=100)
    for _ in range(2):  # a second episode begins with nothing of the first
        recorder.begin(Pose2D(0, 0, 0), {7: (1.5, 0.0), 3: (0.0, 2.0)}, pixels={7: 9})
        recorder.step(
            Pose2D(0.25, 0, 0), {3: (0.0, 2.0), 7: (1.6, 0.0)}, 1, cost=2, pixels={7: 8, 3: 1}
        )
        recorder.step(
            Pose2D(0.25, 0, 0), {3: (0.3, 0.4), 7: (1.7, 0.0)}, 1, hit=3, arrived=True, pixels={}
        )
        recorder.step(
            Pose2D(0.25, 0, 0.3), {3: (0.3, 0.4), 7: (1.7, 0.0)}, 2, arrived=True, pixels={}
        )
    record = recorder.record()
    assert record.people[record.target].tolist() == [[1.5, 0], [1.6, 0], [1.7, 0], [1.7, 0]]
    assert record.hits is not None and record.hits.tolist() == [-1, 1 - record.target, -1]
    assert record.times.tolist() == pytest.approx([0.0, 0.4, 0.6, 0.8])
    assert record.over_at == pytest.approx(0.6)
    assert record.pixels is not None and record.pixels[record.target].tolist() == [9, 8, 0, 0]
    assert (record.reference_steps, record.preferred, record.picture) == (9, 1.5, 100)
    assert count_pixels(np.array([[0, 7], [7, 2]]), [3, 7]) == {3: 0, 7: 2}


def test_a_record_that_breaks_off_is_invalid() -> None:
    with pytest.raises(EpisodeError, match="ends after 9 steps, and the episode goes on"):
        compute_follow_metrics(behind([1.5] * 10), where="episode 'e'")
    fewer = FollowRules(name="short", max_steps=9)
    assert compute_follow_metrics(behind([1.5] * 10), fewer).success


@pytest.mark.parametrize(
    ("field", "value", "where"),
    [
        ("poses", np.zeros((0, 3)), "actions"),
        ("people", np.zeros((1, 4, 2)), "people"),
        ("people", np.full((1, 5, 2), math.nan), "people, row 0"),
        ("actions", np.ones(5, np.int64), "actions"),
        ("target", 1, "target"),
        ("costs", np.array([1, 1, 0, 1]), "costs, row 2"),
        ("hits", np.array([-1, 1, -1, -1]), "hits, row 1"),
        ("pixels", np.array([[1, 2, 3, 4, 20_000]]), "pixels, row 4"),
        ("in_sight", np.ones((1, 4), np.bool_), "in_sight"),
        ("step_seconds", 0.0, "step_seconds"),
        ("preferred", math.nan, "preferred"),
        ("over_at", math.nan, "over_at"),
        ("reference_steps", -1, "reference_steps"),
    ],
)
def test_a_record_that_does_not_fit_is_refused_by_name(field: str, value: Any, where: str) -> None:
    with pytest.raises(EpisodeError) as caught:
        msgspec_replace(behind([1.5] * 5), **{field: value})
    assert where in str(caught.value)


def scored(**more: Any) -> FollowMetrics:
    given: dict[str, Any] = {
        "steps": 10, "reference_steps": 0, "following_steps": 10, "following_rate": 1.0,
        "success": True, "touched": False, "lost": False, "end": "over", "distance_error": 0.1,
        "bearing": 2.0, "visible_share": 0.02, "losses": 0, "first_loss": None, "recoveries": 0,
        "recovery_seconds": 0.0, "wrong_person": 0.0, "by_pictures": True,
    }  # fmt: skip
    return FollowMetrics(**{**given, **more})


def test_the_pooled_rate_weighs_steps_and_the_mean_weighs_episodes() -> None:
    short = scored(reference_steps=20, following_rate=0.5)
    long = scored(steps=180, following_steps=0, following_rate=0.0, success=False)
    found = summarize_following([short, long], ["a", "b"])
    assert found["TR_pooled"].mean == pytest.approx(10 / 200)
    assert found["TR_mean"].mean == pytest.approx(0.25)
    assert found["SR"].mean == 0.5 and found["SR"].clusters == 2
    assert found["TR_pooled"].low == 0.0 and found["TR_pooled"].high == 0.5
    assert "first_loss" not in found and "recovery_time" not in found


def test_a_measure_that_some_do_not_have_says_of_how_many_it_is() -> None:
    a = scored(losses=2, first_loss=3.0, recoveries=2, recovery_seconds=5.0)
    b = scored(losses=1, first_loss=5.0, recoveries=1, recovery_seconds=1.0)
    found = summarize_following([a, b, scored()])
    assert (found["first_loss"].mean, found["first_loss"].count) == (4.0, 2)
    assert (found["recovery_time"].mean, found["recovery_time"].count) == (2.0, 2)
    assert found["losses"].mean == 1.0 and found["losses"].count == 3
    assert summarize_following([]) == {}


def test_every_measure_is_on_the_page_and_every_row_of_the_page_is_a_measure() -> None:
    table = PAGE.read_text().split("## What comes out")[1].split("\n## ")[0]
    rows = [line for line in table.splitlines() if line.startswith("| `")]
    assert [row.split("`")[1] for row in rows] == [info.key for info in FOLLOW_METRICS]
    better = {"up": "higher", "down": "lower", "": "–"}
    for row, info in zip(rows, FOLLOW_METRICS, strict=True):
        assert row.rstrip(" |").endswith(better[info.better]), info.key
