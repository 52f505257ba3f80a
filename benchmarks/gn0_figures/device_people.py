"""Figures of people on the device: steps a second among them, and how many bits differ."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import msgspec
import numpy as np

from gn0.missions.episode import Episode
from gn0.scenes.scene import Scene
from gn0.seeds import random_stream
from gn0.sim.device_env import VectorEnvDevice
from gn0.sim.follow_device import FollowVectorEnvDevice
from gn0.sim.follow_episodes import follow_ways
from gn0.sim.vector import VectorEnv
from gn0_figures.board import Figure, FigureContext, FigureRow, row_at_least, row_at_most
from gn0_figures.device import is_emulation
from gn0_figures.device_people_seen import measure_seen
from gn0_figures.device_rates import WALK, measure_rate
from gn0_figures.people_sim import FOLLOWER, plan_episodes

ENVS = 4096
PEOPLE = 8
STEPS = 8e6  # agent-steps a second among eight people, at least
COMPARED = 60  # steps


def measure_people(ctx: FigureContext) -> list[FigureRow]:
    """Steps a second with 0, 1, 5 and 8 people, following, against the CPU to the bit, and seen."""
    tiny = is_emulation(ctx.device)
    rows: list[FigureRow] = []

    def add(row: FigureRow) -> None:
        rows.append(row)
        ctx.report(row)

    count, steps = (8, 3) if tiny else (ENVS, 200)
    shape = (1, 3) if tiny else (8, 32)
    scenes, episodes = plan_episodes(*shape, most=PEOPLE)
    mean = float(np.mean([len(episode.people) for episode in episodes]))
    here = (
        f"{len(scenes)} floor plans, {len(episodes)} episodes, {count} agents, body 0.25 m, 15°, "
        "0.2 s, goal_vector; random walk with 1 % STOP, actions on the device, autoresets included"
    )
    settings: dict[str, Any] = {"agent": FOLLOWER, "sensors": ("goal_vector",)}
    for people in (0, PEOPLE) if tiny else (0, 1, 5, PEOPLE):
        some = [msgspec.structs.replace(e, people=e.people[:people]) for e in episodes]
        env = VectorEnvDevice(count, scenes, episodes=some, device=ctx.device, **settings)
        rate = measure_rate(env, steps)
        name = f"agent-steps a second, {people} people an environment, no pictures"
        if people < PEOPLE or tiny:
            add(FigureRow(name=name, value=rate, unit="1/s", detail=here))
        else:
            held = env.memory["people"] / 2**20
            detail = f"{here}; {mean:.1f} people on average, {held:.0f} MB of them on the device"
            add(row_at_least(name, rate, STEPS, "1/s", detail))
        del env
    ways = [
        way
        for scene in scenes
        for way in follow_ways(scene, [e for e in episodes if e.scene_id == scene.id], FOLLOWER)
    ]
    env = FollowVectorEnvDevice(count, scenes, episodes=ways, device=ctx.device, **settings)
    detail = f"{count} agents, each with one person who walks ahead, its rewards and ends"
    rate = measure_rate(env, steps)
    add(FigureRow(name="the same, following", value=rate, unit="1/s", detail=detail))
    del env
    add(_compare(ctx, count, 5 if tiny else COMPARED, scenes, episodes))
    for row in measure_seen(ctx):
        add(row)
    return rows


def _compare(
    ctx: FigureContext,
    count: int,
    steps: int,
    scenes: Sequence[Scene],
    episodes: Sequence[Episode],
) -> FigureRow:
    """Agents whose pose, reward, people or ring are not the CPU's to the bit."""
    settings: dict[str, Any] = {"episodes": episodes, "agent": FOLLOWER, "sensors": ("ranges",)}
    there = VectorEnvDevice(count, scenes, device=ctx.device, **settings)
    here = VectorEnv(count, scenes, **settings)
    there.reset(seed=1)
    here.reset(seed=1)
    actions = random_stream(1, "figure actions").choice(4, (steps, count), p=WALK)
    wrong, hits = np.zeros(count, np.bool_), 0
    for row in actions:
        seen, rewards, _, _, told = there.step(row)
        want, gains, _, _, facts = here.step(row)
        pairs = (
            (rewards, gains),
            (seen["ranges"], want["ranges"]),
            *((told[name], facts[name]) for name in ("pose", "people", "hit_person", "hit_tick")),
        )
        for mine, theirs in pairs:
            bits = [np.ascontiguousarray(v).view(np.uint8).reshape(count, -1)
                    for v in (mine.numpy(), theirs)]  # fmt: skip
            wrong |= (bits[0] != bits[1]).any(axis=1)
        hits += int((facts["hit_person"] > 0).sum())
    return row_at_most(
        "agents among people who are not those of VectorEnv, to the bit", int(wrong.sum()), 0, "",
        f"{count} agents, {steps} steps, {hits} moves cut by people: poses, rewards, range rings, "
        "places and headings of everybody, hits",
    )  # fmt: skip


FIGURES = [
    Figure("people.sim.cuda", "CUDA: people in the simulators", measure_people, 2.0, backend="cuda")
]
