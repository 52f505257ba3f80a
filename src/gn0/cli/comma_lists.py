"""Values of flags that hold several things with commas between."""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeVar

from gn0.errors import ConfigError

Number = TypeVar("Number", int, float)


def split_words(text: str) -> tuple[str, ...]:
    """The words between commas; empty ones are left out."""
    return tuple(one.strip() for one in text.split(",") if one.strip())


def read_numbers(
    text: str, kind: Callable[[str], Number], where: str, example: str
) -> tuple[Number, ...]:
    """The numbers of a flag.

    Args:
        text: the value.
        kind: int or float.
        where: the flag.
        example: of a value.

    Raises:
        ConfigError: one is not such a number.
    """
    try:
        return tuple(kind(one) for one in split_words(text))
    except ValueError:
        raise ConfigError(
            f"not {'whole ' if kind is int else ''}numbers: {text!r}",
            where=where,
            remedy=f"give {example} or the like",
        ) from None


def read_joins(text: str) -> tuple[int, ...]:
    """The whole numbers of `--joins`.

    Raises:
        ConfigError: one is not a whole number.
    """
    return read_numbers(text, int, "--joins", "0,500000")
