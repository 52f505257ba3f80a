"""Rewards are those that one finds by hand, and stay within their bounds."""

from __future__ import annotations

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

torch = pytest.importorskip("torch")

from gn0.data.answer_form import AnswerForm  # noqa: E402
from gn0.training.rewards import (  # noqa: E402
    PlanWalks,
    RewardWeights,
    find_readable,
    find_spoken,
    read_texts,
    score_answers,
)

STOP, FORWARD, LEFT, RIGHT = range(4)


def walks(poses, cut=()) -> PlanWalks:
    """One plan's walk; `cut` are the numbers of actions that were cut short."""
    hit = torch.zeros((1, len(poses)), dtype=torch.bool)
    hit[0, list(cut)] = True
    return PlanWalks(torch.tensor([poses], dtype=torch.float64), hit)


def plan(*actions: int):
    return torch.tensor([[*actions, *[STOP] * (6 - len(actions))]])


STRAIGHT = [(0.25 * k, 0.0, 0.0) for k in range(1, 7)]
YES = torch.tensor([True])


def test_the_references_own_answer_scores_one_and_a_half() -> None:
    plain = walks(STRAIGHT)
    six = plan(*[FORWARD] * 6)
    way = torch.rand((1, 12, 2))
    found = score_answers(plain, plain, six, six, YES, waypoints=way, wanted_waypoints=way)
    assert found.total.item() == pytest.approx(1.5)
    assert found.trajectory.item() == pytest.approx(1.0)


def test_a_wrong_plan_by_hand() -> None:
    """Half a metre aside and a quarter turn away, wrong first, half cut short, two too short."""
    aside = walks([(x, 0.5, math.pi / 2) for x, _, _ in STRAIGHT], cut=[1])
    said, wanted = plan(LEFT, FORWARD, FORWARD, LEFT), plan(*[FORWARD] * 6)
    poses = 0.5 * math.exp(-1) + 0.5 * 0.5
    found = score_answers(aside, walks(STRAIGHT), said, wanted, YES)
    assert found.trajectory.item() == pytest.approx(poses)
    assert (found.first.item(), found.collision.item()) == (0, 0.5)
    assert found.length.item() == pytest.approx(2 / 6)
    assert found.total.item() == pytest.approx(poses - 0.25 - 0.2 * 2 / 6)
    near = torch.zeros((1, 12, 2))
    off = near.clone()
    off[:, :6, 0] = 0.6  # the mean of twelve is 0.3 m
    both = score_answers(
        aside, walks(STRAIGHT), said, wanted, YES, waypoints=off, wanted_waypoints=near
    )
    assert both.trajectory.item() == pytest.approx((poses + math.exp(-1)) / 2)


def test_what_follows_a_stop_counts_for_nothing() -> None:
    there = walks([STRAIGHT[0]] * 6, cut=[3])
    said, wanted = plan(FORWARD, STOP, FORWARD, FORWARD), plan(FORWARD)
    found = score_answers(there, walks([STRAIGHT[0]] * 6), said, wanted, YES)
    assert found.total.item() == pytest.approx(1.5)


def test_an_answer_that_cannot_be_read_scores_minus_two_and_nothing_else() -> None:
    plain, six = walks(STRAIGHT, cut=[0]), plan(*[FORWARD] * 6)
    found = score_answers(plain, plain, six, six, ~YES)
    assert found.total.item() == -2
    assert found.means()["reward_format"].item() == 1
    assert found.trajectory.item() == found.first.item() == found.collision.item() == 0


def test_weights_and_scales_are_settings() -> None:
    weights = RewardWeights(first=2, collision=3, length=5, position_scale=1, format=7)
    aside = walks([(x, 1.0, 0.0) for x, _, _ in STRAIGHT], cut=range(6))
    six = plan(*[FORWARD] * 6)
    found = score_answers(aside, walks(STRAIGHT), six, six, YES, weights=weights)
    assert found.total.item() == pytest.approx(0.5 * math.exp(-1) + 0.5 + 2 - 3)
    found = score_answers(aside, aside, six, plan(FORWARD), ~YES, weights=weights)
    assert found.total.item() == -7


POSE = st.tuples(*[st.floats(-50, 50)] * 2, st.floats(-7, 7))
PLAN = st.lists(st.integers(0, 3), min_size=6, max_size=6)
POSES = st.lists(POSE, min_size=6, max_size=6)


@given(POSES, POSES, PLAN, PLAN, st.sets(st.integers(0, 5)), st.booleans())
def test_every_reward_is_within_its_bounds(one, other, said, wanted, cut, readable) -> None:
    actions = torch.tensor([said])
    hit = [k for k in cut if said[k] == FORWARD]
    found = score_answers(
        walks(one, hit), walks(other), actions, torch.tensor([wanted]), torch.tensor([readable])
    )
    terms = (found.trajectory, found.first, found.collision, found.length, found.format)
    assert all(0 <= term.item() <= 1 + 1e-12 for term in terms)
    low, high = (-0.7, 1.5) if readable else (-2, -2)
    assert low <= found.total.item() <= high + 1e-12


def test_what_is_readable_is_what_the_slots_decode(pupil, draw_states) -> None:
    answer = pupil.maker.make(draw_states(4)).answer
    slots, frame = pupil.slots, pupil.maker.frame
    assert find_readable(slots, frame, answer).all()
    assert find_spoken(slots, answer).all()
    answer[1, 0] = slots.vocabulary.actions[0]  # an action where a coordinate belongs
    answer[2, 5] = slots.vocabulary.end
    assert find_readable(slots, frame, answer).tolist() == [True, False, False, True]
    assert find_spoken(slots, answer).sum(1).tolist() == [answer.shape[1]] * 2 + [
        6, answer.shape[1],
    ]  # fmt: skip


def test_texts_are_read_strictly() -> None:
    form = AnswerForm(points=2)
    good = '{"pixel":"[[<1>,<2>],[<3>,<4>]]","vlnce":"<action>' + ",".join(["<FWD>"] * 6)
    good += '</action>"}'
    actions, tokens, readable = read_texts(form, [good, good[:-1]])
    assert readable.tolist() == [True, False]
    assert actions[0].tolist() == [FORWARD] * 6
    assert tokens[0].tolist() == [[1, 2], [3, 4]]
