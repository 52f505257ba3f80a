"""Who is meant by the names of drawn people: a person at random, or one who is all but the same."""

from __future__ import annotations

from functools import lru_cache

from gn0.avatars.identity import Identity, draw_identity
from gn0.avatars.likeness import CHANGES, change_record
from gn0.errors import DataError, EpisodeError
from gn0.people.person import drawn_change, drawn_identity


def name_drawn(seed: int, number: int, key: str = "", change: int = 0) -> str:
    """The name of a drawn person, or of one who differs from it in one word.

    Args:
        seed: that it is drawn by.
        number: of it.
        key: of the word that is another, of `gn0.avatars.likeness.CHANGES`; "" for none.
        change: seed of that word.
    """
    return f"drawn:{seed}:{number}" + (f":{key}:{change}" if key else "")


@lru_cache(maxsize=1024)
def find_identity(name: str) -> Identity:
    """The person of a name "drawn:SEED:NUMBER" or "drawn:SEED:NUMBER:KEY:CHANGE".

    Raises:
        EpisodeError: it is no such name, or nobody differs in that word.
    """
    drawn, change = drawn_identity(name), drawn_change(name)
    if drawn is None:
        raise EpisodeError(
            f"{name!r:.60} names nobody drawn", where="identity", remedy="give drawn:SEED:NUMBER"
        )
    person = draw_identity(*drawn)
    if change is None:
        return person
    key, seed = change
    try:
        if key not in CHANGES:
            raise DataError(f"no word {key!r} changes", remedy=f"one of {', '.join(CHANGES)}")
        return change_record(person.words(), key, seed)
    except DataError as error:
        raise EpisodeError(
            f"{name!r:.60}: {error.what}", where="identity", remedy=error.remedy
        ) from None
