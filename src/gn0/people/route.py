"""Routes as kernels read them: paths with tangents and the speeds at which their bends are taken.

A person's turn rate is bounded, so it slows down before bends, stops at sharp ones until it faces
the way on, and brakes for stops and ends. All of it by + − × / and square root: the same bytes
everywhere.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from gn0.geometry import F64
from gn0.people.person import EpisodePerson
from gn0.seeds import derive_seed

I64 = NDArray[np.int64]

BRAKE = 0.7  # m/s², planned; ticks may add up to ACCELERATION
ACCELERATION = 0.8  # m/s²
TURN_RATE = 1.35  # rad/s in bends, below the 90°/s that a body may turn
SHARP = 0.40  # length between unit tangents (23°) from which a bend is taken by standing
CRAWL = 0.07  # m/s, at sharp bends: one tick of braking from rest
_LAG = 0.25  # m over which a body may lag behind a bend of its path
_LEAST = 1e-6  # m: points closer than that are one
PATIENCE = (0.8, 1.8)  # s that one waits before one goes round, by the seed

END, BACK, LOOP = 0, 1, 2
SCRIPT, STAND, SIT = 0, 1, 2
_AFTER = {"end": END, "back": BACK, "loop": LOOP}
_BEHAVIOUR = {"script": SCRIPT, "stand": STAND, "sit": SIT}


class Routes(NamedTuple):
    """Many routes in one table, for kernels; route r has the points `first[r]` to `first[r + 1]`.

    Attributes:
        first: [R + 1] of points; hold_first: [R + 1] of stops.
        after, behaviour: [R] codes; patience: [R] ticks.
        speed: [R] m/s; length: [R] m; face: [R, 2] unit vector at the beginning.
        place: [N, 2] m; tangent: [N, 2] of the piece that begins there, unit.
        way: [N] m from the start; ahead, behind: [N] m/s, the fastest at a point on the way out
            and on the way back.
        hold_at: [K] m; hold_seconds: [K] s; hold_face: [K, 2] unit vector.
    """

    first: I64
    hold_first: I64
    after: I64
    behaviour: I64
    patience: I64
    speed: F64
    length: F64
    face: F64
    place: F64
    tangent: F64
    way: F64
    ahead: F64
    behind: F64
    hold_at: F64
    hold_seconds: F64
    hold_face: F64


def build_routes(people: Sequence[EpisodePerson], ticks_a_second: int = 10) -> Routes:
    """The routes of people, in their order.

    Args:
        people: of any number of episodes.
        ticks_a_second: rate of the ticks; 10 but where ticks themselves are examined.
    """
    parts = [_build(person, ticks_a_second) for person in people]
    points = np.cumsum([0, *(len(p["way"]) for p in parts)]).astype(np.int64)
    holds = np.cumsum([0, *(len(p["hold_at"]) for p in parts)]).astype(np.int64)

    def joined(name: str, *shape: int) -> F64:
        rows = [p[name] for p in parts]
        return np.concatenate(rows) if rows else np.zeros((0, *shape))

    return Routes(
        first=points,
        hold_first=holds,
        after=np.array([_AFTER[p.after] for p in people], np.int64),
        behaviour=np.array([_BEHAVIOUR[p.behaviour] for p in people], np.int64),
        patience=np.array([p["patience"] for p in parts], np.int64),
        speed=np.array([p.speed for p in people], np.float64),
        length=np.array([p["way"][-1] for p in parts], np.float64),
        face=np.array([p["face"] for p in parts], np.float64).reshape(-1, 2),
        place=joined("place", 2),
        tangent=joined("tangent", 2),
        way=joined("way"),
        ahead=joined("ahead"),
        behind=joined("behind"),
        hold_at=joined("hold_at"),
        hold_seconds=joined("hold_seconds"),
        hold_face=joined("hold_face", 2),
    )


def _build(person: EpisodePerson, rate: int) -> dict[str, F64]:
    waits = derive_seed(person.seed, "patience") % 1024 / 1024
    patience = round((PATIENCE[0] + (PATIENCE[1] - PATIENCE[0]) * waits) * rate)
    place = [person.path[0]]
    for x, y in person.path[1:]:
        if _long(x - place[-1][0], y - place[-1][1]) > _LEAST:
            place.append((x, y))
    if len(place) == 1:
        face = unit_of(person.yaw * (180.0 / 3.141592653589793))
        none = np.zeros(0)
        return {
            "place": np.array(place, np.float64), "tangent": np.array([face]), "way": np.zeros(1),
            "ahead": np.zeros(1), "behind": np.zeros(1), "face": np.array(face),
            "hold_at": none, "hold_seconds": none, "hold_face": np.zeros((0, 2)),
            "patience": np.array(patience, np.float64),
        }  # fmt: skip
    steps = [(x - u, y - v) for (u, v), (x, y) in pairwise(place)]
    long = [_long(x, y) for x, y in steps]
    tangent = [(x / d, y / d) for (x, y), d in zip(steps, long, strict=True)]
    way = [0.0]
    for d in long:
        way.append(way[-1] + d)
    closed = person.after == "loop"
    ahead, behind = _bend_speeds(tangent, long, person.speed, closed)
    if not closed:
        ahead[-1] = 0.0
        behind[0] = 0.0
    elif behind[0]:
        behind[0] = 0.0  # nobody walks back over the seam of a loop
    for _ in range(2 if closed else 1):
        if closed:
            ahead[-1] = ahead[0] = min(ahead[-1], ahead[0])
        for k in range(len(long) - 1, -1, -1):
            ahead[k] = min(ahead[k], _root(ahead[k + 1] * ahead[k + 1] + 2.0 * BRAKE * long[k]))
    for k in range(len(long)):
        behind[k + 1] = min(behind[k + 1], _root(behind[k] * behind[k] + 2.0 * BRAKE * long[k]))
    tangent.append(tangent[0] if closed else tangent[-1])
    faces = []
    for stop in person.stops:
        k = 0
        while k + 2 < len(way) and way[k + 1] <= stop.at:
            k += 1
        (tx, ty), (cx, cy) = tangent[k], unit_of(stop.look)
        faces.append((tx * cx - ty * cy, tx * cy + ty * cx))
    return {
        "place": np.array(place, np.float64), "tangent": np.array(tangent, np.float64),
        "way": np.array(way), "ahead": np.array(ahead), "behind": np.array(behind),
        "face": np.array(tangent[0]),
        "hold_at": np.array([min(stop.at, way[-1]) for stop in person.stops], np.float64),
        "hold_seconds": np.array([stop.seconds for stop in person.stops], np.float64),
        "hold_face": np.array(faces, np.float64).reshape(-1, 2),
        "patience": np.array(patience, np.float64),
    }  # fmt: skip


def _bend_speeds(
    tangent: list[tuple[float, float]], long: list[float], speed: float, closed: bool
) -> tuple[list[float], list[float]]:
    """The fastest that each point may be passed at [m/s], out and back, its own bend alone."""
    count = len(long) + 1
    fastest = [speed] * count
    for k in range(count):
        if 0 < k < count - 1:
            (ax, ay), (bx, by), room = tangent[k - 1], tangent[k], 0.5 * (long[k - 1] + long[k])
        elif closed:
            (ax, ay), (bx, by), room = tangent[-1], tangent[0], 0.5 * (long[-1] + long[0])
        else:
            continue
        bend = _long(bx - ax, by - ay)
        if bend > SHARP:
            fastest[k] = CRAWL
        elif bend > 0.01:  # an angle is less than 1.02 times its chord up to there
            fastest[k] = max(min(speed, TURN_RATE * min(room, _LAG) / (1.02 * bend)), CRAWL)
    return list(fastest), list(fastest)


def unit_of(degrees: float) -> tuple[float, float]:
    """(cos, sin) of an angle by a series of + and ×: the same bits on every machine."""
    quarters = round(degrees / 90.0)
    x = (degrees - 90.0 * quarters) * 0.017453292519943295
    q = x * x
    cos, sin, term = 1.0, x, 1.0
    for k in range(1, 10):
        term = -term * q / ((2 * k - 1) * (2 * k))
        cos += term
        sin += term * x / (2 * k + 1)
    size = _long(cos, sin)
    cos, sin = cos / size, sin / size
    for _ in range(quarters % 4):
        cos, sin = -sin, cos
    return cos, sin


def _long(x: float, y: float) -> float:
    return _root(x * x + y * y)


def _root(value: float) -> float:
    return float(np.sqrt(value))
