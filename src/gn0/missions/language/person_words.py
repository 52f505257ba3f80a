"""Which words of a person's record to say, so that they fit one person among those who are there.

The words of each part (garments, hair, hat, scarf) have a few combinations; all ways to take one
combination a part are looked through, and one is drawn from those that tell the person from
everybody else.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import product

import numpy as np

from gn0.avatars.likeness import SHOWN_PATTERNS, Sight, seen_words, words_apart
from gn0.missions.language.follow_grammar import held_out_pairs
from gn0.missions.language.person_nouns import (
    garment_word,
    is_pair,
    pattern_word,
    say_garment,
    say_hair,
)
from gn0.missions.language.word_forms import indefinite

Record = Mapping[str, str]
_MOST = 9  # words of a record in one text
_SEX, _ADJECTIVE, _MORE = 0.9, 0.25, 0.65  # how often: woman or man, age or build, more than needed
_COLOURED = 0.8  # how often a garment goes by its colour, where there is a choice
_COLOURS = frozenset(("top_colour", "bottom_colour"))
_ADJECTIVES = {
    "stature": {"short": "short", "tall": "tall"},
    "build": {"slim": "slim", "heavy": "heavyset", "muscular": "muscular"},
    "age": {"young": "young", "middle-aged": "middle-aged", "elderly": "elderly"},
}


@dataclass(frozen=True)
class PersonChoice:
    """What is said of a person.

    Attributes:
        said: keys of the record that are said.
        complete: whether they tell the person from everybody else.
    """

    said: frozenset[str]
    complete: bool


def has_held_out_pair(record: Record) -> bool:
    """Whether a person wears a colour and garment that training never sees together."""
    return any(pair in held_out_pairs() for pair in _pairs(record, frozenset(record)))


def _pairs(record: Record, said: frozenset[str]) -> Iterator[tuple[str, str]]:
    for part in ("top", "bottom"):
        if {part, f"{part}_colour"} <= said and record.get(part, "none") != "none":
            yield (record[f"{part}_colour"], garment_word(part, record[part]))


def choose_words(
    people: Sequence[Record],
    who: int,
    sight: Sight,
    stream: np.random.Generator,
    *,
    held_out: bool,
) -> PersonChoice:
    """Which keys of a record to say.

    Seen splits never say a pair that is held out; unseen ones do wherever there is one.

    Args:
        people: records of all who are there.
        who: which of them is meant.
        sight: how they are first seen.
        stream: chance.
        held_out: for unseen splits.
    """
    record = people[who]
    others = [other for k, other in enumerate(people) if k != who]
    shown = seen_words(record, sight)
    parts = _combinations(record, shown)
    everybody = (1 << len(others)) - 1
    for telling in (frozenset(("sex",)), frozenset[str]()):  # from behind, sex is told by no more
        apart: dict[str, int] = {}  # others that each key excludes, a bit each
        for bit, other in enumerate(others):
            for key in words_apart(record, other, sight) - telling:
                apart[key] = apart.get(key, 0) | 1 << bit
        found, best = _search(record, parts, apart, held_out)
        if best == everybody:
            break
    said = _draw(record, found, stream, held_out)
    if stream.random() < _SEX:
        said |= {"sex"}
    if stream.random() < _ADJECTIVE:
        fit = [
            key for key, words in _ADJECTIVES.items() if key in shown and record.get(key) in words
        ]
        if fit:
            said |= {fit[int(stream.integers(len(fit)))]}
    return PersonChoice(said, best == everybody)


def _search(
    record: Record, parts: list[list[frozenset[str]]], apart: Mapping[str, int], held_out: bool
) -> tuple[dict[int, list[frozenset[str]]], int]:
    """By number of words, what may be said to exclude the most others, and whom that excludes."""
    masks = [[_mask(keys, apart) for keys in part] for part in parts]
    found: dict[int, list[frozenset[str]]] = {}
    most, best = -1, 0
    for numbers in product(*(range(len(part)) for part in parts)):
        mask, count = 0, 0
        for part, mask_of, number in zip(parts, masks, numbers, strict=True):
            mask |= mask_of[number]
            count += len(part[number])
        covered = mask.bit_count()
        if covered < most or not 1 <= count <= _MOST:
            continue
        said: frozenset[str] = frozenset().union(
            *(part[n] for part, n in zip(parts, numbers, strict=True))
        )
        bare_colour = "top_colour" in said and "top" not in said
        if bare_colour and said & {"bottom", "shoes"}:  # "in red and trousers"
            continue
        if not held_out and any(pair in held_out_pairs() for pair in _pairs(record, said)):
            continue
        if covered > most:
            found, most, best = {}, covered, mask
        found.setdefault(count, []).append(said)
    return found, best


def _mask(keys: frozenset[str], apart: Mapping[str, int]) -> int:
    mask = 0
    for key in keys:
        mask |= apart.get(key, 0)
    return mask


def _draw(
    record: Record,
    found: dict[int, list[frozenset[str]]],
    stream: np.random.Generator,
    held_out: bool,
) -> frozenset[str]:
    """One of the choices: as few words as will do, or some more."""
    if held_out:
        unseen = {
            count: kept
            for count, choices in found.items()
            if (
                kept := [
                    c for c in choices if any(p in held_out_pairs() for p in _pairs(record, c))
                ]
            )
        }
        found = unseen or found
    counts = sorted(found)
    more = int(stream.integers(1, 4)) if stream.random() < _MORE else 0
    wanted = counts[0] + more
    count = min(counts, key=lambda c: (abs(c - wanted), c))
    choices = found[count]
    coloured = [c for c in choices if c & _COLOURS]
    if coloured and stream.random() < _COLOURED:
        choices = coloured
    return choices[int(stream.integers(len(choices)))]


def _combinations(record: Record, shown: frozenset[str]) -> list[list[frozenset[str]]]:
    """For each part, the sets of keys that may be said of it together."""

    def sets(*groups: tuple[str, ...]) -> list[frozenset[str]]:
        return [frozenset(), *(frozenset(g) for g in groups if set(g) <= shown)]

    mixed = record.get("top_pattern", "plain") in SHOWN_PATTERNS
    tops: list[tuple[str, ...]] = [("top",), ("top", "top_colour")]
    if not mixed:
        tops.append(("top_colour",))
    bottoms: list[tuple[str, ...]] = [("bottom",), ("bottom", "bottom_colour")]
    for part, groups in (("top", tops), ("bottom", bottoms)):
        pattern = record.get(f"{part}_pattern", "plain")
        if pattern == "denim" and "jeans" in garment_word(part, record[part]):
            continue
        groups.append((part, f"{part}_colour", f"{part}_pattern"))
        if pattern != "plain":
            groups.append((part, f"{part}_pattern"))
    return [
        [frozenset(), frozenset(("sex",))],
        sets(*tops),
        sets(*bottoms) if record.get("bottom", "none") != "none" else [frozenset()],
        sets(("hair",), ("hair_colour",), ("hair", "hair_colour")),
        sets(("hat",)),
        sets(("extra",), ("extra", "extra_colour")),
        sets(("shoes_colour", "shoes")),
    ]


@dataclass(frozen=True)
class PersonPhrase:
    """A person in words.

    Attributes:
        noun: "tall young woman".
        has: what she has on and about her, with articles: "long hair and a red scarf"; or "".
        clothes: "the red checked shirt and blue jeans"; or "".
        words: what is said, by the record's keys, in the words that say it.
    """

    noun: str
    has: str
    clothes: str
    words: dict[str, str]


def say_person(record: Record, said: frozenset[str], stream: np.random.Generator) -> PersonPhrase:
    """The keys of a record that are said, as parts of a sentence."""
    words: dict[str, str] = {}
    adjectives = []
    for key, forms in _ADJECTIVES.items():
        if key in said:
            words[key] = forms[record[key]]
            adjectives.append(words[key])
    noun = record["sex"] if "sex" in said else "person"
    words["sex"] = noun
    the = stream.random() < 0.5
    clothes = []
    for part in ("top", "bottom", "shoes"):
        keys = [k for k in (part, f"{part}_colour", f"{part}_pattern") if k in said]
        if not keys:
            continue
        for key in keys:
            value = record[key]
            words[key] = (
                garment_word(part, value) if key == part
                else pattern_word(value) if key.endswith("_pattern") else value
            )  # fmt: skip
        if part not in said:  # "in red"
            clothes.append(words[f"{part}_colour"])
            continue
        name = words[part]
        told = say_garment(name, words.get(f"{part}_colour", ""), words.get(f"{part}_pattern", ""))
        plural = is_pair(name)
        article = the and not (plural and clothes)
        clothes.append(f"the {told}" if article else told if plural else indefinite(told))
    has = []
    if said & {"hair", "hair_colour"}:
        cut = record["hair"] if "hair" in said else ""
        colour = record["hair_colour"] if "hair_colour" in said else ""
        told = say_hair(cut, colour)
        if cut:
            words["hair"] = say_hair(cut)
        if colour:
            words["hair_colour"] = colour
        has.append(told)
    if "hat" in said:
        words["hat"] = "hat"
        has.append("a hat")
    if "extra" in said:
        words["extra"] = record["extra"]
        colour = record["extra_colour"] if "extra_colour" in said else ""
        if colour:
            words["extra_colour"] = colour
        has.append(indefinite(" ".join(w for w in (colour, record["extra"]) if w)))
    return PersonPhrase(" ".join([*adjectives, noun]), _list(has), _list(clothes), words)


def _list(names: Sequence[str]) -> str:
    """Names with commas and "and" between them."""
    if len(names) < 3:
        return " and ".join(names)
    return f"{', '.join(names[:-1])} and {names[-1]}"
