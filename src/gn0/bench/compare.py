"""Is run A better than run B, worse, or can nobody tell? A paired bootstrap over their episodes."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np

from gn0.bench.intervals import LEVEL, bootstrap_means
from gn0.bench.metrics import METRICS, MetricInfo
from gn0.bench.results import load_results, load_summary
from gn0.errors import BenchError

Verdict = Literal["A is better", "B is better", "A is higher", "B is higher", "nobody can tell"]


@dataclass(frozen=True)
class Comparison:
    """One metric of two runs on the same episodes.

    Attributes:
        metric: which.
        a, b: means over the episodes that both runs scored.
        difference: a − b.
        low, high: its 95 % interval.
        verdict: a difference counts only when the interval leaves out zero.
        episodes: how many pairs.
    """

    metric: MetricInfo
    a: float
    b: float
    difference: float
    low: float
    high: float
    verdict: Verdict
    episodes: int

    def __str__(self) -> str:
        scale, unit = (100.0, "%") if self.metric.unit == "%" else (1.0, self.metric.unit)
        a, b, low, high = (v * scale for v in (self.a, self.b, self.low, self.high))
        difference = f"{self.difference * scale:+.2f} [{low:+.2f}, {high:+.2f}] {unit}".rstrip()
        return (
            f"{self.metric.key:<15} A {a:8.2f}   B {b:8.2f}   A − B {difference:<30} {self.verdict}"
        )


def compare_runs(a: Path | str, b: Path | str, *, seed: int = 0) -> list[Comparison]:
    """Compare two runs of one suite, metric by metric, on the episodes that both scored.

    The runs may differ in map mode, which `name_difference` then says.

    Pairs are resampled by scene where there are several scenes, else by episode.

    Raises:
        BenchError: different suites, or no episode scored by both.
        StorageError, FormatError: a run is missing or damaged.
    """
    first, second = load_summary(a), load_summary(b)
    same_task = first.task_hash and first.task_hash == second.task_hash
    if first.suite_hash != second.suite_hash and not same_task:
        raise BenchError(
            f"ran suite {second.suite!r} ({second.suite_hash}), {a} ran {first.suite!r} "
            f"({first.suite_hash})",
            where=b,
            remedy="compare runs of one suite; they may differ in map mode, in nothing else",
        )
    scored_a = {r.episode: r for r in load_results(a) if r.metrics is not None}
    scored_b = {r.episode: r for r in load_results(b) if r.metrics is not None}
    shared = sorted(scored_a.keys() & scored_b.keys())
    if not shared:
        raise BenchError("no episode was scored by both runs", where=b, remedy="run them again")
    scenes = [scored_a[name].scene for name in shared]
    rows = []
    for info in METRICS:
        x = np.array([float(getattr(scored_a[n].metrics, info.field)) for n in shared])
        y = np.array([float(getattr(scored_b[n].metrics, info.field)) for n in shared])
        means = bootstrap_means(x - y, scenes, seed=seed, name=f"compare {info.key}")
        low, high = np.quantile(means, [(1 - LEVEL) / 2, (1 + LEVEL) / 2])
        rows.append(
            Comparison(
                metric=info,
                a=float(x.mean()),
                b=float(y.mean()),
                difference=float((x - y).mean()),
                low=float(low),
                high=float(high),
                verdict=_judge(info, float(low), float(high)),
                episodes=len(shared),
            )
        )
    return rows


def name_difference(a: Path | str, b: Path | str) -> str:
    """What two runs of one task were shown differently, in a sentence; "" when it is the same.

    Raises:
        StorageError, FormatError: a run is missing or damaged.
    """
    first, second = load_summary(a), load_summary(b)
    if first.map_mode == second.map_mode:
        return ""
    return (
        f"not the same task: A ran with map mode {first.map_mode!r}, B with {second.map_mode!r}; "
        "the difference is that of policy and maps together"
    )


def _judge(info: MetricInfo, low: float, high: float) -> Verdict:
    if low <= 0.0 <= high:
        return "nobody can tell"
    higher_is_a = low > 0
    if not info.better:
        return "A is higher" if higher_is_a else "B is higher"
    return "A is better" if higher_is_a == (info.better == "up") else "B is better"
