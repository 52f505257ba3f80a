"""Figures of the simulator: speed, penetration, and how close the oracle comes to the geodesic."""

from __future__ import annotations

import time

import numpy as np

from gn0.geometry import polyline_length
from gn0.maps.navigation import NavigationMap
from gn0.maps.ros import load_ros_map
from gn0.policies.oracle import PolicyOracle
from gn0.scenes.scene import Scene
from gn0.seeds import random_stream
from gn0.sim.open import open_simulator
from gn0.sim.rollout import run_episode
from gn0.sim.simulator import Simulator
from gn0.testing.scenes import (
    build_floor_plan,
    build_map_scene,
    build_point_episodes,
    build_room_scene,
)
from gn0_figures.board import Figure, FigureContext, FigureRow, row_at_least, row_at_most

STEPS = 1_000_000
SHARES = [0.0, 0.6, 0.2, 0.2]  # STOP, FORWARD, LEFT, RIGHT of the random walker
PLANS = 20


def _house(ctx: FigureContext) -> Scene:
    """The SLAM map of small_house as a scene."""
    folder = ctx.need_data("worlds/small_house")
    found = sorted(folder.rglob("map.yaml"))
    if not found:
        raise FileNotFoundError("worlds/small_house/**/map.yaml")
    return build_map_scene(load_ros_map(found[0]), "small-house-map")


def _walker(scene: Scene, sensors: frozenset[str] = frozenset()) -> Simulator:
    """A simulator in mid-episode that will not end by itself."""
    simulator = open_simulator(scene, sensors=sensors, max_steps=10 * STEPS)
    simulator.reset(build_point_episodes(scene, simulator.navigation, 1)[0])
    return simulator


def measure_speed(ctx: FigureContext) -> list[FigureRow]:
    """Steps a second without pictures: one process, one thread, every step through `step()`."""
    rows = []
    actions = random_stream(0, "figure speed").choice(4, 50_000, p=SHARES).tolist()
    for sensors in (frozenset[str](), frozenset({"goal_vector"}), frozenset({"ranges"})):
        simulator = _walker(build_map_scene(build_floor_plan(0, width=20.0, depth=20.0)), sensors)
        rates = []
        for _ in range(5):
            start = time.perf_counter()
            for action in actions:
                simulator.step(action)
            rates.append(len(actions) / (time.perf_counter() - start))
        name = "steps a second, " + (", ".join(sorted(sensors)) if sensors else "no sensor")
        detail = f"400x400 floor plan, random actions, median of 5 runs of {len(actions)} steps"
        if sensors:
            rows.append(
                FigureRow(name=name, value=float(np.median(rates)), unit="1/s", detail=detail)
            )
        else:
            rows.append(row_at_least(name, float(np.median(rates)), 40_000, "1/s", detail))
    return rows


def count_penetrations(scene: Scene, steps: int, seed: int) -> tuple[int, int]:
    """Random steps that ended in a blocked cell, and distinct cells visited."""
    simulator = _walker(scene)
    actions = random_stream(seed, "figure walk", scene.id).choice(4, steps, p=SHARES)
    points = np.empty((steps, 2))
    for i, action in enumerate(actions.tolist()):
        simulator.step(action)
        points[i] = simulator.pose[:2]
    grid = simulator.navigation.inflated
    cells = grid.cells_of(points)
    inside = ((cells >= 0) & (cells < np.array(grid.shape))).all(axis=-1)
    row, col = np.where(np.expand_dims(inside, -1), cells, 0).T
    return int((~inside | (grid.cells[row, col] != 0)).sum()), len(np.unique(cells, axis=0))


