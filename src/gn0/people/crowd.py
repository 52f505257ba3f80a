"""Everybody's next tick: one kernel for one episode and for thousands.

Whoever walks is on its path, at a way from its start, and speeds up, brakes and turns within
bounds. Where another is in its way it brakes, waits, then goes round with an eye on walls, and
turns back where there is no way round. Everybody reads last tick's places: between two people
each may come nearer by half of the gap, seen along the line between them, so that no order of
people can show and no two ever overlap. Only + − × / and square root decide.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from gn0.errors import SimError
from gn0.geometry import F64
from gn0.jit import njit, prange
from gn0.maps.grid import OccupancyGrid
from gn0.maps.inflate import inflate
from gn0.people.clock import MOVED_BY, PART, PLANS, do_parts
from gn0.people.person import RADIUS, WALL_DISTANCE
from gn0.people.reach import (
    BLOCKED_BY,
    CLAIM,
    CLAIM0,
    CLIP_SINCE,
    DIRECTION,
    FX,
    FY,
    HX,
    HY,
    NOBODY,
    REALS,
    SETTLE,
    TURN_SINCE,
    WHOLES,
    X0,
    Y0,
    Pace,
    X,
    Y,
)
from gn0.people.route import I64, Routes
from gn0.people.tick import tick_people

TICKS_A_SECOND = 10
LONG_AGO = 1_000  # ticks: who stands when an episode begins did not just stop


class Walls(NamedTuple):
    """Where people may not be, of one scene or of many, for kernels.

    Attributes:
        blocked: cells of all scenes, row after row, inflated by 0.30 m.
        shape: [W, 3] where a scene's cells begin in it, and its rows and columns.
        frame: [W, 3] x, y of the corner of cell (0, 0) and length of a cell [m].
    """

    blocked: NDArray[np.bool_]
    shape: I64
    frame: F64


def build_walls(grids: Sequence[OccupancyGrid], distance: float = WALL_DISTANCE) -> Walls:
    """What people keep away from, of raw grids in their order."""
    masks = [inflate(grid, distance).blocked for grid in grids]
    begins = np.cumsum([0, *(mask.size for mask in masks)])
    rows = [np.ascontiguousarray(mask).ravel() for mask in masks]
    shape = [(begin, *mask.shape) for begin, mask in zip(begins, masks, strict=False)]
    frame = [(*grid.origin, grid.resolution) for grid in grids]
    return Walls(
        np.concatenate(rows) if rows else np.zeros(0, np.bool_),
        np.array(shape, np.int64).reshape(-1, 3),
        np.array(frame, np.float64).reshape(-1, 3),
    )


@dataclass(frozen=True, eq=False)
class CrowdState:
    """People of E episodes, P places each; see `gn0.people.reach` for the columns.

    Attributes:
        real: [E, P, REALS] float64: places, headings, speeds, ways.
        whole: [E, P, WHOLES] int64: what each is doing.
        route: [E, P] number of the route; −1 where there is nobody.
        walls: [E] number of the scene's walls; −1 where nobody minds walls.
        plan: [E, P, PLANS] of `gn0.people.clock`: moves that ticks cut; no places where none do.
    """

    real: F64
    whole: I64
    route: I64
    walls: I64
    plan: F64 = field(default_factory=lambda: np.zeros((0, 0, PLANS)))

    def copy(self) -> CrowdState:
        """The same in memory of its own."""
        return CrowdState(
            self.real.copy(),
            self.whole.copy(),
            self.route.copy(),
            self.walls.copy(),
            self.plan.copy(),
        )


def empty_crowd(episodes: int, places: int, *, pace: Pace | None = None) -> CrowdState:
    """Nobody in any of E episodes, with room for P people each, who go at a pace."""
    cuts = pace is not None and pace.cuts > 1
    return CrowdState(
        np.zeros((episodes, places, REALS)),
        np.zeros((episodes, places, WHOLES), np.int64),
        np.full((episodes, places), -1, np.int64),
        np.full(episodes, -1, np.int64),
        np.zeros((episodes if cuts else 0, places if cuts else 0, PLANS)),
    )


def place_people(state: CrowdState, episode: int, routes: Routes, numbers: Sequence[int]) -> None:
    """Put the people of an episode at the beginning of their routes, in place.

    Args:
        state: of all episodes.
        episode: row of the one that begins.
        routes: the table of all routes.
        numbers: those of its people, in the order of `Episode.people`.
    """
    rows = np.asarray(numbers, np.int64)
    place_rows(state.real, state.whole, state.route, routes, episode, rows)
    state.plan[episode : episode + 1] = 0.0


@njit
def place_rows(real, whole, route, routes, row, numbers):  # type: ignore[no-untyped-def]
    """`place_people` for kernels: the people of episode `row` on the routes `numbers`."""
    route[row], real[row], whole[row] = -1, 0.0, 0
    for p in range(len(numbers)):
        r = numbers[p]
        route[row, p] = r
        first = routes.table[r, 0]
        real[row, p, X] = real[row, p, X0] = routes.points[first, 0]
        real[row, p, Y] = real[row, p, Y0] = routes.points[first, 1]
        real[row, p, HX], real[row, p, HY] = routes.lines[r, 2], routes.lines[r, 3]
        whole[row, p, DIRECTION] = 1
        whole[row, p, BLOCKED_BY] = NOBODY
        whole[row, p, CLIP_SINCE] = LONG_AGO
        whole[row, p, CLAIM] = whole[row, p, CLAIM0] = routes.table[r, 7]
        real[row, p, FX], real[row, p, FY] = routes.lines[r, 2], routes.lines[r, 3]
        whole[row, p, TURN_SINCE] = SETTLE


def find_pace(ticks_a_second: int = TICKS_A_SECOND, *, decide_each: bool = False) -> Pace:
    """Lengths of decisions and of ticks, for the kernels.

    Args:
        ticks_a_second: where they are a multiple of ten, people decide once in a tenth of a second
            and ticks cut their moves; at any other rate they decide each tick.
        decide_each: at any rate each tick, which is another crowd from its first meeting on.
    """
    cuts, rest = divmod(ticks_a_second, TICKS_A_SECOND)
    if (rest == 0 and not decide_each) or ticks_a_second == TICKS_A_SECOND:
        # nine degrees, to the last bit
        return Pace(0.1, 0.9876883405951378, 0.15643446504023087, TICKS_A_SECOND, 3, cuts)
    turn = np.pi / 2 / ticks_a_second
    return Pace(
        1 / ticks_a_second,
        float(np.cos(turn)),
        float(np.sin(turn)),
        ticks_a_second,
        max(-(-30 // ticks_a_second), 1),
    )


PACE = find_pace()


@njit
def step_crowd_one(real, whole, route, walls, routes, wall_arrays, pace, agent, radius, row):  # type: ignore[no-untyped-def]
    """A tick of one episode, `row`; `agent` [E, 3] is x, y [m] and radius, negative for none."""
    tick_people(real, whole, route, walls, routes, wall_arrays, pace, agent, radius, row)


@njit(parallel=True)
def step_crowd_many(real, whole, route, walls, routes, wall_arrays, pace, agent, radius):  # type: ignore[no-untyped-def]
    """A tick of all episodes; see `step_crowd_one`."""
    for row in prange(real.shape[0]):
        tick_people(real, whole, route, walls, routes, wall_arrays, pace, agent, radius, row)


def step_crowd(
    state: CrowdState,
    routes: Routes,
    walls: Walls,
    agent: F64,
    *,
    pace: Pace = PACE,
    radius: float = RADIUS,
) -> None:
    """Everybody's next tick, in place.

    Args:
        state: of all episodes.
        routes: the table that `state.route` counts in.
        walls: the table that `state.walls` counts in.
        agent: [E, 3] x, y [m] and radius [m] of each episode's agent; a negative radius is nobody.
        pace: length of the tick; the one that `empty_crowd` was told.
        radius: of people's discs [m].

    Raises:
        SimError: ticks cut moves, and `state` was made for others.
    """
    if pace.cuts > 1:
        _do_a_part(state, routes, walls, agent, pace, radius)
    else:
        _decide(state, routes, walls, agent, pace, radius)


def _decide(
    state: CrowdState, routes: Routes, walls: Walls, agent: F64, pace: Pace, radius: float
) -> None:
    arrays = (state.real, state.whole, state.route, state.walls, routes, walls, pace, agent, radius)
    if len(state.real) == 1:
        step_crowd_one(*arrays, 0)
    else:
        step_crowd_many(*arrays)


def _do_a_part(
    state: CrowdState, routes: Routes, walls: Walls, agent: F64, pace: Pace, radius: float
) -> None:
    """A tick of a part of a decision's move, which is made first where it is time for one."""
    real, plan = state.real, state.plan
    if plan.shape[:2] != real.shape[:2]:
        raise SimError(
            f"a tick cuts moves into {pace.cuts}, and the state has no room for them",
            remedy="make it with empty_crowd(..., pace=pace)",
        )
    if not plan.size:
        return
    rows = np.flatnonzero(plan[:, 0, PART] == 0.0)
    if len(rows):
        part = CrowdState(real[rows], state.whole[rows], state.route[rows], state.walls[rows])
        before = part.real[:, :, MOVED_BY]
        _decide(part, routes, walls, agent[rows], pace._replace(cuts=1), radius)
        plan[rows, :, PART + 1 :] = part.real[:, :, MOVED_BY]
        part.real[:, :, MOVED_BY] = before
        real[rows], state.whole[rows] = part.real, part.whole
    do_parts(
        *(real, state.whole, state.route, state.walls, routes, walls, float(pace.cuts), plan),
        *(agent, radius),
    )
