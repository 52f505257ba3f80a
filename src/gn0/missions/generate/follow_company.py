"""Who else walks about in a follow mission: some begin in sight, and none comes in the way."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence

import msgspec
import numpy as np

from gn0.geometry import F64
from gn0.maps.grid import OccupancyGrid
from gn0.maps.ray import is_line_free
from gn0.missions.generate.follow_settings import FollowSettings
from gn0.missions.generate.human_path import AT_EASE, HumanPath
from gn0.people.crowd import Walls, build_walls, empty_crowd, place_people, step_crowd
from gn0.people.person import PEOPLE_MOST, EpisodePerson, PersonStop
from gn0.people.planning import blocked_at, people_map, round_path
from gn0.people.route import build_routes
from gn0.people.tick import X
from gn0.people.walk import NO_AGENT, walk_alone

_IN_SIGHT = (1.5, 6.0)  # m from the agent within which somebody begins in sight of it
_HALF_VIEW = math.radians(32.0)
_STANDING = 0.25  # share of those in sight who stay where they are
_ROOMY = 8.0  # m² in which others find places far enough from walls
_LENGTHS = (3.0, 20.0)  # m of a way
_SPEEDS = (0.5, 1.2)  # m/s
_CANDIDATES = 10  # places looked at for each who is wanted
_TRIES = 8  # drawn for each of those
_NOBODY = "drawn:0:0"  # until it is said who it is
_ON_TIME = 0.01  # m off its place alone: farther, and others make the person wait
_TO_AGENT = 0.95  # m that others stay away from where the agent will be


class CompanyPlanner:
    """Plans ways for others on one scene's map.

    Args:
        grid: raw occupancy.
    """

    def __init__(self, grid: OccupancyGrid) -> None:
        self.grid = grid
        self._blocked: Walls = build_walls([grid])

    def plan(
        self,
        path: HumanPath,
        start: tuple[float, float, float],
        distance: float,
        count: int,
        settings: FollowSettings,
        rng: np.random.Generator,
    ) -> tuple[EpisodePerson, ...]:
        """Up to `count` others, numbered from 2; half of them begin in sight of the agent.

        Nobody meets the person or comes near to where the agent will be, played together by the
        dynamics of crowds. Their identities are still to be chosen.

        Args:
            path: of the person to follow.
            start: of the agent (x, y) [m], yaw [rad].
            distance: at which it follows [m].
            count: how many are wanted.
            settings: how near others may come.
            rng: chance.
        """
        if count == 0:
            return ()
        ticks = round(10 * path.seconds) + 31
        agent = _agent_places(path, start, distance, ticks)
        drawn: list[EpisodePerson] = []
        spots = [start[:2], path.person.spot]
        for x, y, seen in self._places(path, start, _CANDIDATES * count, rng):
            if any(math.dist((x, y), spot) < 0.9 for spot in spots):
                continue
            for person in self._draw(x, y, seen, rng, number=2 + len(drawn)):
                alone = walk_alone(person, (ticks - 1) / 10).place
                far = _least(alone - path.track.place[:ticks]) >= settings.meet
                if far and _least(alone - agent) >= _TO_AGENT:
                    drawn.append(person)
                    spots.append((x, y))
                    break
            if len(drawn) == min(2 * count + 1, PEOPLE_MOST - 1):
                break
        return self._choose(path, agent, drawn, count, settings)

    def _places(
        self,
        path: HumanPath,
        start: tuple[float, float, float],
        wanted: int,
        rng: np.random.Generator,
    ) -> list[tuple[float, float, bool]]:
        """Places (x, y [m], in sight of the agent), those in sight and others in turns."""
        grid = self.grid
        cells = np.zeros((0, 2), np.int64)
        for walls in (people_map(grid, AT_EASE), people_map(grid)):
            near = {walls.region_of(*place) for place in path.person.path} - {-1}
            cells = np.argwhere(np.isin(walls.regions, sorted(near)))
            if len(cells) >= _ROOMY / grid.resolution**2:
                break
        if not len(cells):
            return []
        points = np.asarray(walls.inflated.centres_of(cells), np.float64)
        away = points - start[:2]
        far = np.hypot(*away.T)
        bearing = np.arctan2(away[:, 1], away[:, 0]) - start[2]
        bearing = np.abs((bearing + math.pi) % (2 * math.pi) - math.pi)
        ahead = (far >= _IN_SIGHT[0]) & (far <= _IN_SIGHT[1]) & (bearing <= _HALF_VIEW)
        found: list[tuple[float, float, bool]] = []
        front, rest = points[ahead], points[far >= 1.2]
        for k in range(wanted):
            pool, seen = (front, True) if k % 2 == 0 and len(front) else (rest, False)
            for _ in range(_TRIES):
                if not len(pool):
                    break
                x, y = map(float, pool[int(rng.integers(len(pool)))])
                if not seen or is_line_free(grid, start[:2], (x, y)):
                    found.append((x, y, seen))
                    break
        return found

    def _draw(
        self, x: float, y: float, seen: bool, rng: np.random.Generator, *, number: int
    ) -> Iterator[EpisodePerson]:
        """Who may begin at a place: somebody who walks back and forth, else who stands there."""
        seed, yaw = int(rng.integers(2**31)), round(float(rng.uniform(-math.pi, math.pi)), 3)
        if not seen or rng.random() >= _STANDING:
            walker = self._walker(x, y, rng, number, seed)
            if walker is not None:
                yield walker
        yield EpisodePerson(
            number=number, identity=_NOBODY, path=((x, y),), behaviour="stand", yaw=yaw, seed=seed
        )

    def _walker(
        self, x: float, y: float, rng: np.random.Generator, number: int, seed: int
    ) -> EpisodePerson | None:
        wide, tight = people_map(self.grid, AT_EASE), people_map(self.grid)
        walls = wide if wide.is_free(x, y) else tight
        cells = np.argwhere(walls.regions == walls.region_of(x, y))
        ends = walls.inflated.centres_of(cells[rng.integers(len(cells), size=_TRIES)])
        for end in ends.tolist():
            if not _LENGTHS[0] <= math.dist((x, y), end) <= _LENGTHS[1]:
                continue
            way = walls.geodesic((end[0], end[1]), keep=False).path(x, y)
            rounded = round_path(self.grid, np.asarray(way, np.float64))
            length = float(np.hypot(*np.diff(rounded, axis=0).T).sum())
            if length > _LENGTHS[1] or blocked_at(self.grid, rounded.tolist()) is not None:
                continue
            at = round(float(rng.uniform(0.2, 0.8)) * length, 2)
            pause = round(float(rng.uniform(1.0, 4.0)), 1)
            return EpisodePerson(
                number=number, identity=_NOBODY, path=tuple((u, v) for u, v in rounded.tolist()),
                speed=round(float(rng.uniform(*_SPEEDS)), 2), after="back", seed=seed,
                stops=(PersonStop(at=at, seconds=pause),) if rng.random() < 0.5 else (),
            )  # fmt: skip
        return None

    def _choose(
        self,
        path: HumanPath,
        agent: F64,
        drawn: Sequence[EpisodePerson],
        count: int,
        settings: FollowSettings,
    ) -> tuple[EpisodePerson, ...]:
        """Those who come in nobody's way, in their order; played again until that holds of all."""
        ticks, left = len(agent), list(drawn)
        while left:
            places = play_people(self._blocked, [path.person, *left[:count]], ticks)
            gap = np.hypot(*(places[1:] - places[:1]).transpose(2, 0, 1)).min(axis=1)
            near = np.hypot(*(places[1:] - agent[None]).transpose(2, 0, 1)).min(axis=1)
            late = np.abs(places[0] - path.track.place[:ticks]).max()
            bad = (gap < settings.meet) | (near < _TO_AGENT)
            if not bad.any() and late > _ON_TIME:
                bad[int(np.argmin(gap))] = True  # who makes the person wait
            if not bad.any():
                chosen = left[:count]
                return tuple(
                    msgspec.structs.replace(person, number=2 + k) for k, person in enumerate(chosen)
                )
            left = [p for k, p in enumerate(left) if k >= len(bad) or not bad[k]]
        return ()


