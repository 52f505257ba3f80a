"""Ego maps: pairs of squares a second, on the device and on a core, and whether they are equal."""

from __future__ import annotations

import time

import numpy as np

from gn0.device.device import DeviceArray
from gn0.seeds import random_stream
from gn0.sim.device_env import VectorEnvDevice
from gn0.sim.device_there import AgentsThere
from gn0.sim.vector import VectorEnv
from gn0_figures.board import Figure, FigureContext, FigureRow, row_at_least, row_at_most
from gn0_figures.device import interleave, is_emulation, median
from gn0_figures.device_rates import WALK, build_plans

PAIRS = 200e3  # a second, at least: 128 px of 0.06 m and 128 px of 0.15 m


def measure_ego(ctx: FigureContext) -> list[FigureRow]:
    """Pairs a second by maps of two sizes, bytes an agent, and pixels unlike `VectorEnv`'s."""
    tiny = is_emulation(ctx.device)
    count, rounds = (2, 1) if tiny else (4096, 20)
    rows: list[FigureRow] = []
    taken = []
    for size in (6.0, 9.0) if tiny else (13.0, 60.0):
        scenes, episodes = build_plans(2 if tiny else 8, size, 10)
        env = VectorEnvDevice(
            count, scenes, episodes=episodes, device=ctx.device, sensors=("ego_map",)
        )
        env.reset(seed=0)
        agents = AgentsThere(env.simulator, env._eyes)

        def draw(turn: int, agents: AgentsThere = agents) -> DeviceArray:
            return agents.ego_maps()

        times = interleave(ctx.device, {"": draw}, rounds, warm=1)
        rate = count / median(times[""]) * 1e3
        taken.append(env.memory["pictures"] / count)
        name = f"ego map pairs a second, floor plans of {size:g} m"
        detail = f"{count} agents in {len(scenes)} plans at 0.05 m, merged; the kernel alone"
        rows.append(
            FigureRow(name=name, value=rate, unit="1/s", detail=detail)
            if tiny
            else row_at_least(name, rate, PAIRS, "1/s", detail)
        )
        ctx.report(rows[-1])
        del env, agents
    name = "bytes an agent in large plans over those in small ones"
    rows.append(row_at_most(name, taken[1] / taken[0], 1.0, "times", f"{taken[0]:g} bytes"))
    ctx.report(rows[-1])
    rows.append(_compare(ctx, tiny))
    ctx.report(rows[-1])
    rows.append(_time_core())
    ctx.report(rows[-1])
    return rows


def _compare(ctx: FigureContext, tiny: bool) -> FigureRow:
    """Pixels of a walk that are not those of `VectorEnv`."""
    scenes, episodes = build_plans(2, 9.0, 10)
    count, steps = (2, 2) if tiny else (32, 60)
    env = VectorEnvDevice(count, scenes, episodes=episodes, device=ctx.device, sensors=("ego_map",))
    twin = VectorEnv(count, scenes, episodes=episodes, sensors=("ego_map",), backend="cpu")
    drawn = random_stream(1, "figure ego").choice(4, (steps, count), p=WALK)
    mine, theirs, unlike = env.reset(seed=0)[0], twin.reset(seed=0)[0], 0
    for actions in drawn:
        unlike += int((mine["ego_map"].numpy() != theirs["ego_map"]).any(axis=-1).sum())
        mine, theirs = env.step(actions)[0], twin.step(actions)[0]
    detail = f"{count} agents, {steps} steps of a random walk, autoresets included"
    return row_at_most("pixels unlike VectorEnv's on the CPU", unlike, 0, "px", detail)


def _time_core() -> FigureRow:
    """Pairs a second on one core."""
    scenes, episodes = build_plans(1, 9.0, 10)
    env = VectorEnv(1, scenes, episodes=episodes, sensors=("ego_map",), backend="cpu")
    env.reset(seed=0)
    eyes, episode = env._open_suite(scenes[0].id), episodes[0]
    eyes.ego_picture(episode.start_pose, episode.start_pose)
    spent = []
    for _ in range(5):
        begin = time.perf_counter()
        for _ in range(40):
            eyes.ego_picture(episode.start_pose, episode.start_pose)
        spent.append(time.perf_counter() - begin)
    rate = 40 / float(np.median(spent))
    return FigureRow(name="ego map pairs a second on one core of the host", value=rate, unit="1/s")


FIGURES = [
    Figure("train.ego", "CUDA: maps around agents", measure_ego, 1.0, backend="cuda"),
]
