"""An open splat file on its way to a reader, and careful reads from it."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import IO, TypeVar

import msgspec

from gn0.errors import FormatError

_T = TypeVar("_T")
REFETCH = "fetch or write the file again"
REEXPORT = "export the splats again"
JSON_ENTRIES = 500_000


@dataclass(frozen=True)
class CloudSource:
    """What a reader is given.

    Attributes:
        stream: the file, opened in binary, seekable, unbuffered.
        file: its name, for messages and for files beside it.
        size: its size [bytes].
        limit_bytes: the largest decoded size allowed, if any.
        level: level of detail asked for, 0 the finest; None for the finest there is.
    """

    stream: IO[bytes]
    file: Path
    size: int
    limit_bytes: int | None = None
    level: int | None = None

    def read(self, offset: int, count: int, what: str) -> bytes:
        """Exactly `count` bytes from `offset`.

        Args:
            offset: first byte.
            count: number of bytes.
            what: what they are, for the message.

        Raises:
            FormatError: the file ends before.
        """
        if offset < 0 or count < 0 or offset + count > self.size:
            raise self.refuse(
                f"file is truncated or forged: {what} needs {count} bytes from byte {offset}, "
                f"but the file ends at byte {self.size}",
                min(max(offset, 0), self.size),
                remedy=REFETCH,
            )
        self.stream.seek(offset)
        parts, left = [], count
        while left:  # one read of an unbuffered file may give less
            part = self.stream.read(left)
            if not part:
                raise self.refuse(f"file ended within {what}", offset, remedy=REFETCH)
            parts.append(part)
            left -= len(part)
        return parts[0] if len(parts) == 1 else b"".join(parts)

    def refuse(
        self, what: str, offset: int | None = 0, *, field: str = "", remedy: str = REEXPORT
    ) -> FormatError:
        """An error about this file, to be raised."""
        return FormatError(what, file=self.file, offset=offset, field=field, remedy=remedy)


def decode_json(
    data: bytes | memoryview, kind: type[_T], file: Path, what: str, *, offset: int = 0
) -> _T:
    """JSON of an untrusted file as a `msgspec.Struct`, with our own error.

    Args:
        data: the text.
        kind: the type to decode to; unknown fields are skipped.
        file: file at fault, for messages.
        what: name of the JSON, for messages.
        offset: byte at which it begins in the file.

    Raises:
        FormatError: malformed, a field missing or of the wrong type, nested too deeply, or with
            more entries than any real file has.
    """
    # each entry may cost a hundred times its bytes: count them before they become objects
    entries = bytes(data).count(b",") if len(data) > 1 << 20 else 0
    if entries > JSON_ENTRIES:
        raise FormatError(
            f"{what} has {entries} entries, more than the {JSON_ENTRIES} that are read",
            file=file,
            offset=offset,
            remedy="is this really a splat file? if so, split the scene",
        )
    try:
        return msgspec.json.decode(data, type=kind)
    except (msgspec.DecodeError, UnicodeDecodeError, RecursionError, OverflowError) as error:
        reason = "nested too deeply" if isinstance(error, RecursionError) else str(error)
        raise FormatError(
            f"{what} is not what it should be: {reason}", file=file, offset=offset, remedy=REEXPORT
        ) from error


def little(data: bytes, offset: int, size: int) -> int:
    """The little-endian unsigned integer of `size` bytes at `offset`."""
    return int.from_bytes(data[offset : offset + size], "little")
