"""Outcomes of two policies over made-up suites, to learn how often a comparison is wrong."""

from __future__ import annotations

import numpy as np

from gn0.bench.compare import FEW_SCENES, judge_difference, paired_interval, sign_flip_chance
from gn0.bench.metrics import METRICS
from gn0.geometry import F64
from gn0.seeds import random_stream

_RATE = next(info for info in METRICS if info.key == "SR")
_METRES = next(info for info in METRICS if info.key == "NE_geo")


def draw_pair(
    seed: int, episodes: int, scenes: int, *, better: float = 0.0, rate: bool = True
) -> tuple[F64, F64, list[str]]:
    """Outcomes [episodes] of policies A and B, and the scene of each episode.

    Episodes are hard or easy for both, and each policy has scenes that it likes: with `better` 0
    the two are equal all the same, for nobody knows beforehand which scenes these are.

    Args:
        seed: names the suite.
        episodes: how many.
        scenes: over how many scenes they are spread.
        better: by how much B is more able than A (logits, or metres).
        rate: outcomes are 0 or 1 (a success rate), else lengths [m] with a heavy tail.
    """
    rng = random_stream(seed, "simulated suite", episodes, scenes)
    place = rng.integers(0, scenes, episodes)
    hard = rng.normal(0.0, 1.5, episodes)
    outcomes = []
    for gain in (0.0, better):
        liking = rng.normal(0.0, 0.4, scenes) if scenes >= FEW_SCENES else np.zeros(scenes)
        able = gain + liking[place] - hard
        if rate:
            outcomes.append((rng.logistic(0.0, 1.0, episodes) < able).astype(np.float64))
        else:
            outcomes.append(np.exp(rng.normal(0.0, 0.8, episodes) - 0.3 * able))
    return outcomes[0], outcomes[1], [f"scene {i}" for i in place]


def told_apart(
    suites: int, episodes: int, scenes: int, *, better: float = 0.0, rate: bool = True
) -> float:
    """Share of `suites` made-up suites in which a comparison calls one policy better."""
    info = _RATE if rate else _METRES
    called = 0
    for seed in range(suites):
        a, b, names = draw_pair(seed, episodes, scenes, better=better, rate=rate)
        clusters = names if len(set(names)) >= FEW_SCENES else None
        low, high = paired_interval(a - b, clusters, seed=seed, name=info.key)
        chance = sign_flip_chance(a - b, clusters, seed=seed, name=info.key)
        called += judge_difference(info, low, high, chance) != "nobody can tell"
    return called / suites
