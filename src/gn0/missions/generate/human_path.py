"""Algorithm 4, lines 3 and 4: a path becomes a person's way in time, if it can be walked so."""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from gn0.errors import PlanError
from gn0.geometry import F64, polyline_length
from gn0.maps.grid import OccupancyGrid
from gn0.missions.episode import AgentSpec, FollowCategory
from gn0.missions.filters import discrete_frechet
from gn0.missions.generate.follow_settings import FollowSettings
from gn0.missions.paths import densify_path
from gn0.people.person import EpisodePerson, PersonStop
from gn0.people.planning import blocked_at, people_map, round_path
from gn0.people.route import ACCELERATION
from gn0.people.walk import WalkTrack, walk_alone

AT_EASE = 0.42  # m from walls where there is room for it: bends can be rounded there
_SAME_WAY = 0.75  # m, discrete Fréchet distance up to which a way is that of the path
_SNAP = 0.4  # m by which its ends may move
_CLEAR = 1.0  # m of both ends in which nobody stops
_APART = 2.0  # m between stops
_TURN_LIMIT = math.radians(90.0) / 10  # of a tick
_ROUNDING = 1e-6
_SPARE = 20.0  # s beyond the longest in which somebody may still arrive


@dataclass(frozen=True, eq=False)
class HumanPath:
    """A person's way in time.

    Attributes:
        person: who walks it, its identity still to be chosen.
        track: how, with nobody in the way, to its end.
        category: in which manner.
        seconds: when it arrives [s].
    """

    person: EpisodePerson
    track: WalkTrack
    category: FollowCategory
    seconds: float


def find_way(grid: OccupancyGrid, points: F64) -> F64:
    """A person's way [N, 2] m along a path: bends rounded, farther from walls where there is room.

    Args:
        grid: raw occupancy.
        points: the path [N, 2] m.
    """
    corners = _corners(points)
    ease = people_map(grid, AT_EASE)
    begin = ease.nearest_free(float(points[0, 0]), float(points[0, 1]), reach=_SNAP)
    end = ease.nearest_free(float(points[-1, 0]), float(points[-1, 1]), reach=_SNAP)
    if begin is not None and end is not None and ease.region_of(*begin) == ease.region_of(*end):
        try:
            wide = ease.plan(begin, end)
        except PlanError:
            wide = corners[:0]
        apart = len(wide) > 1 and discrete_frechet(densify_path(wide), densify_path(points))
        if len(wide) > 1 and apart <= _SAME_WAY:
            corners = np.asarray(wide, np.float64)
    return round_path(grid, corners)


def _corners(points: F64) -> F64:
    """A polyline without the points that lie on straights."""
    kept = [points[0]]
    for here, after in pairwise(points[1:]):
        a, b = here - kept[-1], after - here
        across = abs(a[0] * b[1] - a[1] * b[0])
        if across > 1e-6 * float(np.hypot(*a)) * float(np.hypot(*b)) or float(a @ b) < 0:
            kept.append(here)
    return np.array([*kept, points[-1]])


def cut_way(way: F64, begin: float) -> F64:
    """What of a way [N, 2] m is left after `begin` [m] of it; nothing [0, 2] beyond its end."""
    arcs = np.r_[0.0, np.cumsum(np.hypot(*np.diff(way, axis=0).T))]
    if begin <= 0.0:
        return way
    if begin >= arcs[-1]:
        return way[:0]
    k = int(np.searchsorted(arcs, begin, "right"))
    part = (begin - arcs[k - 1]) / (arcs[k] - arcs[k - 1])
    first = way[k - 1] + part * (way[k] - way[k - 1])
    rest = way[k:]
    return np.vstack([first, rest]) if np.hypot(*(rest[0] - first)) > 1e-4 else rest.copy()


def draw_category(settings: FollowSettings, rng: np.random.Generator) -> FollowCategory:
    """In which manner a person walks."""
    drawn = rng.random()
    if drawn < settings.cruise:
        return "cruise"
    return "turn" if drawn < settings.cruise + settings.turn else "stop-and-go"


def draw_speed(
    length: float, settings: FollowSettings, agent: AgentSpec, rng: np.random.Generator
) -> float | None:
    """At what speed [m/s] somebody walks `length` [m]; None where no speed fits.

    It leaves the agent a fifth of its own, and takes about as long as it may.
    """
    low, high = settings.speeds
    high = min(high, settings.agent_share * agent.forward_step / agent.step_seconds)
    low = max(low, length / settings.seconds[1])
    high = min(high, length / settings.seconds[0] * 1.15)  # braking takes its time as well
    if high < low - 1e-9:
        return None
    return math.floor(100 * float(rng.uniform(low, max(high, low))) + 1e-6) / 100


