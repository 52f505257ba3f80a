"""Steps a second of agents on the device who see people walk, over those without people.

People of an episode set share some identities; each is posed anew as it walks, unless the bank on
the device still has that pose. All of that is in the time.
"""

from __future__ import annotations

import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import msgspec
import numpy as np

from gn0.avatars.bank import AvatarBank
from gn0.avatars.bank_build import generate_bank
from gn0.maps.navigation import NavigationMap
from gn0.missions.episode import Episode
from gn0.people.plan import plan_people
from gn0.people.settings import PeopleSettings
from gn0.scenes.scene import Scene
from gn0.seeds import random_stream
from gn0.sim.device_env import VectorEnvDevice
from gn0.testing.scenes import build_map_scene, build_point_episodes
from gn0_figures.board import FigureContext, FigureRow, row_at_least
from gn0_figures.device import (
    Contender,
    is_emulation,
    median,
    memory_left,
    time_call,
    turn_order,
    wake,
)
from gn0_figures.device_parts import SHARES
from gn0_figures.device_rates import WALK
from gn0_figures.flat import build_flat, flat_floor
from gn0_figures.people_sim import FOLLOWER
from gn0_figures.people_split import split_row, split_steps

AGENTS, EPISODES, IDENTITIES = 1024, 64, 16
_STEPS, _ROUNDS, _WARM, _LEAST = 24, 12, 6, 3
_SECONDS = 240.0  # of all rounds together: where people have to be posed anew, there are fewer


def measure_seen(ctx: FigureContext) -> list[FigureRow]:
    """Env-steps a second with RGB-D and 1, 4 and 8 people who walk, over those with none."""
    tiny = is_emulation(ctx.device)
    count, steps, rounds = (1, 1, 1) if tiny else (AGENTS, _STEPS, _ROUNDS)
    shares = {1: SHARES[1]} if tiny else SHARES
    scene, episodes, bank = _people_of_flat(ctx, max(shares), tiny)
    drawn = random_stream(0, "figure actions").choice(4, (steps, count), p=WALK)
    actions = ctx.device.upload(drawn.astype(np.int64))
    envs: dict[str, VectorEnvDevice] = {}
    calls: dict[str, Contender] = {}
    taken: dict[str, int] = {}
    seen: dict[str, list[tuple[int, int, int]]] = {}
    for people in (0, *shares):
        name = str(people)
        before = memory_left(ctx.device)
        env = envs[name] = VectorEnvDevice(
            *(count, scene),
            episodes=[msgspec.structs.replace(e, people=e.people[:people]) for e in episodes],
            device=ctx.device,
            sensors=("rgb", "depth", "goal_vector"),
            preset="rgbd_224",
            agent=FOLLOWER,
            visible_sets=not tiny,
            max_steps=100,
            bank=bank,
        )
        env.reset(seed=0)
        seen[name] = []

        def walk(turn: int, env: VectorEnvDevice = env, name: str = name) -> None:
            for t in range(steps):
                env.step(actions[t])
            seen[name].append(_found(env))

        calls[name] = walk
        walk(0)
        taken[name] = before - memory_left(ctx.device)
        ctx.progress(f"agents among {people} people each have walked", len(envs), 1 + len(shares))
    times, warm = _walk_by_turns(ctx, calls, rounds, tiny)
    rounds = len(times["0"])
    splits = {}
    for name, env in envs.items():
        env.synchronize()
        splits[name] = split_steps(env, actions, steps)
    none = np.array(times["0"])
    settings = (
        f"standard flat of {len(scene.gaussians) / 1e6:g} M splats, visible sets, {count} agents, "
        f"RGB-D of 224x224, {len(episodes)} episodes of at most 100 steps, whose people are of "
        f"{IDENTITIES} identities and walk at 0.5 to 1.3 m/s; random walk with 1 % STOP; banks "
        f"filled as they go, counted from step {(warm + 1) * steps} or later on; medians of "
        f"{rounds} rounds of {steps} steps by turns, as many as fit into {_SECONDS:.0f} s"
    )
    rate = steps * count / median(times["0"]) * 1e3
    rows = [
        FigureRow(
            name="env-steps a second with RGB-D, nobody there", value=rate, unit="1/s",
            detail=f"{settings}; {taken['0'] / 2**20:.0f} MB of the device",
        )
    ]  # fmt: skip
    for people, least in shares.items():
        name = str(people)
        share = float(np.median(none / np.array(times[name])))
        last, first = seen[name][-1], seen[name][-1 - rounds]
        hits, misses, ahead = (after - before for after, before in zip(last, first, strict=True))
        eyes: Any = envs[name]._eyes
        posed = eyes.people.posed
        detail = (
            f"{settings}; {steps * count / median(times[name]) * 1e3:,.0f} steps a second, "
            f"{taken[name] / 2**20:.0f} MB of the device more, of them people "
            f"{envs[name].memory['people'] / 2**20:.0f} MB and posed ones "
            f"{posed.bytes / 2**20:.0f} MB, at rest {posed.rest_bytes / 2**20:.0f} MB; "
            f"{ahead / rounds / steps:.1f} clouds posed ahead of a step and "
            f"{misses / rounds / steps:.1f} in it, hit rate {hits / max(hits + misses, 1):.4f}, "
            f"{posed.evicted} made room"
        )
        title = f"env-steps with {people} who walk over those with nobody"
        if tiny:
            rows.append(FigureRow(name=title, value=share, unit="times", detail=detail))
        else:
            rows.append(row_at_least(title, share, least, "times", detail))
    told = f"{settings.split(';')[0]}; medians of {steps} steps behind those, by events"
    return [*rows, *(split_row(int(name), split, told) for name, split in splits.items())]


