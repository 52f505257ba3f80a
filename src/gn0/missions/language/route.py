"""What is said about a route, before it is said: segments, landmarks, target. Values only."""

from __future__ import annotations

from typing import Literal

import msgspec

from gn0.config import Config

Style = Literal["base", "detailed", "benchmark"]
STYLES: tuple[Style, ...] = ("base", "detailed", "benchmark")
NOWHERE = "destination"  # name of a target that has none
Turn = Literal["left", "right", "around"]
Relation = Literal["past", "towards", "at", "facing"]


class Landmark(Config, frozen=True):
    """Something that one sees on a segment and can be told by.

    Attributes:
        object_id: the instance; of several alike, the nearest one.
        name: as it is said, e.g. "coffee table", or "shelves" when several stand in a row.
        relation: "past": the segment goes by it; "towards": the segment leads to it; "at": the
            turn happens beside it; "facing": it lies ahead after the turn.
        side: where it is when one goes by, "left" or "right"; "" for what lies ahead.
        unique: only one of that name is in its room and in sight, so that "the" is right.
        plural: the name is a plural.
        distance: from the path to its footprint at the nearest [m].
        share: share of the view that it fills where it is seen best, 0..1.
        seen_from: pose (x, y, yaw) [m, rad] on the route where it is seen best.
    """

    object_id: str
    name: str
    relation: Relation
    side: Literal["left", "right", ""] = ""
    unique: bool = True
    plural: bool = False
    distance: float = 0.0
    share: float = 0.0
    seen_from: tuple[float, float, float] = (0.0, 0.0, 0.0)


class RouteSegment(Config, frozen=True):
    """One step of a route: a turn, or a way straight on.

    Attributes:
        turn: which way, or None for a straight.
        angle: angle of the turn [degrees], positive to the left; 0 for a straight.
        distance: length of a straight [m]; 0 for a turn.
        start: where the segment begins (x, y) [m].
        end: where it ends (x, y) [m].
        leaves: type of the room it leaves, "" when it stays in one or the type is unknown.
        enters: type of the room it ends in, "" when it stays in one or the type is unknown.
        crosses: types of the rooms that it goes through from end to end, in order.
        inside: type of the room it stays in or begins in; "" when unknown.
        enters_after: way from the segment's start to where it enters that room [m].
        doors: doorways it goes through.
        door_after: way from the segment's start to the first of them [m].
        blocked_ahead: of a turn: who went straight on would soon stand before an obstacle.
        landmarks: what can be said of it, best first.
    """

    turn: Turn | None = None
    angle: float = 0.0
    distance: float = 0.0
    start: tuple[float, float] = (0.0, 0.0)
    end: tuple[float, float] = (0.0, 0.0)
    leaves: str = ""
    enters: str = ""
    crosses: tuple[str, ...] = ()
    inside: str = ""
    enters_after: float = 0.0
    doors: int = 0
    door_after: float = 0.0
    blocked_ahead: bool = False
    landmarks: tuple[Landmark, ...] = ()


class RouteTarget(Config, frozen=True):
    """Where a route ends.

    Attributes:
        object_id: the target, or "" for a region.
        name: as it is said, e.g. "office chair".
        unique: what is said of it, name, neighbour and room, fits nothing else in the scene.
        plural: the name is a plural, as "stairs".
        near: a neighbour that tells two of a kind apart, or "".
        room: type of the room it is in, "" when unknown.
        region: the target is a room or a part of one, not an object.
        side: where it is for one who has arrived.
    """

    object_id: str
    name: str
    unique: bool = True
    plural: bool = False
    near: str = ""
    room: str = ""
    region: bool = False
    side: Literal["left", "right", "ahead", ""] = ""


class RouteDescription(Config, frozen=True):
    """A route as a list of steps.

    Attributes:
        scene_id: the scene.
        key: digest of scene, path, heading and target: the same route has the same key.
        segments: turns and straights in order.
        target: where it ends.
        length: length of the path [m].
        vocabulary: every name of an object or room that the scene holds, sorted; what a text may
            not mention unless the route does.
        shared_rooms: types of room of which the scene has several: "a bedroom" is entered.
    """

    scene_id: str
    key: str
    segments: tuple[RouteSegment, ...]
    target: RouteTarget
    length: float
    vocabulary: tuple[str, ...] = ()
    shared_rooms: tuple[str, ...] = ()

    @property
    def turns(self) -> tuple[Turn, ...]:
        """The turns in order."""
        return tuple(s.turn for s in self.segments if s.turn is not None)

    @property
    def rooms(self) -> tuple[str, ...]:
        """Types of the rooms that the route touches, each once, in order."""
        names = [n for s in self.segments for n in (s.inside, s.leaves, *s.crosses, s.enters) if n]
        return tuple(dict.fromkeys([*names, *([self.target.room] if self.target.room else [])]))

    @property
    def landmarks(self) -> tuple[Landmark, ...]:
        """All landmarks, each object and name once, in order."""
        found: dict[tuple[str, str], Landmark] = {}
        for segment in self.segments:
            for landmark in segment.landmarks:
                found.setdefault((landmark.object_id, landmark.name), landmark)
        return tuple(found.values())


class InstructionText(msgspec.Struct, frozen=True, kw_only=True):
    """An instruction and who wrote it.

    Attributes:
        style: base, detailed or benchmark.
        text: never empty.
        provider: who wrote this text: "template", "openai", …
        version: version of that provider, e.g. "1" or "gpt-x, prompts 1".
        fallback: why the provider that was asked did not write it; "" when it did.
    """

    style: Style
    text: str
    provider: str
    version: str
    fallback: str = ""
