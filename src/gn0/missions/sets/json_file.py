"""JSON files that must come out as they went in: value for value, plain or gzip.

Python's own JSON keeps what others lose: 3 and 3.0 apart, integers of any size, NaN and Infinity,
the order of keys. A name that appears twice in one object is refused, because one of the two values
would be lost.
"""

from __future__ import annotations

import gzip
import io
import json
import zlib
from pathlib import Path
from typing import Any

from gn0.errors import FormatError
from gn0.storage import read_bytes, write_bytes

JSON_LIMIT = 1 << 30  # bytes, unpacked
GZIP_MAGIC = b"\x1f\x8b"


def _refuse_twice(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    found = dict(pairs)
    if len(found) != len(pairs):
        names = [name for name, _ in pairs]
        twice = next(name for name in names if names.count(name) > 1)
        raise ValueError(f"the name {twice!r:.80} appears twice in one object")
    return found


def load_unpacked(path: Path | str, limit: int = JSON_LIMIT) -> bytes:
    """The bytes of a file, unpacked where it is gzipped.

    Raises:
        StorageError: missing or unreadable.
        FormatError: no whole gzip file, or larger than `limit` bytes when unpacked.
    """
    data = read_bytes(path, limit)
    if data[:2] == GZIP_MAGIC:
        try:
            with gzip.GzipFile(fileobj=io.BytesIO(data)) as stream:
                data = stream.read(limit + 1)
        except (OSError, EOFError, zlib.error) as error:
            raise FormatError(
                f"not a whole gzip file: {error}", file=path, remedy="copy the file again"
            ) from None
        if len(data) > limit:
            raise FormatError(
                f"unpacks to more than {limit} bytes", file=path, remedy="split the set"
            )
    return data


def load_exact(path: Path | str, limit: int = JSON_LIMIT) -> Any:
    """The value of a JSON file, gzipped or not.

    Raises:
        StorageError: missing or unreadable.
        FormatError: damaged, larger than `limit` bytes when unpacked, or a name given twice.
    """
    data = load_unpacked(path, limit)
    try:
        return json.loads(data.decode("utf-8"), object_pairs_hook=_refuse_twice)
    except (ValueError, RecursionError) as error:
        reason = str(error).splitlines()[0]
        raise FormatError(
            f"not valid JSON: {reason}", file=path, remedy="restore the file"
        ) from None


def save_exact(path: Path | str, value: Any) -> None:
    """Write a value, gzipped if the name ends in `.gz`; the same value gives the same bytes.

    Raises:
        StorageError: the file cannot be written.
    """
    data = json.dumps(value, separators=(", ", ": ")).encode("ascii")
    if str(path).endswith(".gz"):
        data = gzip.compress(data, compresslevel=6, mtime=0)
    write_bytes(path, data)


def same_values(a: Any, b: Any) -> bool:
    """Whether two JSON values are equal, types and key order included; NaN equals NaN."""
    if type(a) is not type(b):
        return False
    if isinstance(a, dict):
        return list(a) == list(b) and all(same_values(v, b[k]) for k, v in a.items())
    if isinstance(a, list):
        return len(a) == len(b) and all(map(same_values, a, b))
    return bool(a == b) or (isinstance(a, float) and a != a and b != b)
