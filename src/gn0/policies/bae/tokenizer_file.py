"""A `tokenizer.json`: Qwen's kind is read by GN0 itself, others by the `tokenizers` package."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from gn0.data.navigation_vocabulary import TextTokenizer
from gn0.errors import FormatError, StorageError
from gn0.policies.qwen.byte_pairs import read_byte_pairs
from gn0.storage import plain_path, read_bytes

LIMIT = 256 * 2**20  # bytes of a tokenizer.json


class TokenizerFile:
    """A tokenizer of the `tokenizers` package as `gn0.data.navigation_vocabulary.TextTokenizer`.

    Args:
        tokenizer: a `tokenizers.Tokenizer`.
    """

    def __init__(self, tokenizer: Any) -> None:
        self.tokenizer = tokenizer

    def __len__(self) -> int:
        return int(self.tokenizer.get_vocab_size(with_added_tokens=True))

    def encode(self, text: str) -> list[int]:
        """Ids of a text, with nothing put before or behind it."""
        return list(self.tokenizer.encode(text, add_special_tokens=False).ids)

    def decode(self, ids: Sequence[int]) -> str:
        """The text of ids; special tokens are left out."""
        return str(self.tokenizer.decode(list(ids), skip_special_tokens=True))

    def find_id(self, token: str) -> int | None:
        """The id of a token; None if there is no such token."""
        found = self.tokenizer.token_to_id(token)
        return None if found is None else int(found)

    def add_tokens(self, tokens: Sequence[str]) -> None:
        """Add tokens behind all others, not special and not normalised."""
        from tokenizers import AddedToken

        self.tokenizer.add_tokens(
            [AddedToken(token, special=False, normalized=False) for token in tokens]
        )


def load_tokenizer(path: Path | str) -> TextTokenizer:
    """Read a `tokenizer.json`, or the one of a checkpoint's folder.

    Raises:
        StorageError: the file is missing or unreadable.
        FormatError: it is no tokenizer; or of another kind than Qwen's, and the `tokenizers`
            package is not installed.
    """
    file = plain_path(path)
    file = file / "tokenizer.json" if file.is_dir() else file
    if file.exists() and not file.is_file():  # a pipe would never end
        raise StorageError("not a file", where=file, remedy="give the path of a tokenizer.json")
    data = read_bytes(file, LIMIT)
    try:
        return read_byte_pairs(data, file)
    except FormatError as error:
        other = error
    try:
        from tokenizers import Tokenizer
    except ImportError:
        raise FormatError(
            other.what,
            file=file,
            remedy="pip install tokenizers, which reads other kinds, or restore the file",
        ) from None
    try:
        return TokenizerFile(Tokenizer.from_buffer(data))
    except Exception as error:  # the package raises bare Exception
        raise FormatError(
            f"not a tokenizer: {str(error)[:200]}", file=file, remedy="restore the file"
        ) from None
