"""Figure of learning: PPO of Stable-Baselines3 on PointNav in the built-in flat."""

from __future__ import annotations

import multiprocessing
import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, ThreadPoolExecutor
from typing import Any, NamedTuple

import numpy as np

from gn0.errors import ConfigError
from gn0.missions.episode import Episode
from gn0.scenes.example import build_example_scene
from gn0.sim.adapters import FlatVectorEnv, build_vec_env
from gn0.sim.tasks import load_tasks
from gn0.sim.vector import VectorEnv
from gn0_figures.board import (
    Figure,
    FigureContext,
    FigureRow,
    FigureSkipped,
    row_at_least,
    row_at_most,
)
from gn0_figures.spread import cores_here, keep_to_cores

AGENTS, ROLLOUT, BATCH = 128, 32, 1024
MAX_STEPS = 150
SUCCESS = 0.5  # m; the ids' own 3 m is soon reached
TRAIN, HELD_OUT = 400, 100  # episodes, drawn with other seeds
SEEDS = 5
ENOUGH, LIMIT = 120.0, 900.0  # s a seed: where it may end, and must
LOOK_EVERY = 10.0  # s between looks at the held-out episodes
TARGET = 0.5


class Look(NamedTuple):
    """What a policy was worth at one time: seconds of learning, agent-steps, success rate."""

    seconds: float
    steps: int
    success: float


def build_env(count: int, episodes: Sequence[Episode], space: str = "discrete") -> FlatVectorEnv:
    """The task: goal vector and range ring in the built-in flat."""
    return FlatVectorEnv(
        VectorEnv(
            count,
            build_example_scene(),
            episodes=episodes,
            sensors=("goal_vector", "ranges"),
            max_steps=MAX_STEPS,
            success_distance=SUCCESS,
            action_space=space,
        )
    )


def success_rate(env: FlatVectorEnv, act: Callable[[Any], Any]) -> float:
    """Of episodes 0..N−1, played once each by the N agents, how many end well."""
    seen, _ = env.reset(options={"episode": list(range(env.num_envs))})
    playing, found = np.ones(env.num_envs, np.bool_), 0
    while playing.any():
        seen, _, stopped, cut, infos = env.step(act(seen))
        ended = (stopped | cut) & playing
        found += sum(infos["final_info"][i]["success"] for i in np.flatnonzero(ended))
        playing &= ~ended
    return float(found) / env.num_envs


def learn(
    seed: int,
    enough: float = ENOUGH,
    limit: float = LIMIT,
    look_every: float = LOOK_EVERY,
    agents: int = AGENTS,
    space: str = "discrete",
) -> list[Look]:
    """Train one policy, and look at it on held-out episodes from time to time.

    It ends after `enough` seconds if it has reached TARGET, and after `limit` in any case. Looking
    does not count.

    Raises:
        FigureSkipped: Stable-Baselines3 is not installed.
    """
    scene = build_example_scene()
    train, held_out = (
        load_tasks(scene, count=count, seed=drawn).episodes
        for count, drawn in ((TRAIN, 1), (HELD_OUT, 2))
    )
    try:
        raw = build_vec_env(build_env(agents, train, space))
    except ConfigError as error:
        raise FigureSkipped("needs Stable-Baselines3: pip install -e '.[rl]'") from error
    from stable_baselines3 import PPO
    from stable_baselines3.common.vec_env import VecNormalize

    env = VecNormalize(raw, norm_reward=False, clip_obs=5.0)
    model = PPO(
        "MlpPolicy", env, n_steps=ROLLOUT, batch_size=min(BATCH, agents * ROLLOUT), n_epochs=4,
        learning_rate=1e-3, gamma=0.98, ent_coef=0.01, seed=seed, device="cpu",
        policy_kwargs={"net_arch": [64, 64]},
    )  # fmt: skip
    judge = build_env(HELD_OUT, held_out, space)
    looks: list[Look] = []
    spent, due = 0.0, 0.0
    while True:
        start = time.perf_counter()
        model.learn(agents * ROLLOUT, reset_num_timesteps=False)
        spent += time.perf_counter() - start
        good = bool(looks) and looks[-1].success >= TARGET
        over = spent >= limit or (spent >= enough and good)
        if spent >= due or over:
            rate = success_rate(judge, lambda seen: model.predict(env.normalize_obs(seen))[0])
            looks.append(Look(spent, model.num_timesteps, rate))
            due = spent + look_every
        if over:
            return looks


def learn_by_twos(ctx: FigureContext) -> Iterator[Sequence[Look]]:
    """The curve of each seed, on two cores of its own; side by side where there are more."""
    pairs = list(zip(*[iter(cores_here())] * 2, strict=False))
    if len(pairs) < SEEDS:
        for seed in range(SEEDS):
            ctx.progress("sim.ppo", seed, SEEDS)
            yield learn(seed)
        return
    with ThreadPoolExecutor(SEEDS) as pool:
        yield from pool.map(_learn_apart, range(SEEDS), pairs[:SEEDS])


def _learn_apart(seed: int, cores: tuple[int, int]) -> Sequence[Look]:
    """One seed in a process that has these cores alone."""
    spawn = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(
        1, mp_context=spawn, initializer=keep_to_cores, initargs=(cores,)
    ) as pool:
        return pool.submit(learn, seed).result()


def measure_ppo(ctx: FigureContext) -> list[FigureRow]:
    """PPO on PointNav: success on held-out episodes, by seed and by time."""
    where = (
        f"built-in flat, {AGENTS} agents, goal vector and 72 rays, STOP within {SUCCESS:g} m, "
        f"{HELD_OUT} held-out episodes, Stable-Baselines3 on the CPU"
    )
    curves: list[Sequence[Look]] = []
    rows: list[FigureRow] = []
    for curve in learn_by_twos(ctx):
        rows.append(seed_row(len(curves), curve))
        curves.append(curve)
        ctx.report(rows[-1])
    return [*rows, *sum_up(curves, where)]


def seed_row(seed: int, curve: Sequence[Look]) -> FigureRow:
    """What one seed came to, and how."""
    return FigureRow(
        name=f"PPO seed {seed}: success",
        value=100 * curve[-1].success,
        unit="%",
        detail=", ".join(f"{look.seconds:.0f} s {look.success:.0%}" for look in curve),
    )


def sum_up(curves: Sequence[Sequence[Look]], where: str) -> list[FigureRow]:
    """Rows of all seeds, a curve each."""
    good = sum(curve[-1].success >= TARGET for curve in curves)
    first = [next((k.seconds for k in c if k.success >= TARGET), np.inf) for c in curves]
    fourth = sorted(first)[min(3, len(first) - 1)]
    how = f"looked at every {LOOK_EVERY:g} s"
    if np.isinf(fourth):  # the board holds finite numbers only
        fourth, how = 2 * LIMIT, f"not reached in {max(c[-1].seconds for c in curves):.0f} s"
    rates = [curve[-1].steps / curve[-1].seconds for curve in curves]
    return [
        row_at_least(f"seeds of {len(curves)} with PPO at ≥ 50 %", good, 4, "seeds", where),
        row_at_most(
            "minutes until ≥ 50 %, fourth of five seeds",
            fourth / 60,
            LIMIT / 60,
            "min",
            how,
        ),
        FigureRow(
            name="agent-steps a second, learning included",
            value=float(np.median(rates)),
            unit="1/s",
            detail="median of the seeds",
        ),
    ]


FIGURES = [Figure("sim.ppo", "PPO on PointNav (Stable-Baselines3)", measure_ppo, 13.0)]
