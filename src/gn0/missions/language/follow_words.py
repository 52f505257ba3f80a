"""The words of a follow mission: who is meant, what she does, and how to keep to her.

A pure function of records, scene words and a seed. The people of an episode are known by the
records of their avatars; what the person does comes from the description of her path.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Literal

import msgspec
import numpy as np

from gn0.avatars.likeness import Sight
from gn0.config import Config
from gn0.errors import LanguageError
from gn0.missions.language.follow_grammar import follow_phrases
from gn0.missions.language.person_words import (
    PersonPhrase,
    Record,
    choose_words,
    say_person,
)
from gn0.missions.language.route import Landmark, RouteDescription
from gn0.missions.language.template import landmark_phrase, say_grounds
from gn0.missions.language.word_forms import definite, indefinite
from gn0.seeds import random_stream
from gn0.storage import content_hash

VERSION = "1"
FIRST_WAY = 3.0  # m of a path in which what a person does is there to be seen
SLOW, BRISK = 0.55, 0.85  # m/s: below, a person walks slowly; above, briskly
CLOSE, ROOMY = 1.3, 1.7  # m that are kept: below, one stays close; above, leaves some room
BESIDE = 0.3  # m to one side from which on it is told
_NUMBERS = {
    1.0: "one meter", 1.25: "a little over one meter", 1.5: "one and a half meters",
    1.75: "a little under two meters", 2.0: "two meters",
}  # fmt: skip
_DOING, _NEAR, _TAIL, _AMONG = 0.75, 0.15, 0.55, 0.4  # how often each is said
_PRONOUNS = {
    "woman": {
        "he": "she", "him": "her", "his": "her", "He": "She", "is": "is", "s": "s", "es": "es",
    },
    "man": {"he": "he", "him": "him", "his": "his", "He": "He", "is": "is", "s": "s", "es": "es"},
    "person": {
        "he": "they", "him": "them", "his": "their", "He": "They", "is": "are", "s": "", "es": "",
    },
}  # fmt: skip


# a clause without a verb, and the orders that can do without one: "follow her into the kitchen"
_BARE = ("out ", "into ", "from ", "past ", "towards ", "through ", "in front", "just ahead")
_MOVES = (
    "Follow {who}", "Please follow", "Walk", "Go after", "Could you follow", "Tail", "Trail",
    "Shadow", "Now follow", "Follow along", "Please walk", "Start following",
)  # fmt: skip


class FollowScene(Config, frozen=True):
    """What the person does at first, and how to keep to her; what is not known is left out.

    Attributes:
        leaves, enters: types of the rooms that she leaves and enters within sight, "" none.
        inside: type of the room in which she stays, "" unknown.
        shared_rooms: types of which the scene has several.
        past: what she walks past; towards: what she walks towards.
        ahead: she is straight ahead of the agent and nearer than anybody else.
        distance: that the agent should keep [m]; 0 says nothing of it.
        lateral: how far to her right it should keep [m]; to the left below 0.
        speed: at which she walks [m/s]; 0 unknown.
        category: how she walks: steadily, with many turns, with stops.
    """

    leaves: str = ""
    enters: str = ""
    inside: str = ""
    shared_rooms: tuple[str, ...] = ()
    past: Landmark | None = None
    towards: Landmark | None = None
    ahead: bool = False
    distance: float = 0.0
    lateral: float = 0.0
    speed: float = 0.0
    category: Literal["cruise", "turn", "stops"] = "cruise"


class FollowText(msgspec.Struct, frozen=True, kw_only=True):
    """The words of a follow mission.

    Attributes:
        text: one to three sentences.
        said: what they say of the person, by the keys of the record, in the words that say it.
        doing: the kind of what she is said to do, "" nothing.
        decides: "looks" if what is said of her fits nobody else, "first view" if one has to go by
            where she is.
        skeleton: the phrases that it is made of.
        version: of the grammar.
    """

    text: str
    said: dict[str, str]
    doing: str
    decides: Literal["looks", "first view"]
    skeleton: tuple[str, ...]
    version: str = VERSION


def scene_of_route(
    route: RouteDescription, *, reach: float = FIRST_WAY, **more: object
) -> FollowScene:
    """What somebody who walks a route does in its first `reach` metres.

    Args:
        route: of the person's path.
        reach: how much of it is in sight at first [m].
        more: further fields of the scene.
    """
    scene: dict[str, object] = {"shared_rooms": route.shared_rooms, **more}
    gone = 0.0
    for segment in route.segments:
        if gone > reach:
            break
        if not scene.get("inside") and (segment.inside or segment.leaves):
            scene["inside"] = segment.inside or segment.leaves
        if segment.enters and gone + segment.enters_after <= reach and "enters" not in scene:
            scene["enters"] = segment.enters
            scene["leaves"] = segment.leaves if segment.leaves != segment.enters else ""
        for landmark in segment.landmarks:
            relation = landmark.relation
            if relation in ("past", "towards") and landmark.name != "object":
                scene.setdefault(relation, landmark)
        gone += segment.distance
    return msgspec.convert(scene, FollowScene)


def write_follow(
    people: Sequence[Record],
    who: int,
    scene: FollowScene | None = None,
    *,
    sight: Sight | None = None,
    seed: int = 0,
    held_out: bool = False,
) -> FollowText:
    """Words that fit one of the people of an episode.

    Args:
        people: records of all who are there, as `Avatar.record` has them.
        who: which of them is to be followed.
        scene: what the person does, and how to keep to her.
        sight: how she is first seen.
        seed: of the choice of words; the same arguments give the same text.
        held_out: use the phrases that training never sees, and say a colour and garment that it
            never sees together where the record has such; otherwise neither is ever said.

    Raises:
        LanguageError: the person is not among them, or neither looks nor place tell her apart.
    """
    scene, sight = scene or FollowScene(), sight or Sight()
    if not 0 <= who < len(people):
        raise LanguageError(
            f"person {who} of {len(people)}", where="write_follow",
            remedy="give the place of the person among the people",
        )  # fmt: skip
    records = [dict(sorted(record.items())) for record in people]
    key = content_hash(msgspec.json.encode([records, who, scene, sight]))
    stream = random_stream(seed, "follow words", VERSION, key, int(held_out))
    choice = choose_words(records, who, sight, stream, held_out=held_out)
    if not choice.complete and not scene.ahead:
        raise LanguageError(
            "nothing that shows tells the person from the others", where="write_follow",
            remedy="choose other people for the episode, or place the person straight ahead",
        )  # fmt: skip
    person = say_person(records[who], choice.said, stream)
    text = _Text(scene, person, stream, held_out, len(people) > 1)
    sentence = text.order(must_place=not choice.complete)
    told = " ".join([sentence, *text.tails()])
    return FollowText(
        text=say_grounds(told),
        said=person.words,
        doing=text.doing,
        decides="looks" if choice.complete else "first view",
        skeleton=tuple(text.skeleton),
    )


class _Text:
    """A text in the making."""

    def __init__(
        self,
        scene: FollowScene,
        person: PersonPhrase,
        stream: np.random.Generator,
        held_out: bool,
        among: bool,
    ) -> None:
        self.scene, self.person, self.stream = scene, person, stream
        self.held_out, self.among = held_out, among
        self.skeleton: list[str] = []
        self.doing = ""
        self.told_distance = False
        self.slots = {**_PRONOUNS[person.words["sex"]], "n": distance_words(scene.distance)}

    def chance(self, p: float) -> bool:
        return bool(self.stream.random() < p)

    def pick(self, choices: Sequence[str]) -> str:
        return choices[int(self.stream.integers(len(choices)))]

    def say(self, kind: str, usable: Sequence[str] = (), **slots: str) -> str:
        phrase = self.pick(usable or follow_phrases(kind, self.held_out))
        self.skeleton.append(phrase)
        return phrase.format_map({**self.slots, **slots})

    def order(self, *, must_place: bool) -> str:
        """The first sentence: whom to follow."""
        who = f"the {self.person.noun}"
        worn = ""
        if self.person.has:
            who += f" with {self.person.has}"
        if self.person.clothes:
            worn = self.say("clothes", clothes=self.person.clothes)
            who += f" {worn}"
        doing = ""
        if must_place or self.chance(_DOING):
            doing = self._say_doing(worn, must_place)
            who += f" {doing}" if doing else ""
        kind = "order"
        if self.among and self.chance(_AMONG):
            kind = "order among"
        elif self.scene.distance and self.chance(_NEAR):
            kind, self.told_distance = "order near", True
        usable = follow_phrases(kind, self.held_out)
        if doing and not doing.startswith(("who ", "and ")):  # it tells how to follow: comes last
            last = [p for p in (*usable, *follow_phrases("order", self.held_out)) if _ends(p)]
            moves = [p for p in last if p.startswith(_MOVES)]
            usable = tuple(moves if doing.startswith(_BARE) and moves else last)
        return self.say(kind, usable, who=who)

    def _say_doing(self, worn: str, must_place: bool) -> str:
        """A clause on what the person does, which must not be read as one on what she wears."""
        kind, slots = ("ahead", {}) if must_place else self._choose_doing()
        usable = follow_phrases(kind, self.held_out)
        clear = [
            p for p in usable
            if not (worn.startswith("who ") and p.startswith("who "))
            and not (p.startswith(_BARE) and worn and not worn.startswith("in "))
        ]  # fmt: skip
        if not clear and not must_place:
            return ""
        self.doing = kind
        clause = self.say(kind, clear or usable, **slots)
        return f"and {clause}" if worn.startswith("who ") and clause.startswith("who ") else clause

    def _choose_doing(self) -> tuple[str, dict[str, str]]:
        scene = self.scene
        options: list[tuple[str, dict[str, str]]] = []
        if scene.leaves and scene.enters:
            options.append(
                ("leaves enters", {"left": self._left(), "room": self._room(scene.enters)})
            )
        if scene.leaves:
            options.append(("leaves", {"left": self._left()}))
        if scene.enters:
            options.append(("enters", {"room": self._room(scene.enters)}))
        for kind, landmark in (("past", scene.past), ("towards", scene.towards)):
            if landmark is not None:
                options.append((kind, {"lm": landmark_phrase(landmark)}))
        if not options and scene.inside:
            options.append(("inside", {"room": definite(scene.inside)}))
        if not options:
            options = [("anywhere", {})]
            if scene.ahead:
                options.append(("ahead", {}))
        return options[int(self.stream.integers(len(options)))]

    def _left(self) -> str:
        return definite(self.scene.leaves)

    def _room(self, name: str) -> str:
        return indefinite(name) if name in self.scene.shared_rooms else definite(name)

    def tails(self) -> list[str]:
        """Up to two more sentences: distance, side, pace, stops."""
        scene = self.scene
        kinds = ["keep"]
        if scene.distance and not self.told_distance:
            kinds.append("near")
            if scene.distance <= CLOSE:
                kinds.append("close")
            elif scene.distance >= ROOMY:
                kinds.append("roomy")
        if abs(scene.lateral) >= BESIDE:
            kinds.append("beside")
        if scene.speed and scene.speed < SLOW:
            kinds.append("slow")
        elif scene.speed > BRISK:
            kinds.append("brisk")
        if scene.category != "cruise":
            kinds.append({"turn": "turns", "stops": "stops"}[scene.category])
        out: list[str] = []
        side = "right" if scene.lateral > 0 else "left"
        while kinds and len(out) < 2 and self.chance(_TAIL):
            kind = self.pick(kinds)
            kinds = [k for k in kinds if k != kind and not {k, kind} <= {"near", "close", "roomy"}]
            out.append(self.say(kind, side=side))
        return out


def _ends(phrase: str) -> bool:
    return phrase.rstrip(".?").endswith("{who}")


def distance_words(metres: float) -> str:
    """A distance that is kept, to a quarter of a metre: "one and a half meters"."""
    return _NUMBERS[min(_NUMBERS, key=lambda known: abs(known - metres))]
