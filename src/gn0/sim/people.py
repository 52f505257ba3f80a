"""The people around one agent: they move in the ticks of its actions, and its moves stop at them.

Within a tick people go first, with an eye on where the agent was a tick ago, and come nearer to it
by at most half of the gap. Then the agent wants its place of that tick: where it would touch
somebody, it stays where it is until the action is over.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from gn0.geometry import F32, F64
from gn0.jit import njit
from gn0.missions.people import check_people_walls
from gn0.people.crowd import (
    CrowdState,
    Walls,
    build_walls,
    empty_crowd,
    place_people,
    step_crowd,
)
from gn0.people.person import RADIUS, EpisodePerson
from gn0.people.reach import HX, HY, X0, Y0, X, Y
from gn0.people.route import Routes, build_routes
from gn0.sim.collision import Move
from gn0.sim.ticks import cut_move, move_in_ticks

if TYPE_CHECKING:
    from gn0.maps.navigation import NavigationMap
    from gn0.missions.episode import AgentSpec, Episode


@dataclass(frozen=True)
class PersonHit:
    """A move of the agent that was cut because of a person.

    Attributes:
        number: of the person, see `EpisodePerson.number`.
        by: who moved more towards the other in that tick: "agent" or "person".
        tick: of the action, from 1, that the agent did not do.
    """

    number: int
    by: str
    tick: int


class Company:
    """The people of the episode in progress, and how an agent moves among them.

    Args:
        navigation: the agent's own map, of whose grid people's walls are made.
        agent: the body.
        radius: of people's discs [m].
    """

    def __init__(self, navigation: NavigationMap, agent: AgentSpec, radius: float = RADIUS) -> None:
        self.navigation, self.agent, self.radius = navigation, agent, radius
        self.people: tuple[EpisodePerson, ...] = ()
        self._walls: Walls | None = None
        self._routes: Routes = build_routes(())
        self._state: CrowdState = empty_crowd(1, 0)
        self._fits: tuple[EpisodePerson, ...] = ()
        self.hit: PersonHit | None = None

    def begin(self, episode: Episode) -> None:
        """Put the people of an episode where they begin.

        Raises:
            EpisodeError: somebody would walk through a wall.
        """
        people = episode.people
        if people and people != self._fits:
            check_people_walls(people, self.navigation.grid, f"episode {episode.id!r}")
            self._fits = people
        self._meet(people)
        place_people(self._state, 0, self._routes, range(len(people)))

    def _meet(self, people: tuple[EpisodePerson, ...]) -> None:
        self.hit = None
        if people == self.people:
            return
        if people and self._walls is None:
            self._walls = build_walls([self.navigation.grid])
        self.people, self._routes = people, build_routes(people)
        self._state = empty_crowd(1, len(people))
        self._state.walls[0] = 0

    def __len__(self) -> int:
        return len(self.people)

    @property
    def state(self) -> CrowdState:
        """What they do now, see `gn0.people.reach`; not to be written to."""
        return self._state

    @property
    def places(self) -> F64:
        """Where they are [P, 2] m."""
        return self._state.real[0, :, X : Y + 1]

    @property
    def faces(self) -> F64:
        """Unit vectors of their headings [P, 2]."""
        return self._state.real[0, :, HX : HY + 1]

    def save(self) -> CrowdState | None:
        """What they do, to be restored; None of nobody."""
        return self._state.copy() if self.people else None

    def restore(self, episode: Episode, state: CrowdState | None) -> None:
        """Go back to a saved state of an episode's people."""
        self._meet(episode.people)
        if state is not None:
            self._state = state.copy()

    def wait(self, x: float, y: float, ticks: int) -> None:
        """Let people move for some ticks while the agent is at (x, y) [m]."""
        if not self.people:
            return
        assert self._walls is not None
        agent = np.array([[x, y, self.agent.radius]])
        for _ in range(ticks):
            step_crowd(self._state, self._routes, self._walls, agent, radius=self.radius)

    def go(self, x0: float, y0: float, places: Sequence[tuple[float, float]]) -> tuple[Move, int]:
        """Move the agent through the ticks of an action, and everybody with it.

        Args:
            x0: where it begins, x [m].
            y0: the same, y [m].
            places: where it wants to be after each tick [(x, y) m].

        Returns:
            Where it ended, and the tick (from 1) that it did not do for somebody, else 0. The rest
            of the ticks is left to be waited for.
        """
        self.hit = None
        last, stopped = [x0, y0], 0

        def touches(tick: int, x: float, y: float) -> bool:
            nonlocal stopped
            self.wait(last[0], last[1], 1)
            person = self._touched(x, y)
            if person >= 0:
                stopped = tick
                came = self._who_came(person, last[0], last[1], x, y)
                self.hit = PersonHit(self.people[person].number, came, tick)
                return True
            last[0], last[1] = x, y
            return False

        move = move_in_ticks(self.navigation, x0, y0, places, self.agent, touches)
        return move, stopped

    def move(self, x0: float, y0: float, x1: float, y1: float) -> Move:
        """Move the agent from (x0, y0) towards (x1, y1) [m] for the time of an action."""
        ticks = self.agent.step_ticks
        move, stopped = self.go(x0, y0, cut_move(x0, y0, x1, y1, ticks))
        if stopped:
            self.wait(move.x, move.y, ticks - stopped)
        return move

    def foretell(self, ticks: int) -> tuple[F64, F64]:
        """Where everybody is from now on with the agent out of their way; nobody moves.

        Returns:
            Places [ticks+1, P, 2] m and unit vectors of headings [ticks+1, P, 2].
        """
        if not self.people:
            return np.zeros((ticks + 1, 0, 2)), np.zeros((ticks + 1, 0, 2))
        state, nobody = self._state.copy(), np.array([[0.0, 0.0, -1.0]])
        rows = [state.real[0].copy()]
        for _ in range(ticks):
            assert self._walls is not None
            step_crowd(state, self._routes, self._walls, nobody, radius=self.radius)
            rows.append(state.real[0].copy())
        found = np.array(rows)
        return found[:, :, [X, Y]], found[:, :, [HX, HY]]

    def foresee(
        self, x0: float, y0: float, places: Sequence[tuple[float, float]]
    ) -> PersonHit | None:
        """Who would cut a move short; see `go`. Nobody moves."""
        if not self.people:
            return None
        kept, hit = self._state.copy(), self.hit
        self.go(x0, y0, places)
        found, self._state, self.hit = self.hit, kept, hit
        return found

    def _touched(self, x: float, y: float) -> int:
        """The nearest person whom the agent would touch at (x, y); −1 for nobody."""
        reach = self.radius + self.agent.radius
        away = self.places - (x, y)
        square = away[:, 0] * away[:, 0] + away[:, 1] * away[:, 1]
        person = int(np.argmin(square))
        return person if square[person] < reach * reach else -1

    def _who_came(self, person: int, x0: float, y0: float, x: float, y: float) -> str:
        """Who of agent and person moved more towards the other in a tick."""
        row = self._state.real[0, person]
        dx, dy = row[X0] - x0, row[Y0] - y0
        mine = (x - x0) * dx + (y - y0) * dy
        theirs = -((row[X] - row[X0]) * dx + (row[Y] - row[Y0]) * dy)
        return "agent" if mine >= theirs else "person"

    def limit_ranges(self, x: float, y: float, angles: F64, ranges: F32) -> F32:
        """Range rays [R] m from (x, y), shortened to where the agent would touch somebody.

        Args:
            x: of the agent [m].
            y: of the agent [m].
            angles: directions of the rays [R] rad.
            ranges: how far they reach without people [R] m.
        """
        if not self.people:
            return ranges
        found, state = ranges.copy(), self._state
        reach = self.radius + self.agent.radius
        shorten_rays(state.real, state.route, 0, reach, x, y, angles, found)
        return found


@njit
def shorten_rays(real, route, i, reach, x, y, angles, ranges):  # type: ignore[no-untyped-def]
    """Rays `ranges` [R] m from (x, y), cut in place where the agent would touch somebody.

    `angles` [R] are their directions [rad], `reach` the sum of radii [m]; of environment `i`.
    """
    for r in range(len(ranges)):
        ux, uy = math.cos(angles[r]), math.sin(angles[r])
        least = np.float64(ranges[r])
        for p in range(real.shape[1]):
            if route[i, p] < 0:
                break
            dx, dy = real[i, p, X] - x, real[i, p, Y] - y
            along = dx * ux + dy * uy
            aside = dx * uy - dy * ux
            under = reach * reach - aside * aside
            if along > 0.0 and under > 0.0:
                least = min(least, max(along - math.sqrt(under), 0.0))
        ranges[r] = np.float32(least)
