"""Strict configuration: one frozen definition gives the CLI, JSON files and their errors.

tyro does not enforce msgspec's bounds, so whatever comes from it passes `check_config` once.
"""

from __future__ import annotations

import math
import operator
from pathlib import Path
from typing import Any, TypeVar

import msgspec

from gn0.errors import ConfigError, FormatError, Gn0Error, brief
from gn0.storage import read_bytes

T = TypeVar("T")

JSON_LIMIT = 256 * 2**20  # bytes; a JSON file larger than this is refused unread


class Config(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Parent of all settings: frozen, keyword-only, unknown fields refused."""


def as_index(value: Any) -> int | None:
    """A whole number of whatever library as an int; None for anything else, a truth among it."""
    if isinstance(value, bool):  # NumPy's own is no index
        return None
    try:
        return operator.index(value)
    except TypeError:
        return None


def whole_number(value: Any, name: str, least: float = 1) -> int:
    """An argument that counts something, as an int.

    Raises:
        ConfigError: it is no whole number, or less than `least`.
    """
    number = as_index(value)
    if number is None or number < least:
        low = "" if least == -math.inf else f" of at least {least}"
        raise ConfigError(f"{name} is {brief(value)}", remedy=f"give a whole number{low}")
    return number


def check_config(config: T) -> T:
    """The same settings, checked against their types and bounds.

    Raises:
        ConfigError: a value is of the wrong type or out of range; names the field.
    """
    try:
        return msgspec.convert(msgspec.to_builtins(config), type=type(config))
    except msgspec.ValidationError as error:
        raise ConfigError(str(error), where=type(config).__name__, remedy="see --help") from None


def decode_json(data: bytes | str, type_: type[T], *, file: str | Path = "") -> T:
    """Decode JSON into `type_`, strictly.

    Raises:
        FormatError: not JSON, or a field is missing, unknown or of the wrong type.
        Gn0Error: what a type's own checks raise, with the file before where they found it.
    """
    try:
        return msgspec.json.decode(data, type=type_)
    except Gn0Error as error:
        error.where = f"{file}, {error.where}".strip(", ")
        raise
    except msgspec.ValidationError as error:
        raise FormatError(str(error), file=file, remedy="correct the named field") from None
    except (msgspec.DecodeError, UnicodeDecodeError, RecursionError) as error:
        raise FormatError(
            f"not valid JSON: {error}", file=file, remedy="restore the file"
        ) from None


def load_json(path: Path | str, type_: type[T] = Any, *, limit: int = JSON_LIMIT) -> T:  # type: ignore[assignment]
    """Read and decode a JSON file.

    Raises:
        StorageError: missing, unreadable or too large.
        FormatError: see `decode_json`.
    """
    return decode_json(read_bytes(path, limit), type_, file=path)
