"""Qwen's tokenizer without packages: byte-level BPE, read from a `tokenizer.json`.

Ids are those of the `tokenizers` package for all characters that this Python's Unicode knows; later
ones may be cut elsewhere (https://github.com/huggingface/tokenizers; the pattern is that of
`transformers.models.qwen2.tokenization_qwen2.PRETOKENIZE_REGEX`).
"""

from __future__ import annotations

import json
import re
import unicodedata
from collections.abc import Sequence
from functools import lru_cache
from itertools import pairwise
from pathlib import Path

from gn0.errors import FormatError, brief

PATTERN = (
    r"(?i:'s|'t|'re|'ve|'m|'ll|'d)|[^\r\n\p{L}\p{N}]?\p{L}+|\p{N}| ?[^\s\p{L}\p{N}]+[\r\n]*"
    r"|\s*[\r\n]+|\s+(?!\S)|\s+"
)
# the same over classes of characters, see _Classes: `re` knows no \p{L}
_WORDS = re.compile(
    r"'(?:s|t|re|ve|m|ll|d)|[^\na-z0]?[a-z]+|0| ?['.]+\n*|[ \t\n]*\n+|[ \t\n]+(?![^ \t\n])|[ \t\n]+"
)
_SHORTENED = dict(zip("stremvldSTREMVLDſ", "stremvldstremvlds", strict=True))
_WORDS_KEPT = 65_536


class _Classes(dict[int, str]):
    """A letter of `_WORDS` for each character: a-z letters, 0 numbers, tab space, . others."""

    def __missing__(self, code: int) -> str:
        one = chr(code)
        kind = unicodedata.category(one)[0]
        found = (
            one if one in " '"
            else "\n" if one in "\r\n"
            else _SHORTENED.get(one, "x") if kind == "L"
            else "0" if kind == "N"
            else "\t" if one.isspace() and not "\x1c" <= one <= "\x1f"
            else "."
        )  # fmt: skip
        self[code] = found
        return found


_CLASSES = _Classes()


def list_byte_letters() -> str:
    """The letter that stands for each byte in a vocabulary (GPT-2's `bytes_to_unicode`)."""
    shown = {*range(0x21, 0x7F), *range(0xA1, 0xAD), *range(0xAE, 0x100)}
    hidden = iter(range(0x100, 0x200))
    return "".join(chr(byte if byte in shown else next(hidden)) for byte in range(256))


_LETTERS = list_byte_letters()
_BYTES = {letter: byte for byte, letter in enumerate(_LETTERS)}


