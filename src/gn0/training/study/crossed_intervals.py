"""Intervals of means over trained seeds and scenes together.

Every seed is examined in the same scenes, so seeds and scenes are crossed: what another seed and
other scenes would have given is asked by drawing both again (Owen 2007, the pigeonhole bootstrap).
Alone, it counts the noise of a cell up to three times and is too narrow for few seeds; so its draws
give the interval's shape, and its width is that of the crossed design's own standard error, from
the mean squares of seeds, scenes and their interaction, with Student's t of Satterthwaite's degrees
of freedom.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from scipy import special

from gn0.errors import ConfigError
from gn0.geometry import F64
from gn0.seeds import random_stream

RESAMPLES = 4000
LEVEL, POWER = 0.95, 0.8
FEW_SCENES = 6  # with fewer, episodes are drawn, and the interval speaks of these scenes alone
DISCORDANT, ALIKE = 0.3, 0.02
"""Assumed beforehand: the share of episodes that two policies end differently, and how much more
alike those of one scene are (intraclass correlation)."""


@dataclass(frozen=True)
class Estimate:
    """A mean, or a mean difference, with its 95 % interval.

    Attributes:
        value: the mean over seeds of the means over episodes.
        low, high: its interval.
        error: its standard error.
        seeds, scenes, episodes: of how many.
        unit: what was drawn again beside seeds: scenes, or episodes of these very scenes.
    """

    value: float
    low: float
    high: float
    error: float
    seeds: int
    scenes: int
    episodes: int
    unit: Literal["scene", "episode"]


def estimate_mean(
    values: F64, scenes: Sequence[str], *, seed: int = 0, name: str = "", resamples: int = RESAMPLES
) -> Estimate:
    """The mean of values [S, N] of S seeds on the same N episodes, with its interval.

    Of one seed, the interval speaks of that very training run. Differences of two policies are such
    values too: by seed and episode.

    Args:
        values: a row a seed.
        scenes: of each episode.
        seed: of the draws.
        name: of the draws.
        resamples: how many draws.

    Raises:
        ConfigError: no values, or some that are not finite.
    """
    table = np.atleast_2d(np.asarray(values, np.float64))
    if not table.size or not np.isfinite(table).all() or table.shape[1] != len(scenes):
        raise ConfigError(
            f"no mean of {table.shape} values in {len(scenes)} scenes",
            where=name,
            remedy="give a finite value a seed and episode",
        )
    names = sorted(set(scenes))
    whole = len(names) >= FEW_SCENES
    sums: F64 = table
    sizes: F64 = np.ones(table.shape[1])
    if whole:
        index = {scene: k for k, scene in enumerate(names)}
        member = np.array([index[scene] for scene in scenes])
        sums = np.array([np.bincount(member, row, len(names)) for row in table], np.float64)
        sizes = np.bincount(member, minlength=len(names)).astype(np.float64)
    value = float(sums.sum() / (len(sums) * sizes.sum()))
    error, freedom = _find_error(sums, sizes)
    low = high = value
    if error > 0:
        drawn = _draw_means(sums, sizes, seed, name, resamples)
        spread = float(drawn.std())
        reach = float(special.stdtrit(freedom, (1 + LEVEL) / 2) / special.ndtri((1 + LEVEL) / 2))
        scale = reach * error / spread if spread > 0 else 0.0
        ends = np.quantile(drawn, [(1 - LEVEL) / 2, (1 + LEVEL) / 2]) - drawn.mean()
        low, high = (value + scale * float(end) for end in ends)
    return Estimate(
        value=value,
        low=low,
        high=high,
        error=error,
        seeds=len(table),
        scenes=len(names),
        episodes=table.shape[1],
        unit="scene" if whole else "episode",
    )


def _find_error(sums: F64, sizes: F64) -> tuple[float, float]:
    """The standard error of the mean of cells [S, C], and its degrees of freedom.

    Cells are compared by what they add to the mean: of C scenes, C (sum − mean · size) / N.
    """
    count, width = sums.shape
    total = float(sizes.sum())
    means = sums.sum(1) / total
    cells = width * (sums - means[:, None] * sizes) / total
    if width < 2:
        return 0.0, 1.0
    columns = cells.mean(0)
    of_scenes = float(columns.var(ddof=1)) / width
    if count < 2:
        return math.sqrt(of_scenes), width - 1.0
    of_seeds = float(means.var(ddof=1)) / count
    inner = (count - 1.0) * (width - 1.0)
    noise = float(((cells - columns) ** 2).sum()) / inner / (count * width)
    if of_seeds <= noise:  # seeds differ by no more than noise makes them
        return math.sqrt(of_scenes), width - 1.0
    if of_scenes <= noise:
        return math.sqrt(of_seeds), count - 1.0
    whole = of_seeds + of_scenes - noise
    parts = of_seeds**2 / (count - 1) + of_scenes**2 / (width - 1) + noise**2 / inner
    return math.sqrt(whole), max(1.0, whole**2 / parts)


def _draw_means(sums: F64, sizes: F64, seed: int, name: str, resamples: int) -> F64:
    """Means [resamples] of seeds and scenes that are both drawn again."""
    count, width = sums.shape
    rng = random_stream(seed, "seeds and scenes", name)
    seeds = rng.multinomial(count, np.full(count, 1 / count), resamples).astype(np.float64)
    means = np.empty(resamples)
    block = max(1, 4_000_000 // width)  # at most 32 MB of counts at a time
    for begin in range(0, resamples, block):
        some = seeds[begin : begin + block]
        scenes = rng.multinomial(width, np.full(width, 1 / width), len(some)).astype(np.float64)
        means[begin : begin + block] = ((some @ sums) * scenes).sum(1) / (count * (scenes @ sizes))
    return means


def smallest_effect(
    scenes: int, episodes: int, *, discordant: float = DISCORDANT, alike: float = ALIKE
) -> float:
    """The smallest difference of two success rates that would be seen in 80 of 100 studies.

    Stated before anything is run, from the number of scenes and episodes and two assumptions:
    (z₀.₉₇₅ + z₀.₈) · √(q (1 + (m − 1) ρ) / (C m)) for C scenes of m episodes. What seeds differ by
    comes on top.

    Args:
        scenes: C.
        episodes: of all scenes together.
        discordant: q, share of episodes that the two end differently.
        alike: ρ, of episodes of one scene.
    """
    each = episodes / scenes
    spread = discordant * (1 + (each - 1) * alike) / episodes
    return float(special.ndtri((1 + LEVEL) / 2) + special.ndtri(POWER)) * math.sqrt(spread)


def estimate_seeds(values: Sequence[float]) -> Estimate:
    """The mean of one number a seed, with Student's interval; endless for a single seed."""
    v = np.asarray(values, np.float64)
    mean = float(v.mean())
    error = float(v.std(ddof=1)) / math.sqrt(len(v)) if len(v) > 1 else math.inf
    reach = float(special.stdtrit(len(v) - 1, (1 + LEVEL) / 2)) * error if len(v) > 1 else math.inf
    return Estimate(mean, mean - reach, mean + reach, error, len(v), 0, 0, "episode")
