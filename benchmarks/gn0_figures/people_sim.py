"""Figures of people in the simulators: steps a second, what holds at every tick, ticks, workers."""

from __future__ import annotations

import hashlib
import time
from collections.abc import Sequence
from dataclasses import dataclass

import msgspec
import numba
import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from gn0.geometry import F64
from gn0.maps.grid import OccupancyGrid
from gn0.maps.inflate import inflate
from gn0.maps.navigation import NavigationMap
from gn0.missions.episode import AgentSpec, Episode
from gn0.people.crowd import build_walls, empty_crowd, find_pace, place_people, step_crowd
from gn0.people.plan import PeopleSettings, plan_people
from gn0.people.reach import CLIP, HOLD_LEFT, MODE, WAY, X, Y
from gn0.people.route import build_routes
from gn0.scenes.scene import Scene
from gn0.seeds import random_stream
from gn0.sim.vector import VectorEnv
from gn0.testing.scenes import build_floor_plan, build_map_scene, build_point_episodes
from gn0_figures.board import Figure, FigureContext, FigureRow, row_at_least, row_at_most

ENVS = 4096
SCENES, PER_SCENE, SIDE = 8, 125, 12.0  # 1,000 episodes; side of a floor plan [m]
PEOPLE = 5
FOLLOWER = AgentSpec(radius=0.25, step_seconds=0.2)  # 0.25 m and 15° in 0.2 s
TICKER = AgentSpec(radius=0.25, step_seconds=0.1, forward_step=0.125, turn_degrees=7.5)
WALL, BODIES = 0.30, 0.50  # m from walls, and between two centres
SECONDS = 60.0  # of each episode that is looked at tick by tick
STILL = 0.005  # m a tick
NO_WAY, WON = 20.0, 0.25  # s in which who is on its way should win so much of it [m]
ROUNDS = 5
FINE = 4  # parts of a cell's side that free room is looked at in
ROOM = 0.25  # m² that a centre can come to: who has less is shut in


def plan_episodes(
    count: int, per_scene: int, ctx: FigureContext | None = None, most: int = PEOPLE
) -> tuple[list[Scene], list[Episode]]:
    """Floor plans, and episodes in them with so many people each where there is room."""
    scenes = [
        build_map_scene(build_floor_plan(k, width=SIDE, depth=SIDE), f"plan-{k}")
        for k in range(count)
    ]
    episodes = []
    for number, scene in enumerate(scenes):
        if ctx is not None:
            ctx.progress("people.sim", number, count)
        ground = NavigationMap(scene.grid, FOLLOWER.radius)
        for k, bare in enumerate(build_point_episodes(scene, ground, per_scene, agent=FOLLOWER)):
            people = plan_people(scene, bare, PeopleSettings(count=most, seed=k))
            episodes.append(
                msgspec.structs.replace(bare, id=f"{scene.id}-{bare.id}", people=people)
            )
    return scenes, episodes


