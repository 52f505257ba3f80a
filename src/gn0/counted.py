"""Numbers with their nouns, as they are told to people."""

from __future__ import annotations


def counted(number: int, noun: str, many: str = "") -> str:
    """A number and what it counts: "1 scene", "2,000 scenes", "0 people".

    Args:
        number: how many.
        noun: of one.
        many: of several; the noun with an s without it.
    """
    return f"{number:,} {noun if number == 1 else many or noun + 's'}"
