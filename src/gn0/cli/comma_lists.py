"""Values of flags that hold several things with commas between."""

from __future__ import annotations

from gn0.errors import ConfigError


def split_words(text: str) -> tuple[str, ...]:
    """The words between commas; empty ones are left out."""
    return tuple(one.strip() for one in text.split(",") if one.strip())


def read_joins(text: str) -> tuple[int, ...]:
    """The whole numbers of `--joins`.

    Raises:
        ConfigError: one is not a whole number.
    """
    try:
        return tuple(int(one) for one in split_words(text))
    except ValueError:
        raise ConfigError(
            f"not whole numbers: {text!r}", where="--joins", remedy="give 0,500000 or the like"
        ) from None