def _walk_by_turns(
    ctx: FigureContext, calls: dict[str, Contender], rounds: int, tiny: bool
) -> tuple[dict[str, list[float]], int]:
    """Milliseconds of each, round by round until the time is up; how many were not counted."""
    times: dict[str, list[float]] = {name: [] for name in calls}
    wake(ctx.device, calls)
    warm, begin, turn = 0, time.perf_counter(), 0
    while len(times["0"]) < rounds:
        since = time.perf_counter() - begin
        if len(times["0"]) >= _LEAST and since * (turn + 1) > _SECONDS * turn:
            break
        found = {
            name: time_call(ctx.device, calls[name], turn)[0] for name in turn_order(calls, turn)
        }
        # the banks fill: a third of the time, or so many rounds
        counts = tiny or warm >= _WARM or since > _SECONDS / 3
        if counts:
            for name, taken in found.items():
                times[name].append(taken)
        warm += not counts
        turn += 1
        spent = ", ".join(f"{name}: {taken:,.0f}" for name, taken in sorted(found.items()))
        ctx.progress(f"rounds among people, the last in ms: {spent}", turn, _WARM + rounds)
    return times, warm


def _found(env: VectorEnvDevice) -> tuple[int, int, int]:
    """How many posed people were there, how many not, and how many were posed ahead, so far."""
    eyes: Any = env._eyes
    if eyes.people is None:
        return 0, 0, 0
    posed = eyes.people.posed
    return posed.hits, posed.misses, posed.ahead


def _people_of_flat(
    ctx: FigureContext, most: int, tiny: bool
) -> tuple[Scene, list[Episode], AvatarBank | None]:
    """The standard flat, and episodes among people who walk in it."""
    cloud = build_flat(1500 if tiny else 1_000_000)
    scene = replace(
        build_map_scene(flat_floor(0.0), "flat"),
        load_cloud=lambda: cloud,
        cloud_hash=cloud.content_hash,
    )
    bank: AvatarBank | None = None
    if tiny:  # one whom nobody has to build
        folder = Path(ctx.work) / "bank"
        generate_bank(folder, count=1, seed=1, density=0.03)
        bank = AvatarBank(folder)
    settings = PeopleSettings(
        count=most, seed=3, groups=0.0, seated=0.0, variety=IDENTITIES,
        bank=() if bank is None else tuple(sorted(bank.names)),
    )  # fmt: skip
    ground = NavigationMap(scene.grid, FOLLOWER.radius)
    episodes = []
    for k, bare in enumerate(
        build_point_episodes(scene, ground, 2 if tiny else EPISODES, agent=FOLLOWER)
    ):
        ctx.progress("episodes among people", k, EPISODES)
        people = plan_people(scene, bare, settings, radius=FOLLOWER.radius)
        episodes.append(msgspec.structs.replace(bare, people=people))
    return scene, episodes, bank