def retime_path(
    way: F64,
    category: FollowCategory,
    speed: float,
    rng: np.random.Generator,
    *,
    number: int = 1,
    identity: str = "drawn:0:0",
) -> EpisodePerson:
    """Somebody who walks a way in a manner (paper, RetimePath).

    Args:
        way: [N, 2] m.
        category: the manner.
        speed: m/s on straights.
        rng: chance.
        number: of the person.
        identity: of the person.
    """
    stops: tuple[PersonStop, ...] = ()
    length = polyline_length(way)
    if category == "turn":
        stops = _looks(length, rng)
    elif category == "stop-and-go":
        places = _spread(length, int(rng.integers(1, 5)), rng)
        stops = tuple(
            PersonStop(at=at, seconds=round(float(rng.uniform(1.0, 4.0)), 1)) for at in places
        )
    return EpisodePerson(
        number=number,
        identity=identity,
        path=tuple((float(x), float(y)) for x, y in way),
        speed=max(speed, 0.4),
        stops=stops,
        seed=int(rng.integers(2**31)),
    )


def _looks(length: float, rng: np.random.Generator) -> tuple[PersonStop, ...]:
    """One to three looks round on the spot, some at one place: to one side, then to the other."""
    stops: list[PersonStop] = []
    looks = int(rng.integers(1, 4))
    places = _spread(length, int(rng.integers(1, looks + 1)), rng)
    for k in range(looks):
        side = 1.0 if rng.random() < 0.5 else -1.0
        at = places[min(k, len(places) - 1)]
        if stops and stops[-1].at == at:
            side = -math.copysign(1.0, stops[-1].look)
        look = side * round(float(rng.uniform(40.0, 110.0)), 1)
        stops.append(PersonStop(at=at, seconds=round(float(rng.uniform(1.2, 2.4)), 1), look=look))
    return tuple(stops)


def _spread(length: float, count: int, rng: np.random.Generator) -> list[float]:
    """Up to `count` places on a way [m], 1 m from its ends and 2 m apart, sorted."""
    room = length - 2 * _CLEAR
    count = max(min(count, int(room // _APART) + 1), 1)
    slack = np.sort(rng.uniform(0.0, max(room - (count - 1) * _APART, 0.0), count))
    return [round(float(_CLEAR + k * _APART + at), 3) for k, at in enumerate(slack)]


def walk_path(
    person: EpisodePerson, category: FollowCategory, settings: FollowSettings
) -> HumanPath | None:
    """The person's way in time, or None if it does not arrive soon enough."""
    track = walk_alone(person, settings.seconds[1] + _SPARE)
    if not track.arrived.any():
        return None
    last = int(np.argmax(track.arrived))
    return HumanPath(person, track, category, last / 10)


def invalid_path(
    path: HumanPath, grid: OccupancyGrid, settings: FollowSettings, agent: AgentSpec
) -> str:
    """Why a person's way is refused (paper, InvalidHumanPath); "" for one that can be walked.

    Args:
        path: the way in time.
        grid: raw occupancy.
        settings: lengths and times.
        agent: who is to follow.
    """
    person, track = path.person, path.track
    if person.length < settings.least_length:
        return "short"
    if not settings.seconds[0] <= path.seconds <= settings.seconds[1]:
        return "too quick" if path.seconds < settings.seconds[0] else "too slow"
    if blocked_at(grid, person.path) is not None:
        return "walls"
    moved = np.hypot(*np.diff(track.place, axis=0).T) * 10
    if moved.max() > person.speed + _ROUNDING:
        return "speed"
    if np.abs(np.diff(track.speed)).max() * 10 > ACCELERATION + _ROUNDING:
        return "speed"
    turned = np.abs(_wrapped(np.diff(track.yaw)))
    if turned.max() > _TURN_LIMIT + _ROUNDING:
        return "turn rate"
    if least_seconds(person, agent) > path.seconds:
        return "no time for turns"
    return ""


def least_seconds(person: EpisodePerson, agent: AgentSpec) -> float:
    """What an agent needs for a person's way at least [s]: it stands still to turn."""
    legs = np.diff(np.array(person.path), axis=0)
    yaws = np.arctan2(legs[:, 1], legs[:, 0])
    turns = float(np.abs(_wrapped(np.diff(yaws))).sum())
    strides = person.length / agent.forward_step
    return (strides + turns / math.radians(agent.turn_degrees)) * agent.step_seconds


def _wrapped(angles: F64) -> F64:
    """Angles [rad] within −π..π."""
    return np.asarray((angles + math.pi) % (2.0 * math.pi) - math.pi, np.float64)
