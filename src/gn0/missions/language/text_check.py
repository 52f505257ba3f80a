"""Every text is checked against its route before it is accepted."""

from __future__ import annotations

import re
import unicodedata
from dataclasses import dataclass
from functools import lru_cache

from gn0.missions.language.route import NOWHERE, RouteDescription, Style
from gn0.missions.language.word_forms import COMMON_NAMES, name_pattern, plural_of

LANDMARKS_MOST = 6  # distinct ones in one text
STRUCTURE = frozenset(("door", "doorway", "room"))  # may be said of any route
_AFTER_TARGET = 10  # words

_AROUND = re.compile(
    r"\bturn(?:ing|s)?(?: all the way| completely| fully| right)? (?:around|round|back)\b"
    r"(?! (?:the|a|an|to the left|to the right)\b(?! other))"
    r"|\bfac(?:e|ing) the other way\b|\b(?:u|about)[- ]turn\b",
    re.IGNORECASE,
)
_SIDE_WORD = re.compile(r"\b(left|right)(?:[- ]hand)?\b", re.IGNORECASE)
_BESIDE = re.compile(r"\b(?:on|at|along|down|from) (?:your|the|its|my)(?: \w+)? $")
_TO_SIDE = re.compile(r"\bto (?:your|the|my|its)(?: \w+)? $")
_TURNING_TO = re.compile(
    r"\b(?:turn\w*(?: \w+)?|veer\w*|bear\w*|curv\w*|angl\w*|head\w*|drift\w*|swing\w*|go|going|"
    r"step\w*|pivot\w*|rotat\w*|mov\w*|cut\w*|look\w*)(?: \w+){0,2} "
    r"to (?:your|the|my|its)(?: \w+)? $"
)
_HAVE_LEFT = re.compile(r"\b(?:have|has|had|having|you've|you|just|being) $")
_TURN_BEFORE = re.compile(
    r"\b(?:turn\w*|veer\w*|bear\w*|tak\w+ an?|mak\w+ an?|sharp\w*|hard|immediate\w*|an?|swing\w*)"
    r" $"
)
_ADVERB_AFTER = re.compile(
    r"^ (?:by|next|before|after|in front|there|away|beside|now|behind|here|past|up|through|across|"
    r"along|back|outside|inside|where|when|as|ahead|near|between)\b"
)
_NUMBER = (
    r"(?:\d+(?:[.,]\d+)?|an?|one|two|three|four|five|six|seven|eight|nine|ten|eleven|twelve|"
    r"fifteen|twenty|thirty|half an?|a few|a couple(?: of)?|several|some)"
)
_DISTANCE = re.compile(
    rf"\b({_NUMBER})(?: more)?[ -]?(m|meters?|metres?|cm|centimeters?|centimetres?|feet|foot|ft|"
    r"yards?|steps?|paces?|inch(?:es)?)\b",
    re.IGNORECASE,
)
_COUNTS: dict[str, float] = {
    "a": 1, "an": 1, "one": 1, "two": 2, "three": 3, "four": 4, "five": 5, "six": 6, "seven": 7,
    "eight": 8, "nine": 9, "ten": 10, "eleven": 11, "twelve": 12, "fifteen": 15, "twenty": 20,
    "thirty": 30,
}  # fmt: skip
_DEGREES = re.compile(r"\d\s?°|\bdegrees?\b|\bradians?\b", re.IGNORECASE)
_MARKUP = re.compile(r"[<>{}\[\]|`*#_\\]|\bassistant:|\buser:|\bsystem:", re.IGNORECASE)
_SENTENCE_END = re.compile(r"[.!?]+(?=\s|$)")


@dataclass(frozen=True)
class Mention:
    """A name found in a text: from where to where, and in which form of ours."""

    begin: int
    end: int
    name: str


