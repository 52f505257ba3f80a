"""Answers in words: what NaVid, Uni-NaVid and NaVILA say, as actions.

Each parser follows its policy's published evaluation code, with two differences: an answer that
cannot be read means STOP (upstream draws a random action, or fails) and is counted; and turns are
made of the agent's own turns, so that a turn of 30° is two actions, and two steps, for an agent
that turns by 15°.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from typing import NamedTuple

from gn0.errors import ConfigError
from gn0.paper import TURN_DEGREES
from gn0.sim.state import Action

TEXT_LIMIT = 20_000  # characters of an answer that are read


class TextAnswer(NamedTuple):
    """Actions out of a text.

    Attributes:
        actions: in order; a single STOP when nothing was understood.
        understood: whether the text was in the policy's own language.
    """

    actions: tuple[Action, ...]
    understood: bool


_LOST = TextAnswer((Action.STOP,), False)
_STOP = TextAnswer((Action.STOP,), True)
_NUMBER = re.compile(r"-?[0-9]+")
_TURNS = {"left": Action.LEFT, "right": Action.RIGHT}


def parse_navid(text: str, turn_degrees: float = TURN_DEGREES) -> TextAnswer:
    """What NaVid says, as in "The next action is turn left 30 degrees": one kind of action.

    The first of stop, forward, left, right (in that order of precedence) that occurs, with the
    first number in the text: min(3, N // 25) steps of 25 cm, or min(3, N // 30) turns of 30°.
    """
    text = text[:TEXT_LIMIT]
    if "stop" in text:
        return _STOP
    word = next((word for word in ("forward", "left", "right") if word in text), None)
    number = _NUMBER.search(text)
    if word is None or number is None:
        return _LOST
    amount = _small(number.group())
    count = min(3, amount // (25 if word == "forward" else 30)) if amount > 0 else 0
    if not count:
        return _LOST
    if word == "forward":
        return TextAnswer((Action.FORWARD,) * count, True)
    return TextAnswer(_turn(_TURNS[word], 30.0 * count, turn_degrees), True)


def parse_uninavid(text: str, turn_degrees: float = TURN_DEGREES) -> TextAnswer:
    """What Uni-NaVid says, as in "forward forward left stop"; other words are passed over.

    A forward is 25 cm, a turn 30°; nothing after stop counts.
    """
    actions: list[Action] = []
    for word in text[:TEXT_LIMIT].split():
        if word == "stop":
            actions.append(Action.STOP)
            break
        if word == "forward":
            actions.append(Action.FORWARD)
        elif word in _TURNS:
            actions += _turn(_TURNS[word], 30.0, turn_degrees)
    return TextAnswer(tuple(actions), True) if actions else _LOST


_NAVILA = (
    ("stop", re.compile(r"\bstop\b", re.I)),
    ("forward", re.compile(r"\bis move forward\b", re.I)),
    ("left", re.compile(r"\bis turn left\b", re.I)),
    ("right", re.compile(r"\bis turn right\b", re.I)),
)
_NAVILA_AMOUNT = {
    "forward": re.compile(r"move forward ([0-9]+) cm", re.I),
    "left": re.compile(r"turn left ([0-9]+) degree", re.I),
    "right": re.compile(r"turn right ([0-9]+) degree", re.I),
}


def parse_navila(text: str, turn_degrees: float = TURN_DEGREES) -> TextAnswer:
    """What NaVILA says, as in "The next action is move forward 75 cm": one kind of action.

    A missing number means 25 cm or 15°; one that is no multiple is the nearest of 25, 50, 75 cm or
    15, 30, 45°, the smaller on a tie.
    """
    text = text[:TEXT_LIMIT]
    word = next((word for word, pattern in _NAVILA if pattern.search(text)), None)
    if word is None:
        return _LOST
    if word == "stop":
        return _STOP
    unit = 25 if word == "forward" else 15
    found = _NAVILA_AMOUNT[word].search(text)
    amount = _small(found.group(1)) if found else unit
    if amount % unit:
        amount = min((unit, 2 * unit, 3 * unit), key=lambda known: abs(known - amount))
    count = min(max(1, amount // unit), 64)
    if word == "forward":
        return TextAnswer((Action.FORWARD,) * count, True)
    return TextAnswer(_turn(_TURNS[word], 15.0 * count, turn_degrees), True)


def _small(digits: str) -> int:
    """A number as far as it matters: what is longer than six digits is as good as 999 999."""
    return int(digits) if len(digits) <= 6 else (-1 if digits.startswith("-") else 999_999)


def _turn(action: Action, degrees: float, turn_degrees: float) -> tuple[Action, ...]:
    return (action,) * max(1, round(min(degrees, 360.0) / turn_degrees))


TEXT_PARSERS: dict[str, Callable[[str, float], TextAnswer]] = {
    "navid": parse_navid,
    "uninavid": parse_uninavid,
    "navila": parse_navila,
}


def find_parser(name: str) -> Callable[[str, float], TextAnswer]:
    """The parser of that policy's answers.

    Raises:
        ConfigError: no such parser; lists those that exist.
    """
    try:
        return TEXT_PARSERS[name]
    except (KeyError, TypeError):
        raise ConfigError(
            f"no text answers of {name!r}", remedy="known: " + ", ".join(TEXT_PARSERS)
        ) from None
