"""A tokenizer small enough to be read: bytes, a few pieces, special and added tokens.

It splits as the fast tokenizers do: added tokens first, the longest that fits, then what is between
them by its pieces.
"""

from __future__ import annotations

import re
from collections.abc import Sequence

BYTES = 256
PIECES = (' "', '"pixel":"[[', "],[", ']]","', '{"', '"}', " the", "go", '":"', "],", "99")
SPECIAL = ("<|endoftext|>", "<|im_start|>", "<|im_end|>", "<|image_pad|>")
_PIECE = re.compile(
    "|".join(map(re.escape, sorted(PIECES, key=len, reverse=True))) + "|.", re.DOTALL
)


class ToyTokenizer:
    """A tokenizer; see `gn0.data.navigation_vocabulary.TextTokenizer`.

    Args:
        special: tokens that decoding leaves out.
        adds_special: tokens added later are special, too: a fault that a loader must find.
    """

    def __init__(self, special: Sequence[str] = SPECIAL, *, adds_special: bool = False) -> None:
        self.tokens = [bytes([n]) for n in range(BYTES)] + [p.encode() for p in PIECES]
        self.added: dict[str, int] = {}
        self.special: set[int] = set()
        self._pattern: re.Pattern[str] | None = None
        self._adds_special = adds_special
        for token in special:
            self.special.add(self._add(token))

    def __len__(self) -> int:
        return len(self.tokens)

    def _add(self, token: str) -> int:
        self.added[token] = len(self.tokens)
        self.tokens.append(token.encode())
        self._pattern = None
        return self.added[token]

    def add_tokens(self, tokens: Sequence[str]) -> None:
        """Add tokens behind all others."""
        for token in tokens:
            own = self._add(token)
            if self._adds_special:
                self.special.add(own)

    def find_id(self, token: str) -> int | None:
        """The id of an added token."""
        return self.added.get(token)

    def encode(self, text: str) -> list[int]:
        """Ids of a text."""
        if self._pattern is None:
            names = sorted(self.added, key=len, reverse=True)
            self._pattern = re.compile("(" + "|".join(map(re.escape, names)) + ")")
        ids: list[int] = []
        for part in self._pattern.split(text) if self.added else [text]:
            if part in self.added:
                ids.append(self.added[part])
                continue
            for piece in _PIECE.findall(part):
                own = PIECES.index(piece) if piece in PIECES else -1
                ids += [BYTES + own] if own >= 0 else piece.encode("utf-8", "replace")
        return ids

    def decode(self, ids: Sequence[int]) -> str:
        """The text of ids, without special tokens."""
        kept = [self.tokens[own] for own in ids if own not in self.special]
        return b"".join(kept).decode("utf-8", "replace")