def check_text(text: str, route: RouteDescription, style: Style) -> list[str]:
    """What is wrong with a text for this route and style; empty when it may be used."""
    faults = _check_form(text, route, style)
    if faults:
        return faults
    plain = " ".join(text.lower().split())
    mentions = find_mentions(plain, route)
    # what a thing is called tells no turn and no distance
    bare = _blank(plain, mentions)
    turns = find_turns(bare)
    expected = () if style == "base" else route.turns
    if tuple(turn for _, turn in turns) != expected:
        said = ", ".join(turn for _, turn in turns) or "none"
        faults.append(f"turns are {said} instead of {', '.join(expected) or 'none'}")
    faults += _check_names(mentions, route, style)
    faults += _check_target(plain, mentions, turns, route, style)
    faults += _check_sides(bare, mentions, route)
    faults += _check_distances(bare, route, style)
    return faults


def _check_form(text: str, route: RouteDescription, style: Style) -> list[str]:
    if not text.strip():
        return ["the text is empty"]
    faults = []
    if any(unicodedata.category(c) in ("Cc", "Cf", "Co", "Cs", "Zl", "Zp") for c in text):
        faults.append("it holds a line break or a control character")
    if _MARKUP.search(text):
        faults.append("it holds control tokens or markup")
    words = len(text.split())
    steps = len(route.segments)
    limit = {"base": 30, "benchmark": 36 + 16 * steps, "detailed": 36 + 20 * steps}[style]
    if words > limit or len(text) > 12 * limit:
        faults.append(f"it is too long: {words} words, at most {limit}")
    sentences = len(_SENTENCE_END.findall(text.strip())) + (text.strip()[-1] not in ".!?")
    most = {"base": 1, "benchmark": 2, "detailed": max(3, steps + 2)}[style]
    if sentences > most:
        faults.append(f"it has {sentences} sentences, at most {most}")
    if re.search(r"\bslight(?:ly)?\b", text, re.IGNORECASE):
        faults.append('it says "slightly"')
    return faults


@lru_cache(maxsize=256)
def _known_names(names: frozenset[str]) -> tuple[re.Pattern[str], dict[str, str]]:
    forms = {plural_of(name): name for name in names} | {name: name for name in names}
    return name_pattern(sorted(names)), forms


def find_mentions(plain: str, route: RouteDescription) -> list[Mention]:
    """Every name of an object or room in a lower-case text, longest names first."""
    names = COMMON_NAMES | _allowed(route, "detailed") | set(route.vocabulary)
    pattern, forms = _known_names(names)
    out = []
    for hit in pattern.finditer(plain):
        form = " ".join(hit.group().replace("-", " ").split())
        out.append(Mention(hit.start(), hit.end(), forms.get(form, forms.get(hit.group(), form))))
    return out


def _blank(plain: str, mentions: list[Mention]) -> str:
    """The text with every name as a word of x's, all else in its place."""
    for m in mentions:
        plain = plain[: m.begin] + "x" * (m.end - m.begin) + plain[m.end :]
    return plain


def find_turns(plain: str) -> list[tuple[int, str]]:
    """The turns that a lower-case text tells, in order: (where, "left" | "right" | "around").

    "On your left" and the like say where a thing is and are no turns.
    """
    return [(at, word) for at, word, is_turn in _directions(plain) if is_turn]


def _directions(plain: str) -> list[tuple[int, str, bool]]:
    out: list[tuple[int, str, bool]] = []
    covered = []
    for hit in _AROUND.finditer(plain):
        out.append((hit.start(), "around", True))
        covered.append((hit.start(), hit.end()))
    for hit in _SIDE_WORD.finditer(plain):
        if any(a <= hit.start() < b for a, b in covered):
            continue
        before, after, word = plain[: hit.start()], plain[hit.end() :], hit.group(1)
        if _BESIDE.search(before):
            out.append((hit.start(), word, False))
        elif _TO_SIDE.search(before):
            out.append((hit.start(), word, bool(_TURNING_TO.search(before))))
        elif (word == "left" and _HAVE_LEFT.search(before)) or (
            word == "right" and _ADVERB_AFTER.match(after) and not _TURN_BEFORE.search(before)
        ):
            continue
        else:
            out.append((hit.start(), word, True))
    return sorted(out)


