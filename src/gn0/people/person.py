"""A person of an episode: who it is, what it does, where it goes. Values only.

Coordinates are those of the scene [m], yaw [rad]. What a person does with nobody in its way follows
from its record alone; see `gn0.people.walk`.
"""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from itertools import pairwise
from typing import Literal, get_args

import msgspec

from gn0.errors import EpisodeError, brief

PEOPLE_MOST = 16  # in one episode: as many as one picture may show
RADIUS = 0.25  # m, of the disc that a person is to whoever walks
WALL_DISTANCE = 0.30  # m, of a person's centre from walls
SPEEDS = (0.4, 1.6)  # m/s
SEATS = (0.30, 0.65)  # m, heights that clips of sitting are made for: `avatars.motion.standing`
_POINTS_MOST, _STOPS_MOST = 4096, 64
_LONGEST_STOP = 3600.0  # s
_FARTHEST = 1e6  # m from the origin, far beyond any scene; squares of it stay finite
_DRAWN = re.compile(r"drawn:(\d{1,10}):(\d{1,6})(?::([a-z_]{1,20}):(\d{1,10}))?")

Behaviour = Literal["script", "stand", "sit"]
"""`script`: walks a path; `stand`: stands at a spot; `sit`: sits there."""
After = Literal["end", "back", "loop"]
"""At the path's end: stands there; walks back and forth; begins anew, the path being closed."""


class PersonStop(
    msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True, omit_defaults=True
):
    """A stop on the way.

    Attributes:
        at: way from the path's start [m]; stops at one place follow one another.
        seconds: how long [s], turning included.
        look: where the body turns meanwhile [degrees], to the left of the way ahead.
    """

    at: float
    seconds: float
    look: float = 0.0


class EpisodePerson(
    msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True, omit_defaults=True
):
    """A person of an episode.

    Attributes:
        number: 1 to 16, its own in the episode, as pictures of who is who have it.
        identity: a person of the bank by name ("p0007"), or "drawn:SEED:NUMBER", see
            `gn0.avatars.identity.draw_identity`; "drawn:SEED:NUMBER:KEY:CHANGE" is another person
            of the same words but one, see `gn0.people.identities`.
        path: where it walks [(x, y) m]; of who stands or sits, the one spot.
        behaviour: "script" walks the path, "stand" and "sit" stay.
        clips: set of clips that it moves by; "default" is `gn0.avatars.motion.library`.
        clip: what it does where it stands: one of the clips that stay on the spot; "" chooses an
            idle, or the seat's, by the seed.
        speed: it walks at [m/s], 0.4 to 1.6.
        stops: stops on the way, in its order; made on the way out only.
        after: what it does at the end of its path.
        yaw: where who stands or sits looks [rad].
        seat: height of what it sits on [m].
        o_space: (x, y, radius) [m] of the space that a standing group shares; its people face it,
            and nobody walks through.
        seed: of whatever the record leaves open.
        bank: hash of the bank that the identity is of, where that is to be told; "" is any.

    Raises:
        EpisodeError: a value that has no meaning.
    """

    number: int
    identity: str
    path: tuple[tuple[float, float], ...]
    behaviour: Behaviour = "script"
    clips: str = "default"
    clip: str = ""
    speed: float = 1.0
    stops: tuple[PersonStop, ...] = ()
    after: After = "end"
    yaw: float = 0.0
    seat: float = 0.45
    o_space: tuple[float, float, float] | None = None
    seed: int = 0
    bank: str = ""

    def __post_init__(self) -> None:
        where = f"person {brief(self.number)}"
        if not (isinstance(self.number, int) and 1 <= self.number <= PEOPLE_MOST):
            give = f"1 to {PEOPLE_MOST}: an episode has no more people"
            raise _fault(where, "number", f"is {brief(self.number)}", give)
        if not self.identity or len(self.identity) > 120:
            raise _fault(where, "identity", "names nobody", "a person of a bank, or drawn:0:7")
        if self.identity.startswith("drawn:") and drawn_identity(self.identity) is None:
            give = "drawn:SEED:NUMBER, or drawn:SEED:NUMBER:KEY:CHANGE"
            raise _fault(where, "identity", f"is {brief(self.identity)}", give)
        change = drawn_change(self.identity)
        if change is not None:
            from gn0.avatars.likeness import CHANGES  # few people are of that kind

            if change[0] not in CHANGES:
                give = f"drawn:SEED:NUMBER:KEY:CHANGE with a key of {', '.join(CHANGES)}"
                raise _fault(where, "identity", f"is {brief(self.identity)}", give)
        if self.clips != "default":
            raise _fault(where, "clips", f"has no set {brief(self.clips)}", "default")
        if self.behaviour not in get_args(Behaviour):
            raise _fault(where, "behaviour", f"is {brief(self.behaviour)}", "script, stand or sit")
        if self.after not in get_args(After):
            raise _fault(where, "after", f"is {brief(self.after)}", "end, back or loop")
        if not SPEEDS[0] <= self.speed <= SPEEDS[1]:
            raise _fault(
                where, "speed", f"is {brief(self.speed)} m/s", f"{SPEEDS[0]} to {SPEEDS[1]} m/s"
            )
        if not math.isfinite(self.yaw):
            raise _fault(where, "yaw", f"is {brief(self.yaw)}", "radians")
        if not SEATS[0] <= self.seat <= SEATS[1]:
            give = f"{SEATS[0]} to {SEATS[1]} m"
            raise _fault(where, "seat", f"is {brief(self.seat)} m high", give)
        if self.clip:
            self._check_clip(where)
        self._check_path(where)
        self._check_stops(where)
        if self.o_space is not None and not (
            all(map(math.isfinite, self.o_space)) and 0 < self.o_space[2] <= 5
        ):
            raise _fault(where, "o_space", "has no meaning", "x, y and a radius up to 5 m")

    def _check_clip(self, where: str) -> None:
        from gn0.avatars.motion.library import STAYING  # few people have one

        known = {"stand": STAYING, "sit": ("sit",)}.get(self.behaviour, ())
        if self.clip not in known:
            give = f"one of {', '.join(known)}" if known else "clips to who stands"
            raise _fault(where, "clip", f"is {brief(self.clip)}", give)

    def _check_path(self, where: str) -> None:
        count = len(self.path)
        plain = tuple((float(x), float(y)) for x, y in self.path)  # NumPy's own cannot be written
        msgspec.structs.force_setattr(self, "path", plain)
        if not all(abs(x) <= _FARTHEST and abs(y) <= _FARTHEST for x, y in self.path):
            give = f"metres up to {_FARTHEST:g}"
            raise _fault(where, "path", "holds NaN, infinity or a place too far away", give)
        if self.behaviour != "script":
            if count != 1:
                raise _fault(where, "path", f"has {count} points", "the one spot of who stays")
        elif not 2 <= count <= _POINTS_MOST or self.length < 0.1:
            raise _fault(
                where, "path", f"is {count} points and {self.length:.3g} m long",
                f"2 to {_POINTS_MOST} points, at least 0.1 m",
            )  # fmt: skip
        elif self.after == "loop" and self.path[0] != self.path[-1]:
            raise _fault(where, "path", "is not closed", "a loop that ends where it begins")

    def _check_stops(self, where: str) -> None:
        if len(self.stops) > _STOPS_MOST or (self.stops and self.behaviour != "script"):
            raise _fault(
                where, "stops", f"are {len(self.stops)}", f"at most {_STOPS_MOST}, of who walks"
            )
        before, length = 0.0, self.length if self.stops else 0.0
        for row, stop in enumerate(self.stops, 1):
            field = f"stop {row}"
            if not (0 < stop.seconds <= _LONGEST_STOP and math.isfinite(stop.look)):
                give = f"more than 0 and at most {_LONGEST_STOP:g} s: time runs forwards"
                raise _fault(where, field, f"lasts {brief(stop.seconds)} s", give)
            if not before <= stop.at <= length:
                raise _fault(
                    where, field, f"is at {brief(stop.at)} m, after {before:g} m",
                    f"metres that rise, at most the path's {length:.3f}",
                )  # fmt: skip
            before = stop.at

    @property
    def length(self) -> float:
        """Length of the path [m]."""
        ends = pairwise(self.path)
        return sum(math.sqrt((x - u) * (x - u) + (y - v) * (y - v)) for (u, v), (x, y) in ends)

    @property
    def spot(self) -> tuple[float, float]:
        """Where it is when the episode begins (x, y) [m]."""
        return self.path[0]


