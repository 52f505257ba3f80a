"""Is run A better than run B, worse, or too close to tell? Paired, episode by episode.

A difference counts when two things hold: its bootstrap interval leaves out zero, and a sign-flip
test (Fisher 1935: under equal policies each pair could as well have come out the other way round)
would see so large a difference at most once in twenty times. The first says how large it is; the
second is exact for any number of episodes, so equal policies are told apart in at most 5 % of
comparisons, however few episodes there are.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from gn0.bench.follow_metrics import FOLLOW_MEANS
from gn0.bench.intervals import LEVEL, bootstrap_means
from gn0.bench.metrics import METRICS, TOUCHED, MetricInfo
from gn0.bench.pairing import Pair, pair_episodes, pair_paths, scored_episodes
from gn0.bench.results import load_summary
from gn0.bench.standing import tell_standings
from gn0.geometry import F64
from gn0.seeds import random_stream

FLIPS = 10_000
FEW_SCENES = 6  # with fewer, no test at 5 % can speak about other scenes: 2 / 2^5 > 0.05
Unit = Literal["auto", "scene", "episode"]
Verdict = Literal["A is better", "B is better", "A is higher", "B is higher", "nobody can tell"]


@dataclass(frozen=True)
class Comparison:
    """One metric of two runs on the same episodes.

    Attributes:
        metric: which.
        a, b: means over the episodes that both runs scored.
        difference: a − b.
        low, high: its 95 % interval.
        verdict: see the module.
        episodes: how many pairs, of episodes or of paths; those in which both have a value of it.
        chance: how often equal policies would differ as much (sign-flip test, two-sided).
        wins: pairs in which A has the higher value.
        losses: pairs in which B has it.
        unit: what was resampled and flipped: whole scenes, or episodes of these very scenes.
        following: of episodes in which a person is followed, whose measures are others.
    """

    metric: MetricInfo
    a: float
    b: float
    difference: float
    low: float
    high: float
    verdict: Verdict
    episodes: int
    chance: float = 1.0
    wins: int = 0
    losses: int = 0
    unit: Literal["scene", "episode"] = "episode"
    following: bool = False

    def __str__(self) -> str:
        scale, unit = (100.0, "%") if self.metric.unit == "%" else (1.0, self.metric.unit)
        a, b, low, high = (v * scale for v in (self.a, self.b, self.low, self.high))
        difference = f"{self.difference * scale:+.2f} [{low:+.2f}, {high:+.2f}] {unit}".rstrip()
        return (
            f"{self.metric.key:<15} A {a:8.2f}   B {b:8.2f}   A − B {difference:<30} "
            f"{self.wins:>4} : {self.losses:<4} {self.verdict}"
        )


def compare_runs(
    a: Path | str, b: Path | str, *, seed: int = 0, unit: Unit = "auto"
) -> list[Comparison]:
    """Compare two runs of one suite, metric by metric, on the episodes that both scored.

    The runs may differ in map mode, which `name_difference` then says. Episodes of following come
    after all others, with measures of their own, but for ratios of sums over episodes.

    Whole scenes are resampled where there are at least six, which speaks of scenes like these; with
    fewer, episodes are, which speaks of these scenes alone. `unit` overrules.

    Raises:
        BenchError: different suites, or no episode scored by both.
        StorageError, FormatError: a run is missing or damaged.
    """
    return compare_pairs(pair_episodes(a, b), seed=seed, unit=unit)


def compare_paths(
    a: Path | str,
    b: Path | str,
    *,
    mission_a: str = "",
    mission_b: str = "",
    seed: int = 0,
    unit: Unit = "auto",
) -> list[Comparison]:
    """Compare two runs, or two missions of one run, on the paths that both scored.

    So goal missions stand against instructions under matched geometry; see `pair_paths`.

    Raises:
        BenchError: nothing to pair, or runs that measure differently.
        StorageError, FormatError: a run is missing or damaged.
    """
    return compare_pairs(pair_paths(a, b, mission_a, mission_b), seed=seed, unit=unit)


def compare_pairs(pairs: Sequence[Pair], *, seed: int = 0, unit: Unit = "auto") -> list[Comparison]:
    """Compare what was scored pair by pair, metric by metric; see `compare_runs`."""
    rows = []
    for following, measures in ((False, (*METRICS, TOUCHED)), (True, FOLLOW_MEANS)):
        some = [pair for pair in pairs if pair.following is following]
        for info in measures:
            known = [(pair, means) for pair in some if (means := pair.means(info)) is not None]
            if known:
                rows.append(_compare(info, known, seed, unit))
    return rows


def _compare(
    info: MetricInfo, known: Sequence[tuple[Pair, tuple[float, float]]], seed: int, unit: Unit
) -> Comparison:
    """One metric, of the pairs in which both sides have it, with its means of each pair."""
    pairs = [pair for pair, _ in known]
    names = [pair.scene for pair in pairs]
    whole = unit == "scene" or (unit == "auto" and len(set(names)) >= FEW_SCENES)
    scenes = names if whole and len(set(names)) >= 2 else None
    x, y = np.array([means for _, means in known]).T
    low, high = paired_interval(x - y, scenes, seed=seed, name=info.key)
    chance = sign_flip_chance(x - y, scenes, seed=seed, name=info.key)
    return Comparison(
        metric=info,
        a=float(x.mean()),
        b=float(y.mean()),
        difference=float((x - y).mean()),
        low=low,
        high=high,
        verdict=judge_difference(info, low, high, chance),
        episodes=len(pairs),
        chance=chance,
        wins=int((x > y).sum()),
        losses=int((x < y).sum()),
        unit="episode" if scenes is None else "scene",
        following=pairs[0].following,
    )


def paired_interval(
    differences: NDArray[np.floating], scenes: Sequence[str] | None, *, seed: int, name: str
) -> tuple[float, float]:
    """The 95 % bootstrap interval of a mean difference [N], widened for few units.

    A percentile interval is too narrow for few units; its levels are moved out as far as Student's
    t would move them (Hesterberg 2015, "expanded percentile interval").
    """
    from scipy import special  # here, so that who compares nothing does not load it

    units = len(set(scenes)) if scenes is not None else len(differences)
    means = bootstrap_means(differences, scenes, seed=seed, name=f"compare {name}")
    if units < 2:
        return float(means.min()), float(means.max())
    reach = np.sqrt(units / (units - 1)) * special.stdtrit(units - 1, (1 + LEVEL) / 2)
    level = float(special.ndtr(-reach))
    low, high = np.quantile(means, [level, 1 - level])
    return float(low), float(high)


def sign_flip_chance(
    differences: NDArray[np.floating], scenes: Sequence[str] | None, *, seed: int, name: str
) -> float:
    """How often a mean difference [N] at least so large comes about when every sign is a coin toss.

    All differences of a scene are flipped together where `scenes` are given. With the differences
    as they are counted among the draws, the test is exact: a value of at most p turns up in at most
    a share p of comparisons of equal policies (Phipson and Smyth 2010).
    """
    d: F64 = np.asarray(differences, np.float64)
    if scenes is not None:
        index = {scene: i for i, scene in enumerate(sorted(set(scenes)))}
        member = [index[s] for s in scenes]
        d = np.bincount(member, weights=d, minlength=len(index)).astype(np.float64)
    d = d[d != 0.0]
    if not len(d):
        return 1.0
    observed = abs(float(d.sum()))
    slack = 1e-12 * float(np.abs(d).sum())  # sums in another order are not other sums
    rng = random_stream(seed, "sign flip", name)
    as_large, block = 1, max(1, 4_000_000 // len(d))
    for begin in range(0, FLIPS, block):
        signs = rng.integers(0, 2, size=(min(block, FLIPS - begin), len(d)), dtype=np.int8)
        sums = (2.0 * signs - 1.0) @ d
        as_large += int((np.abs(sums) >= observed - slack).sum())
    return as_large / (FLIPS + 1)


def name_pairing(a: Path | str, b: Path | str) -> str:
    """What a comparison of two runs leaves out, in a sentence; "" when nothing.

    Raises:
        StorageError, FormatError: a run is missing or damaged.
    """
    scored_a, scored_b = scored_episodes(a).keys(), scored_episodes(b).keys()
    if scored_a == scored_b:
        return ""
    return (
        f"{len(scored_a & scored_b)} episodes were scored by both; left out: "
        f"{len(scored_a - scored_b)} that only A scored, {len(scored_b - scored_a)} that only B did"
    )


def name_difference(a: Path | str, b: Path | str) -> str:
    """What two runs of one task were told or shown differently; "" when it is the same.

    Raises:
        StorageError, FormatError: a run is missing or damaged.
    """
    first, second = load_summary(a), load_summary(b)
    lines = [tell_standings(first, second)]
    if first.map_mode != second.map_mode:
        lines.insert(
            0,
            f"not the same task: A ran with map mode {first.map_mode!r}, B with "
            f"{second.map_mode!r}; the difference is that of policy and maps together",
        )
    if first.control != second.control:
        lines.append(
            f"a control: A ran with {first.control!r}, B with {second.control!r}; the difference "
            "is what was taken away"
        )
    return "; ".join(line for line in lines if line)


def judge_difference(info: MetricInfo, low: float, high: float, chance: float) -> Verdict:
    """The verdict on a metric from its interval and its sign-flip chance."""
    if low <= 0.0 <= high or chance > 1.0 - LEVEL:
        return "nobody can tell"
    higher_is_a = low > 0
    if not info.better:
        return "A is higher" if higher_is_a else "B is higher"
    return "A is better" if higher_is_a == (info.better == "up") else "B is better"
