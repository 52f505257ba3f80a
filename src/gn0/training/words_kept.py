"""The tokenizer of a policy in training, which cuts each text once.

Before its first batch a stage asks for every instruction and for every stretch of prompt around it
several times: how long they are, which are too long, and then for the table of each input.
"""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Sequence
from typing import Any
from weakref import WeakKeyDictionary

from gn0.policies.bae.tokenizer_file import TokenizerFile

MOST = 2**18  # texts whose ids are kept; the first of them make room


class WordsKept(TokenizerFile):
    """A `TokenizerFile` that keeps the ids of the latest texts.

    Args:
        tokenizer: a `tokenizers.Tokenizer`, which gets no further tokens but by `add_tokens`.
        most: texts that are kept.
    """

    def __init__(self, tokenizer: Any, most: int = MOST) -> None:
        super().__init__(tokenizer)
        self._most = most
        self._ids: OrderedDict[str, tuple[int, ...]] = OrderedDict()

    def encode(self, text: str) -> list[int]:
        """Ids of a text, with nothing put before or behind it."""
        found = self._ids.get(text)
        if found is None:
            found = self._ids[text] = tuple(super().encode(text))
            if len(self._ids) > self._most:
                self._ids.popitem(last=False)
        return list(found)

    def add_tokens(self, tokens: Sequence[str]) -> None:
        """Add tokens behind all others, not special and not normalised."""
        self._ids.clear()  # texts may be cut in another way now
        super().add_tokens(tokens)


_words_of: WeakKeyDictionary[Any, WordsKept] = WeakKeyDictionary()


def keep_words(tokenizer: Any) -> WordsKept:
    """The one `WordsKept` of a tokenizer of transformers, whoever asks in whichever input."""
    found = _words_of.get(tokenizer)
    if found is None or found.tokenizer is not tokenizer.backend_tokenizer:
        found = _words_of[tokenizer] = WordsKept(tokenizer.backend_tokenizer)
    return found
