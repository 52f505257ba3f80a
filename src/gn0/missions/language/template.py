"""The provider `template`: a seeded grammar over segments, landmarks and rooms. No network."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass, field

import msgspec
import numpy as np

from gn0.missions.language.grammar import (
    JOINTS,
    LAST_JOINTS,
    MIDDLE_JOINTS,
    OPENINGS,
    PLAIN_JOINTS,
    SECOND_OPENINGS,
    phrases,
)
from gn0.missions.language.route import (
    NOWHERE,
    Landmark,
    RouteDescription,
    RouteSegment,
    RouteTarget,
    Style,
)
from gn0.missions.language.word_forms import definite, indefinite, is_plural, is_stuff
from gn0.seeds import random_stream

SOFT, SHARP = 55.0, 115.0  # degrees
SHORT = 1.2  # m: a shorter straight between two turns needs no clause
LONG = 4.0  # m: a straight that goes through a room rather than on
ALONG = 2.5  # m in a hallway before one speaks of its end
SOON = 1.6  # m after a turn: one turns into the room
LANDMARKS_MOST = 6  # in one text
_ONGOING = ("continue", "keep going", "keep walking", "carry on", "move on", "go on", "walk on")
# one is on a lawn, not in it
_ON_GROUND = re.compile(
    r"\b([Ii])n(to)? "
    r"((?:the|an?) (?:\w+ )?(?:lawn|terrace|patio|balcony|porch|path|plaza|square|deck|walkway))\b"
)
NARROW_ROOMS = frozenset(("hallway", "corridor", "hall", "aisle", "passage", "path", "alley"))


@dataclass
class _Text:
    """A text in the making."""

    route: RouteDescription
    style: Style
    rng: np.random.Generator
    held_out: bool
    used: set[str] = field(default_factory=set)
    clauses: list[str] = field(default_factory=list)
    skeleton: list[str] = field(default_factory=list)

    def add(self, kind: str, **slots: str) -> None:
        """Add a clause of a kind."""
        usable = phrases(kind, self.held_out)
        if not self.clauses:  # nobody keeps going who has not begun
            usable = tuple(p for p in usable if not p.startswith(_ONGOING)) or usable
        phrase = usable[int(self.rng.integers(len(usable)))]
        self.skeleton.append(phrase)
        self.clauses.append(phrase.format_map(slots))

    def chance(self, p: float) -> bool:
        return bool(self.rng.random() < p)


class ProviderTemplate:
    """Writes from a grammar; the same route, style and seed give the same text."""

    name = "template"
    version = "1"
    concurrency = 1

    def write(
        self, route: RouteDescription, style: Style, *, seed: int, held_out: bool = False
    ) -> str:
        """A text; see `gn0.missions.language.providers.TextProvider`."""
        return self.compose(route, style, seed=seed, held_out=held_out)[0]

    def compose(
        self, route: RouteDescription, style: Style, *, seed: int, held_out: bool = False
    ) -> tuple[str, tuple[str, ...]]:
        """A text and the phrases it is made of."""
        rng = random_stream(seed, "instruction", self.version, route.key, style, int(held_out))
        text = _Text(route, style, rng, held_out)
        if style == "base":
            _write_base(text)
            joined = text.clauses[0]
        else:
            _write_steps(text)
            _write_arrival(text)
            joined = _join_detailed(text) if style == "detailed" else _join_benchmark(text)
        return say_grounds(joined), tuple(text.skeleton)


def say_grounds(text: str) -> str:
    """A text in which one is on a lawn, not in it."""
    return _ON_GROUND.sub(_on_ground, text)


def _on_ground(hit: re.Match[str]) -> str:
    return f"{'On' if hit[1] == 'I' else 'on'}{hit[2] or ''} {hit[3]}"


def target_phrase(target: RouteTarget, *, route: bool) -> str:
    """The target with its article, and with its neighbour where that tells it from others."""
    if target.region:
        return definite(target.name) if target.unique else indefinite(target.name)
    if target.near:
        return f"{definite(target.name)} next to the {target.near}"
    # at the end of a route one stands before the very ones that are meant
    plural = route and (is_plural(target.name) or is_stuff(target.name))
    return definite(target.name) if target.unique or plural else indefinite(target.name)


def landmark_phrase(landmark: Landmark) -> str:
    """The landmark with its article."""
    return definite(landmark.name) if landmark.unique else indefinite(landmark.name)


def distance_phrase(metres: float) -> str:
    """A distance in whole metres, at least one: "1 meter", "3 meters"."""
    whole = max(1, round(metres))
    return f"{whole} meter" if whole == 1 else f"{whole} meters"


def _write_base(text: _Text) -> None:
    target = text.route.target
    name = target_phrase(target, route=False)
    if target.region:
        text.add("base" if target.name == NOWHERE else "base region", target=name)
    elif target.room and text.chance(0.35):
        room = _room(text, target.room)
        any_one = target_phrase(target, route=False) if target.near else indefinite(target.name)
        text.add("base room", target=name, troom=room, target_any=any_one)
    else:
        if target.room:
            name += f" in {_room(text, target.room)}"
        text.add("base", target=name)


def _room(text: _Text, name: str) -> str:
    """A room that is entered or talked of: "a bedroom" where there are several."""
    return indefinite(name) if name in text.route.shared_rooms else definite(name)


def _write_steps(text: _Text) -> None:
    segments = [_without_room(s, text.route.target.name) for s in text.route.segments]
    entered = False
    for i, segment in enumerate(segments):
        following = segments[i + 1] if i + 1 < len(segments) else None
        if segment.turn is not None:
            before = segments[i - 1] if i > 0 else None
            entered = _write_turn(text, segment, before, following)
        else:
            _write_straight(text, segment, entered, last=following is None)
            entered = False


def _without_room(segment: RouteSegment, name: str) -> RouteSegment:
    """A segment that does not tell of the room that is the target: that one is named at the end."""
    return msgspec.structs.replace(
        segment,
        inside="" if segment.inside == name else segment.inside,
        leaves="" if segment.leaves == name else segment.leaves,
        enters="" if segment.enters == name else segment.enters,
        crosses=tuple(room for room in segment.crosses if room != name),
    )


def _take(text: _Text, segment: RouteSegment, *relations: str) -> Landmark | None:
    """The best landmark of a segment that has not been told yet."""
    if len(text.used) >= LANDMARKS_MOST:
        return None
    for landmark in segment.landmarks:
        if landmark.relation in relations and landmark.name not in text.used:
            text.used.add(landmark.name)
            return landmark
    return None


def _slots(landmark: Landmark) -> dict[str, str]:
    slots = {"lm": landmark_phrase(landmark), "is": "are" if landmark.plural else "is"}
    return {**slots, "on": landmark.side} if landmark.side else slots


def _ends_here(segment: RouteSegment, before: RouteSegment | None) -> bool:
    """Whether a turn is at the end of a hallway: one has walked along it and can go no further."""
    if before is None or not segment.blocked_ahead or segment.inside not in NARROW_ROOMS:
        return False
    came = before.enters or before.inside
    walked = before.distance - (before.enters_after if before.enters else 0.0)
    return came == segment.inside and walked >= ALONG


def _write_turn(
    text: _Text, segment: RouteSegment, before: RouteSegment | None, after: RouteSegment | None
) -> bool:
    """Write a turn; whether it told where the next straight goes in."""
    if segment.turn == "around":
        landmark = _take(text, segment, "facing")
        if landmark is not None:
            text.add("around facing", **_slots(landmark))
        else:
            text.add("around")
        return False
    side = str(segment.turn)
    soon = after is not None and after.enters and after.enters_after <= SOON and not after.crosses
    if soon and after is not None and text.chance(0.6):
        text.add("turn into", side=side, room=_room(text, after.enters))
        return True
    if _ends_here(segment, before) and text.chance(0.5):
        text.add("turn end", side=side, mid=definite(segment.inside))
        return False
    landmark = _take(text, segment, "at", "facing")
    if landmark is not None:
        kind = "turn at" if landmark.relation == "at" else "turn facing"
        text.add(kind, side=side, **_slots(landmark))
        return False
    if after is not None and after.doors == 1 and after.door_after <= SOON and not soon:
        text.add("turn door", side=side)
        return True
    if abs(segment.angle) < SOFT and text.chance(0.6):
        text.add("turn soft", side=side)
    elif abs(segment.angle) > SHARP and text.chance(0.6):
        text.add("turn sharp", side=side)
    else:
        text.add("turn", side=side)
    return False


def _write_straight(text: _Text, s: RouteSegment, entered: bool, *, last: bool) -> None:
    far = text.style == "detailed" and s.distance >= SHORT
    n = {"n": distance_phrase(s.distance)} if far else {}
    enters = s.enters if not entered else ""
    # areas for moves: a room that is entered comes before a thing that is passed
    if enters:
        room = {"room": _room(text, enters)}
        left = {"left": definite(s.leaves)} if s.leaves and s.leaves != enters else {}
        if s.crosses and s.crosses[0] not in (enters, s.leaves):
            text.add("pass room", mid=definite(s.crosses[0]), **room)
        elif far and left and text.chance(0.3):
            text.add("far leave enter", **n, **room, **left)
        elif far and text.chance(0.7):
            text.add("far enter", **n, **room)
        elif s.doors and text.chance(0.5):
            text.add("enter door", **room)
        elif left and text.chance(0.5):
            text.add("leave enter", **room, **left)
        else:
            text.add("enter", **room)
        return
    if s.crosses and not entered and not far:
        text.add("through", mid=definite(s.crosses[-1]))
        return
    if s.distance < SHORT and not (last and not text.clauses):
        return
    landmark = _take(text, s, "past", "towards")
    if landmark is not None:
        relation = landmark.relation
        text.add(f"far {relation}" if far else relation, **n, **_slots(landmark))
    elif s.doors and not entered and not far:
        text.add("door")
    elif s.leaves and not entered and not far:
        text.add("leave", left=definite(s.leaves))
    elif (here := s.enters if entered and s.enters else s.inside if not s.leaves else "") and (
        s.distance >= LONG and text.chance(0.7)
    ):
        kind = "along" if here in NARROW_ROOMS else "through"
        text.add(f"far {kind}" if far else kind, **n, mid=definite(here))
    else:
        text.add("go far" if far else "go", **n)


def _write_arrival(text: _Text) -> None:
    target = text.route.target
    slots = {"target": target_phrase(target, route=True)}
    if target.region:
        text.add("arrive nowhere" if target.name == NOWHERE else "arrive region", **slots)
    elif target.side in ("left", "right") and text.chance(0.4):
        text.add("arrive side", at=target.side, **slots)
    elif target.side == "ahead" and text.chance(0.4):
        text.add("arrive ahead", **slots)
    else:
        text.add("arrive", **slots)


def _pick(text: _Text, choices: Sequence[str]) -> str:
    return choices[int(text.rng.integers(len(choices)))]


def _sentence(text: _Text, clauses: Sequence[str]) -> str:
    """Clauses as one sentence, without its capital and full stop."""
    if len(clauses) == 1:
        return clauses[0]
    if len(clauses) == 2:
        # two "and" in a row would hide which belongs to which
        joints = PLAIN_JOINTS if " and " in clauses[0] + clauses[1] else JOINTS
        return clauses[0] + _pick(text, joints) + clauses[1]
    out = clauses[0]
    for clause in clauses[1:-1]:
        out += _pick(text, MIDDLE_JOINTS) + clause
    last = PLAIN_JOINTS if " and " in clauses[-2] + clauses[-1] else LAST_JOINTS
    return out + _pick(text, last) + clauses[-1]


def _finish(sentences: Sequence[str]) -> str:
    return " ".join(s[0].upper() + s[1:] + "." for s in sentences)


def _join_benchmark(text: _Text) -> str:
    """One sentence, or two where there is more to say."""
    clauses = text.clauses
    if len(clauses) <= 3 or (len(clauses) == 4 and text.chance(0.4)):
        return _finish([_sentence(text, clauses)])
    cut = (len(clauses) + 1) // 2
    second = _pick(text, SECOND_OPENINGS) + _sentence(text, clauses[cut:])
    return _finish([_sentence(text, clauses[:cut]), second])


def _join_detailed(text: _Text) -> str:
    """A sentence for one or two steps each."""
    sentences: list[str] = []
    opening = ""
    rest = list(text.clauses)
    while rest:
        size = 2 if len(rest) >= 2 and text.chance(0.6) else 1
        body = _sentence(text, rest[:size])
        if sentences:  # never twice the same in a row
            opening = _pick(text, [o for o in OPENINGS if o != opening or not o])
        sentences.append(opening + body)
        rest = rest[size:]
    return _finish(sentences)
