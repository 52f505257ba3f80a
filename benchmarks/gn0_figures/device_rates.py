"""Figures of what is built on the device renderer: simulation."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from gn0.maps.navigation import NavigationMap
from gn0.missions.episode import Episode
from gn0.scenes.parts import build_ball
from gn0.scenes.scene import Scene
from gn0.seeds import random_stream
from gn0.sim.device_env import VectorEnvDevice
from gn0.sim.motion import PartPath, PathMotion
from gn0.sim.presets import find_preset
from gn0.testing.scenes import build_floor_plan, build_map_scene, build_point_episodes
from gn0_figures.board import (
    Figure,
    FigureContext,
    FigureRow,
    row_at_least,
    row_at_most,
)
from gn0_figures.device import interleave, is_emulation, median
from gn0_figures.flat import build_flat, flat_floor

WALK = [0.01, 0.59, 0.2, 0.2]  # STOP, FORWARD, LEFT, RIGHT: an episode of about 100 steps
STEPS = 2e6  # agent-steps a second, at least, of 4096 agents without pictures
MOVING = {1: 0.90, 4: 0.75, 8: 0.60}  # parts, and the share of env-steps that is left, at least
PICTURES = 15e3  # env-steps a second, at least, with 224x224 RGB-D over a million splats


def measure_rate(env: VectorEnvDevice, steps: int) -> float:
    """Agent-steps a second through `step()` with actions on the device, autoresets included."""
    env.reset(seed=0)
    drawn = random_stream(0, "figure actions").choice(4, (steps, env.num_envs), p=WALK)
    actions = env.device.upload(drawn.astype(np.int64))

    def walk(turn: int) -> None:
        for t in range(steps):
            env.step(actions[t])

    times = interleave(env.device, {"": walk}, 5, warm=1)
    env.synchronize()
    return steps * env.num_envs / median(times[""]) * 1e3


def build_plans(count: int, size: float, goals: int) -> tuple[list[Scene], list[Episode]]:
    """Square floor plans of `size` [m], and episodes in each."""
    scenes = [
        build_map_scene(build_floor_plan(k, width=size, depth=size), f"plan-{k}")
        for k in range(count)
    ]
    maps = [NavigationMap(scene.grid, 0.2) for scene in scenes]
    pairs = zip(scenes, maps, strict=True)
    return scenes, [e for scene, plan in pairs for e in build_point_episodes(scene, plan, goals)]


def measure_sim(ctx: FigureContext) -> list[FigureRow]:
    """Steps a second on the device, without pictures and with RGB-D."""
    tiny = is_emulation(ctx.device)
    rows: list[FigureRow] = []

    def add(name: str, rate: float, least: float, detail: str) -> None:
        if tiny:
            rows.append(FigureRow(name=name, value=rate, unit="1/s", detail=detail))
        else:
            rows.append(row_at_least(name, rate, least, "1/s", detail))
        ctx.report(rows[-1])

    count, steps = (8, 3) if tiny else (4096, 200)
    scenes, episodes = build_plans(1, 6.0, 25) if tiny else build_plans(8, 20.0, 25)
    env = VectorEnvDevice(count, scenes, episodes=episodes, device=ctx.device)
    detail = f"{len(scenes)} floor plans, {len(episodes)} episodes, {count} agents, goal_vector"
    detail += "; random walk with 1 % STOP, actions on the device, autoresets included"
    add("agent-steps a second, no pictures", measure_rate(env, steps), STEPS, detail)
    del env
    cloud = build_flat(1500 if tiny else 1_000_000)
    flat = replace(
        build_map_scene(flat_floor(0.0), "flat"),
        load_cloud=lambda: cloud,
        cloud_hash=cloud.content_hash,
    )
    episodes = build_point_episodes(flat, NavigationMap(flat.grid, 0.2), 4 if tiny else 200)
    for sets in (False, True):
        if tiny and sets:
            continue  # thirty pictures of 640x640 a cell: too much for an emulation
        count, steps = (2, 2) if tiny else (1024, 24)
        env = VectorEnvDevice(
            *(count, flat),
            episodes=episodes,
            device=ctx.device,
            sensors=("rgb", "depth", "goal_vector"),
            preset="rgbd_224",
            visible_sets=sets,
        )
        size = find_preset("rgbd_224").rgb
        detail = (
            f"standard flat of {len(cloud) / 1e6:g} M splats, {count} agents, RGB-D of "
            f"{size.width}x{size.height}; tensors stay on the device"
        )
        name = "env-steps a second with RGB-D, " + ("visible sets" if sets else "full set")
        add(name, measure_rate(env, steps), PICTURES, detail)
        del env
    return rows


def _roam(count: int, splats: int, below: float = 0.0) -> PathMotion:
    """So many balls of so many splats that cross the standard flat to and fro for ever."""
    radius = 0.25
    ball = build_ball(radius, spacing=float(np.sqrt(4 * np.pi * radius**2 / splats)))
    stream, paths = random_stream(count, "figure roam"), []
    for _ in range(count):
        ends = np.tile(np.eye(4), (3, 1, 1))
        ends[:, 0, 3], ends[:, 1, 3] = stream.uniform(1.0, 9.0, 3), stream.uniform(1.0, 7.0, 3)
        ends[:, 2, 3] = 1.0 - below
        ends[2] = ends[0]
        paths.append(PartPath("ball", np.array([0.0, 20.0, 40.0]), ends, repeats=True))
    return PathMotion({"ball": ball}, paths)


def measure_moving(ctx: FigureContext) -> list[FigureRow]:
    """Agent-steps a second with things that move over those without, in turns."""
    tiny = is_emulation(ctx.device)
    cloud = build_flat(1500 if tiny else 1_000_000)
    flat = replace(
        build_map_scene(flat_floor(0.0), "flat"),
        load_cloud=lambda: cloud,
        cloud_hash=cloud.content_hash,
    )
    episodes = build_point_episodes(flat, NavigationMap(flat.grid, 0.2), 4 if tiny else 200)
    count, steps, splats = (1, 1, 100) if tiny else (1024, 24, 10_000)
    asked = dict(list(MOVING.items())[:1]) if tiny else MOVING
    motions = {"none": None, "unseen": _roam(1, splats, below=500.0)}
    motions |= {str(parts): _roam(parts, splats) for parts in asked}
    drawn = random_stream(0, "figure actions").choice(4, (steps, count), p=WALK)
    actions = ctx.device.upload(drawn.astype(np.int64))
    contenders, envs = {}, []
    for name, motion in motions.items():
        env = VectorEnvDevice(
            *(count, flat),
            episodes=episodes,
            device=ctx.device,
            sensors=("rgb", "depth", "goal_vector"),
            preset="rgbd_224",
            visible_sets=not tiny,
            max_steps=100,
            motions={} if motion is None else {"flat": motion},
        )
        env.reset(seed=0)
        envs.append(env)

        def walk(turn: int, env: VectorEnvDevice = env) -> None:
            for t in range(steps):
                env.step(actions[t])

        contenders[name] = walk
    times = interleave(ctx.device, contenders, 1 if tiny else 12, warm=1 if tiny else 4)
    for env in envs:
        env.synchronize()
    none = np.array(times["none"])
    detail = (
        f"standard flat of {len(cloud) / 1e6:g} M splats, {count} agents, RGB-D of 224x224, "
        f"visible sets; balls of {splats:,} splats that roam the flat; medians of the ratios of "
        f"{len(none)} rounds by turns"
    )
    rows = [
        FigureRow(
            name="env-steps a second with nothing that moves",
            value=steps * count / median(times["none"]) * 1e3,
            unit="1/s",
            detail=detail,
        )
    ]
    for parts, least in asked.items():
        share = float(np.median(none / np.array(times[str(parts)])))
        name = f"env-steps with {parts} that move{'s' * (parts == 1)} over those with none"
        rows.append(
            FigureRow(name=name, value=share, unit="times", detail=detail)
            if tiny
            else row_at_least(name, share, least, "times", detail)
        )
    cost = 100 * (float(np.median(np.array(times["unseen"]) / none)) - 1.0)
    name = "time that a moving part takes which no agent sees"
    rows.append(
        FigureRow(name=name, value=cost, unit="%", detail=detail)
        if tiny
        else row_at_most(name, cost, 1.0, "%", detail)
    )
    for row in rows:
        ctx.report(row)
    return rows


FIGURES = [
    Figure(
        "render.cuda.sim", "CUDA: steps a second on the device", measure_sim, 1.5, backend="cuda"
    ),
    Figure(
        "render.cuda.moving",
        "CUDA: steps a second while things move",
        measure_moving,
        1.5,
        backend="cuda",
    ),
]
