"""Agents among people, many at once: each action in its ticks, as `gn0.sim.people.Company` has it.

The order within a tick is the same: people go first, with an eye on where the agent was a tick ago,
then the agent wants its place of that tick (`gn0.sim.ticks`). An environment without people takes
the step of `gn0.sim.batch_kernels` itself.
"""
# mypy: disable-error-code="no-untyped-def"

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from gn0.geometry import F64
from gn0.jit import njit, njit_borrowing, prange
from gn0.maps.ray import trace_points
from gn0.maps.slide import slide_points
from gn0.people.crowd import CrowdState, Walls, place_rows
from gn0.people.reach import HX, HY, X0, Y0, Pace, X, Y
from gn0.people.route import I64, Routes
from gn0.people.tick import tick_people
from gn0.sim.batch_kernels import (
    COS,
    SIN,
    YAW,
    AgentArrays,
    EpisodeArrays,
    FieldArrays,
    MapArrays,
    finish_step,
    step_block,
)
from gn0.sim.people import shorten_rays

BLOCK = 32  # environments a task of the parallel loop
PARALLEL_FROM = 4 * BLOCK  # fewer are stepped faster than threads wake up
ROW, CAME, TICK = range(3)  # columns of a hit: person's row from 1, 0 none; who came; tick from 1
BY_AGENT, BY_PERSON = 0, 1


class CrowdArrays(NamedTuple):
    """The people of N environments, as kernels move them; see `CrowdState` for the first four.

    Attributes:
        agent: float64 [N, 3], place [m] and radius [m] of each agent, as people saw it last.
        hit: int64 [N, 3], for whom the last move was cut: `ROW`, `CAME`, `TICK`.
    """

    real: F64
    whole: I64
    route: I64
    walls: I64
    agent: F64
    hit: I64

    @property
    def state(self) -> CrowdState:
        """What they do, without the agents."""
        return CrowdState(self.real, self.whole, self.route, self.walls)


class Bodies(NamedTuple):
    """Radii [m] of the agent and of a person."""

    agent: float
    person: float


@njit_borrowing
def _touched(crowd, reach, i, x, y):
    """The row of the nearest person whom the agent would touch at (x, y); −1 for nobody."""
    best, person = reach * reach, -1
    for p in range(crowd.route.shape[1]):
        if crowd.route[i, p] < 0:
            break
        dx, dy = crowd.real[i, p, X] - x, crowd.real[i, p, Y] - y
        square = dx * dx + dy * dy
        if square < best:
            best, person = square, p
    return person


@njit_borrowing
def _go(blocked, frame, slides, x0, y0, x1, y1):
    if slides:
        return slide_points(blocked, frame[0], frame[1], frame[2], x0, y0, x1, y1)
    return trace_points(blocked, frame[0], frame[1], frame[2], x0, y0, x1, y1)


@njit_borrowing
def _move(
    i, e, agents, maps, episodes, forward, slides, crowd, routes, walls, pace, bodies, shares
):  # fmt: skip
    """Move agent i ahead through the ticks of an action: where it ends, and whether it was cut."""
    scene, turn = episodes.scene[e], agents.turns[i]
    x, y = agents.position[i, 0], agents.position[i, 1]
    x1 = x + forward * episodes.headings[e, turn, COS]
    y1 = y + forward * episodes.headings[e, turn, SIN]
    height, width = maps.shapes[scene, 0], maps.shapes[scene, 1]
    first = maps.offsets[scene]
    blocked = maps.blocked[first : first + height * width].reshape((height, width))
    frame = maps.frames[scene]
    dx, dy = x1 - x, y1 - y
    reach = bodies.person + bodies.agent
    ex, ey, hit = _go(blocked, frame, slides, x, y, x1, y1)
    stopped = False
    for tick in range(shares.shape[0]):
        tick_people(
            crowd.real, crowd.whole, crowd.route, crowd.walls, routes, walls, pace, crowd.agent,
            bodies.person, i,
        )  # fmt: skip
        if stopped:
            continue
        share = shares[tick]
        nx, ny = ex, ey
        if tick < shares.shape[0] - 1 and share != 1.0:
            nx, ny, _ = _go(blocked, frame, slides, x, y, x + dx * share, y + dy * share)
        person = _touched(crowd, reach, i, nx, ny)
        lx, ly = crowd.agent[i, 0], crowd.agent[i, 1]
        if person >= 0:
            px, py = crowd.real[i, person, X0], crowd.real[i, person, Y0]
            ax, ay = px - lx, py - ly
            mine = (nx - lx) * ax + (ny - ly) * ay
            theirs = -((crowd.real[i, person, X] - px) * ax + (crowd.real[i, person, Y] - py) * ay)
            crowd.hit[i, ROW] = person + 1
            crowd.hit[i, CAME] = BY_AGENT if mine >= theirs else BY_PERSON
            crowd.hit[i, TICK] = tick + 1
            stopped = hit = True
        else:
            crowd.agent[i, 0], crowd.agent[i, 1] = nx, ny
    return crowd.agent[i, 0], crowd.agent[i, 1], hit


