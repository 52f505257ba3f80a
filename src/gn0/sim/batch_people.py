"""The people of many episodes in progress, packed for the batch kernels.

Each environment's people do what `gn0.sim.people.Company` has them do, bit for bit. Routes are
packed when an episode is first played, walls when a scene with people is.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from gn0.geometry import F32, F64
from gn0.missions.episode import AgentSpec, Episode
from gn0.missions.follow_rules import TOUCHED_BY
from gn0.missions.people import check_people_walls
from gn0.people.crowd import PACE, CrowdState, Walls, build_walls, empty_crowd
from gn0.people.person import RADIUS, EpisodePerson
from gn0.people.route import I64, Routes, build_routes
from gn0.sim.batch_kernels import AgentArrays, EpisodeArrays, FieldArrays, MapArrays
from gn0.sim.batch_people_kernels import (
    CAME,
    ROW,
    TICK,
    Bodies,
    CrowdArrays,
    begin_people,
    read_people,
    shorten_rings,
    step_among,
)
from gn0.sim.batch_tables import grow_rows
from gn0.sim.ground import GroundStore

ROUTE_MEMORY = 256 * 2**20  # bytes of packed routes
CAME_WORDS = np.array(["agent", "person"], object)


class RouteTable:
    """Routes of people, in one table that grows."""

    def __init__(self) -> None:
        self.arrays = build_routes(())
        self._used = [0, 0, 0, 0]  # rows of each array

    @property
    def count(self) -> int:
        """How many routes there are."""
        return self._used[0]

    @property
    def nbytes(self) -> int:
        """Bytes that it takes."""
        return sum(array.nbytes for array in self.arrays)

    def add(self, people: Sequence[EpisodePerson]) -> int:
        """Pack the routes of people, in their order; the number of the first."""
        more, begin = build_routes(people), self.count
        points, holds = self._used[2:]
        more.table[:, :4] += (points, points, holds, holds)
        grown: list[NDArray[Any]] = []
        for k, (array, rows) in enumerate(zip(self.arrays, more, strict=True)):
            at = self._used[k]
            self._used[k] = end = at + len(rows)
            kept = array if end <= len(array) else grow_rows(array, end)
            kept[at:end] = rows
            grown.append(kept)
        self.arrays = Routes(*grown)
        return begin


class Hits(NamedTuple):
    """For whom the last moves of agents were cut; see `gn0.sim.people.PersonHit`.

    Attributes:
        number: int64 [K], of the person; 0 for nobody.
        by: [K], "agent" or "person"; "" for nobody.
        tick: int64 [K], of the action, from 1, that the agent did not do; 0 for nobody.
    """

    number: I64
    by: NDArray[np.object_]
    tick: I64


class CompanyBatch:
    """The people of N environments, and how agents move among them.

    Args:
        count: N.
        agent: the body.
        ground: maps of the scenes.
        episodes: of all numbers; it may grow.
        radius: of people's discs [m].
        memory: bytes that packed routes may take; those in use are never dropped.
    """

    def __init__(
        self,
        count: int,
        agent: AgentSpec,
        ground: GroundStore,
        episodes: Sequence[Episode],
        radius: float = RADIUS,
        memory: int = ROUTE_MEMORY,
    ) -> None:
        self._ground, self._episodes, self._agent, self._memory = ground, episodes, agent, memory
        self._bodies = Bodies(agent.radius, radius)
        ticks = agent.step_ticks
        self.shares = np.array([[k / ticks for k in range(1, ticks)] + [1.0]])
        self._table = RouteTable()
        self._numbers = np.zeros(0, np.int64)  # person's number, by route
        self._first = np.zeros(0, np.int64)  # by episode
        self._count = np.zeros(0, np.int64)  # by episode; −1 before it is first played
        self._scene = np.zeros(0, np.int64)  # walls by episode
        self._walls = build_walls(())
        self._wall_numbers: dict[str, int] = {}
        empty = empty_crowd(count, 0)
        self.crowd = CrowdArrays(
            *(empty.real, empty.whole, empty.route, empty.walls),
            np.zeros((count, 3)),
            np.zeros((count, 3), np.int64),
        )

    def __bool__(self) -> bool:
        return self.crowd.route.shape[1] > 0

    def prepare(self, chosen: NDArray[np.int64], in_use: NDArray[np.integer]) -> None:
        """Make the people of episodes `chosen` [K] ready; `in_use` [N] are played now.

        Raises:
            EpisodeError: somebody would walk through a wall.
        """
        missing = len(self._episodes) - len(self._count)
        if missing:
            self._first, self._scene = (
                np.append(array, np.zeros(missing, np.int64))
                for array in (self._first, self._scene)
            )
            self._count = np.append(self._count, np.full(missing, -1))
        fresh = chosen[self._count[chosen] < 0]
        if not len(fresh):
            return
        numbers = np.unique(fresh).tolist()
        busy = [number for number in numbers if self._episodes[number].people]
        for number in busy:
            episode = self._episodes[number]
            grid = self._ground.open(episode.scene_id).grid
            check_people_walls(episode.people, grid, f"episode {episode.id!r}")
        if busy and self._table.nbytes > self._memory:
            self._drop(np.union1d(in_use[in_use >= 0], chosen))
        for number in busy:
            self._scene[number] = self._find_walls(self._episodes[number].scene_id)
        self._pack(busy)
        most = max((len(self._episodes[number].people) for number in busy), default=0)
        if most > self.crowd.route.shape[1]:
            self._widen(most)
        self._count[numbers] = [len(self._episodes[number].people) for number in numbers]

    def _pack(self, numbers: Sequence[int]) -> None:
        people: list[EpisodePerson] = []
        for number in numbers:
            self._first[number] = self._table.count + len(people)
            people += self._episodes[number].people
        if people:
            self._table.add(people)
            self._numbers = np.append(self._numbers, [person.number for person in people])

    def _drop(self, needed: NDArray[np.integer]) -> None:
        """Begin the table of routes anew with those of episodes that are played or will be."""
        kept = [int(n) for n in needed if self._count[n] > 0]
        self._count[self._count > 0] = -1
        self._table, self._numbers = RouteTable(), np.zeros(0, np.int64)
        before = self._first.copy()
        self._pack(kept)
        self._count[kept] = [len(self._episodes[n].people) for n in kept]
        route = self.crowd.route
        shift = {int(before[n]): int(self._first[n]) for n in kept}
        for i in np.flatnonzero(route[:, 0] >= 0):
            row = route[i]
            row[row >= 0] += shift[int(row[0])] - row[0]

    def _find_walls(self, scene_id: str) -> int:
        number = self._wall_numbers.get(scene_id)
        if number is None:
            number = self._wall_numbers[scene_id] = len(self._wall_numbers)
            old, new = self._walls, build_walls([self._ground.open(scene_id).grid])
            new.shape[:, 0] += len(old.blocked)
            self._walls = Walls(
                np.concatenate([old.blocked, new.blocked]),
                np.vstack([old.shape, new.shape]),
                np.vstack([old.frame, new.frame]),
            )
        return number

    def _widen(self, places: int) -> None:
        old = self.crowd
        new, have = empty_crowd(len(old.route), places), old.route.shape[1]
        new.real[:, :have], new.whole[:, :have] = old.real, old.whole
        new.route[:, :have] = old.route
        self.crowd = old._replace(real=new.real, whole=new.whole, route=new.route)

    def place(
        self, which: NDArray[np.int64], chosen: NDArray[np.int64], agents: AgentArrays
    ) -> None:
        """Put people of prepared episodes `chosen` [K] around agents `which` [K] at their starts.

        `agents` stand there already.
        """
        if self:
            begin_people(
                *(which, chosen, self._first, self._count, self._scene, agents.position),
                *(self._bodies.agent, self.crowd, self._table.arrays),
            )

    def step(
        self,
        actions: NDArray[np.int64],
        agents: AgentArrays,
        maps: MapArrays,
        fields: FieldArrays,
        episodes: EpisodeArrays,
        forward: float,
        slides: bool,
        max_steps: int,
        outcome: tuple[F64, NDArray[np.bool_], NDArray[np.bool_]],
        shares: F64 | None = None,
    ) -> None:
        """Take one action (0..3) each; fills progress [N] m, stopped [N] and truncated [N].

        `shares` [N, ticks] says which part of a move is done after each tick; even parts when None.
        """
        step_among(
            *(actions, agents, maps, fields, episodes, forward, slides, max_steps, *outcome),
            *(self.crowd, self._table.arrays, self._walls, PACE, self._bodies),
            self.shares if shares is None else shares,
        )

    def limit_ranges(
        self,
        which: NDArray[np.int64],
        agents: AgentArrays,
        episodes: EpisodeArrays,
        rays: F64,
        out: F32,
    ) -> None:
        """Shorten range rings `out` [K, R] m of agents `which` where people are in the way."""
        if self:
            reach = self._bodies.person + self._bodies.agent
            shorten_rings(which, agents, episodes, self.crowd, reach, rays, out)

    def places(self, which: NDArray[np.int64], room: int) -> F64:
        """[K, room, 4] x, y [m] and unit vector of the heading of each person; NaN for nobody."""
        out = np.full((len(which), room, 4), np.nan)
        read_people(which, self.crowd, out)
        return out

    def touched(self) -> NDArray[np.bool_]:
        """Which agents touched somebody in their last moves; see `follow_rules.touched_person`."""
        hit = self.crowd.hit
        came = CAME_WORDS.tolist().index(TOUCHED_BY)
        return np.asarray((hit[:, ROW] > 0) & (hit[:, CAME] == came))

    def hits(self, which: NDArray[np.int64]) -> Hits:
        """For whom the last moves of agents `which` [K] were cut."""
        hit = self.crowd.hit[which]
        rows = np.flatnonzero(hit[:, ROW])
        number, tick = np.zeros(len(which), np.int64), np.zeros(len(which), np.int64)
        by = np.full(len(which), "", object)
        if len(rows):
            routes = self.crowd.route[which[rows], hit[rows, ROW] - 1]
            number[rows] = self._numbers[routes]
            by[rows] = CAME_WORDS[hit[rows, CAME]]
            tick[rows] = hit[rows, TICK]
        return Hits(number, by, tick)

    def state_of(self, agent: int) -> CrowdState | None:
        """What the people around one agent do, as `Company.save` says it; None of nobody."""
        if not self:
            return None
        crowd = self.crowd
        count = int((crowd.route[agent] >= 0).sum())
        if not count:
            return None
        return CrowdState(
            crowd.real[agent : agent + 1, :count].copy(),
            crowd.whole[agent : agent + 1, :count].copy(),
            np.arange(count)[None],
            np.zeros(1, np.int64),
        )
