"""Kernels that move many agents at once, through maps of several scenes in one buffer.

The arithmetic is that of `Simulator` and of the geodesic field, operation by operation, so a pose,
a collision or a distance is the same float either way. Sines and cosines come from tables made
with Python's own `math`: a vector library could differ in the last bit.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from gn0.geometry import F64
from gn0.jit import njit, njit_borrowing, prange
from gn0.maps.ray import cast_rays_cells, trace_points
from gn0.maps.slide import slide_points

BLOCK = 512  # agents a task of the parallel loop
PARALLEL_FROM = 4 * BLOCK  # fewer agents are stepped faster than threads wake up
YAW, COS, SIN = range(3)


class MapArrays(NamedTuple):
    """Inflated maps of S scenes, end to end.

    Attributes:
        blocked: bool [cells], row by row.
        compact: int32 [cells], a free cell's number among the free cells of its scene.
        offsets: int64 [S], where a scene begins.
        shapes: int64 [S, 2], rows and columns.
        frames: float64 [S, 3], origin x, y and resolution [m].
    """

    blocked: NDArray[np.bool_]
    compact: NDArray[np.int32]
    offsets: NDArray[np.int64]
    shapes: NDArray[np.int64]
    frames: F64


class FieldArrays(NamedTuple):
    """Geodesic fields, end to end.

    Attributes:
        labels: [free cells] root of each free cell, relative to the field's first root.
        roots: float64 [R, 3] bends as (x, y, distance to the goal) in cells.
    """

    labels: NDArray[np.unsignedinteger]
    roots: F64


class EpisodeArrays(NamedTuple):
    """What an agent needs of E episodes.

    Attributes:
        scene: int32 [E].
        start: float64 [E, 2] m.
        goal: float64 [E, 2] m.
        label_at, root_at: int64 [E], where its field begins; −1 while it has none.
        headings: float64 [E, circle, 3]: yaw [rad], cosine and sine after k turns.
        stays: bool [E], STOP stands still for one action, as where somebody is followed.
    """

    scene: NDArray[np.int32]
    start: F64
    goal: F64
    label_at: NDArray[np.int64]
    root_at: NDArray[np.int64]
    headings: F64
    stays: NDArray[np.bool_]


class AgentArrays(NamedTuple):
    """The state of N agents.

    Attributes:
        episode: int32 [N], −1 before the first reset.
        position: float64 [N, 2] m.
        turns: int32 [N], whole turns since the start, modulo the circle.
        steps: int32 [N], actions taken.
        collided: bool [N], the last action was truncated.
        distance: float64 [N] m, geodesic distance to the goal.
    """

    episode: NDArray[np.int32]
    position: F64
    turns: NDArray[np.int32]
    steps: NDArray[np.int32]
    collided: NDArray[np.bool_]
    distance: F64


@njit_borrowing
def _distance(maps, fields, episodes, e, x, y):  # type: ignore[no-untyped-def]
    """Geodesic distance [m] of a free point, as `GeodesicField.distance` gives it."""
    scene = episodes.scene[e]
    resolution = maps.frames[scene, 2]
    u = (x - maps.frames[scene, 0]) / resolution
    v = (y - maps.frames[scene, 1]) / resolution
    cell = maps.offsets[scene] + int(v) * maps.shapes[scene, 1] + int(u)
    label = fields.labels[episodes.label_at[e] + maps.compact[cell]]
    root = episodes.root_at[e] + np.int64(label)
    dx, dy = u - fields.roots[root, 0], v - fields.roots[root, 1]
    away = fields.roots[root, 2] + math.sqrt(dx * dx + dy * dy)  # −inf in an area
    return max(away, 0.0) * resolution


@njit_borrowing
def finish_step(  # type: ignore[no-untyped-def]
    i, e, action, hit, agents, maps, fields, episodes, max_steps, progress, stopped, truncated
):  # fmt: skip
    """What an action of agent i in episode e led to, now that it stands where it ends."""
    agents.collided[i] = hit
    agents.steps[i] += 1
    before = after = agents.distance[i]
    if action == 1:
        after = _distance(maps, fields, episodes, e, agents.position[i, 0], agents.position[i, 1])
    agents.distance[i] = after
    progress[i] = before - after
    stops = action == 0 and not episodes.stays[e]
    stopped[i] = stops
    truncated[i] = not stops and agents.steps[i] >= max_steps


@njit_borrowing
def step_block(  # type: ignore[no-untyped-def]
    begin, end, actions, agents, maps, fields, episodes, forward, slides, max_steps, progress,
    stopped, truncated,
):  # fmt: skip
    """Actions of agents `begin` to `end`; see `step_agents`."""
    circle = episodes.headings.shape[1]
    for i in range(begin, end):
        e = agents.episode[i]
        scene = episodes.scene[e]
        action = actions[i]
        x, y = agents.position[i, 0], agents.position[i, 1]
        hit = False
        if action == 1:
            turn = agents.turns[i]
            x1 = x + forward * episodes.headings[e, turn, COS]
            y1 = y + forward * episodes.headings[e, turn, SIN]
            height, width = maps.shapes[scene, 0], maps.shapes[scene, 1]
            first = maps.offsets[scene]
            blocked = maps.blocked[first : first + height * width].reshape((height, width))
            frame = maps.frames[scene]
            if slides:
                x, y, hit = slide_points(blocked, frame[0], frame[1], frame[2], x, y, x1, y1)
            else:
                x, y, hit = trace_points(blocked, frame[0], frame[1], frame[2], x, y, x1, y1)
            agents.position[i, 0], agents.position[i, 1] = x, y
        elif action == 2:
            agents.turns[i] = (agents.turns[i] + 1) % circle
        elif action == 3:
            agents.turns[i] = (agents.turns[i] + circle - 1) % circle
        finish_step(
            i, e, action, hit, agents, maps, fields, episodes, max_steps, progress, stopped,
            truncated,
        )  # fmt: skip


@njit
def step_agents_serial(  # type: ignore[no-untyped-def]
    actions,
    agents,
    maps,
    fields,
    episodes,
    forward,
    slides,
    max_steps,
    progress,
    stopped,
    truncated,
):
    """`step_agents` on one thread."""
    step_block(
        0, len(actions), actions, agents, maps, fields, episodes, forward, slides, max_steps,
        progress, stopped, truncated,
    )  # fmt: skip


@njit(parallel=True)
def step_agents_parallel(  # type: ignore[no-untyped-def]
    actions,
    agents,
    maps,
    fields,
    episodes,
    forward,
    slides,
    max_steps,
    progress,
    stopped,
    truncated,
):
    """`step_agents` on all threads; agents do not meet, so the thread count cannot show."""
    count = len(actions)
    for block in prange((count + BLOCK - 1) // BLOCK):
        step_block(
            block * BLOCK, min(count, (block + 1) * BLOCK), actions, agents, maps, fields, episodes,
            forward, slides, max_steps, progress, stopped, truncated,
        )  # fmt: skip


def step_agents(
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
) -> None:
    """Take one action (0..3) each; fills progress [N] m, stopped [N] and truncated [N]."""
    kernel = step_agents_parallel if len(actions) >= PARALLEL_FROM else step_agents_serial
    kernel(
        actions,
        agents,
        maps,
        fields,
        episodes,
        forward,
        slides,
        max_steps,
        progress,
        stopped,
        truncated,
    )


@njit
def place_agents(which, chosen, agents, maps, fields, episodes):  # type: ignore[no-untyped-def]
    """Put agents `which` [K] at the starts of episodes `chosen` [K]."""
    for k in range(len(which)):
        i, e = which[k], chosen[k]
        x, y = episodes.start[e, 0], episodes.start[e, 1]
        agents.episode[i] = e
        agents.position[i, 0], agents.position[i, 1] = x, y
        agents.turns[i] = 0
        agents.steps[i] = 0
        agents.collided[i] = False
        agents.distance[i] = _distance(maps, fields, episodes, e, x, y)


@njit
def read_poses(which, agents, episodes, out):  # type: ignore[no-untyped-def]
    """Poses (x, y, yaw) of agents `which` [K] into `out` [K, 3]."""
    for k in range(len(which)):
        i = which[k]
        out[k, 0], out[k, 1] = agents.position[i, 0], agents.position[i, 1]
        out[k, 2] = episodes.headings[agents.episode[i], agents.turns[i], YAW]


@njit
def read_goal_vectors(which, agents, episodes, limit, out):  # type: ignore[no-untyped-def]
    """Goals in the agents' frames, (forward, left) m, clipped to ±limit, into `out` [K, 2]."""
    for k in range(len(which)):
        i = which[k]
        e = agents.episode[i]
        dx = episodes.goal[e, 0] - agents.position[i, 0]
        dy = episodes.goal[e, 1] - agents.position[i, 1]
        c, s = (
            episodes.headings[e, agents.turns[i], COS],
            episodes.headings[e, agents.turns[i], SIN],
        )
        out[k, 0] = min(max(np.float32(c * dx + s * dy), -limit), limit)
        out[k, 1] = min(max(np.float32(-s * dx + c * dy), -limit), limit)


@njit(parallel=True)
def read_ranges(which, agents, maps, episodes, rays, limit, out):  # type: ignore[no-untyped-def]
    """Range rings [K, R] m of agents `which` [K]; `rays` [R] rad are relative to the yaw."""
    for k in prange(len(which)):
        i = which[k]
        e = agents.episode[i]
        scene = episodes.scene[e]
        height, width = maps.shapes[scene, 0], maps.shapes[scene, 1]
        first = maps.offsets[scene]
        blocked = maps.blocked[first : first + height * width].reshape((height, width))
        x0, y0, s = maps.frames[scene, 0], maps.frames[scene, 1], maps.frames[scene, 2]
        u, v = (agents.position[i, 0] - x0) / s, (agents.position[i, 1] - y0) / s
        angles = episodes.headings[e, agents.turns[i], YAW] + rays
        distances = np.empty(len(rays))
        cast_rays_cells(blocked, u, v, angles, limit / s, distances)
        for r in range(len(rays)):
            out[k, r] = np.float32(distances[r] * s)
