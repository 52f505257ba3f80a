"""Figures of explored maps: what they cost, how far they can be trusted, what they are worth."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy import ndimage

from gn0.geometry import F32, F64, U8, Pose2D
from gn0.maps.grid import FREE, OCCUPIED, UNKNOWN, OccupancyGrid
from gn0.maps.navigation import NavigationMap
from gn0.missions.episode import Episode
from gn0.missions.goal import sample_goal_episodes
from gn0.paper import BEV_CUT
from gn0.plugins import get_plugin
from gn0.scenes.procedural.generate import GenerateSettings, build_generated
from gn0.scenes.scene import Scene
from gn0.scenes.scene_sources import import_scene
from gn0.sim.mapping import Mapper
from gn0.sim.open import open_simulator
from gn0.sim.rollout import run_episode
from gn0_figures.board import Figure, FigureContext, FigureRow, row_at_most

PRESET = "gn_bench"
EPISODES = 6
LIMIT_MS = 3.0
ROUNDS = 5
WORTH_EPISODES = 20


@dataclass(frozen=True)
class Walk:
    """An oracle's walk with all that a camera saw on the way."""

    episode: Episode
    views: list[tuple[Pose2D, F32, U8]]
    render_ms: float


def build_flat(ctx: FigureContext) -> Scene:
    """The generator's default apartment of seed 7."""
    return build_generated(GenerateSettings(seed=7), "apartment-7", ctx.progress)


def build_house(ctx: FigureContext) -> Scene:
    """small_house as `gn0 scene import` makes it."""
    source = ctx.need_data("worlds/small_house")
    return import_scene(source, ctx.work / "mapping-house", overwrite=True, progress=ctx.progress)


def walk(scene: Scene, episodes: Sequence[Episode]) -> list[Walk]:
    """Let the oracle walk, and keep every picture it could have taken; ms a picture by the way."""
    simulator = open_simulator(scene, PRESET, sensors={"rgb", "depth"})
    blind = open_simulator(scene, PRESET)
    oracle = get_plugin("policy", "oracle")()
    walks = []
    for episode in episodes:
        poses = run_episode(blind, oracle, episode).poses
        simulator.reset(episode)
        views: list[tuple[Pose2D, F32, U8]] = []
        start = time.perf_counter()
        for pose in poses:
            seen = simulator.observe_at(pose)
            assert seen.depth is not None and seen.rgb is not None
            views.append((pose, seen.depth, seen.rgb))
        walks.append(Walk(episode, views, 1e3 * (time.perf_counter() - start) / len(poses)))
    return walks


def make_mapper(scene: Scene) -> Mapper:
    """A mapper of BEV and occupancy for the figures' preset."""
    config = open_simulator(scene, PRESET).config
    return Mapper(scene.grid, config.preset, config.preset.agent, BEV_CUT, coloured=True)


def time_steps(mapper: Mapper, walks: Sequence[Walk]) -> F64:
    """Milliseconds of each step of all walks: update and both pictures; least of some rounds."""
    rounds = []
    for _ in range(ROUNDS):
        spent = []
        for one in walks:
            mapper.reset()
            for pose, depth, rgb in one.views:
                start = time.perf_counter()
                mapper.update(pose, depth, rgb)
                _ = mapper.occupancy, mapper.bev
                spent.append(time.perf_counter() - start)
        rounds.append(spent)
    return 1e3 * np.array(rounds).min(axis=0)


def judge(grid: OccupancyGrid, true: OccupancyGrid) -> dict[str, float]:
    """How an explored grid compares with the scene's own, shares in %.

    A mark agrees when a cell of its kind lies within one cell of it. Walls are hollow, and the
    outside unknown, on the true grid: a free mark there is a look through a wall.
    """
    free, occupied = grid.cells == FREE, grid.cells == OCCUPIED
    truly_free, solid = true.cells == FREE, true.cells != FREE
    touch = np.ones((3, 3), bool)
    near_free = ndimage.binary_dilation(truly_free, touch)
    near_solid = ndimage.binary_dilation(solid, touch)
    through = free & ~near_free & (true.cells == UNKNOWN)
    return {
        "free": 100 * float(near_free[free].mean()),
        "occupied": 100 * float(near_solid[occupied].mean()),
        "wall": 100 * float(through.sum() / max(free.sum(), 1)),
        "seen": 100 * float((grid.cells[_reachable(true)] == FREE).mean()),
        "free_exact": 100 * float(truly_free[free].mean()),
        "occupied_exact": 100 * float(solid[occupied].mean()),
    }


def _reachable(true: OccupancyGrid) -> np.ndarray:
    """Free cells of rooms that an agent can be in: those its body sweeps from the main region."""
    main = NavigationMap(true, 0.20).regions == 0
    reach = ndimage.distance_transform_edt(~main) * true.resolution <= 0.25
    return reach & (true.cells == FREE)


