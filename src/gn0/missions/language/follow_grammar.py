"""The grammar of follow missions: phrases with slots, by meaning. A fixed fifth is held out.

Slots: {who} the person with all that is said of her, {he}, {him}, {his} and {He} pronouns, {s}
and {es} endings of verbs ("she walks", "they walk"), {is} "is" or "are"; {clothes} what is worn;
{left} a room left, {room} a room entered or gone through; {lm} a thing with its article; {n} a
distance; {side} left or right. A phrase is one skeleton, as in `gn0.missions.language.grammar`.
"""

from __future__ import annotations

import hashlib
from functools import cache

from gn0.avatars.colour_names import NAMES
from gn0.missions.language.grammar import HELD_OUT, hold_out
from gn0.missions.language.person_nouns import GARMENT_WORDS

PHRASES: dict[str, tuple[str, ...]] = {
    # whole sentences
    "order": (
        "Follow {who}.", "Please follow {who}.", "Walk behind {who}.", "Go after {who}.",
        "Stay with {who}.", "Keep up with {who}.", "Stay behind {who}.", "Could you follow {who}?",
        "Can you keep up with {who}?", "Your task is to follow {who}.", "You are to follow {who}.",
        "I would like you to follow {who}.", "Walk along behind {who}.", "Tail {who}.",
        "Trail {who}.", "Find {who} and follow {him}.", "Look for {who} and stay with {him}.",
        "Do not lose {who}.", "Go along with {who}.", "Start following {who}.",
        "Follow along behind {who}.", "Please stay behind {who}.", "Please walk behind {who}.",
        "Keep walking behind {who}.", "Track {who} and keep {him} in sight.",
        "Keep an eye on {who} and follow {him}.", "Walk after {who}.", "Make sure to follow {who}.",
        "Be sure to stay with {who}.", "Now follow {who}.", "Watch {who} and go after {him}.",
        "Please go with {who}.", "Would you follow {who}?", "Your job is to stay with {who}.",
        "Shadow {who}.",
    ),
    # where others are about
    "order among": (
        "Among the people here, follow {who}.", "Of the people you see, follow {who}.",
        "Ignore the others and follow {who}.", "Follow only {who}.",
        "More than one person is here; follow {who}.",
        "There are others around; stay with {who}.", "Pick out {who} and follow {him}.",
        "Single out {who} and stay behind {him}.", "Follow nobody but {who}.",
        "Do not mix up the people here; go after {who}.",
    ),
    "order near": (
        "Stay {n} behind {who}.", "Walk {n} behind {who}.", "Keep {n} behind {who}.",
        "Follow {n} behind {who}.", "Keep a distance of {n} from {who}.",
        "Follow at a distance of {n} behind {who}.", "Leave {n} between you and {who}.",
    ),
    # what is worn
    "clothes": (
        "in {clothes}", "wearing {clothes}", "dressed in {clothes}", "who is wearing {clothes}",
        "who wears {clothes}", "who is dressed in {clothes}", "clad in {clothes}",
    ),
    # what the person does
    "leaves": (
        "who is leaving {left}", "who is walking out of {left}",
        "who is on {his} way out of {left}",
        "who is about to leave {left}", "who is just leaving {left}",
        "who is heading out of {left}", "who walks out of {left}", "as {he} leave{s} {left}",
        "as {he} walk{s} out of {left}", "when {he} leave{s} {left}", "out of {left}",
        "as {he} head{s} out of {left}",
    ),
    "enters": (
        "who is walking into {room}", "who is heading into {room}", "who is entering {room}",
        "who is on {his} way into {room}", "who is about to enter {room}",
        "who is going into {room}", "into {room}", "as {he} enter{s} {room}",
        "as {he} walk{s} into {room}", "when {he} go{es} into {room}", "who walks into {room}",
    ),
    "leaves enters": (
        "who is walking from {left} into {room}", "who is leaving {left} for {room}",
        "from {left} into {room}", "who is going from {left} into {room}",
        "as {he} walk{s} from {left} into {room}", "as {he} leave{s} {left} for {room}",
        "who is on {his} way from {left} into {room}", "out of {left} and into {room}",
    ),
    "past": (
        "who is walking past {lm}", "who is passing {lm}", "who is going past {lm}", "past {lm}",
        "as {he} walk{s} past {lm}", "as {he} pass{es} {lm}", "who is about to pass {lm}",
        "who is on {his} way past {lm}",
    ),
    "towards": (
        "who is walking towards {lm}", "who is heading for {lm}", "towards {lm}",
        "as {he} walk{s} towards {lm}", "who is on {his} way to {lm}", "who is approaching {lm}",
        "as {he} approach{es} {lm}",
    ),
    "inside": (
        "who is walking through {room}", "who is on the move in {room}", "through {room}",
        "as {he} walk{s} through {room}", "who is walking about in {room}", "who walks in {room}",
    ),
    "ahead": (
        "who is walking ahead of you", "who is walking in front of you", "who is ahead of you",
        "who is right in front of you", "just ahead of you", "in front of you",
    ),
    "anywhere": ("wherever {he} go{es}", "as {he} walk{s} on", "as {he} move{s} about"),
    # second sentences
    "near": (
        "Stay {n} behind {him}.", "Keep a distance of {n}.", "Keep {n} behind {him}.",
        "Leave {n} between you and {him}.", "Let {him} walk {n} ahead of you.",
    ),
    "close": (
        "Stay close behind {him}.", "Keep close to {him}.", "Stay right behind {him}.",
        "Do not fall behind.", "Stay near {him}.",
    ),
    "roomy": (
        "Leave {him} some room.", "Do not get too close to {him}.", "Keep a little distance.",
        "Hang back a little.", "Do not crowd {him}.",
    ),
    "beside": (
        "Keep a little to {his} {side}.", "Stay a little to the {side} of {him}.",
        "Walk behind {him}, a little to the {side}.", "Keep to {his} {side} side.",
    ),
    "slow": (
        "{He} walk{s} slowly.", "{He} {is} in no hurry.",
        "Take your time, for {he} walk{s} slowly.", "Do not hurry; {he} walk{s} slowly.",
    ),
    "brisk": (
        "{He} walk{s} briskly.", "{He} {is} in a hurry.", "{He} walk{s} at a brisk pace.",
        "Be quick, for {he} walk{s} fast.",
    ),
    "stops": (
        "Stop whenever {he} stop{s}.", "Wait whenever {he} pause{s}.",
        "{He} will stop now and then; wait behind {him}.", "If {he} stop{s}, wait for {him}.",
        "Stand still while {he} stand{s} still.",
    ),
    "turns": (
        "{He} will turn often.", "{He} will change direction, so watch {him}.",
        "{He} may look around on the way.", "Be ready for {his} turns.",
    ),
    "keep": (
        "Do not lose sight of {him}.", "Keep {him} in view.", "Keep {him} in sight at all times.",
        "Do not lose {him}.", "Keep up with {him}.", "Always keep {him} in view.",
    ),
}  # fmt: skip


def count_follow_phrases() -> int:
    """How many different skeletons the grammar of follow missions holds."""
    return len({phrase for group in PHRASES.values() for phrase in group})


@cache
def held_out_follow_phrases() -> frozenset[str]:
    """The phrases that only unseen splits use."""
    return hold_out(PHRASES)


@cache
def follow_phrases(kind: str, held_out: bool) -> tuple[str, ...]:
    """The phrases of a kind for seen splits, or those for unseen ones."""
    apart = held_out_follow_phrases()
    return tuple(p for p in PHRASES[kind] if (p in apart) is held_out)


@cache
def held_out_pairs() -> frozenset[tuple[str, str]]:
    """(colour, garment) that training never says together: a fifth of each garment's colours.

    A garment is a word of `GARMENT_WORDS`; for each, the colours of the least digests.
    """
    count = round(HELD_OUT * len(NAMES))
    out: set[tuple[str, str]] = set()
    for word in GARMENT_WORDS:

        def rank(colour: str, word: str = word) -> bytes:
            return hashlib.blake2b(f"{colour} {word}".encode(), digest_size=8).digest()

        out |= {(colour, word) for colour in sorted(NAMES, key=rank)[:count]}
    return frozenset(out)
