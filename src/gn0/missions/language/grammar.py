"""The grammar: phrases with slots, by meaning. A fixed fifth of each kind is held out.

Slots: {side} where a turn goes; {lm} a landmark with its article, {on} the side it is passed on;
{room} a room entered, {left} a room left, {mid} one gone through; {n} a distance; {target} the
target with its article, {at} its side; {is} "is" or "are" for the landmark, {troom} the target's
room. A phrase is one skeleton: the same words whatever is put into its slots.
"""

from __future__ import annotations

import hashlib
import math
import re
from collections.abc import Mapping, Sequence
from functools import cache

HELD_OUT = 0.2  # share of each kind that only unseen splits use

PHRASES: dict[str, tuple[str, ...]] = {
    # whole instructions that name the target alone
    "base": (
        "Go to {target}.", "Walk to {target}.", "Head to {target}.", "Find {target}.",
        "Make your way to {target}.", "Please go to {target}.", "Navigate to {target}.",
        "Could you go to {target}?", "Go and find {target}.", "Go over to {target}.",
        "Find your way to {target}.", "Walk over to {target}.", "Get to {target}.",
        "Move to {target} and wait there.", "Look for {target} and stop there.",
        "Go and stand by {target}.", "Please walk to {target} and stop.", "Take me to {target}.",
        "Your goal is to reach {target}.", "I would like you to go to {target}.",
        "Show me the way to {target}.", "Please find {target}.", "Can you walk to {target}?",
        "Meet me at {target}.", "Proceed to {target}.", "You should now go to {target}.",
        "Bring yourself to {target}.", "Stop when you have reached {target}.",
        "Search for {target} and go there.", "Let us go to {target}.",
    ),
    "base room": (
        "In {troom}, find {target}.", "Go to {troom} and stop at {target}.",
        "Head into {troom} and find {target}.", "Find {troom}, then go up to {target}.",
        "Somewhere in {troom} there is {target_any}; go there.",
        "Walk to {troom} and look for {target}.", "Please go to {troom} and wait by {target}.",
        "Go into {troom} and walk up to {target}.",
        "Make your way to {troom} and stop next to {target}.", "Once in {troom}, go to {target}.",
    ),
    "base region": (
        "Go to {target}.", "Walk into {target}.", "Head for {target}.", "Find {target}.",
        "Make your way to {target} and wait there.", "Please go to {target}.",
        "Walk over to {target} and stop.", "Find your way into {target}.",
        "Could you go to {target}?", "Move to {target} and stop there.",
    ),
    # turns
    "turn": (
        "turn {side}", "make a {side} turn", "take a {side}", "make a {side}", "go {side}",
        "head {side}", "turn to the {side}", "turn to your {side}", "take a {side} turn",
        "take the turn to the {side}",
    ),
    "turn soft": (
        "bear {side}", "veer {side}", "veer to the {side}", "bear to the {side}",
        "curve to the {side}", "angle to the {side}", "head off to the {side}",
        "drift over to the {side}",
    ),
    "turn sharp": (
        "make a sharp {side}", "turn sharply to the {side}", "take a hard {side}",
        "make a sharp {side} turn", "take a sharp {side}", "turn sharp {side}",
    ),
    "turn at": (
        "turn {side} at {lm}", "at {lm}, turn {side}", "when you reach {lm}, turn {side}",
        "make a {side} at {lm}", "take a {side} by {lm}", "turn {side} by {lm}",
        "once you are at {lm}, turn {side}", "turn {side} when you get to {lm}",
        "turn {side} next to {lm}", "at {lm}, take a {side}", "on reaching {lm}, go {side}",
        "take a {side} when you come to {lm}", "beside {lm}, make a {side}",
        "as soon as you are next to {lm}, turn {side}", "head to the {side} at {lm}",
        "at {lm}, go {side}", "once beside {lm}, take a {side} turn",
    ),
    "turn facing": (
        "turn {side} towards {lm}", "turn {side} to face {lm}",
        "turn {side} until {lm} {is} in front of you", "turn {side} so that {lm} {is} ahead of you",
        "make a {side} and face {lm}", "turn {side}, in the direction of {lm}",
        "head to the {side}, towards {lm}", "take a {side} towards {lm}",
        "turn {side} and look for {lm} ahead", "turn to your {side} until you face {lm}",
        "turn {side} until you see {lm} straight ahead", "make a {side} turn towards {lm}",
    ),
    "turn end": (
        "at the end of {mid}, turn {side}", "turn {side} at the end of {mid}",
        "when {mid} ends, turn {side}", "take a {side} at the end of {mid}",
        "once you reach the end of {mid}, go {side}", "make a {side} where {mid} ends",
    ),
    "turn door": (
        "turn {side} through the doorway", "take a {side} through the door",
        "turn {side} and go through the doorway", "turn to the {side} and use the doorway",
        "make a {side} and pass through the door", "turn {side} to go through the door",
    ),
    "turn into": (
        "turn {side} into {room}", "take a {side} into {room}", "go to the {side} into {room}",
        "make a {side} into {room}", "turn {side} and enter {room}",
        "head to the {side} and into {room}",
        "turn {side} and step into {room}", "turn {side} and walk into {room}",
        "make a {side} turn into {room}", "turn {side} to enter {room}",
        "take a {side} and go into {room}", "turn {side} to get into {room}",
    ),
    "around": (
        "turn around", "turn all the way around", "face the other way", "make a U-turn",
        "turn around completely", "begin by turning around",
    ),
    "around facing": (
        "turn around to face {lm}", "turn around so that {lm} {is} in front of you",
        "turn around towards {lm}", "turn around until you see {lm}",
        "face the other way, towards {lm}", "turn around until {lm} {is} ahead of you",
        "turn around and look for {lm} ahead",
    ),
    # straights
    "go": (
        "go straight", "walk forward", "continue straight ahead", "keep going straight",
        "walk straight on", "go forward", "carry on straight", "move straight ahead",
        "head straight on", "keep walking ahead", "walk straight ahead", "proceed straight",
    ),
    "go far": (
        "go straight for {n}", "walk forward for {n}", "walk {n} straight ahead",
        "continue straight for {n}", "keep going straight for {n}", "move forward {n}",
        "walk on for {n}", "go ahead for {n}", "proceed straight for {n}", "advance {n}",
    ),
    "through": (
        "walk through {mid}", "go across {mid}", "cross {mid}", "continue through {mid}",
        "make your way across {mid}", "walk straight through {mid}", "keep going through {mid}",
        "walk across {mid}", "pass straight through {mid}",
    ),
    "along": (
        "walk down {mid}", "go along {mid}", "follow {mid}", "continue down {mid}",
        "keep going down {mid}", "walk straight along {mid}", "go straight down {mid}",
        "head down {mid}",
    ),
    "enter": (
        "walk into {room}", "go straight into {room}", "continue into {room}", "enter {room}",
        "head into {room}", "step into {room}", "walk forward into {room}", "move on into {room}",
        "go on into {room}", "keep going until you are in {room}",
    ),
    "enter door": (
        "go through the doorway into {room}", "walk through the door into {room}",
        "pass through the doorway and into {room}", "enter {room} through the doorway",
        "step through the door into {room}", "continue through the doorway to {room}",
        "go through the door and enter {room}", "use the doorway to get into {room}",
        "walk through the doorway and into {room}",
    ),
    "leave": (
        "leave {left}", "walk out of {left}", "exit {left}", "go out of {left}",
        "head out of {left}", "step out of {left}", "move out of {left}",
    ),
    "leave enter": (
        "leave {left} and enter {room}", "walk from {left} into {room}",
        "exit {left} and walk into {room}", "go out of {left} and into {room}",
        "walk out of {left} into {room}", "leave {left} for {room}",
        "step out of {left} and into {room}", "go from {left} to {room}",
        "head out of {left} and into {room}", "exit {left} into {room}",
    ),
    "pass room": (
        "walk through {mid} into {room}", "go through {mid} and into {room}",
        "cross {mid} and enter {room}", "pass through {mid} to reach {room}",
        "continue through {mid} until you are in {room}", "go straight through {mid} to {room}",
        "walk across {mid} and on into {room}",
    ),
    "door": (
        "go through the doorway", "walk through the door", "pass through the doorway",
        "continue through the door", "step through the doorway",
        "walk straight through the doorway", "go straight through the door",
    ),
    "past": (
        "walk past {lm} on your {on}", "pass {lm} on your {on}", "go past {lm} on the {on}",
        "continue past {lm} on your {on}", "keep {lm} on your {on} as you walk forward",
        "go straight, passing {lm} on your {on}", "walk by {lm} on your {on}",
        "walk forward and pass {lm} on the {on}", "go by {lm} on the {on}",
        "walk straight ahead, with {lm} on your {on}", "continue straight with {lm} on your {on}",
        "move past {lm} on your {on}", "leave {lm} behind on your {on}",
        "with {lm} on your {on}, walk straight on", "walk past {lm}", "go straight past {lm}",
        "pass {lm}", "continue past {lm}", "keep going past {lm}", "walk straight past {lm}",
    ),
    "towards": (
        "walk towards {lm}", "go straight towards {lm}", "head towards {lm}",
        "continue straight towards {lm}", "walk straight to {lm}",
        "go straight ahead until you reach {lm}", "walk forward to {lm}", "make your way to {lm}",
        "keep going until you come to {lm}", "approach {lm}", "walk up to {lm}",
        "go forward until you are at {lm}", "continue to {lm}",
    ),
    "far past": (
        "go straight for {n}, passing {lm} on your {on}", "walk {n} past {lm} on your {on}",
        "walk forward for {n} with {lm} on your {on}",
        "continue straight for {n} and pass {lm} on the {on}",
        "move forward {n}, keeping {lm} on your {on}", "walk {n} straight ahead, past {lm}",
        "go straight for {n}, past {lm} on the {on}",
    ),
    "far towards": (
        "go straight for {n} towards {lm}", "walk {n} towards {lm}",
        "walk forward for {n} until you reach {lm}", "continue straight for {n} to {lm}",
        "move forward {n} in the direction of {lm}", "go {n} straight ahead, up to {lm}",
    ),
    "far enter": (
        "go straight for {n} into {room}", "walk {n} straight ahead into {room}",
        "continue straight for {n} and enter {room}", "walk forward for {n} into {room}",
        "move forward {n} until you are in {room}", "walk {n} forward into {room}",
    ),
    "far leave enter": (
        "walk {n}, leaving {left} for {room}", "go straight for {n} from {left} into {room}",
        "go straight for {n}, out of {left} and into {room}",
        "walk {n} out of {left} and into {room}", "leave {left} and go {n} straight into {room}",
    ),
    "far through": (
        "go straight for {n} through {mid}", "walk {n} across {mid}",
        "go straight through {mid} for {n}", "walk forward for {n} through {mid}",
        "continue straight for {n} through {mid}",
        "move forward {n} across {mid}",
    ),
    "far along": (
        "go straight for {n} down {mid}", "walk {n} along {mid}",
        "walk forward for {n} down {mid}", "walk down {mid} for {n}", "follow {mid} for {n}",
    ),
    # arrivals
    "arrive": (
        "stop at {target}", "stop next to {target}", "stop when you reach {target}",
        "wait by {target}", "stop beside {target}", "come to a stop at {target}",
        "stop once you are at {target}", "wait next to {target}", "halt by {target}",
        "stop right by {target}", "finish at {target}", "walk up to {target} and stop",
        "stop near {target}", "stop as soon as you reach {target}", "end at {target}",
    ),
    "arrive side": (
        "stop with {target} on your {at}", "stop at {target} on your {at}",
        "stop next to {target} on your {at}", "wait by {target} on the {at}",
        "stop beside {target} on your {at}", "stop once you have {target} on your {at}",
        "come to a stop with {target} on your {at}",
    ),
    "arrive ahead": (
        "stop in front of {target}", "walk up to {target} and stop", "stop facing {target}",
        "wait in front of {target}", "halt in front of {target}", "stop before {target}",
        "go up to {target} and stop there",
    ),
    "arrive region": (
        "stop in {target}", "stop once you are in {target}", "wait in {target}",
        "come to a stop in {target}", "stop when you are in {target}", "halt inside {target}",
    ),
    "arrive nowhere": (
        "stop at {target}", "stop when you reach {target}", "wait at {target}",
        "come to a stop at {target}", "finish at {target}",
    ),
}  # fmt: skip

