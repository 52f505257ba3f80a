"""Prompts and answers on disk, found by their content: cache of `openai`, source of `replay`.

A folder holds one file an exchange, written whole or not at all, so that several processes may
share it. `pack_exchanges` puts them into one JSON-lines file, sorted by key: the same exchanges
are the same bytes.
"""

from __future__ import annotations

import hashlib
from pathlib import Path
from typing import Any

import msgspec

from gn0.config import decode_json
from gn0.errors import FormatError, Gn0Error
from gn0.storage import plain_path, read_bytes, write_bytes

EXCHANGE_LIMIT = 2**20  # bytes of one exchange
FILE_LIMIT = 2**30  # bytes of a packed file


class ChatRequest(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """What is asked of a model; its digest is the exchange's key."""

    model: str
    messages: list[dict[str, str]]
    temperature: float
    max_tokens: int
    seed: int

    @property
    def key(self) -> str:
        """Digest of the request: the same request has the same key anywhere."""
        return hashlib.blake2b(_canonical(self), digest_size=20).hexdigest()


class Exchange(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """A request and the text that answered it."""

    key: str
    request: ChatRequest
    answer: str


def _canonical(value: Any) -> bytes:
    return msgspec.json.encode(msgspec.to_builtins(value), order="sorted")


class ExchangeFolder:
    """A folder of exchanges.

    Args:
        folder: where they are; made on the first write.
    """

    def __init__(self, folder: Path | str) -> None:
        self.folder = plain_path(folder)

    def _path(self, key: str) -> Path:
        return self.folder / key[:2] / f"{key}.json"

    def get(self, request: ChatRequest) -> str | None:
        """The answer to a request, or None; a damaged file is as good as none."""
        key = request.key
        path = self._path(key)
        if not path.is_file():
            return None
        try:
            return _decode(read_bytes(path, EXCHANGE_LIMIT), path, key).answer
        except Gn0Error:
            return None

    def put(self, request: ChatRequest, answer: str) -> None:
        """Keep an answer.

        Raises:
            StorageError: the folder cannot be written.
        """
        exchange = Exchange(key=request.key, request=request, answer=answer)
        write_bytes(self._path(exchange.key), _canonical(exchange) + b"\n")


def load_exchanges(path: Path | str) -> dict[str, Exchange]:
    """All exchanges of a folder or of a packed file, by key.

    Raises:
        StorageError: nothing there, unreadable, or too large.
        FormatError: an exchange is damaged; names the file or line.
    """
    path = plain_path(path)
    if path.is_dir():
        files = sorted(path.glob("??/*.json"))
        found = [_decode(read_bytes(f, EXCHANGE_LIMIT), f, f.stem) for f in files]
    else:
        lines = read_bytes(path, FILE_LIMIT).splitlines()
        found = [_decode(line, path, "", number) for number, line in enumerate(lines, 1) if line]
    return {exchange.key: exchange for exchange in found}


def pack_exchanges(folder: Path | str, file: Path | str) -> int:
    """Write a folder's exchanges as one file, sorted by key; how many.

    Raises:
        StorageError: the folder or the file cannot be used.
        FormatError: an exchange is damaged.
    """
    found = load_exchanges(folder)
    write_bytes(file, b"".join(_canonical(found[key]) + b"\n" for key in sorted(found)))
    return len(found)


def _decode(data: bytes, file: Path, key: str, line: int = 0) -> Exchange:
    where = f"{file}, line {line}" if line else str(file)
    exchange = decode_json(data, Exchange, file=where)
    if exchange.request.key != exchange.key or (key and key != exchange.key):
        raise FormatError(
            "the key is not that of the request",
            file=where,
            field="key",
            remedy="record the exchange again; it was edited or damaged",
        )
    return exchange
