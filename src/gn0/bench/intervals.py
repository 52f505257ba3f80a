"""Bootstrap intervals: how much a mean would move on other episodes, or on other scenes."""

from __future__ import annotations

from collections.abc import Sequence

import msgspec
import numpy as np
from numpy.typing import NDArray

from gn0.errors import BenchError
from gn0.geometry import F64
from gn0.seeds import random_stream

RESAMPLES = 10_000
LEVEL = 0.95


class Interval(msgspec.Struct, frozen=True, kw_only=True):
    """A mean with its bootstrap interval.

    Attributes:
        mean: mean over the episodes.
        low, high: percentile bounds at `level`.
        level: e.g. 0.95.
        count: episodes.
        clusters: what was resampled: scenes when there are several, else 0 (episodes).
    """

    mean: float
    low: float
    high: float
    level: float
    count: int
    clusters: int


def bootstrap_means(
    values: NDArray[np.floating],
    clusters: Sequence[str] | None,
    *,
    seed: int,
    name: str,
    resamples: int = RESAMPLES,
) -> F64:
    """Means [resamples] of values [N] drawn again with replacement.

    With two or more distinct clusters (scenes), whole clusters are drawn: episodes of one scene
    are not independent (Field and Welsh 2007, the cluster bootstrap).
    """
    v = np.asarray(values, np.float64)
    return _bootstrap_ratios(v, np.ones(len(v)), clusters, seed, name, resamples)


def _bootstrap_ratios(
    over: F64, under: F64, clusters: Sequence[str] | None, seed: int, name: str, resamples: int
) -> F64:
    """Sums of `over` [N] divided by sums of `under` [N], of episodes or clusters drawn again."""
    rng = random_stream(seed, "bootstrap", name)
    names = sorted(set(clusters)) if clusters is not None else []
    sums: F64
    if len(names) >= 2 and clusters is not None:
        index = {name: i for i, name in enumerate(names)}
        member = np.array([index[c] for c in clusters])
        sums = np.bincount(member, weights=over, minlength=len(names)).astype(np.float64)
        sizes = np.bincount(member, weights=under, minlength=len(names)).astype(np.float64)
    else:
        sums, sizes = over, under
    means = np.empty(resamples)
    block = max(1, 4_000_000 // len(sums))  # at most 32 MB of indices at a time
    for begin in range(0, resamples, block):
        end = min(begin + block, resamples)
        drawn = rng.integers(0, len(sums), size=(end - begin, len(sums)))
        means[begin:end] = sums[drawn].sum(axis=1) / sizes[drawn].sum(axis=1)
    return means


def bootstrap_interval(
    values: NDArray[np.floating] | Sequence[float],
    *,
    clusters: Sequence[str] | None = None,
    seed: int = 0,
    name: str = "",
    level: float = LEVEL,
    resamples: int = RESAMPLES,
) -> Interval:
    """Mean and percentile bootstrap interval (Efron 1979) of values [N].

    Args:
        values: one number an episode.
        clusters: the scene of each episode; scenes are resampled when there are several.
        seed: root seed; the same values give the same interval.
        name: metric name, so that metrics do not share their draws by accident.
        level: coverage, 0..1.
        resamples: bootstrap draws.

    Raises:
        BenchError: no values, or one that is not finite.
    """
    v = np.asarray(values, np.float64)
    if v.ndim != 1 or not len(v):
        raise BenchError(
            "an interval needs at least one value", where=name, remedy="run an episode"
        )
    if not np.isfinite(v).all():
        raise BenchError(
            "a value that is not finite cannot be averaged",
            where=name,
            remedy="count the episode as invalid",
        )
    means = bootstrap_means(v, clusters, seed=seed, name=name, resamples=resamples)
    return _interval(float(v.mean()), means, clusters, level, len(v))


def pooled_interval(
    over: NDArray[np.floating] | Sequence[float],
    under: NDArray[np.floating] | Sequence[float],
    *,
    clusters: Sequence[str] | None = None,
    seed: int = 0,
    name: str = "",
    level: float = LEVEL,
    resamples: int = RESAMPLES,
) -> Interval:
    """Σ over [N] / Σ under [N] with its interval: episodes count as much as their `under`.

    The arguments are those of `bootstrap_interval`.

    Raises:
        BenchError: no values, one that is not finite, or an `under` that is not above 0.
    """
    a, b = np.asarray(over, np.float64), np.asarray(under, np.float64)
    if a.ndim != 1 or a.shape != b.shape or not len(a):
        raise BenchError(
            f"{a.size} values over {b.size}",
            where=name,
            remedy="give as many of both, one at least",
        )
    if not (np.isfinite(a).all() and np.isfinite(b).all() and (b > 0).all()):
        raise BenchError(
            "a value is not finite, or is divided by nothing",
            where=name,
            remedy="leave out episodes that have none",
        )
    ratios = _bootstrap_ratios(a, b, clusters, seed, name, resamples)
    return _interval(float(a.sum() / b.sum()), ratios, clusters, level, len(a))


def _interval(
    mean: float, draws: F64, clusters: Sequence[str] | None, level: float, count: int
) -> Interval:
    low, high = np.quantile(draws, [(1 - level) / 2, (1 + level) / 2])
    distinct = len(set(clusters)) if clusters is not None else 0
    return Interval(
        mean=mean,
        low=float(low),
        high=float(high),
        level=level,
        count=count,
        clusters=distinct if distinct >= 2 else 0,
    )
