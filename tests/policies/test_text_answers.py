"""What NaVid, Uni-NaVid and NaVILA say, as actions; and whatever else they might say, as STOP."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from gn0.errors import ConfigError
from gn0.policies.text import (
    TEXT_PARSERS,
    find_parser,
    parse_navid,
    parse_navila,
    parse_uninavid,
)
from gn0.sim.state import Action

S, F, L, R = Action


@pytest.mark.parametrize(
    ("text", "actions"),
    [
        ("The next action is move forward 75 cm.", [F, F, F]),
        ("The next action is move forward 25 cm.", [F]),
        ("forward 500", [F, F, F]),
        ("forward 74", [F, F]),
        ("The next action is turn left 30 degrees.", [L, L]),
        ("turn left 60", [L] * 4),
        ("turn right 90 degrees", [R] * 6),
        ("turn right 360", [R] * 6),
        ("stop", [S]),
        ("do not go forward 75, stop", [S]),
        ("go forward 25, not left 30", [F]),
    ],
)
def test_navid(text: str, actions: list[Action]) -> None:
    assert parse_navid(text) == (tuple(actions), True)


@pytest.mark.parametrize(
    "text", ["", "hello", "forward", "turn left", "forward 24", "left 15", "forward -75", "Stop"]
)
def test_navid_not_understood(text: str) -> None:
    """Upstream draws a random action here; ours stops, and counts it."""
    assert parse_navid(text) == ((S,), False)


@pytest.mark.parametrize(
    ("text", "actions"),
    [
        ("forward forward left stop", [F, F, L, L, S]),
        ("right right right right", [R] * 8),
        ("stop forward", [S]),
        ("forward hop left", [F, L, L]),
        ("  left \n forward ", [L, L, F]),
    ],
)
def test_uninavid(text: str, actions: list[Action]) -> None:
    assert parse_uninavid(text) == (tuple(actions), True)


@pytest.mark.parametrize("text", ["", "hop", "Forward", "forward,left", "back back back back"])
def test_uninavid_not_understood(text: str) -> None:
    assert parse_uninavid(text) == ((S,), False)


@pytest.mark.parametrize(
    ("text", "actions"),
    [
        ("The next action is move forward 75 cm.", [F, F, F]),
        ("The next action is move forward 30 cm.", [F]),
        ("The next action is move forward 40 cm.", [F, F]),
        ("The next action is move forward 90 cm.", [F, F, F]),
        ("The next action is move forward 100 cm.", [F] * 4),
        ("The next action is move forward.", [F]),
        ("The next action is turn left 15 degree.", [L]),
        ("The next action is turn left 45 degrees.", [L] * 3),
        ("The next action is turn right 20 degrees.", [R]),
        ("The next action is turn right.", [R]),
        ("the next action IS TURN RIGHT 30 DEGREE", [R, R]),
        ("The next action is stop.", [S]),
        ("STOP", [S]),
        ("The next action is move forward 0 cm.", [F]),
    ],
)
def test_navila(text: str, actions: list[Action]) -> None:
    assert parse_navila(text) == (tuple(actions), True)


@pytest.mark.parametrize("text", ["", "move forward 25 cm", "stopping", "turn left 30 degree"])
def test_navila_not_understood(text: str) -> None:
    assert parse_navila(text) == ((S,), False)


def test_turns_are_made_of_the_agents_own_turns() -> None:
    assert parse_uninavid("left", 30.0).actions == (L,)
    assert parse_uninavid("left", 15.0).actions == (L, L)
    assert parse_uninavid("left", 10.0).actions == (L, L, L)
    assert parse_navila("is turn right 45 degree", 15.0).actions == (R, R, R)
    assert parse_navid("left 90", 30.0).actions == (L, L, L)


words = st.sampled_from(
    [
        "stop",
        "forward",
        "left",
        "right",
        "is",
        "turn",
        "move",
        "cm",
        "degrees",
        "25",
        "-30",
        "9" * 99,
    ]
)


@pytest.mark.parametrize("name", sorted(TEXT_PARSERS))
@given(text=st.text(max_size=60) | st.lists(words, max_size=12).map(" ".join))
def test_every_text_means_some_actions(name: str, text: str) -> None:
    """Never an exception, never nothing; STOP stands alone at the end; one kind of turn a word."""
    actions, understood = TEXT_PARSERS[name](text, 15.0)
    assert 1 <= len(actions) <= 64
    assert all(isinstance(action, Action) for action in actions)
    assert S not in actions[:-1]
    assert understood or actions == (S,)


def test_unknown_speakers_are_refused() -> None:
    with pytest.raises(ConfigError, match="navid"):
        find_parser("gpt")
