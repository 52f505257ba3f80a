"""Who else is there in a follow mission: people who look different, or all but the same.

Levels are EVT-Bench's: nobody else; 1 to 7 others who look different; others who share all but one
of the words of the person's record.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Literal, get_args

from gn0.avatars.identity import Identity
from gn0.avatars.likeness import CHANGES, Record, Sight, change_record, words_apart
from gn0.errors import ConfigError, DataError
from gn0.seeds import random_stream

Level = Literal["single", "distractors", "ambiguous"]
LEVELS: tuple[Level, ...] = get_args(Level)
OTHERS_MOST = 7
_COLOURS = frozenset(("top_colour", "bottom_colour"))
_DIFFERENT = 3  # words by which somebody looks different, one of them a colour of a garment


def choose_different(
    person: Record,
    bank: Mapping[str, Record],
    count: int,
    seed: int,
    *,
    sight: Sight | None = None,
) -> list[str]:
    """Names of `count` people of a bank who look different from a person, seen from either side.

    Any two of them differ from each other as well, by one thing that shows at least.

    Args:
        person: the record of who is followed.
        bank: records of a bank's people by name; the person's own is left out.
        count: how many, 1 to 7.
        seed: of the choice.
        sight: how people are first seen.

    Raises:
        ConfigError: the count is out of range, or the bank has too few of them.
    """
    if not 1 <= count <= OTHERS_MOST:
        raise ConfigError(
            f"{count} others", where="choose_different", remedy=f"ask for 1 to {OTHERS_MOST}"
        )
    sight = sight or Sight()
    names = sorted(bank)
    stream = random_stream(
        seed, "others", "distractors", *(f"{k}={person[k]}" for k in sorted(person))
    )
    chosen: list[str] = []
    for k in stream.permutation(len(names)):
        other = bank[names[int(k)]]
        if not looks_different(person, other, sight):
            continue
        if all(words_apart(other, bank[name], sight) for name in chosen):
            chosen.append(names[int(k)])
            if len(chosen) == count:
                return chosen
    raise ConfigError(
        f"only {len(chosen)} of {count} others of the bank look different from this person",
        where="choose_different", remedy="give a larger bank, or ask for fewer",
    )  # fmt: skip


def looks_different(person: Record, other: Record, sight: Sight) -> bool:
    """Whether nobody would take one for the other: three words differ, a garment's colour too."""
    apart = words_apart(person, other, sight)
    return len(apart) >= _DIFFERENT and bool(apart & _COLOURS)


def change_people(
    person: Record, count: int, seed: int, *, sight: Sight | None = None
) -> list[tuple[str, Identity]]:
    """The same as `choose_changes`, without the seeds."""
    found = choose_changes(person, count, seed, sight=sight)
    return [(key, other) for key, _, other in found]


def choose_changes(
    person: Record, count: int, seed: int, *, sight: Sight | None = None
) -> list[tuple[str, int, Identity]]:
    """People who share all of a person's words but one.

    Each comes with the key of that word, and the seed by which `change_record` makes it. They have
    faces and builds of their own. Words that change take turns in a seeded order, so that a
    sentence has to say more than one thing where there are several people.

    Args:
        person: the record of who is followed.
        count: how many, 1 to 7.
        seed: of the choice.
        sight: how people are first seen.

    Raises:
        ConfigError: the count is out of range, or no more people of that kind exist.
        DataError: it is not a record of ours.
    """
    if not 1 <= count <= OTHERS_MOST:
        raise ConfigError(
            f"{count} others", where="change_people", remedy=f"ask for 1 to {OTHERS_MOST}"
        )
    sight = sight or Sight()
    stream = random_stream(
        seed, "others", "ambiguous", *(f"{k}={person[k]}" for k in sorted(person))
    )
    found: list[tuple[str, int, Identity]] = []
    usable = [CHANGES[int(k)] for k in stream.permutation(len(CHANGES))]
    tries = 0
    while usable and len(found) < count:
        key = usable[tries % len(usable)]
        tries += 1
        try:
            change = int(stream.integers(2**31))
            other = change_record(person, key, change, sight)
        except DataError:
            usable.remove(key)
            continue
        if any(not words_apart(other.words(), done.words(), sight) for _, _, done in found):
            if tries > 12 * count:
                usable.remove(key)
            continue
        found.append((key, change, other))
    if len(found) < count:
        raise ConfigError(
            f"only {len(found)} of {count} people differ from this one in a single word",
            where="change_people", remedy="ask for fewer, or follow somebody else",
        )  # fmt: skip
    return found


def draw_count(level: Level, seed: int) -> int:
    """How many others a level has: none, 1 to 7, or 1 to 3."""
    if level == "single":
        return 0
    most = OTHERS_MOST if level == "distractors" else 3
    return int(random_stream(seed, "others", "count", level).integers(1, most + 1))


def all_apart(people: Sequence[Record], who: int, sight: Sight) -> bool:
    """Whether something that shows tells a person from each of the others."""
    return all(words_apart(people[who], other, sight) for k, other in enumerate(people) if k != who)
