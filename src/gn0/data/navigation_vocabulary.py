"""The ids that a tokenizer gives to the tokens of answers; checked before anything relies on them.

The tokens are added with `special=False`: special ones are dropped by `decode`, and an answer
becomes `,[]`. The ids of `<0>` … `<999>` must be contiguous, as decoders and masks count with them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from gn0.data.codec import ACTION_BEGIN, ACTION_END, ACTION_TOKENS, NAVIGATION_TOKENS
from gn0.errors import FormatError
from gn0.paper import MAP_BINS

TURN_END = "<|im_end|>"  # what ends an answer in Qwen's chat template
_ADD = "add them to a tokenizer without any by `add_navigation_tokens`"


class TextTokenizer(Protocol):
    """What is asked of a tokenizer; `len` is the number of its tokens."""

    def __len__(self) -> int: ...

    def encode(self, text: str) -> Sequence[int]:
        """Ids of a text, with nothing put before or behind it."""
        ...

    def decode(self, ids: Sequence[int]) -> str:
        """The text of ids; special tokens are left out."""
        ...

    def find_id(self, token: str) -> int | None:
        """The id of a token; None if there is no such token."""
        ...

    def add_tokens(self, tokens: Sequence[str]) -> None:
        """Add tokens behind all others, not special and not normalised."""
        ...


@dataclass(frozen=True)
class NavigationVocabulary:
    """Ids of the tokens of answers.

    Attributes:
        number: id of `<0>`; `<n>` is n further.
        actions: ids of the actions, by their codes: STOP, FORWARD, LEFT, RIGHT.
        begin: id of `<action>`.
        close: id of `</action>`.
        end: id of what ends an answer; None where nothing does.
        size: tokens of the tokenizer.
        rows: rows of the model's output, at least `size`.
    """

    number: int
    actions: tuple[int, int, int, int]
    begin: int
    close: int
    end: int | None
    size: int
    rows: int

    @property
    def first(self) -> int:
        """The least id of all these tokens."""
        return min(self.number, *self.actions, self.begin, self.close)

    def padded_rows(self) -> NDArray[np.bool_]:
        """Whether a row of the output stands for no token [rows]: never to be sampled."""
        return np.arange(self.rows) >= self.size

    def id_of(self, token: str) -> int:
        """Id of a navigation token."""
        named = {ACTION_BEGIN: self.begin, ACTION_END: self.close}
        named |= dict(zip(ACTION_TOKENS, self.actions, strict=True))
        return named[token] if token in named else self.number + int(token[1:-1])


def add_navigation_tokens(
    tokenizer: TextTokenizer, *, rows: int | None = None, end: str | None = TURN_END
) -> NavigationVocabulary:
    """Add the 1006 tokens to a tokenizer that has none of them; see `load_vocabulary`.

    Raises:
        FormatError: it has some of them, or does not keep them as they must be.
    """
    held = [token for token in NAVIGATION_TOKENS if tokenizer.find_id(token) is not None]
    if 0 < len(held) < len(NAVIGATION_TOKENS):
        raise FormatError(
            f"the tokenizer has {len(held)} of {len(NAVIGATION_TOKENS)} navigation tokens",
            field=held[0],
            remedy="take a tokenizer that has none of them, or all",
        )
    if not held:
        tokenizer.add_tokens(NAVIGATION_TOKENS)
    return load_vocabulary(tokenizer, rows=rows, end=end)


def load_vocabulary(
    tokenizer: TextTokenizer, *, rows: int | None = None, end: str | None = TURN_END
) -> NavigationVocabulary:
    """The ids of the navigation tokens of a tokenizer.

    Args:
        tokenizer: one that has them.
        rows: rows of the model's output layer, often padded to a multiple of 64; by default as
            many as there are tokens.
        end: the token that ends an answer; None for none.

    Raises:
        FormatError: a token is missing, their ids have a gap, they are not read as one token each
            or are special, or the model has fewer rows than there are tokens; says what to do.
    """
    found = [tokenizer.find_id(token) for token in NAVIGATION_TOKENS]
    ids = [own for own in found if own is not None]
    if len(ids) != len(found):
        missing = NAVIGATION_TOKENS[found.index(None)]
        raise FormatError(
            f"{len(found) - len(ids)} of {len(found)} navigation tokens are missing",
            field=missing,
            remedy=_ADD,
        )
    for number in range(1, MAP_BINS):
        if ids[number] != ids[0] + number:
            raise FormatError(
                f"the ids of <0> to <999> have a gap: <{number}> is {ids[number]}, "
                f"expected {ids[0] + number}",
                field=f"<{number}>",
                remedy="the tokens must have been added at once and in order; " + _ADD,
            )
    if list(tokenizer.encode("".join(NAVIGATION_TOKENS))) != ids:
        raise FormatError(
            "the tokenizer does not read each navigation token as one token",
            field=NAVIGATION_TOKENS[0],
            remedy="add them with normalized=False, and without lstrip, rstrip or single_word",
        )
    for token, own in ((NAVIGATION_TOKENS[0], ids[0]), (NAVIGATION_TOKENS[-1], ids[-1])):
        if tokenizer.decode([own]).strip() != token:
            raise FormatError(
                "decoding drops navigation tokens", field=token, remedy="add them as special=False"
            )
    size = len(tokenizer)
    if max(ids) >= size:
        raise FormatError(
            f"id {max(ids)} in a tokenizer of {size} tokens",
            field=NAVIGATION_TOKENS[ids.index(max(ids))],
            remedy="restore the tokenizer's files",
        )
    if rows is not None and rows < size:
        raise FormatError(
            f"the model has {rows} rows for {size} tokens",
            field="rows",
            remedy="resize its embeddings to the tokenizer, or take the tokenizer beside it",
        )
    last = None if end is None else tokenizer.find_id(end)
    if end is not None and last is None:
        raise FormatError(
            "the tokenizer has no token that ends an answer", field=end, remedy="give end=None"
        )
    by_name = dict(zip(NAVIGATION_TOKENS, ids, strict=True))
    stop, forward, left, right = (by_name[token] for token in ACTION_TOKENS)
    return NavigationVocabulary(
        number=ids[0],
        actions=(stop, forward, left, right),
        begin=by_name[ACTION_BEGIN],
        close=by_name[ACTION_END],
        end=last,
        size=size,
        rows=size if rows is None else rows,
    )
