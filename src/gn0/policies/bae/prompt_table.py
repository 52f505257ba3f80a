"""Prompts of many episodes as ids of one length: tokenised once, then put together by indexing.

A prompt is a turn of Qwen's chat template. What is always one token (coordinates, the heading)
parts the text into chunks. A chunk holds what an episode says (its instruction) and what has few
values (the last action, the bumper); a table has its ids for each of them. Shorter texts of a chunk
are filled up in front, with padding, so that the instruction stands right before what follows it.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gn0.data.codec import ACTION_TOKENS
from gn0.data.navigation_vocabulary import TextTokenizer
from gn0.errors import ConfigError
from gn0.policies.bae.prompt_fields import PromptState, read_field
from gn0.policies.bae.prompt_template import PICTURE_TAG, PromptTemplate
from gn0.policies.bae.tokens import TokenIds
from gn0.policies.qwen.architecture import Architecture
from gn0.policies.qwen.layout import PictureSize, PromptLayout, build_layout

I32 = NDArray[np.int32]
USER, TURN, ASSISTANT = "user\n", "\n", "assistant\n"  # of Qwen's chat template
NUMBERS = ("CUR_XN", "CUR_YN", "HEADING")  # fields of one token each
_LAST, _BUMPER = "LAST_ACTION", "BUMPER"
_ACTIONS: tuple[int | None, ...] = (None, *range(len(ACTION_TOKENS)))
TEXT_LIMIT = 4096  # tokens of a chunk


@dataclass(frozen=True, eq=False)
class PromptChunk:
    """A stretch of a prompt that hangs on its episode, its last action or its bumper.

    Attributes:
        begin: its first place in the prompt.
        table: int32 [E or 1, last actions or 1, bumpers or 1, length] ids.
    """

    begin: int
    table: I32


@dataclass(frozen=True, eq=False)
class PromptTable:
    """Prompts of a template for E texts.

    Attributes:
        template: the template.
        layout: places of pictures and text; the same for all.
        constant: int32 [P] ids; padding where chunks and numbers are filled in.
        chunks: what is looked up.
        numbers: places in the prompt of `NUMBERS`, with the index there.
        number: id of `<0>`.
        pad: id of padding.
    """

    template: PromptTemplate
    layout: PromptLayout
    constant: I32
    chunks: tuple[PromptChunk, ...]
    numbers: tuple[tuple[int, int], ...]
    number: int
    pad: int

    @property
    def place(self) -> tuple[int, int] | None:
        """Where the prompt says the map tokens x and y of where the agent stands; None: nowhere."""
        found = {which: at for at, which in self.numbers}
        return (found[0], found[1]) if {0, 1} <= found.keys() else None


class PromptFiller:
    """Fills a table's prompts, in NumPy or in torch.

    Args:
        table: what is filled.
        convert: from NumPy to the arrays that `fill` is given; they stay as they are by default.
    """

    def __init__(self, table: PromptTable, convert: Callable[[Any], Any] = np.asarray) -> None:
        self.table = table
        self._constant = convert(table.constant[None])
        self._flat = [convert(c.table.reshape(-1, c.table.shape[-1])) for c in table.chunks]

    def fill(self, text: Any, last: Any, bumper: Any, numbers: Any) -> Any:
        """Prompts [N, P], int32.

        Args:
            text: [N] which of the table's texts.
            last: [N] code of the action before; -1 at the start of an episode.
            bumper: [N] 1 where that action was cut short, else 0.
            numbers: int32 [N, 3] map tokens x and y of where the agent stands, and the heading's.
        """
        out = self._constant[text * 0]
        for chunk, flat in zip(self.table.chunks, self._flat, strict=True):
            texts, actions, bumpers, length = chunk.table.shape
            row = text if texts > 1 else text * 0
            row = row * actions + (last + 1 if actions > 1 else 0)
            row = row * bumpers + (bumper if bumpers > 1 else 0)
            out[:, chunk.begin : chunk.begin + length] = flat[row]
        for place, which in self.table.numbers:
            out[:, place] = numbers[:, which] + self.table.number
        return out


def build_prompt_table(
    template: PromptTemplate,
    states: Sequence[PromptState],
    sizes: Mapping[str, PictureSize],
    architecture: Architecture,
    tokenizer: TextTokenizer,
    tokens: TokenIds,
    *,
    text_limit: int = TEXT_LIMIT,
    text_length: int | None = None,
) -> PromptTable:
    """Tokenise a template for many texts.

    Args:
        template: the template.
        states: [E] instruction, and frame where the template speaks of it; one a text.
        sizes: of the pictures, by the name that the template gives them.
        architecture: of the model, which lays the pictures out.
        tokenizer: of the model.
        tokens: its ids.
        text_limit: tokens of a chunk at most.
        text_length: tokens of a chunk that an episode decides, the same whatever the texts are, so
            that tables of other texts have the same layout; None: as many as the longest has.

    Raises:
        ConfigError: no texts, one that is empty or too long (names its number), a field that the
            states do not know, or a picture without a size.
    """
    if not states:
        raise ConfigError("no texts for a prompt", remedy="give one state a text")
    unknown = [name for name in template.pictures if name not in sizes]
    if unknown:
        raise ConfigError(
            f"no size of picture {unknown[0]!r}",
            where=template.file,
            remedy=f"known: {', '.join(sizes) or 'none'}",
        )
    builder = _Builder(template, states, tokenizer, tokens, text_limit, text_length)
    pictures = [sizes[name] for name in template.pictures]
    builder.put(tokens.start)
    builder.put(*tokenizer.encode(USER))
    tagged = any(PICTURE_TAG in "".join(line.pieces[::2]) for line in template.shown)
    if not tagged:
        for size in pictures:
            builder.show(size)
        pictures = []
    for row, line in enumerate(template.shown):
        if row:
            builder.say("\n")
        for k, piece in enumerate(line.pieces):
            if k % 2:
                builder.ask(piece)
                continue
            for j, text in enumerate(piece.split(PICTURE_TAG)):
                if j:
                    builder.close()
                    builder.show(pictures.pop(0))
                builder.say(text)
    builder.close()
    builder.put(tokens.end, *tokenizer.encode(TURN), tokens.start, *tokenizer.encode(ASSISTANT))
    layout = build_layout(architecture, builder.parts)
    return PromptTable(
        template=template,
        layout=layout,
        constant=layout.ids.astype(np.int32),
        chunks=tuple(replace(c, begin=builder.place(c.begin, layout)) for c in builder.chunks),
        numbers=tuple((builder.place(at, layout), which) for at, which in builder.numbers),
        number=tokens.vocabulary.number,
        pad=tokens.pad,
    )


class _Builder:
    """Parts of a prompt so far; `begin` of chunks counts parts until `place` is asked."""

    def __init__(
        self,
        template: PromptTemplate,
        states: Sequence[PromptState],
        tokenizer: TextTokenizer,
        tokens: TokenIds,
        text_limit: int,
        text_length: int | None,
    ) -> None:
        self.template, self.states, self.limit = template, states, text_limit
        self.length = text_length
        self.tokenizer, self.tokens = tokenizer, tokens
        self.parts: list[int | PictureSize] = []
        self.chunks: list[PromptChunk] = []
        self.numbers: list[tuple[int, int]] = []
        self._open: list[tuple[str, bool]] = []  # texts, and names of fields

    def put(self, *ids: int) -> None:
        self.parts += ids

    def show(self, size: PictureSize) -> None:
        self.put(self.tokens.vision_start)
        self.parts.append(size)
        self.put(self.tokens.vision_end)

    def say(self, text: str) -> None:
        if text:
            self._open.append((text, False))

    def ask(self, name: str) -> None:
        if name not in NUMBERS:
            self._open.append((name, True))
            return
        self.close()
        self.numbers.append((len(self.parts), NUMBERS.index(name)))
        self.put(self.tokens.pad)

    def place(self, part: int, layout: PromptLayout) -> int:
        """The place in the prompt of a part's first token."""
        before = [k for k, one in enumerate(self.parts[:part]) if isinstance(one, PictureSize)]
        return part + sum(layout.places[k][1] - 1 for k in range(len(before)))

    def close(self) -> None:
        """End a chunk: tokenise its text for all values of its fields."""
        pieces, self._open = self._open, []
        if not pieces:
            return
        asked = {text for text, is_field in pieces if is_field}
        told = bool(asked - {_LAST, _BUMPER, "TASK_TYPE"})
        texts = self.states if told else self.states[:1]
        actions = _ACTIONS if _LAST in asked else _ACTIONS[:1]
        bumpers = (False, True) if _BUMPER in asked else (False,)
        rows = [
            self.tokenizer.encode(self._fill(pieces, number, last, hit))
            for (number, _), last, hit in itertools.product(enumerate(texts), actions, bumpers)
        ]
        longest = max(map(len, rows))
        fixed = self.length if told else None
        limit = self.limit if fixed is None else min(fixed, self.limit)
        if longest > limit:
            number = int(np.argmax([len(row) for row in rows])) // (len(actions) * len(bumpers))
            raise ConfigError(
                f"text {number} has {longest} tokens, at most {limit} are read",
                where=self.template.file,
                remedy="shorten the instruction",
            )
        if len(rows) == 1 and fixed is None:
            self.put(*rows[0])
            return
        longest = fixed or longest
        table = np.full((len(rows), longest), self.tokens.pad, np.int32)
        for row, ids in zip(table, rows, strict=True):
            row[longest - len(ids) :] = ids
        shape = (len(texts), len(actions), len(bumpers), longest)
        self.chunks.append(PromptChunk(len(self.parts), table.reshape(shape)))
        self.put(*[self.tokens.pad] * longest)

    def _fill(
        self, pieces: list[tuple[str, bool]], number: int, last: int | None, hit: bool
    ) -> str:
        state = replace(self.states[number], last_action=last, collided=hit)
        said = ""
        for text, is_field in pieces:
            value = read_field(text, self.template, state) if is_field else text
            if value is None:
                raise ConfigError(
                    f"nothing is known for field {text!r}",
                    where=self.template.file,
                    remedy="give it, or take a prompt without it",
                )
            said += value
        return said
