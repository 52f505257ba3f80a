"""What the eye can tell of people: which words of a record show, which tell two people apart.

Stricter than a record: what light, distance or another garment may hide is not counted.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Literal

import msgspec

from gn0.avatars.colour_names import NAMES
from gn0.avatars.identity import Identity
from gn0.avatars.skin_paint import HAIR_COLOURS
from gn0.avatars.wardrobe import BOTTOMS, HAIR, HATS, SHOES, TOPS
from gn0.config import Config
from gn0.errors import DataError, brief
from gn0.seeds import random_stream

Record = Mapping[str, str]
# by what people are told apart; the rest of a record is said at most as an ornament
TELLING = (
    "sex", "hair", "hair_colour", "top", "top_colour", "top_pattern", "bottom", "bottom_colour",
    "bottom_pattern", "shoes_colour", "hat", "extra", "extra_colour",
)  # fmt: skip
SHOWN_PATTERNS = frozenset(("striped", "checked", "dotted", "patched"))
FEET = 2.4  # from which on shoes are in a picture whose eye is at 1.3 m [m]
_SHORT = frozenset(("shorts", "knee_shorts", "short_skirt", "skirt"))  # out of sight under a coat
_OVER_SHOES = frozenset(("wide_trousers", "long_skirt"))
_LONG_TOPS = frozenset(("long_coat", "long_dress"))
_LOW_HAIR = frozenset(("long01", "bob01", "bob02"))  # hides a scarf from behind

_COLOURS = (
    "grey black", "beige white", "grey white", "grey beige", "brown black", "brown red",
    "brown beige", "blue purple", "pink purple", "pink beige", "blue black", "yellow beige",
)  # fmt: skip
_HAIR_COLOURS = ("black dark_brown", "dark_brown brown", "brown red", "grey white", "blond white")
_LENGTHS = {  # from behind a bob is short hair, and a ponytail may be any
    "short01": "short", "short02": "short", "short03": "short", "short04": "short",
    "bob01": "short", "bob02": "short", "long01": "long",
}  # fmt: skip
# garments of one class are taken for each other
_TOP_CLASSES = (
    ("tee_slim", "sports_top", "tee", "loose_tee", "vest", "short_shirt"),
    ("sweater", "long_sleeve", "shirt", "turtleneck", "v_sweater"),
    ("collar_jacket", "parka", "suit", "shirt"),
    ("coat", "long_coat", "parka"),
    ("dress", "long_dress"),
)
_BOTTOM_CLASSES = (
    ("slim", "trousers", "suit_trousers", "leggings", "wide_trousers", "straight_trousers"),
    ("shorts", "knee_shorts", "short_skirt"),
    ("short_skirt", "skirt"),
    ("skirt", "long_skirt"),
)


class Sight(Config, frozen=True):
    """How a person is first seen: from behind or in front, and how far away [m]."""

    side: Literal["behind", "front"] = "behind"
    distance: float = 1.5


def _paired(*groups: str) -> frozenset[frozenset[str]]:
    return frozenset(frozenset(w.replace("_", " ") for w in g.split()) for g in groups)


_ALIKE = {
    "colour": _paired(*_COLOURS),
    "hair_colour": _paired(*_HAIR_COLOURS),
}


def seen_words(record: Record, sight: Sight) -> frozenset[str]:
    """The keys of a record that show: what a hat, a coat, hair or the picture's edge hides do not.

    A pattern shows where its two colours differ, a print from the front alone.
    """
    r = {**dict.fromkeys(TELLING, "none"), **record}
    shown = {"sex", "age", "build", "stature", "hair", "hair_colour", "top", "top_colour"}
    behind = sight.side == "behind"
    if r["top"] in ("coat", "long_coat", "parka", "collar_jacket", "suit"):
        shown.discard("build")
    if r["hat"] != "none":
        if r["hair"] not in ("bob01", "bob02"):  # which come out over its brim
            shown.add("hat")
        shown.discard("hair")
        if r["hair"] not in _LOW_HAIR:
            shown.discard("hair_colour")
    if not behind and r["hair"] == "ponytail01":
        shown.discard("hair")
    if not _hides_bottom(r, behind):
        shown |= {"bottom", "bottom_colour"}
        if _pattern_shows(r, "bottom", behind):
            shown.add("bottom_pattern")
    if _pattern_shows(r, "top", behind):
        shown.add("top_pattern")
    if r["extra"] == "scarf" and not (behind and r["hair"] in _LOW_HAIR):
        shown |= {"extra", "extra_colour"}
    if r["extra"] == "apron" and not behind:
        shown |= {"extra", "extra_colour"}
    hidden = r["bottom"] in _OVER_SHOES or r["top"] in _LONG_TOPS
    if sight.distance >= FEET and not hidden:
        shown |= {"shoes", "shoes_colour"}
    return frozenset(shown)


def _hides_bottom(r: Mapping[str, str], behind: bool) -> bool:
    """Whether legs are out of sight, or nothing is worn on them."""
    bottom, top = r["bottom"], r["top"]
    if bottom == "none" or top == "long_coat":
        return True
    apron = r["extra"] == "apron" and not behind
    return bottom in _SHORT and (top == "coat" or apron)


def _pattern_shows(r: Mapping[str, str], part: str, behind: bool) -> bool:
    pattern = r.get(f"{part}_pattern", "plain")
    if pattern == "printed":
        return not behind and r["extra"] != "apron"
    second = r.get("second_colour", "")
    mixed = pattern in SHOWN_PATTERNS
    return not (mixed and alike("colour", r[f"{part}_colour"], second))


def alike(kind: str, one: str, other: str) -> bool:
    """Whether two words of a kind (colour, hair_colour, hair, top, bottom) may be mixed up."""
    if one == other:
        return True
    if kind in ("top", "bottom"):
        classes = _TOP_CLASSES if kind == "top" else _BOTTOM_CLASSES
        return any(one in group and other in group for group in classes)
    if kind == "hair":
        lengths = {_LENGTHS.get(one, ""), _LENGTHS.get(other, "")}
        return len(lengths) == 1 or "" in lengths
    return frozenset((one, other)) in _ALIKE[kind]


def words_apart(one: Record, other: Record, sight: Sight) -> frozenset[str]:
    """The keys of `TELLING` by which the eye tells one person from another.

    A key counts only where it shows of the first, and where it is certain that the other is
    different: what is hidden of him might be the same.
    """
    mine, his = seen_words(one, sight), seen_words(other, sight)
    out = set()
    for key in TELLING:
        if key not in mine:
            continue
        if key == "hat":
            apart = other.get("hat", "none") == "none"
        elif key in ("extra", "extra_colour"):
            apart = _extra_apart(one, other, key, his)
        elif key in ("bottom", "bottom_colour", "bottom_pattern"):
            apart = _bottom_apart(one, other, key, his)
        elif key.endswith("_pattern"):
            apart = key in his and _look(one, key) != _look(other, key)
        elif key == "sex":
            apart = one[key] != other[key]
        else:
            kind = "colour" if key in ("top_colour", "shoes_colour") else key
            apart = key in his and not alike(kind, one[key], other[key])
        if apart:
            out.add(key)
    return frozenset(out)


def _look(record: Record, key: str) -> str:
    """A pattern as it is told: knits, leather, denim and prints may pass for plain."""
    return record[key] if record[key] in SHOWN_PATTERNS else "plain"


def _extra_apart(one: Record, other: Record, key: str, his: frozenset[str]) -> bool:
    has = other.get("extra", "none") == one["extra"]
    if key == "extra":
        return not has
    return not has or ("extra" in his and not alike("colour", one[key], other[key]))


def _bottom_apart(one: Record, other: Record, key: str, his: frozenset[str]) -> bool:
    if other.get("bottom", "none") == "none":  # a dress
        return key == "bottom"
    if "bottom" not in his:
        return False
    if key == "bottom":
        return not alike("bottom", one[key], other[key])
    if key == "bottom_colour":
        return not alike("colour", one[key], other[key])
    return key in his and _look(one, key) != _look(other, key)


def read_record(record: Record, seed: int) -> Identity:
    """The person of a record of words; what the words leave open follows from the seed.

    Raises:
        DataError: a word is missing, or nobody here is or wears what it says.
    """
    fields = {key: record[key] for key in Identity.__struct_fields__ if key in record}
    try:
        who = msgspec.convert(
            {**fields, "tone": int(record.get("tone", 3)), "seed": int(seed)}, Identity
        )
    except (msgspec.ValidationError, ValueError) as error:
        raise DataError(
            f"not the record of a person: {error}", where="record",
            remedy="give the record of an avatar that GN0 made",
        ) from None  # fmt: skip
    for key, known in _KNOWN.items():
        if getattr(who, key) not in known:
            raise DataError(
                f"nobody has {brief(getattr(who, key))} for {key}", where=f"record, {key}",
                remedy=f"one of {', '.join(sorted(known))}",
            )  # fmt: skip
    return who


_KNOWN: dict[str, frozenset[str]] = {
    "sex": frozenset(("woman", "man")),
    "hair": frozenset(HAIR),
    "hair_colour": frozenset(HAIR_COLOURS),
    "top": frozenset(TOPS),
    "bottom": frozenset((*BOTTOMS, "none")),
    "shoes": frozenset(SHOES),
    "hat": frozenset((*HATS, "none")),
    "extra": frozenset(("scarf", "apron", "none")),
    **{f"{k}_colour": frozenset(NAMES) for k in ("top", "bottom", "shoes", "extra", "second")},
}
CHANGES = ("top_colour", "bottom_colour", "top_pattern", "top", "bottom", "hair", "hair_colour")


def change_record(record: Record, key: str, seed: int, sight: Sight | None = None) -> Identity:
    """Another person of the same words but one, by which the eye tells the two apart.

    Args:
        record: whose words are kept.
        key: which one changes, of `CHANGES`.
        seed: of the new word, and of all that words leave open: a face and a build of his own.
        sight: how both are seen.

    Raises:
        DataError: no other word of that key would show, or fit the rest.
    """
    sight = sight or Sight()
    stream = random_stream(
        seed, "change record", key, *sorted(f"{k}={v}" for k, v in record.items())
    )
    who = read_record(record, int(stream.integers(2**31)))
    options = [o for o in _options(who, key) if o != getattr(who, key)]
    for k in stream.permutation(len(options)):
        changed = {key: options[int(k)]}
        if key == "top_colour" and who.bottom == "none":  # a dress is of one colour
            changed["bottom_colour"] = changed[key]
        other = msgspec.structs.replace(who, **changed)
        if words_apart(record, other.words(), sight) == {key}:
            return other
    raise DataError(
        f"no other {key.replace('_', ' ')} would show", where="record",
        remedy="change another word",
    )  # fmt: skip


def _options(who: Identity, key: str) -> list[str]:
    """What else a person may have for a key, the rest of the record as it is."""
    wears = "women" if who.sex == "woman" else "men"
    if key == "top":
        return [
            k for k, g in TOPS.items()
            if getattr(g, wears) and g.bare == TOPS[who.top].bare and who.top_pattern in g.patterns
            and (k == "suit") == (who.top == "suit")
        ]  # fmt: skip
    if key == "bottom":
        return [
            k for k, g in BOTTOMS.items()
            if getattr(g, wears) and who.bottom_pattern in g.patterns and who.bottom != "none"
            and who.top != "suit" and k != "suit_trousers"
        ]  # fmt: skip
    if key == "top_pattern":
        return list(TOPS[who.top].patterns)
    if key == "hair":
        return [k for k, (_, women, men) in HAIR.items() if (women if wears == "women" else men)]
    if key == "hair_colour":
        return list(HAIR_COLOURS) if who.tone < 5 else ["black", "grey"]
    if key == "top_colour":
        free = who.top_pattern != "denim" and who.top != "suit"
        return [c for c in NAMES if c != who.second_colour] if free else []
    if key == "bottom_colour":
        free = who.bottom not in ("none", "suit_trousers") and who.bottom_pattern != "denim"
        return list(NAMES) if free else []
    return []