# what joins clauses and sentences; no skeletons of their own
JOINTS = (" and ", ", then ", " and then ")
PLAIN_JOINTS = (", then ", ", and then ")
LAST_JOINTS = (", and ", ", and then ", ", then ", " and ")
MIDDLE_JOINTS = (", ", ", then ", ", ")
OPENINGS = ("Then ", "Next, ", "After that, ", "From there, ", "Now ", "")
SECOND_OPENINGS = ("Then ", "Next, ", "After that, ", "From there, ", "")


def count_phrases() -> int:
    """How many different skeletons the grammar holds, over all styles."""
    return len({phrase for group in PHRASES.values() for phrase in group})


@cache
def grammar_words() -> frozenset[str]:
    """Every word that the grammar itself uses; a thing of such a name cannot be told by it."""
    texts = [p for group in PHRASES.values() for p in group] + [*JOINTS, *OPENINGS]
    plain = re.sub(r"\{\w+\}", " ", " ".join(texts)).lower()
    return frozenset(re.findall(r"[a-z'-]+", plain)) - {"door", "doorway", "a", "s"}


def _digest(text: str) -> bytes:
    return hashlib.blake2b(text.encode(), digest_size=8).digest()


def hold_out(groups: Mapping[str, Sequence[str]]) -> frozenset[str]:
    """About a fifth of each kind of phrase, fixed for ever: what only unseen splits use.

    They are chosen by the digest of their words, so that a phrase added later moves few others.
    A phrase of two kinds is held out in both.
    """
    out: set[str] = set()
    for group in groups.values():
        count = max(1, math.floor(HELD_OUT * len(group) + 0.5))
        out |= set(sorted(group, key=_digest)[:count])
    return frozenset(out)


@cache
def held_out_phrases() -> frozenset[str]:
    """The phrases of routes and goals that only unseen splits use; see `hold_out`."""
    return hold_out(PHRASES)


@cache
def phrases(kind: str, held_out: bool) -> tuple[str, ...]:
    """The phrases of a kind for seen splits, or those for unseen ones."""
    apart = held_out_phrases()
    return tuple(p for p in PHRASES[kind] if (p in apart) is held_out)