def _episodes(scene: Scene) -> list[Episode]:
    navigation = NavigationMap(scene.grid, 0.20)
    return sample_goal_episodes(scene, navigation, EPISODES, 0, minimum_length=5.0)


def _rows(scene: Scene, name: str) -> list[FigureRow]:
    walks = walk(scene, _episodes(scene))
    mapper = make_mapper(scene)
    time_steps(mapper, walks[:1])  # compile
    spent = time_steps(mapper, walks)
    steps = sum(len(one.views) for one in walks)
    height, width = scene.grid.shape
    where = (
        f"{name}, {len(scene.gaussians)} Gaussians, map {width}x{height}, preset {PRESET} "
        f"(480x360), {steps} steps of {len(walks)} oracle walks"
    )
    render = float(np.median([one.render_ms for one in walks]))
    mean = float(spent.mean())
    rows = [
        row_at_most(
            f"mapping a step, {name}", mean, LIMIT_MS, "ms",
            f"update and both pictures, one core, least of {ROUNDS} rounds; median "
            f"{np.median(spent):.2f}, 95th percentile {np.quantile(spent, 0.95):.2f}, worst "
            f"{spent.max():.2f}; {where}",
        ),
        FigureRow(
            name=f"depth and colour a step, {name}", value=render, unit="ms",
            detail=f"rendering alone, all cores; {where}",
        ),
        FigureRow(
            name=f"a whole step with its explored map, {name}", value=render + mean, unit="ms",
            detail=f"rendering and mapping; {where}",
        ),
    ]  # fmt: skip
    found = []
    for one in walks:
        mapper.reset()
        for pose, depth, rgb in one.views:
            mapper.update(pose, depth, rgb)
        assert (mapper.grid.cells != UNKNOWN).any()
        found.append(judge(mapper.grid, scene.grid))
    mean_of = {key: float(np.mean([f[key] for f in found])) for key in found[0]}
    for key, title, more in (
        ("free", "cells marked free that are, within a cell", "free_exact"),
        ("occupied", "cells marked occupied that are, within a cell", "occupied_exact"),
        ("wall", "cells marked free in walls and beyond, deeper than a cell", ""),
        ("seen", "free floor an agent can reach that was seen", ""),
    ):
        exact = f"to the cell {mean_of[more]:.1f} %; " if more else ""
        worst = min if key in ("free", "occupied") else max
        rows.append(
            FigureRow(
                name=f"{title}, {name}",
                value=mean_of[key],
                unit="%",
                detail=f"after each walk, mean of {len(walks)}; {exact}"
                + (f"worst walk {worst(f[key] for f in found):.2f} %; " if key != "seen" else "")
                + where,
            )
        )
    return rows


def measure_flat(ctx: FigureContext) -> list[FigureRow]:
    """Cost and accuracy on a generated apartment."""
    return _rows(build_flat(ctx), "apartment")


def measure_house(ctx: FigureContext) -> list[FigureRow]:
    """Cost and accuracy on small_house."""
    return _rows(build_house(ctx), "small_house")


def measure_worth(ctx: FigureContext) -> list[FigureRow]:
    """The explorer on one set of episodes with a prior map, its own map, and none of either."""
    scene = build_flat(ctx)
    navigation = NavigationMap(scene.grid, 0.20)
    episodes = sample_goal_episodes(scene, navigation, WORTH_EPISODES, 0, minimum_length=4.0)
    rows = []
    for policy_name, mode in (
        ("explorer", "prior"),
        ("explorer", "explored"),
        ("straight", "none"),
    ):
        policy = get_plugin("policy", policy_name)()
        simulator = open_simulator(scene, PRESET, sensors=policy.sensors, map_mode=mode)
        quality, success, steps = [], [], []
        for done, episode in enumerate(episodes):
            ctx.progress(f"{policy_name}, {mode}", done, len(episodes))
            trajectory = run_episode(simulator, policy, episode)
            points = np.array(trajectory.poses)[:, :2]
            field = navigation.geodesic(episode.destination)
            shortest = field.distance_at(*episode.start[:2])
            walked = float(np.hypot(*np.diff(points, axis=0).T).sum())
            arrived = trajectory.stopped and field.distance_at(*points[-1]) < 3.0
            success.append(arrived)
            quality.append(arrived * shortest / max(shortest, walked))
            steps.append(len(trajectory.actions))
        detail = (
            f"apartment, {len(episodes)} goal episodes ≥ 4 m, preset {PRESET}; success rate "
            f"{100 * np.mean(success):.0f} %, {np.mean(steps):.0f} actions an episode"
        )
        rows.append(
            FigureRow(
                name=f"SPL of {policy_name}, map mode {mode}",
                value=float(np.mean(quality)),
                unit="",
                detail=detail,
            )
        )
    return rows


FIGURES = [
    Figure("mapping.flat", "Explored maps of an apartment", measure_flat, 3.0),
    Figure("mapping.house", "Explored maps of small_house", measure_house, 4.0),
    Figure("mapping.worth", "What knowing the map is worth", measure_worth, 6.0),
]
