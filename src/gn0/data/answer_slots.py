"""Answers in the ids of a tokenizer: targets, masks, a decoder that allows what may be said.

All answers of a form have as many tokens, so a batch is one array [N, S]. Most slots are forced:
a decoder feeds those runs at once and asks the model for the rest, 30 of them for planning.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from gn0.data.answer_form import AnswerForm
from gn0.data.codec import NAVIGATION_TOKENS, Answer
from gn0.data.navigation_vocabulary import NavigationVocabulary, TextTokenizer
from gn0.errors import ConfigError, FormatError
from gn0.paper import MAP_BINS

I32 = NDArray[np.int32]
MARK, X, Y, ACTION, END = range(5)
"""Kinds of slots: fixed text, a point's coordinates, an action, the end of the answer."""

FREE = -1  # of forced ids: there is something to choose
_KIND_OF = {"mark": MARK, "x": X, "y": Y, "action": ACTION}


@dataclass(frozen=True, eq=False)
class AnswerSlots:
    """The slots of a form in the ids of a vocabulary.

    Attributes:
        form: the form.
        vocabulary: the ids.
        ids: [S] the forced id of each slot, or FREE; point 0 counts as free here.
        kinds: [S] MARK, X, Y, ACTION or END.
        index: [S] number of the point or action; -1 of marks.
    """

    form: AnswerForm
    vocabulary: NavigationVocabulary
    ids: I32
    kinds: NDArray[np.int8]
    index: NDArray[np.int8]

    def __len__(self) -> int:
        return len(self.ids)

    @cached_property
    def chosen(self) -> NDArray[np.bool_]:
        """[S] whether a slot is chosen where point 0 is known."""
        point_0 = (self.kinds <= Y) & (self.index == 0) & (self.kinds != MARK)
        return (self.ids == FREE) & ~point_0

    def allowed(self, slot: int) -> I32:
        """The ids that may stand in a slot, rising."""
        if self.ids[slot] != FREE:
            return self.ids[slot : slot + 1]
        if self.kinds[slot] == ACTION:
            return np.sort(np.array(self.vocabulary.actions, np.int32))
        begin = self.vocabulary.number
        return np.arange(begin, begin + MAP_BINS, dtype=np.int32)

    def forced(self, current: NDArray[np.integer] | Sequence[int] | None = None) -> I32:
        """[N, S] the forced ids of N answers, FREE where there is something to choose.

        Args:
            current: [N, 2] map tokens of where the agents stand, or one pair; None leaves point 0
                free in one row.

        Raises:
            ConfigError: they are no pairs of 0 to 999.
        """
        if current is None:
            return self.ids[None].copy()
        places = _check_places(current)
        ids = np.repeat(self.ids[None], len(places), axis=0)
        for axis, kind in enumerate((X, Y)):
            at = np.flatnonzero((self.kinds == kind) & (self.index == 0))
            ids[:, at] = places[:, axis, None] + self.vocabulary.number
        return ids

    def mask(self) -> NDArray[np.bool_]:
        """[S, rows] the rows of the model's output that may be chosen in each slot.

        Padded rows, which stand for no token, are never among them.
        """
        found = np.zeros((len(self), self.vocabulary.rows), bool)
        for slot in range(len(self)):
            found[slot, self.allowed(slot)] = True
        return found

    def encode(
        self, actions: NDArray[np.integer], tokens: NDArray[np.integer] | None = None
    ) -> I32:
        """Ids [N, S] of answers.

        Args:
            actions: [N, A] codes 0 to 3.
            tokens: [N, P, 2] map tokens; more points than the form has are cut off.

        Raises:
            ConfigError: other shapes, or values without meaning.
        """
        said = np.atleast_2d(np.asarray(actions))
        ids = np.repeat(self.ids[None], len(said), axis=0)
        if said.shape[1] != self.form.actions or ((said < 0) | (said > 3)).any():
            raise ConfigError(
                f"actions of shape {list(said.shape)}",
                remedy=f"give [N, {self.form.actions}] codes 0 to 3",
            )
        ids[:, self.kinds == ACTION] = np.array(self.vocabulary.actions, np.int32)[said]
        if not self.form.points:
            return ids
        way = np.asarray(tokens if tokens is not None else np.zeros((0, 0, 2)))
        if way.shape[:1] != said.shape[:1] or way.shape[1] < self.form.points:
            raise ConfigError(
                f"map tokens of shape {list(way.shape)}",
                remedy=f"give [{len(said)}, {self.form.points}, 2]",
            )
        way = way[:, self.form.first_point : self.form.points]
        if ((way < 0) | (way >= MAP_BINS)).any():
            raise ConfigError("a map token outside 0 to 999", remedy="label the samples again")
        for axis, kind in enumerate((X, Y)):
            ids[:, self.kinds == kind] = way[..., axis] + self.vocabulary.number
        return ids

    def decode(
        self, ids: NDArray[np.integer], current: NDArray[np.integer] | None = None
    ) -> tuple[NDArray[np.int8], NDArray[np.int16] | None]:
        """Actions [N, A] and map tokens [N, P, 2] (None without points) of ids [N, S].

        Args:
            ids: of whole answers.
            current: [N, 2] map tokens of where the agents stand, which point 0 must be; needed
                where the form leaves it out.

        Raises:
            FormatError: an id that may not stand in its slot; names row and slot.
            ConfigError: `current` is missing.
        """
        given = np.atleast_2d(np.asarray(ids))
        if given.shape[1] != len(self):
            raise FormatError(
                f"{given.shape[1]} tokens, expected {len(self)}", remedy="see docs/labels.md"
            )
        forced = self.forced(current)
        wrong = (forced != FREE) & (given != forced)
        numbers = given - self.vocabulary.number
        coordinate = (self.kinds == X) | (self.kinds == Y)
        wrong |= coordinate & ((numbers < 0) | (numbers >= MAP_BINS))
        codes = np.full(given.shape, -1, np.int8)
        for code, own in enumerate(self.vocabulary.actions):
            codes[given == own] = code
        wrong |= (self.kinds == ACTION) & (codes < 0)
        if wrong.any():
            row, slot = (int(value) for value in np.argwhere(wrong)[0])
            raise FormatError(
                f"id {int(given[row, slot])} may not stand in slot {slot} of answer {row}",
                field=("mark", "x", "y", "action", "end")[int(self.kinds[slot])],
                remedy="see docs/labels.md",
            )
        actions = codes[:, self.kinds == ACTION]
        if not self.form.points:
            return actions, None
        way = np.stack([numbers[:, self.kinds == kind] for kind in (X, Y)], axis=-1)
        if self.form.first_point:
            if current is None:
                raise ConfigError(
                    "compact answers leave point 0 out", remedy="give current=, [N, 2]"
                )
            way = np.concatenate([_check_places(current)[:, None], way], axis=1)
        return actions, way.astype(np.int16)

    def decoder(self, current: Sequence[int] | None = None) -> AnswerDecoder:
        """A decoder of one answer, at its first token."""
        return AnswerDecoder(self, current)