def measure_penetration(ctx: FigureContext) -> list[FigureRow]:
    """A million random steps: how many end in a cell of the inflated map."""
    scenes = [build_map_scene(build_floor_plan(seed), f"plan-{seed}") for seed in range(10)]
    bad = visited = 0
    for index, scene in enumerate(scenes):
        ctx.progress("random steps", index, len(scenes))
        found, cells = count_penetrations(scene, STEPS // len(scenes), index)
        bad += found
        visited += cells
    detail = f"{STEPS} random steps on {len(scenes)} floor plans, {visited} cells visited"
    return [row_at_most("penetrations", bad, 0, "steps", detail)]


def measure_penetration_house(ctx: FigureContext) -> list[FigureRow]:
    """The same on a real building's map."""
    bad, visited = count_penetrations(_house(ctx), STEPS, 0)
    detail = f"{STEPS} random steps on small_house's SLAM map, {visited} cells visited"
    return [row_at_most("penetrations, small_house", bad, 0, "steps", detail)]


def measure_pictures(ctx: FigureContext) -> list[FigureRow]:
    """Steps a second with pictures, for orientation: the renderer decides."""
    rows = []
    scene = build_room_scene()
    for preset, sensors in (
        ("vlnce", frozenset({"rgb"})),
        ("gn_bench", frozenset({"rgb", "depth"})),
        ("gn_bench", frozenset({"rgb", "history", "bev", "occupancy"})),
    ):
        simulator = open_simulator(scene, preset, sensors=sensors, max_steps=10_000)
        simulator.reset(build_point_episodes(scene, simulator.navigation, 1)[0])
        rates = []
        for _ in range(3):
            start = time.perf_counter()
            for action in [1, 2, 2, 1, 3] * 8:
                simulator.step(action)
            rates.append(40 / (time.perf_counter() - start))
        rows.append(
            FigureRow(
                name=f"steps a second, {preset}: {', '.join(sorted(sensors))}",
                value=float(np.median(rates)),
                unit="1/s",
                detail=f"built-in flat of {len(scene.gaussians)} Gaussians, CPU, median of 3 × 40",
            )
        )
    return rows


def judge_oracle(scene: Scene, count: int, seed: int) -> tuple[list[float], list[float]]:
    """SPL with success at 0.25 m (0 for a failure) and seconds a plan, of each episode."""
    simulator = open_simulator(scene)
    policy = PolicyOracle()
    navigation: NavigationMap = simulator.navigation
    qualities, seconds = [], []
    for episode in build_point_episodes(scene, navigation, count, seed, minimum=5.0):
        field = navigation.geodesic(episode.destination)
        start = time.perf_counter()
        trajectory = run_episode(simulator, policy, episode)
        seconds.append(time.perf_counter() - start)
        points = np.array(trajectory.poses)[:, :2]
        shortest = field.distance_at(*episode.start[:2])
        success = trajectory.stopped and field.distance_at(*points[-1]) <= 0.25
        qualities.append(success * shortest / max(shortest, polyline_length(points)))
    return qualities, seconds


def _oracle_rows(where: str, qualities: list[float], seconds: list[float]) -> list[FigureRow]:
    detail = f"{len(qualities)} episodes ≥ 5 m, {where}; success: STOP within 0.25 m geodesic"
    success = 100.0 * float(np.mean(np.array(qualities) > 0))
    return [
        row_at_least(f"oracle SR, {where}", success, 100, "%", detail),
        row_at_least(f"oracle SPL, {where}", float(np.mean(qualities)), 0.97, "", detail),
        FigureRow(name=f"oracle worst SPL, {where}", value=min(qualities), unit="", detail=detail),
        FigureRow(
            name=f"oracle median time an episode, {where}",
            value=1e3 * float(np.median(seconds)),
            unit="ms",
            detail=detail,
        ),
    ]


def measure_oracle(ctx: FigureContext) -> list[FigureRow]:
    """The oracle between random points of floor plans."""
    judge_oracle(build_map_scene(build_floor_plan(99), "warm"), 1, 0)
    qualities: list[float] = []
    seconds: list[float] = []
    for seed in range(PLANS):
        ctx.progress("floor plans", seed, PLANS)
        scene = build_map_scene(build_floor_plan(seed), f"plan-{seed}")
        found, spent = judge_oracle(scene, 20, seed)
        qualities += found
        seconds += spent
    return _oracle_rows(f"{PLANS} floor plans", qualities, seconds)


def measure_oracle_house(ctx: FigureContext) -> list[FigureRow]:
    """The oracle between random points of small_house's SLAM map."""
    return _oracle_rows("small_house SLAM map", *judge_oracle(_house(ctx), 100, 0))


FIGURES = [
    Figure("sim.speed", "Steps a second without pictures", measure_speed, 0.2),
    Figure("sim.penetration", "Random steps into walls", measure_penetration, 0.3),
    Figure(
        "sim.penetration_house", "Random steps into small_house's walls",
        measure_penetration_house, 0.3,
    ),
    Figure("sim.pictures", "Steps a second with pictures", measure_pictures, 0.3),
    Figure("sim.oracle", "The oracle on floor plans", measure_oracle, 0.5),
    Figure("sim.oracle_house", "The oracle on a real building's map", measure_oracle_house, 0.3),
]  # fmt: skip