def _allowed(route: RouteDescription, style: Style) -> set[str]:
    target = route.target
    names = {target.name, target.near, target.room} - {""}
    if style != "base":
        names |= {landmark.name for landmark in route.landmarks} | set(route.rooms)
    return names


def _check_names(mentions: list[Mention], route: RouteDescription, style: Style) -> list[str]:
    allowed = _allowed(route, style) | STRUCTURE
    allowed |= {plural_of(name) for name in allowed}
    unknown = sorted({m.name for m in mentions} - allowed)
    faults = [f"unknown landmark {name!r}" for name in unknown]
    landmarks = {m.name for m in mentions} & {x.name for x in route.landmarks}
    landmarks -= set(route.rooms)
    if len(landmarks) > LANDMARKS_MOST:
        faults.append(f"{len(landmarks)} landmarks, at most {LANDMARKS_MOST}")
    return faults


def _check_target(
    plain: str,
    mentions: list[Mention],
    turns: list[tuple[int, str]],
    route: RouteDescription,
    style: Style,
) -> list[str]:
    target = route.target
    if target.name == NOWHERE:
        own = [Mention(h.start(), h.end(), target.name) for h in
               re.finditer(rf"\b{target.name}\b", plain)]  # fmt: skip
    else:
        own = [m for m in mentions if m.name == target.name]
    if len(own) != 1:
        return [f"the target {target.name!r} is named {len(own)} times instead of once"]
    if style == "base":
        # what was left unsaid would fit others, which do not count
        told = {m.name for m in mentions}
        return [
            f"it does not say {what} {name!r}"
            for what, name in (("that it is next to the", target.near), ("the room", target.room))
            if name and name not in told
        ]
    after = plain[own[0].end :]
    closing = {target.near, target.room, ""}
    if (
        _SENTENCE_END.search(after.rstrip(" .!?"))
        or any(at > own[0].begin for at, _ in turns)
        or any(m.begin > own[0].begin and m.name not in closing for m in mentions)
        or len(after.split()) > _AFTER_TARGET
    ):
        return [f"the target {target.name!r} is not named at the end"]
    return []


def _check_sides(plain: str, mentions: list[Mention], route: RouteDescription) -> list[str]:
    """A side that is told of a landmark is the side it is on."""
    sides: dict[str, set[str]] = {}
    for landmark in (m for segment in route.segments for m in segment.landmarks):
        if landmark.side:
            sides.setdefault(landmark.name, set()).add(landmark.side)
    if route.target.side in ("left", "right"):
        sides.setdefault(route.target.name, set()).add(route.target.side)
    faults = []
    for at, word, is_turn in _directions(plain):
        if is_turn:
            continue
        near = [m for m in mentions if m.end <= at and not _SENTENCE_END.search(plain[m.end : at])]
        if not near or len(plain[near[-1].end : at].split()) > 8:
            continue
        name = near[-1].name
        if name == route.target.near:
            name = route.target.name
        if word not in sides.get(name, set()):
            faults.append(f"{name!r} is not on the {word}")
    return faults


def _check_distances(plain: str, route: RouteDescription, style: Style) -> list[str]:
    if _DEGREES.search(plain):
        return ["it tells an angle"]
    found = [hit.groups() for hit in _DISTANCE.finditer(plain)]
    if not found:
        return []
    if style != "detailed":
        return ["it tells a distance"]
    rest = iter([s.distance for s in route.segments if s.turn is None])
    for number, unit in found:
        if not unit.startswith("met") and unit != "m":
            return [f"it counts in {unit}"]
        value = _COUNTS.get(number)
        if re.match(r"\d", number):
            value = float(number.replace(",", "."))
        if value is None:
            return [f"{number} {unit} is not a distance of the route"]
        # in the order of the route, to the metre or a quarter
        if not any(abs(value - d) <= max(1.0, 0.25 * d) for d in rest):
            return [f"{number} {unit} is not a distance of the route, or not in its order"]
    return []
