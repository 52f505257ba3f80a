"""What replies mean: every alias of the released client, and clear refusals for the rest."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from gn0.errors import PolicyError
from gn0.geometry import Pose2D
from gn0.policies.remote.answers import build_displacement, is_stop, read_answer
from gn0.policies.text import parse_navid
from gn0.sim.state import Action

S, F, L, R = Action
DELTA = [0.25, 0.0, 0.1]


@pytest.mark.parametrize(
    "reply",
    [
        {"action_type": "discrete", "actions": [1, 1, 2]},
        {"action_type": "discrete", "actions": ["move_forward", "FWD", "<left>"]},
        {"action_type": "vln-ce", "actions": [b"forward", "Forward ", "turn_left"]},
        {"action.type": "int", "action": [1, 1, 2]},
        {"action_format": "vlnce", "action": np.array([1, 1, 2])},
        {"action.discrete": [1, 1, 2]},
        {"action.vlnce": np.array([[1, 1, 2]])},
        {"actions": [1, 1, 2]},
        {"action": ["fwd", "<fwd>", "left"]},
        {"action_type": "discrete", "actions": [1.0, True, np.int64(2)]},
        {"action_type": "", "actions": [1, 1, 2], "confidence": 0.3},
    ],
)
def test_discrete_answers(reply: dict) -> None:
    assert read_answer(reply).actions == (F, F, L)


def test_one_action_needs_no_list() -> None:
    for reply in ({"action": 3}, {"actions": "right"}, {"actions": np.int64(3)}):
        assert read_answer(reply).actions == (R,)
    assert read_answer({"actions": np.array(3)}).actions == (R,)


@pytest.mark.parametrize(
    "reply",
    [
        {"action_type": "nav_delta", "actions": [DELTA]},
        {"action_type": "nav_delta", "actions": DELTA},
        {"action_type": "relative_pose", "actions": np.array([DELTA], np.float32)},
        {"action_type": "continuous", "action": [[*DELTA, 9.0]]},
        {"action.nav_delta": [DELTA]},
        {"action.nav_delta": [np.array(DELTA)]},
        {"actions": [DELTA]},
        {"action": DELTA},
    ],
)
def test_moves_in_metres(reply: dict) -> None:
    assert read_answer(reply).actions == (tuple(np.float32(DELTA).tolist()),)


def test_an_explicit_format_overrules_the_answer() -> None:
    assert read_answer({"actions": [1, 0, 2]}, action_format="nav_delta").actions == ((1, 0, 2),)
    assert read_answer({"actions": [[1.0, 2.0, 3.0]]}, action_format="discrete").actions == (
        F,
        L,
        R,
    )


def test_rows_that_are_not_finite_are_dropped_and_counted() -> None:
    rows = [[math.nan, 0, 0], DELTA, [0, math.inf, 0], [1e39, 0, 0]]
    answer = read_answer({"action_type": "nav_delta", "actions": rows})
    assert answer.actions == (tuple(np.float32(DELTA).tolist()),) and answer.dropped == 3


@pytest.mark.parametrize(
    "reply",
    [
        {"actions": []},
        {"action_type": "nav_delta", "actions": []},
        {"action_type": "nav_delta", "actions": [[math.nan] * 3]},
        {"action_type": "nav_delta", "actions": np.zeros((0, 3))},
    ],
)
def test_no_action_at_all_is_left_to_mean_stop(reply: dict) -> None:
    assert read_answer(reply).actions == ()


@pytest.mark.parametrize(
    ("reply", "says"),
    [
        ([1, 2], "is a list"),
        (None, "is a NoneType"),
        ({}, "no actions"),
        ({"error": "CUDA out of memory"}, "CUDA out of memory"),
        ({"Actions": [1]}, "keys are Actions"),
        ({"action_type": "dance", "actions": [1]}, "dance"),
        ({"action_type": 7, "actions": [1]}, "action_type"),
        ({"actions": [4]}, "unknown action 4"),
        ({"actions": [-1]}, "unknown action -1"),
        ({"actions": ["jump"]}, "unknown action jump"),
        ({"actions": [1.5]}, "unknown action 1.5"),
        ({"actions": [2**64 - 1]}, "unknown action"),
        ({"actions": [None]}, "unknown action None"),
        ({"actions": [{}]}, "unknown action"),
        ({"actions": [[1], [1, 2]]}, "different lengths"),
        ({"actions": [1, [2]]}, "different lengths"),
        ({"actions": [1] * 5000}, "5000 actions"),
        ({"actions": np.zeros((2, 2, 3))}, "shape"),
        ({"action_type": "nav_delta", "actions": [[1.0, 2.0]]}, r"\(1, 2\)"),
        ({"action_type": "nav_delta", "actions": [1.0]}, r"\(1, 1\)"),
        ({"action_type": "nav_delta", "actions": 1.0}, "shape"),
        ({"action_type": "nav_delta", "actions": [["a", 0, 0]]}, "a in it"),
        ({"action_type": "nav_delta", "actions": [[None, 0, 0]]}, "None in it"),
        ({"action_type": "nav_delta", "actions": [[1e6, 0, 0]]}, "1e.06 m"),
        ({"action_type": "text", "text": "forward 25"}, "answers=navid"),
    ],
)
def test_other_answers_are_refused_in_words(reply: object, says: str) -> None:
    with pytest.raises(PolicyError, match=says) as caught:
        read_answer(reply)
    assert caught.value.remedy and "\n" not in str(caught.value)


def test_texts_go_to_whoever_can_read_them() -> None:
    reply = {"action_type": "text", "text": "turn left 30 degrees"}
    assert read_answer(reply, parse_text=parse_navid).actions == (L, L)
    lost = read_answer({"action_type": "text", "text": "hm"}, parse_text=parse_navid)
    assert lost.actions == (S,) and not lost.understood
    for broken in ({"action_type": "text"}, {"action_type": "text", "text": [1]}):
        with pytest.raises(PolicyError):
            read_answer(broken, parse_text=parse_navid)


def test_small_moves_are_stops() -> None:
    assert is_stop((1e-3, -1e-3, 0.0), 1e-3) and not is_stop((1.1e-3, 0.0, 0.0), 1e-3)


angles = st.floats(-3, 3)


@given(x=angles, y=angles, yaw=angles, dx=angles, dy=angles, dyaw=angles, turned=angles)
def test_moves_refer_to_the_heading_at_the_question(
    x: float, y: float, yaw: float, dx: float, dy: float, dyaw: float, turned: float
) -> None:
    """Carried out `turned` later, a move leads where the heading of the question says."""
    there = build_displacement((dx, dy, dyaw), turned).at(Pose2D(x, y, yaw + turned))
    c, s = math.cos(yaw), math.sin(yaw)
    assert there.x == pytest.approx(x + c * dx - s * dy, abs=1e-9)
    assert there.y == pytest.approx(y + s * dx + c * dy, abs=1e-9)
    assert there.yaw == pytest.approx(yaw + turned + dyaw, abs=1e-9)


def test_long_steps_and_turns_can_be_limited() -> None:
    move = build_displacement((3.0, 4.0, -2.0), 0.0, max_translation=1.0, max_yaw=0.5)
    assert (move.forward, move.left, move.turn) == pytest.approx((0.6, 0.8, -0.5))


leaves = (
    st.none()
    | st.booleans()
    | st.integers()
    | st.floats()
    | st.text(max_size=5)
    | st.binary(max_size=5)
)
things = st.recursive(
    leaves | st.builds(np.zeros, st.lists(st.integers(0, 3), max_size=3).map(tuple)),
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(st.text(max_size=3), inner),
    max_leaves=12,
)
keys = st.sampled_from(
    ["action_type", "actions", "action", "action.nav_delta", "action.discrete", "text", "error"]
)
kinds = st.sampled_from(["discrete", "nav_delta", "text", "auto", ""]) | things


@settings(max_examples=80, deadline=None)
@given(
    things
    | st.dictionaries(keys, things)
    | st.fixed_dictionaries({"action_type": kinds, "actions": things})
)
def test_any_reply_means_actions_or_is_refused(reply: object) -> None:
    try:
        answer = read_answer(reply, parse_text=parse_navid)
    except PolicyError as error:
        assert error.remedy
    else:
        for action in answer.actions:
            assert isinstance(action, Action) or all(map(math.isfinite, action))