def drawn_identity(identity: str) -> tuple[int, int] | None:
    """(seed, number) of "drawn:SEED:NUMBER", changed or not; None of a bank's names."""
    found = _DRAWN.fullmatch(identity)
    return None if found is None else (int(found[1]), int(found[2]))


def drawn_change(identity: str) -> tuple[str, int] | None:
    """(key, seed) of the one word that "drawn:SEED:NUMBER:KEY:CHANGE" changes; None of others."""
    found = _DRAWN.fullmatch(identity)
    return None if found is None or found[3] is None else (found[3], int(found[4]))


def check_people(people: Sequence[EpisodePerson]) -> None:
    """Refuse people who cannot be in one episode together.

    Raises:
        EpisodeError: more than 16, two of one number, or two who begin in one place.
    """
    if len(people) > PEOPLE_MOST:
        raise EpisodeError(
            f"{len(people)} people, and pictures have {PEOPLE_MOST} places", where="people",
            remedy=f"leave out {len(people) - PEOPLE_MOST}",
        )  # fmt: skip
    for k, person in enumerate(people):
        for other in people[:k]:
            where = f"person {person.number}"
            if person.number == other.number:
                raise _fault(where, "number", "is that of two people", "a number of its own each")
            (x, y), (u, v) = person.spot, other.spot
            if (x - u) * (x - u) + (y - v) * (y - v) < (2 * RADIUS) * (2 * RADIUS):
                raise _fault(
                    where, "path", f"begins inside person {other.number}",
                    f"places at least {2 * RADIUS} m apart",
                )  # fmt: skip


def _fault(where: str, field: str, what: str, give: str) -> EpisodeError:
    return EpisodeError(f"{field} {what}", where=f"{where}, {field}", remedy=f"give {give}")