class BytePairs:
    """A tokenizer of Qwen's kind, as `gn0.data.navigation_vocabulary.TextTokenizer`.

    Args:
        vocabulary: id of each token that merging makes.
        merges: pairs that become one, the first first.
        added: id of each token that is found in a text before anything else.
        special: those of them that `decode` leaves out.
    """

    def __init__(
        self,
        vocabulary: dict[str, int],
        merges: Sequence[tuple[str, str]],
        added: dict[str, int],
        special: frozenset[str],
    ) -> None:
        self._vocabulary, self._added, self._special = vocabulary, dict(added), special
        self._ranks = {pair: rank for rank, pair in reversed(list(enumerate(merges)))}
        self._merge = lru_cache(_WORDS_KEPT)(self._merge_word)
        self._look_up()

    def _look_up(self) -> None:
        self._names = {own: name for name, own in (self._vocabulary | self._added).items()}
        longest_first = sorted(self._added, key=len, reverse=True)
        self._cut = re.compile(f"({'|'.join(map(re.escape, longest_first))})")

    def __len__(self) -> int:
        return len(self._vocabulary.keys() | self._added.keys())

    def encode(self, text: str) -> list[int]:
        """Ids of a text, with nothing put before or behind it."""
        ids: list[int] = []
        for k, piece in enumerate(self._cut.split(text) if self._added else [text]):
            if k % 2:
                ids.append(self._added[piece])
                continue
            plain = unicodedata.normalize("NFC", piece)
            for word in _WORDS.finditer(plain.translate(_CLASSES)):
                ids += self._merge(plain[word.start() : word.end()])
        return ids

    def _merge_word(self, word: str) -> tuple[int, ...]:
        parts = [_LETTERS[byte] for byte in word.encode()]
        last = len(self._ranks)
        while len(parts) > 1:
            ranks = [self._ranks.get(pair, last) for pair in pairwise(parts)]
            least = min(ranks)
            if least == last:
                break
            at = ranks.index(least)
            parts[at : at + 2] = [parts[at] + parts[at + 1]]
        return tuple(self._vocabulary[part] for part in parts if part in self._vocabulary)

    def decode(self, ids: Sequence[int]) -> str:
        """The text of ids; special tokens are left out."""
        said = bytearray()
        for name in (self._names.get(own, "") for own in ids):
            if name not in self._special:
                known = all(letter in _BYTES for letter in name)
                said += bytes(_BYTES[letter] for letter in name) if known else name.encode()
        return said.decode(errors="replace")

    def find_id(self, token: str) -> int | None:
        """The id of a token; None if there is no such token."""
        return self._added.get(token, self._vocabulary.get(token))

    def add_tokens(self, tokens: Sequence[str]) -> None:
        """Add tokens behind all others, not special and not normalised."""
        for token in tokens:
            if self.find_id(token) is None:
                self._added[token] = max(self._names, default=-1) + 1
                self._names[self._added[token]] = token
        self._look_up()


def read_byte_pairs(data: bytes, file: Path) -> BytePairs:
    """A tokenizer of a `tokenizer.json`'s bytes.

    Args:
        data: of the file.
        file: for errors.

    Raises:
        FormatError: not JSON, not a tokenizer, or of another kind than Qwen's; says what differs.
    """
    try:
        table = json.loads(data)
        model, steps = table["model"], table["pre_tokenizer"]["pretokenizers"]
        split, letters = steps
        wanted = (
            ("model", model["type"], "BPE"),
            ("normalizer", table["normalizer"]["type"], "NFC"),
            ("split", split["pattern"]["Regex"], PATTERN),
            ("split", (split["type"], split["behavior"]), ("Split", "Isolated")),
            ("bytes", letters["type"], "ByteLevel"),
            ("bytes", (letters["add_prefix_space"], letters["use_regex"]), (False, False)),
            ("decoder", table["decoder"]["type"], "ByteLevel"),
            ("truncation", table.get("truncation"), None),
            *(
                (name, bool(model.get(name)), False)
                for name in (
                    "dropout", "continuing_subword_prefix", "end_of_word_suffix", "ignore_merges",
                    "byte_fallback",
                )
            ),
            *(
                (f"{token['content']}: {name}", token[name], False)
                for token in table["added_tokens"]
                for name in ("single_word", "lstrip", "rstrip", "normalized")
            ),
        )  # fmt: skip
        merges = [one.split(" ") if isinstance(one, str) else one for one in model["merges"]]
        found = BytePairs(
            {str(name): int(own) for name, own in model["vocab"].items()},
            [(str(a), str(b)) for a, b in merges],
            {str(token["content"]): int(token["id"]) for token in table["added_tokens"]},
            frozenset(str(token["content"]) for token in table["added_tokens"] if token["special"]),
        )
    except (ValueError, KeyError, TypeError, AttributeError, RecursionError) as error:
        raise FormatError(
            f"not a tokenizer of Qwen's kind: {type(error).__name__} {brief(str(error))}",
            file=file,
            remedy="restore the file",
        ) from None
    for name, got, expected in wanted:
        if got != expected:
            raise FormatError(
                f"not a tokenizer of Qwen's kind: {name[:80]} is {brief(got)}, "
                f"not {brief(expected)}",
                file=file,
                remedy="pip install tokenizers, which reads other kinds",
            )
    return found