def _least(apart: F64) -> float:
    """The least length of vectors [N, 2]."""
    return float(np.hypot(apart[:, 0], apart[:, 1]).min())


def _agent_places(
    path: HumanPath, start: tuple[float, float, float], distance: float, ticks: int
) -> F64:
    """About where the agent will be [T, 2] m: on the person's trail, `distance` behind."""
    track = path.track
    walked = np.r_[track.walked, np.full(max(ticks - len(track.walked), 0), track.walked[-1])]
    trail = np.vstack([[start[:2]], track.place])
    arcs = np.r_[0.0, np.cumsum(np.hypot(*np.diff(trail, axis=0).T))]
    at = np.maximum(walked[:ticks] + arcs[1] - distance, 0.0)
    return np.column_stack([np.interp(at, arcs, trail[:, k]) for k in (0, 1)])


def play_people(walls: Walls, people: Sequence[EpisodePerson], ticks: int) -> F64:
    """Where people are [P, T, 2] m when they are played together without an agent."""
    routes = build_routes(people)
    state = empty_crowd(1, len(people))
    state.walls[0] = 0
    place_people(state, 0, routes, range(len(people)))
    out = np.empty((len(people), ticks, 2))
    for tick in range(ticks):
        if tick:
            step_crowd(state, routes, walls, NO_AGENT)
        out[:, tick] = state.real[0, :, X : X + 2]
    return out
