"""What garments, patterns and hair of a person's record are called in a sentence."""

from __future__ import annotations

from gn0.avatars.wardrobe import BOTTOMS, HAIR, SHOES, TOPS

# words of a garment's name that come before its colour: "a long blue skirt"
_LEADS = ("long", "short", "wide", "short-sleeved", "long-sleeved")
_PAIRS = frozenset(("trousers", "jeans", "shorts", "leggings", "shoes", "trainers", "boots"))
_PATTERN_WORDS = {"dotted": "polka-dot", "patched": "camouflage"}
GARMENT_WORDS = tuple(dict.fromkeys(g.word for g in (*TOPS.values(), *BOTTOMS.values()) if g.word))


def garment_word(part: str, cut: str) -> str:
    """The name of a cut of `top`, `bottom` or `shoes`."""
    if part == "shoes":
        return SHOES[cut]
    return (TOPS if part == "top" else BOTTOMS)[cut].word


def pattern_word(pattern: str) -> str:
    """A pattern as it is said."""
    return _PATTERN_WORDS.get(pattern, pattern)


def say_garment(word: str, colour: str = "", pattern: str = "") -> str:
    """A garment without its article: "long blue polka-dot skirt", "plain red shirt".

    Of jeans it goes without saying that they are of denim.
    """
    lead, _, noun = word.partition(" ")
    if lead not in _LEADS or not noun:
        lead, noun = "", word
    told = "" if pattern == "denim" and noun == "jeans" else pattern
    plain = told if told == "plain" else ""
    return " ".join(w for w in (plain, lead, colour, told if not plain else "", noun) if w)


def is_pair(word: str) -> bool:
    """Whether a garment's name is a plural: "in blue jeans"."""
    return word.split(" ")[-1] in _PAIRS


def say_hair(cut: str = "", colour: str = "") -> str:
    """Hair with its article, of a cut's key and a colour: "bobbed blond hair", "a ponytail"."""
    name = HAIR[cut][0] if cut else "hair"
    if not name.endswith("hair"):
        lead, _, noun = name.partition(" ")
        return " ".join(w for w in (lead, colour, noun) if w)
    return " ".join(w for w in (name.removesuffix("hair").strip(), colour, "hair") if w)
