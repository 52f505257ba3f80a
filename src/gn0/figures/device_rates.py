"""Figures of what is built on the device renderer: simulation."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from gn0.figures.board import (
    Figure,
    FigureContext,
    FigureRow,
    row_at_least,
)
from gn0.figures.device import interleave, is_emulation, median
from gn0.figures.flat import build_flat, flat_floor
from gn0.maps.navigation import NavigationMap
from gn0.missions.episode import Episode
from gn0.scenes.scene import Scene
from gn0.seeds import random_stream
from gn0.sim.device_env import VectorEnvDevice
from gn0.sim.presets import find_preset
from gn0.testing.scenes import build_floor_plan, build_map_scene, build_point_episodes

WALK = [0.01, 0.59, 0.2, 0.2]  # STOP, FORWARD, LEFT, RIGHT: an episode of about 100 steps
STEPS = 2e6  # agent-steps a second, at least, of 4096 agents without pictures
PICTURES = 15e3  # env-steps a second, at least, with 224x224 RGB-D over a million splats


def _rate(env: VectorEnvDevice, steps: int) -> float:
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


def _plans(count: int, size: float) -> tuple[list[Scene], list[Episode]]:
    scenes = [
        build_map_scene(build_floor_plan(k, width=size, depth=size), f"plan-{k}")
        for k in range(count)
    ]
    maps = [NavigationMap(scene.grid, 0.2) for scene in scenes]
    pairs = zip(scenes, maps, strict=True)
    return scenes, [e for scene, plan in pairs for e in build_point_episodes(scene, plan, 25)]


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
    scenes, episodes = _plans(1, 6.0) if tiny else _plans(8, 20.0)
    env = VectorEnvDevice(count, scenes, episodes=episodes, device=ctx.device)
    detail = f"{len(scenes)} floor plans, {len(episodes)} episodes, {count} agents, goal_vector"
    detail += "; random walk with 1 % STOP, actions on the device, autoresets included"
    add("agent-steps a second, no pictures", _rate(env, steps), STEPS, detail)
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
        add(name, _rate(env, steps), PICTURES, detail)
        del env
    return rows


FIGURES = [
    Figure(
        "render.cuda.sim", "CUDA: steps a second on the device", measure_sim, 1.5, backend="cuda"
    )
]