def _rates(
    scenes: Sequence[Scene], episodes: Sequence[Episode], people: int
) -> tuple[float, float]:
    """Agent-steps a second through `step()`, and those of a second of processor time."""
    some = [msgspec.structs.replace(e, people=e.people[:people]) for e in episodes]
    env = VectorEnv(ENVS, scenes, episodes=some, sensors=("goal_vector",), agent=FOLLOWER)
    env.reset(seed=0)
    actions = random_stream(0, "figure actions").choice(
        4, (200 if not people else 60, ENVS), p=[0.01, 0.59, 0.2, 0.2]
    )
    for row in actions[: len(actions) // 2]:
        env.step(row)
    wall, work = [], []
    for _ in range(ROUNDS):
        start, used = time.perf_counter(), time.process_time()
        for row in actions:
            env.step(row)
        wall.append(actions.size / (time.perf_counter() - start))
        work.append(actions.size / (time.process_time() - used))
    return float(np.median(wall)), float(np.median(work))


@dataclass(frozen=True)
class Found:
    """What was seen of people tick by tick.

    Attributes:
        ticks: looked at, people times ticks.
        in_walls: of them, with a centre where a wall is nearer than 0.30 m.
        least_gap: the smallest distance of two centres less the sum of radii [m].
        longest: the longest time that somebody on its way stood still, without a stop [s].
        stuck: people who stood for more than 10 s so.
        no_way: people who won no way for `NO_WAY` s, standing or shuffling, without a stop.
        shut_in: of them, whom agent and walls left no room to go when these were over.
        hits: moves of agents that were cut by somebody.
        digest: of all places.
    """

    ticks: int
    in_walls: int
    least_gap: float
    longest: float
    stuck: int
    no_way: int
    shut_in: int
    hits: int
    digest: str


class WayWatch:
    """Who wins no way: its place along its path stays within `WON` for `NO_WAY` seconds on end.

    Stepping from foot to foot, aside, or back and forth wins nothing. Stops of the script, and who
    has arrived, do not count.

    Args:
        shape: episodes, people.
        ticks: in `NO_WAY` seconds.
    """

    def __init__(self, shape: tuple[int, ...], ticks: int) -> None:
        self._ways = np.full((ticks, *shape), np.nan)  # a ring; NaN: not on its way then
        self._tick = 0
        self.found = np.zeros(shape, np.bool_)  # who ever won none

    def see(self, way: F64, on_way: NDArray[np.bool_]) -> None:
        """Take a tick: ways along paths [E, P] m, and who is on its way."""
        self._ways[self._tick % len(self._ways)] = np.where(on_way, way, np.nan)
        self._tick += 1
        with np.errstate(invalid="ignore"):
            self.found |= self._ways.max(axis=0) - self._ways.min(axis=0) < WON


def room_to_go(mask: OccupancyGrid, place: F64, discs: F64) -> float:
    """Area [m²] that a centre at `place` (2) m can come to, off walls and discs [N, 2] m."""
    size = mask.resolution / FINE
    near = np.kron(mask.blocked, np.ones((FINE, FINE), np.bool_))
    rows, cols = np.indices(near.shape)
    x, y = mask.origin[0] + (cols + 0.5) * size, mask.origin[1] + (rows + 0.5) * size
    for u, v in discs:
        near |= (x - u) ** 2 + (y - v) ** 2 < BODIES**2
    regions, _ = ndimage.label(~near)
    # a body that touches another may be up to a part of a cell in its disc
    own = (x - place[0]) ** 2 + (y - place[1]) ** 2 < (3.0 * size) ** 2
    found = [(regions == k).sum() for k in np.unique(regions[own]) if k]
    return float(max(found, default=0)) * size * size


def watch(
    scenes: Sequence[Scene], episodes: Sequence[Episode], seconds: float, numbers: Sequence[int]
) -> Found:
    """Play `episodes[k]` for each k of `numbers`, an agent walking at random in each, and look."""
    rounds = round(seconds / TICKER.step_seconds)
    env = VectorEnv(
        len(numbers), scenes, episodes=episodes, sensors=(), agent=TICKER, max_steps=rounds + 2
    )
    env.reset(seed=0, options={"episode": [episodes[k].id for k in numbers]})
    masks = {s.id: inflate(s.grid, WALL) for s in scenes}
    walks = np.array(
        [[p.behaviour == "script" for p in episodes[k].people] + [False] * PEOPLE for k in numbers],
        dtype=object,
    )
    walks = np.array([row[:PEOPLE] for row in walks], np.bool_)
    actions = np.stack(
        [random_stream(k, "figure walk").choice(4, rounds, p=[0, 0.7, 0.15, 0.15]) for k in numbers]
    )
    crowd, digest = env.batch.company.crowd, [hashlib.blake2b(digest_size=8) for _ in numbers]
    here = crowd.route >= 0
    still = np.zeros(here.shape, np.int64)
    longest, in_walls, least, hits = still.copy(), 0, np.inf, 0
    ways = WayWatch(here.shape, round(NO_WAY / TICKER.step_seconds))
    shut_in = np.zeros(here.shape, np.bool_)
    limit = round(10.0 / TICKER.step_seconds)
    pairs = np.triu_indices(here.shape[1] + 1, 1)
    for tick in range(rounds):
        *_, infos = env.step(actions[:, tick])
        crowd = env.batch.company.crowd
        hits += int((infos["hit_person"] > 0).sum())
        places = crowd.real[:, :, X : Y + 1]
        for i, k in enumerate(numbers):
            digest[i].update(places[i].tobytes())
            mask = masks[episodes[k].scene_id]
            cells = np.floor((places[i, walks[i]] - mask.origin) / mask.resolution).astype(int)
            in_walls += int(mask.blocked[cells[:, 1], cells[:, 0]].sum())
        everyone = np.concatenate([places, infos["pose"][:, None, :2]], axis=1)
        there = np.concatenate([here, np.ones((len(here), 1), np.bool_)], axis=1)
        apart = np.linalg.norm(everyone[:, pairs[0]] - everyone[:, pairs[1]], axis=2)
        least = min(least, float(apart[there[:, pairs[0]] & there[:, pairs[1]]].min()))
        on_way = walks & (crowd.real[:, :, HOLD_LEFT] <= 0.0) & (crowd.whole[:, :, MODE] != 2)
        ways.see(crowd.real[:, :, WAY], on_way)
        waits = on_way & (crowd.whole[:, :, CLIP] == 0)
        still = np.where(waits, still + 1, 0)
        longest = np.maximum(longest, still)
        for i, p in np.argwhere((still == limit + 1) & (longest == still)):
            stand = here[i] & ~walks[i]
            discs = np.concatenate([places[i, stand], infos["pose"][i, None, :2]])
            mask = masks[episodes[numbers[i]].scene_id]
            shut_in[i, p] = room_to_go(mask, places[i, p], discs) < ROOM
    whole = hashlib.blake2b(digest_size=8)
    for _, one in sorted(zip(numbers, digest, strict=True), key=lambda pair: pair[0]):
        whole.update(one.digest())
    return Found(
        ticks=int(here.sum()) * rounds,
        in_walls=in_walls,
        least_gap=least - BODIES,
        longest=float(longest.max()) * TICKER.step_seconds,
        stuck=int((longest > limit).sum()),
        no_way=int(ways.found.sum()),
        shut_in=int(shut_in.sum()),
        hits=hits,
        digest=whole.hexdigest(),
    )


def compare_ticks(
    scenes: Sequence[Scene],
    episodes: Sequence[Episode],
    *,
    alone: bool,
    decide_each: bool,
    seconds: float = 10.0,
) -> F64:
    """How far each scripted person's places differ at most between ticks of 1/10 and 1/30 s [m].

    Deciding each tick, or at the same tenths of a second.
    """
    walls = build_walls([scene.grid for scene in scenes])
    number = {scene.id: k for k, scene in enumerate(scenes)}
    groups = [
        (number[e.scene_id], group)
        for e in episodes
        for group in ([(p,) for p in e.people] if alone else [e.people])
    ]
    tracks = []
    for rate in (10, 30):
        people = [person for _, group in groups for person in group]
        pace = find_pace(rate, decide_each=decide_each)
        routes, state = build_routes(people, pace.rate), empty_crowd(len(groups), PEOPLE, pace=pace)
        first = 0
        for row, (scene, group) in enumerate(groups):
            place_people(state, row, routes, range(first, first + len(group)))
            state.walls[row] = scene
            first += len(group)
        nobody = np.full((len(groups), 3), -1.0)
        rows = []
        for tick in range(round(seconds * rate)):
            step_crowd(state, routes, walls, nobody, pace=pace)
            if (tick + 1) % (rate // 10) == 0:
                rows.append(state.real[:, :, X : Y + 1].copy())
        tracks.append(np.stack(rows))
    scripted = np.zeros(tracks[0].shape[1:3], np.bool_)
    for row, (_, group) in enumerate(groups):
        scripted[row, : len(group)] = [p.behaviour == "script" for p in group]
    worst = np.linalg.norm(tracks[0] - tracks[1], axis=3).max(axis=0)
    return np.asarray(worst[scripted])


def measure_people(ctx: FigureContext) -> list[FigureRow]:
    """Speed with 0, 1 and 5 people, a thousand episodes tick by tick, ticks, workers."""
    scenes, episodes = plan_episodes(SCENES, PER_SCENE, ctx)
    rows = []
    here = f"{SCENES} floor plans of {SIDE:g} m, {len(episodes):,} episodes"
    for people in (0, 1, PEOPLE):
        wall, work = _rates(scenes, episodes, people)
        name = f"agent-steps a second, {people} people an environment"
        detail = (
            f"{here}, {ENVS} environments, body 0.25 m, 15°, 0.2 s, goal_vector, autoresets "
            f"included, two threads; {work:.0f} in a second of processor time"
        )
        if people == PEOPLE:
            rows.append(row_at_least(name, wall, 3e5, "1/s", detail))
        else:
            rows.append(FigureRow(name=name, value=wall, unit="1/s", detail=detail))
    numbers = list(range(len(episodes)))
    found = watch(scenes, episodes, SECONDS, numbers)
    detail = (
        f"{here}, {found.ticks:,} ticks of people in {SECONDS:g} s each; agents walk at random at "
        f"the follower's speeds, {found.hits:,} of their ticks were cut by somebody"
    )
    rows += [
        row_at_most("centres nearer to a wall than 0.30 m", found.in_walls, 0, "ticks", detail),
        row_at_least("least gap of two bodies", found.least_gap * 1e3, 0, "mm", detail),
        row_at_most("people stuck for more than 10 s", found.stuck, 0, "people", detail),
        row_at_most(
            "of them, who had room to go", found.stuck - found.shut_in, 0, "people",
            f"{found.shut_in} were left less than {ROOM:g} m² for their centre by the agent, which "
            "walks at random, and walls",
        ),
        FigureRow(
            name=f"people who won no way in {NO_WAY:g} s", value=found.no_way, unit="people",
            detail=f"{detail}; {WON:g} m along the path; stops of the script left out",
        ),
        FigureRow(
            name="longest that somebody stood still on its way", value=found.longest, unit="s",
            detail=f"{detail}; stops of the script left out",
        ),
    ]  # fmt: skip
    rows += _tick_rows(scenes, episodes)
    rows.append(_worker_row(scenes, episodes))
    return rows


def _tick_rows(scenes: Sequence[Scene], episodes: Sequence[Episode]) -> list[FigureRow]:
    """Ticks of 0.1 s against 0.033 s: by the engine's clock, and with a decision each tick."""
    apart = compare_ticks(scenes, episodes, alone=False, decide_each=False)
    rows = [
        row_at_most(
            "ticks of 0.1 s against 0.033 s, five together, worst", float(apart.max()) * 100, 5,
            "cm",
            f"{len(apart):,} scripted people, first 10 s, at the moments that both have; people "
            "decide each 0.1 s at either, so this shows that ticks cut moves and change none, not "
            "that 0.1 s is short enough to decide in",
        )
    ]  # fmt: skip
    apart = compare_ticks(scenes, episodes, alone=True, decide_each=True)
    rows.append(
        row_at_most(
            "the same with a decision each tick, each by itself, worst", float(apart.max()) * 100,
            5, "cm", f"{len(apart):,} scripted people among walls",
        )
    )  # fmt: skip
    apart = compare_ticks(scenes, episodes, alone=False, decide_each=True)
    rows.append(
        FigureRow(
            name="the same, five together: who differs by less than 5 cm",
            value=float((apart < 0.05).mean()) * 100, unit="%",
            detail=f"{len(apart):,} scripted people who meet, wait and go round, and decide three "
            f"times as often; median {float(np.median(apart)) * 100:.2g} cm, worst "
            f"{float(apart.max()):.2f} m",
        )
    )  # fmt: skip
    return rows


def _worker_row(scenes: Sequence[Scene], episodes: Sequence[Episode]) -> FigureRow:
    """Results that differ by threads, order and shares."""
    numbers = list(range(0, len(episodes), 4))
    threads = numba.get_num_threads()
    results = []
    for count, order in ((1, numbers), (2, numbers[::-1]), (4, numbers)):
        numba.set_num_threads(min(count, threads))
        results.append(watch(scenes, episodes, 10.0, order).digest)
    numba.set_num_threads(threads)
    return row_at_most(
        "results that differ by threads and order", len(set(results)) - 1, 0, "",
        f"{len(numbers)} episodes of 10 s on 1, 2 and 4 threads (at most {threads} here), "
        "in two orders",
    )  # fmt: skip


FIGURES = [Figure("people.sim", "People in the simulators", measure_people, 6.0)]
