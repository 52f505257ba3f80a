"""What agents do in an update of RL on whole episodes: which episodes, which decisions count.

Plain functions of numbers and walks; `EpisodeStage` carries them out.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gn0.seeds import random_stream
from gn0.training.exams.walks import Walk
from gn0.training.rl.episode_recipe import EpisodePlan
from gn0.training.rl.returns import Returns
from gn0.training.runs.progress_line import format_seconds

I64 = NDArray[np.int64]
PARTS = ("walk", "score", "learn")  # of an update, whose seconds are told apart


@dataclass(frozen=True)
class Rollout:
    """What N agents did in their episodes, and what of it is learned from.

    Attributes:
        walks: of all, those of an episode in a row.
        returns: of all.
        gains: float64 [N] advantages.
        kept: bool [P] episodes that are learned from.
        spread: float64 [P] standard deviations of returns.
        rows: int64 [M] numbers of the decisions that are learned from, see `DecisionStore`.
        carried: int64 [M] how many actions of each were carried out.
    """

    walks: Sequence[Walk]
    returns: Returns
    gains: NDArray[np.float64]
    kept: NDArray[np.bool_]
    spread: NDArray[np.float64]
    rows: I64
    carried: I64


def pick_episodes(count: int, update: int, wanted: int, seed: int) -> list[int]:
    """Numbers of the episodes of an update, from 0: laps through all, each in an order of its own.

    Args:
        count: of episodes that there are.
        update: which, from 0.
        wanted: episodes of an update.
        seed: of the order.
    """
    found: list[int] = []
    at = update * wanted
    while len(found) < wanted:
        lap, begin = divmod(at + len(found), count)
        order = random_stream(seed, "rl episodes", lap).permutation(count)
        found += order[begin : begin + wanted - len(found)].tolist()
    return found


def list_decisions(
    walks: Sequence[Walk], kept: NDArray[np.bool_], group: int, executed: int
) -> tuple[I64, I64]:
    """Decisions of agents in groups that are kept, none behind the end of an episode.

    Args:
        walks: of N agents.
        kept: bool [N / group].
        group: agents of an episode.
        executed: actions from decision to decision.

    Returns:
        Their numbers `decision * N + agent` [M], and how many actions of each were carried out.
    """
    steps = np.array([walk.steps for walk in walks], np.int64)
    steps = np.where(np.repeat(kept, group), steps, 0)
    first = np.arange(-(-steps.max(initial=0) // executed))[:, None] * executed
    carried = np.clip(steps - first, 0, executed)
    rows = np.flatnonzero(carried)
    return rows, carried.ravel()[rows]


def describe_rollout(rollout: Rollout) -> dict[str, float]:
    """What is told of walks, by other names than an examination's: means, shares from 0 to 1."""
    returns, walks = rollout.returns, rollout.walks
    forwards = sum(walk.forwards for walk in walks)
    return {
        "return": float(returns.total.mean()),
        "return_success": float(returns.success.mean()),
        "return_spl": float(returns.spl.mean()),
        "return_left": float(returns.left.mean()),
        "return_cut_short": float(returns.cut_short.mean()),
        "walk_cut_short": float(returns.cut_short.sum()) / max(forwards, 1),
        "walk_stop": float(np.mean([walk.stopped for walk in walks])),
        "walk_steps": float(np.mean([walk.steps for walk in walks])),
        "group_std": float(rollout.spread.mean()),
        "dropped": float(1 - rollout.kept.mean()),
    }


def describe_update(step: int, plan: EpisodePlan, values: Mapping[str, float]) -> str:
    """An update as a line."""
    spent = [values[f"seconds_{name}"] for name in PARTS]
    left = (plan.updates - step) * sum(spent)
    if plan.minutes is not None:
        left = min(left, plan.minutes * 60 - values["seconds"])
    return " · ".join(
        (
            f"update {step:,}/{plan.updates:,}",
            f"return {values['return']:.3f} (SR {values['return_success']:.1%} "
            f"SPL {values['return_spl']:.3f} "
            f"left {values['return_left']:.2f} cut short {values['return_cut_short']:.1f})",
            f"group std {values['group_std']:.3f}, {values['dropped']:.0%} dropped",
            f"clipped {values['clipped']:.1%} entropy {values['answer_entropy']:.3f} "
            f"KL {values['kl']:.4f}",
            " ".join(f"{n} {s:.1f} s" for n, s in zip(PARTS, spent, strict=True)),
            f"{format_seconds(left)} left",
        )
    )


def describe_examination(values: Mapping[str, float]) -> str:
    """An examination as a few words."""
    names = ("SR", "SPL", "first_action", "entropy")
    return " ".join(f"{name} {values[name]:.3f}" for name in names if name in values)
