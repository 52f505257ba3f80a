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
    """Many routes in few arrays, for kernels.

    Attributes:
        table: int64 [R, 8] of each route: its first point and the one after its last, the same of
            its stops, codes of what follows its end and of behaviour, ticks of patience, and the
            right of way: of two people the one with more goes first.
        lines: [R, 4] speed [m/s], length [m], unit vector of the heading it begins with.
        points: [N, 7] x, y [m]; unit vector of the piece that begins there; way from the start
            [m]; the fastest that it may be passed at on the way out, and on the way back [m/s].
        holds: [K, 4] of each stop: way from the start [m], length [s], unit vector to look along.
    """

    table: I64
    lines: F64
    points: F64
    holds: F64


def build_routes(people: Sequence[EpisodePerson], ticks_a_second: int = 10) -> Routes:
    """The routes of people, in their order.

    Args:
        people: of any number of episodes.
        ticks_a_second: rate of the ticks; 10 but where ticks themselves are examined.
    """
    parts = [_build(person, ticks_a_second) for person in people]
    points = np.cumsum([0, *(len(part.points) for part in parts)])
    holds = np.cumsum([0, *(len(part.holds) for part in parts)])
    table = [
        (*points[k : k + 2], *holds[k : k + 2], _AFTER[one.after], _BEHAVIOUR[one.behaviour],
         parts[k].patience, parts[k].right)
        for k, one in enumerate(people)
    ]  # fmt: skip
    lines = [
        (one.speed, part.points[-1, 4], *part.face) for one, part in zip(people, parts, strict=True)
    ]
    return Routes(
        table=np.array(table, np.int64).reshape(-1, 8),
        lines=np.array(lines, np.float64).reshape(-1, 4),
        points=np.concatenate([np.zeros((0, 7)), *(part.points for part in parts)]),
        holds=np.concatenate([np.zeros((0, 4)), *(part.holds for part in parts)]),
    )


class _Route(NamedTuple):
    points: F64
    holds: F64
    face: tuple[float, float]
    patience: int
    right: int


def _build(person: EpisodePerson, rate: int) -> _Route:
    own = derive_seed(person.seed, "patience")
    waits = own % 1024 / 1024
    right = own // 1024 % 65536 * 32 + person.number  # no two of an episode have the same
    # in tenths of a second at any rate, and over in the same one: a person waits for others too
    tenths = round((PATIENCE[0] + (PATIENCE[1] - PATIENCE[0]) * waits) * 10)
    patience = (tenths + 1) * rate // 10 - 1
    place = [person.path[0]]
    for x, y in person.path[1:]:
        if _long(x - place[-1][0], y - place[-1][1]) > _LEAST:
            place.append((x, y))
    if len(place) == 1:
        face = unit_of(person.yaw * (180.0 / 3.141592653589793))
        return _Route(
            np.array([(*place[0], *face, 0.0, 0.0, 0.0)]), np.zeros((0, 4)), face, patience, right
        )
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
    for _ in range(2 if closed else 1):
        if closed:
            ahead[-1] = ahead[0] = min(ahead[-1], ahead[0])
        for k in range(len(long) - 1, -1, -1):
            ahead[k] = min(ahead[k], _root(ahead[k + 1] * ahead[k + 1] + 2.0 * BRAKE * long[k]))
        if closed:
            behind[-1] = behind[0] = min(behind[-1], behind[0])
        for k in range(len(long)):
            behind[k + 1] = min(behind[k + 1], _root(behind[k] * behind[k] + 2.0 * BRAKE * long[k]))
    tangent.append(tangent[0] if closed else tangent[-1])
    holds: list[tuple[float, float, float, float]] = []
    for stop in person.stops:
        k = 0
        while k + 2 < len(way) and way[k + 1] <= stop.at:
            k += 1
        (tx, ty), (cx, cy) = tangent[k], unit_of(stop.look)
        at = min(stop.at, way[-1])
        holds.append((at, stop.seconds, tx * cx - ty * cy, tx * cy + ty * cx))
    rows = [
        (*here, *along, gone, out, back)
        for here, along, gone, out, back in zip(place, tangent, way, ahead, behind, strict=True)
    ]
    return _Route(
        np.array(rows, np.float64),
        np.array(holds, np.float64).reshape(-1, 4),
        tangent[0],
        patience,
        right,
    )


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
