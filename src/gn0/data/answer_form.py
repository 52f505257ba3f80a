"""What an answer must hold, as a list of slots: each one forced token, or a set of which one is.

A form says how many waypoints and actions an answer has, in which order and layout. Point 0 is
where the agent stands (CURRENT_PIXEL), so it is forced wherever that is known:

| task | points | slots to choose |
| --- | --- | --- |
| planning | 13 | 24 coordinates, 6 actions |
| following a person | 7 | 12 coordinates, 6 actions |
| first-person views only | 0 | 6 actions |

The compact layout leaves point 0 out, since the prompt holds it: 32 tokens for planning, instead of
about 105 as JSON; with `current_said` it is written, 34 tokens, and the text reads by itself.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Annotated, Literal, NamedTuple

import msgspec

from gn0.config import Config
from gn0.data.codec import (
    ACTION_BEGIN,
    ACTION_END,
    ACTION_TOKENS,
    NAVIGATION_TOKENS,
    Answer,
    AnswerLayout,
    AnswerOrder,
    parse_answer,
    write_answer,
)
from gn0.errors import ConfigError, FormatError
from gn0.paper import ACTIONS_AHEAD, MAP_BINS, POINTS, TRACKING_POINTS

Role = Literal["mark", "x", "y", "action"]
COORDINATES = NAVIGATION_TOKENS[:MAP_BINS]
POINTS_OF = {"planning": POINTS, "tracking": TRACKING_POINTS, "views": 0}
"""Waypoints of an answer, by task; none where no map is shown."""


class Slot(NamedTuple):
    """One place of an answer.

    Attributes:
        role: a mark is fixed text (brackets, keys, commas); x and y are a point's; an action.
        number: of the point or the action; -1 of a mark.
        choices: the texts that may stand here; one is forced.
    """

    role: Role
    number: int
    choices: tuple[str, ...]

    @property
    def forced(self) -> bool:
        """Whether there is nothing to choose."""
        return len(self.choices) == 1


class AnswerForm(Config, frozen=True):
    """How answers are written: part of a checkpoint's settings.

    Attributes:
        points: waypoints, the agent's own place included; 0 for none.
        actions: next actions.
        order: what comes first, the waypoints (paper) or the actions (actions_first).
        layout: JSON, or the tokens alone (compact).
        current_said: compact only: point 0 is written, though the prompt holds it.
    """

    points: Annotated[int, msgspec.Meta(ge=0, le=64)] = POINTS
    actions: Annotated[int, msgspec.Meta(ge=1, le=64)] = ACTIONS_AHEAD
    order: AnswerOrder = "paper"
    layout: AnswerLayout = "json"
    current_said: bool = False

    def __post_init__(self) -> None:
        if self.layout == "json" and self.current_said:  # one way to say it: JSON always says it
            msgspec.structs.force_setattr(self, "current_said", False)
        if self.points == 1:
            raise ConfigError(
                "an answer of one point says nothing: it is where the agent stands",
                where="points",
                remedy="give 0, or 2 and more",
            )

    @property
    def first_point(self) -> int:
        """Number of the first point that is written: 1 where point 0 is left out."""
        return int(bool(self.points) and self.layout == "compact" and not self.current_said)

    def slots(self, current: Sequence[int] | None = None) -> tuple[Slot, ...]:
        """The slots in order; the texts of any choices, joined, are an answer that is read.

        Args:
            current: map tokens (x, y) of where the agent stands, which point 0 is forced to; None
                leaves it to choose.

        Raises:
            ConfigError: `current` is no pair of 0 to 999.
        """
        place = None if current is None else _check_pair(current)
        spoken, way = list(self._spoken()), list(self._way(place))
        if self.layout == "compact":
            halves = [way, spoken]
        else:
            halves = [[_mark('"vlnce":"'), *spoken, _mark('"')]]
            if way:
                halves.insert(0, [_mark('"pixel":"['), *way, _mark(']"')])
        if self.order == "actions_first":
            halves.reverse()
        if self.layout == "compact":
            return tuple(slot for half in halves for slot in half)
        slots = [_mark("{")]
        for index, half in enumerate(halves):
            slots += [_mark(",")] * (index > 0) + half
        return tuple(_join_marks([*slots, _mark("}")]))

    def _spoken(self) -> Iterator[Slot]:
        yield _mark(ACTION_BEGIN)
        for index in range(self.actions):
            if index and self.layout == "json":
                yield _mark(",")
            yield Slot("action", index, ACTION_TOKENS)
        yield _mark(ACTION_END)

    def _way(self, current: tuple[int, int] | None) -> Iterator[Slot]:
        for index in range(self.first_point, self.points):
            known = current is not None and index == 0
            x, y = (
                ((COORDINATES[value],) for value in current)
                if known and current is not None
                else (COORDINATES, COORDINATES)
            )
            if self.layout == "compact":
                yield from (Slot("x", index, x), Slot("y", index, y))
                continue
            yield _mark(",[" if index else "[")
            yield from (Slot("x", index, x), _mark(","), Slot("y", index, y), _mark("]"))

    def write(self, answer: Answer) -> str:
        """The text of an answer.

        Raises:
            ConfigError: it has another number of points or actions, or values without meaning.
        """
        points = len(answer.tokens or ())
        if (points, len(answer.actions)) != (self.points, self.actions):
            raise ConfigError(
                f"an answer of {points} points and {len(answer.actions)} actions",
                remedy=f"this form has {self.points} and {self.actions}",
            )
        tokens = None if answer.tokens is None else answer.tokens[self.first_point :]
        return write_answer(answer.actions, tokens or None, order=self.order, layout=self.layout)

    def read(self, text: str, current: Sequence[int] | None = None) -> Answer:
        """Read a text of this form, strictly: what the slots can make, and nothing else.

        Args:
            text: the answer; white space around it is forgiven.
            current: map tokens (x, y) of where the agent stands: point 0 must be it, or is added
                where the form leaves it out.

        Raises:
            FormatError: the text is anything else; says what.
            ConfigError: the form leaves point 0 out, and `current` is not given.
        """
        written = self.points - self.first_point
        found = parse_answer(
            text, points=written, actions=self.actions, order=self.order, layout=self.layout
        )
        place = None if current is None else _check_pair(current)
        if not self.points:
            return found
        if self.first_point:
            return Answer(found.actions, (_needed(place), *(found.tokens or ())))
        if place is not None and found.tokens is not None and found.tokens[0] != place:
            raise FormatError(
                f"point 0 is {found.tokens[0]}, the agent stands at {place}",
                field="pixel",
                remedy="see docs/labels.md",
            )
        return found

    def convert(self, text: str, target: AnswerForm, current: Sequence[int] | None = None) -> str:
        """The same answer in another form; nothing is lost between forms of as many points.

        Raises:
            FormatError: the text is not of this form.
            ConfigError: `target` has another number of points or actions, or it leaves point 0 out
                where that is not `current`.
        """
        answer = self.read(text) if not self.first_point else self.read(text, current)
        if target.first_point and not self.first_point and answer.tokens is not None:
            place = _needed(None if current is None else _check_pair(current))
            if answer.tokens[0] != place:
                raise ConfigError(
                    f"point 0 is {answer.tokens[0]}, which would be lost: the agent is at {place}",
                    remedy="convert to a form with current_said=True",
                )
        return target.write(answer)


def _needed(place: tuple[int, int] | None) -> tuple[int, int]:
    if place is None:
        raise ConfigError(
            "a compact answer leaves point 0 out", remedy="give current=, which the prompt holds"
        )
    return place


def _check_pair(current: Sequence[int]) -> tuple[int, int]:
    pair = tuple(int(value) for value in current)
    if len(pair) != 2 or not all(0 <= value < MAP_BINS for value in pair):
        raise ConfigError(f"no place on the map: {pair}", remedy="give a pair of 0 to 999")
    return pair[0], pair[1]


def _mark(text: str) -> Slot:
    return Slot("mark", -1, (text,))


def _join_marks(slots: Sequence[Slot]) -> Iterator[Slot]:
    """Fixed text between two navigation tokens as one mark, as a tokenizer sees it."""
    held = ""
    for slot in slots:
        plain = slot.role == "mark" and slot.choices[0] not in (ACTION_BEGIN, ACTION_END)
        if plain:
            held += slot.choices[0]
            continue
        if held:
            yield _mark(held)
            held = ""
        yield slot
    if held:
        yield _mark(held)