@njit_borrowing
def _step_block_among(
    begin, end, actions, agents, maps, fields, episodes, forward, slides, max_steps, progress,
    stopped, truncated, crowd, routes, walls, pace, bodies, shares,
):  # fmt: skip
    circle = episodes.headings.shape[1]
    for i in range(begin, end):
        if crowd.route[i, 0] < 0:
            step_block(
                i, i + 1, actions, agents, maps, fields, episodes, forward, slides, max_steps,
                progress, stopped, truncated,
            )  # fmt: skip
            continue
        e, action = agents.episode[i], actions[i]
        crowd.hit[i, ROW] = 0
        hit = False
        if action == 1:
            x, y, hit = _move(
                i, e, agents, maps, episodes, forward, slides, crowd, routes, walls, pace, bodies,
                shares[i if shares.shape[0] > 1 else 0],
            )  # fmt: skip
            agents.position[i, 0], agents.position[i, 1] = x, y
        else:
            for _ in range(shares.shape[1]):
                tick_people(
                    crowd.real, crowd.whole, crowd.route, crowd.walls, routes, walls, pace,
                    crowd.agent, bodies.person, i,
                )  # fmt: skip
            if action == 2:
                agents.turns[i] = (agents.turns[i] + 1) % circle
            elif action == 3:
                agents.turns[i] = (agents.turns[i] + circle - 1) % circle
        finish_step(
            i, e, action, hit, agents, maps, fields, episodes, max_steps, progress, stopped,
            truncated,
        )  # fmt: skip


@njit
def step_among_serial(
    actions, agents, maps, fields, episodes, forward, slides, max_steps, progress, stopped,
    truncated, crowd, routes, walls, pace, bodies, shares,
):  # fmt: skip
    """`step_among` on one thread."""
    _step_block_among(
        0, len(actions), actions, agents, maps, fields, episodes, forward, slides, max_steps,
        progress, stopped, truncated, crowd, routes, walls, pace, bodies, shares,
    )  # fmt: skip


@njit(parallel=True)
def step_among_parallel(
    actions, agents, maps, fields, episodes, forward, slides, max_steps, progress, stopped,
    truncated, crowd, routes, walls, pace, bodies, shares,
):  # fmt: skip
    """`step_among` on all threads; environments do not meet, so the thread count cannot show."""
    count = len(actions)
    for block in prange((count + BLOCK - 1) // BLOCK):
        _step_block_among(
            block * BLOCK, min(count, (block + 1) * BLOCK), actions, agents, maps, fields, episodes,
            forward, slides, max_steps, progress, stopped, truncated, crowd, routes, walls, pace,
            bodies, shares,
        )  # fmt: skip


def step_among(
    actions: NDArray[np.int64],
    agents: AgentArrays,
    maps: MapArrays,
    fields: FieldArrays,
    episodes: EpisodeArrays,
    forward: float,
    slides: bool,
    max_steps: int,
    progress: F64,
    stopped: NDArray[np.bool_],
    truncated: NDArray[np.bool_],
    crowd: CrowdArrays,
    routes: Routes,
    walls: Walls,
    pace: Pace,
    bodies: Bodies,
    shares: F64,
) -> None:
    """Take one action (0..3) each, people with it; else as `gn0.sim.batch_kernels.step_agents`.

    `shares` [1 or N, ticks] says which part of a move is done after each tick, 1 all of it.
    """
    kernel = step_among_parallel if len(actions) >= PARALLEL_FROM else step_among_serial
    kernel(
        *(actions, agents, maps, fields, episodes, forward, slides, max_steps, progress, stopped),
        *(truncated, crowd, routes, walls, pace, bodies, shares),
    )


@njit
def begin_people(which, chosen, first, count, scene_walls, position, radius, crowd, routes):
    """People of episodes `chosen` [K] at their beginnings, around agents `which` [K].

    `first` and `count` [E] tell the routes of each episode, `scene_walls` [E] its walls.
    """
    for k in range(len(which)):
        i, e = which[k], chosen[k]
        numbers = np.arange(first[e], first[e] + count[e])
        place_rows(crowd.real, crowd.whole, crowd.route, routes, i, numbers)
        crowd.walls[i] = scene_walls[e]
        crowd.agent[i, 0], crowd.agent[i, 1] = position[i, 0], position[i, 1]
        crowd.agent[i, 2] = radius
        crowd.hit[i] = 0


@njit
def read_people(which, crowd, out):
    """Places [m] and unit vectors of headings, NaN where nobody is, into `out` [K, P, 4]."""
    for k in range(len(which)):
        i = which[k]
        for p in range(crowd.route.shape[1]):
            if crowd.route[i, p] < 0:
                out[k, p, :] = np.nan
                continue
            out[k, p, 0], out[k, p, 1] = crowd.real[i, p, X], crowd.real[i, p, Y]
            out[k, p, 2], out[k, p, 3] = crowd.real[i, p, HX], crowd.real[i, p, HY]


@njit(parallel=True)
def shorten_rings(which, agents, episodes, crowd, reach, rays, out):
    """`shorten_rays` of agents `which` [K]; `rays` [R] rad are relative to the yaw."""
    for k in prange(len(which)):
        i = which[k]
        if crowd.route[i, 0] < 0:
            continue
        angles = episodes.headings[agents.episode[i], agents.turns[i], YAW] + rays
        x, y = agents.position[i, 0], agents.position[i, 1]
        shorten_rays(crowd.real, crowd.route, i, reach, x, y, angles, out[k])