class AnswerDecoder:
    """Which tokens may come next: the state of one answer while it is written.

    It accepts exactly the texts that the strict parser reads in this form.

    Args:
        slots: the slots.
        current: map tokens (x, y) of where the agent stands, which point 0 is forced to.
    """

    def __init__(self, slots: AnswerSlots, current: Sequence[int] | None = None) -> None:
        self.slots = slots
        self.ids: list[int] = []
        self._current = current
        self._forced: list[int] = slots.forced(current)[0].tolist()

    @property
    def done(self) -> bool:
        """Whether the answer is whole."""
        return len(self.ids) == len(self._forced)

    def allowed(self) -> I32:
        """Ids that may come next, rising; none behind the last."""
        if self.done:
            return np.zeros(0, np.int32)
        forced = self._forced[len(self.ids)]
        if forced != FREE:
            return np.array([forced], np.int32)
        return self.slots.allowed(len(self.ids))

    def forced_run(self) -> list[int]:
        """The ids from here to the next choice, or to the end; may be fed to a model at once."""
        run = []
        for own in self._forced[len(self.ids) :]:
            if own == FREE:
                break
            run.append(own)
        return run

    def accept(self, token: int) -> None:
        """Go on by a token.

        Raises:
            FormatError: it may not come here.
        """
        allowed = self.allowed()
        at = int(np.searchsorted(allowed, token))
        if at == len(allowed) or int(allowed[at]) != token:
            raise FormatError(
                f"token {token} may not come at place {len(self.ids)} of {len(self._forced)}",
                remedy="choose one of allowed()",
            )
        self.ids.append(int(token))

    def answer(self) -> Answer:
        """What was said.

        Raises:
            FormatError: the answer is not whole.
            ConfigError: the form leaves point 0 out, and it was not given.
        """
        current = None if self._current is None else np.array([self._current])
        actions, tokens = self.slots.decode(np.array([self.ids]).reshape(1, -1), current)
        way = None if tokens is None else tuple((int(x), int(y)) for x, y in tokens[0])
        return Answer(tuple(actions[0].tolist()), way)


def compile_slots(
    form: AnswerForm, vocabulary: NavigationVocabulary, tokenizer: TextTokenizer
) -> AnswerSlots:
    """The slots of a form, with fixed text as the tokenizer splits it.

    Raises:
        FormatError: the tokenizer splits a whole answer in another way than its parts.
    """
    ids: list[int] = []
    kinds: list[int] = []
    index: list[int] = []
    sample: list[int] = []
    text = ""
    navigation = frozenset(NAVIGATION_TOKENS)
    for slot in form.slots():
        text += slot.choices[0]
        if slot.role != "mark":
            own = [FREE]
            sample.append(vocabulary.id_of(slot.choices[0]))
        elif slot.choices[0] in navigation:
            own = [vocabulary.id_of(slot.choices[0])]
            sample += own
        else:
            own = list(tokenizer.encode(slot.choices[0]))
            sample += own
        ids += own
        kinds += [_KIND_OF[slot.role]] * len(own)
        index += [slot.number] * len(own)
    if list(tokenizer.encode(text)) != sample:
        raise FormatError(
            "the tokenizer splits an answer in another way than its parts",
            field=text[:40],
            remedy="add the navigation tokens with normalized=False and without stripping",
        )
    if vocabulary.end is not None:
        ids, kinds, index = [*ids, vocabulary.end], [*kinds, END], [*index, -1]
    return AnswerSlots(
        form, vocabulary, np.array(ids, np.int32), np.array(kinds, np.int8),
        np.array(index, np.int8),
    )  # fmt: skip


def _check_places(current: NDArray[np.integer] | Sequence[int]) -> NDArray[np.int32]:
    places = np.atleast_2d(np.asarray(current))
    if places.shape[1:] != (2,) or ((places < 0) | (places >= MAP_BINS)).any():
        raise ConfigError("no place on the map", remedy="give pairs [N, 2] of 0 to 999")
    return places.astype(np.int32)
