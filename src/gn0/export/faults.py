"""Collects what is wrong with a folder instead of stopping at the first fault."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, TypeVar

import msgspec

from gn0.config import JSON_LIMIT
from gn0.errors import FormatError, Gn0Error
from gn0.storage import read_bytes

T = TypeVar("T")
MOST = 100  # faults told of one export


class Faults:
    """Faults in words, in the order they were found; the first hundred are kept."""

    def __init__(self) -> None:
        self.found: list[str] = []
        self.more = 0

    def add(self, text: str) -> None:
        """Note a fault."""
        if len(self.found) < MOST:
            self.found.append(text)
        else:
            self.more += 1

    def expect(self, holds: bool, text: str) -> bool:
        """Note a fault unless something holds."""
        if not holds:
            self.add(text)
        return holds

    @contextmanager
    def guard(self) -> Iterator[None]:
        """Within the block, an error of ours is a fault."""
        try:
            yield
        except Gn0Error as error:
            self.add(str(error))

    def told(self) -> list[str]:
        """All faults; the last line says how many more there are."""
        return [*self.found, *([f"… and {self.more} more"] if self.more else [])]


def load_typed(path: Path, kind: type[T], what: str = "") -> T:
    """A JSON file as `kind`; keys that `kind` does not have are ignored.

    Raises:
        StorageError: missing or unreadable.
        FormatError: not JSON, or a field is missing or of the wrong type.
    """
    try:
        return msgspec.json.decode(read_bytes(path, JSON_LIMIT), type=kind)
    except (msgspec.DecodeError, UnicodeDecodeError, RecursionError) as error:
        raise FormatError(f"{what}{error}", file=path, remedy="export it again") from None


def load_lines(path: Path, kind: type[T]) -> list[T]:
    """The values of a JSON Lines file; see `load_typed`.

    Raises:
        StorageError, FormatError: see `load_typed`; names the line.
    """
    found = []
    for number, line in enumerate(read_bytes(path, JSON_LIMIT).splitlines(), 1):
        try:
            found.append(msgspec.json.decode(line, type=kind))
        except (msgspec.DecodeError, UnicodeDecodeError, RecursionError) as error:
            raise FormatError(
                f"line {number}: {error}", file=path, remedy="export it again"
            ) from None
    return found


def encode_lines(values: list[Any]) -> bytes:
    """JSON Lines of values, keys in their order."""
    return b"".join(msgspec.json.encode(value) + b"\n" for value in values)
