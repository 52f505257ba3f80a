"""What intervals say: differences of arms on the same episodes, and verdicts on claims.

A claim says that a value (a difference of two arms, or an arm's own mean) is above, or below, a
number that was written down before the study was run. It held where the whole 95 % interval is on
the claimed side of the number, did not hold where the whole interval is on the other side, and is
too close to tell where the number is inside. Nothing else decides.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from gn0.geometry import F64
from gn0.training.exams.walks import MEANS, Walk
from gn0.training.study.crossed_intervals import Estimate, estimate_mean, estimate_seeds
from gn0.training.study.outcomes import Found, Outcomes, take_metric
from gn0.training.study.study_file import Arm, Claim, Difference

Verdict = Literal["held", "did not hold", "too close to tell", "not run"]
SHARES = ("SR", "SPL", "OS", "SR_straight", "SPL_straight", "SR_1m", "SPL_1m", "STOP")


@dataclass(frozen=True)
class Judged:
    """A claim with its verdict.

    Attributes:
        claim: which.
        estimate: what it is decided by, in the claim's units (points, m, nat); None: not run.
        verdict: see the module.
    """

    claim: Claim
    estimate: Estimate | None
    verdict: Verdict


def scale_of(metric: str) -> float:
    """What a metric is shown times: shares in points."""
    return 100.0 if metric in SHARES else 1.0


def find_mean(
    found: Found, arm: Arm, exam: str, missions: str = "all", metric: str = "SR"
) -> Estimate | None:
    """An arm's mean with its interval, shares in points; None where nothing was walked.

    No metric is below nought, and no share above a hundred: intervals, wider than their draws by
    design, end there.
    """
    own = found.outcomes(arm, exam)
    names = _common(found, own, exam, missions)
    if not names:
        return None
    values = [take_metric([one.walks[n] for n in names], metric, arm.name) for one in own.values()]
    scenes = [next(iter(own.values())).walks[name].scene for name in names]
    scaled = scale_of(metric) * np.stack(values)
    estimate = estimate_mean(scaled, scenes, name=f"{arm.name} {exam} {missions} {metric}")
    most = 100.0 if metric in SHARES else math.inf
    return replace(estimate, low=max(0.0, estimate.low), high=min(most, estimate.high))


def find_difference(found: Found, what: Difference | Claim) -> Estimate | None:
    """The mean of a − b, by seed and episode, shares in points; None where either was not run.

    Seeds are paired with seeds, an arm that is not trained with every seed of the other; episodes
    with episodes, and with those of the same path and kind where exams differ.

    Raises:
        ConfigError, TrainingError, StorageError, FormatError: see `Found`.
    """
    a, b = found.study.arm(what.a), found.study.arm(what.b)
    if what.metric not in MEANS:
        return _compare_figures(found, a, b, what.metric)
    mine = found.outcomes(a, what.exam)
    theirs = found.outcomes(b, what.exam_b or what.exam)
    seeds = _pair_seeds(a, b, mine, theirs)
    rows: list[F64] = []
    pairs = [_pair(found, mine[s], theirs[t], what) for s, t in seeds]
    names = sorted(set.intersection(*(set(one) for one in pairs))) if pairs else []
    if not names:
        return None
    for one in pairs:
        x = take_metric([one[name][0] for name in names], what.metric, what.a)
        y = take_metric([one[name][1] for name in names], what.metric, what.b)
        rows.append(scale_of(what.metric) * (x - y))
    scenes = [pairs[0][name][0].scene for name in names]
    label = f"{what.a} {what.b} {what.exam} {what.exam_b} {what.missions} {what.metric}"
    return estimate_mean(np.stack(rows), scenes, name=label)


def judge_claim(found: Found, claim: Claim) -> Judged:
    """The verdict on a claim.

    Raises:
        ConfigError, TrainingError, StorageError, FormatError: see `Found`.
    """
    if claim.b:
        estimate = find_difference(found, claim)
    elif claim.metric in MEANS:
        arm = found.study.arm(claim.a)
        estimate = find_mean(found, arm, claim.exam, claim.missions, claim.metric)
    else:
        values = _figures(found, found.study.arm(claim.a), claim.metric)
        estimate = estimate_seeds(list(values.values())) if values else None
    return Judged(claim, estimate, _decide(claim, estimate))


def _decide(claim: Claim, estimate: Estimate | None) -> Verdict:
    if estimate is None:
        return "not run"
    low, high = estimate.low, estimate.high
    if claim.above is not None:
        more, less = low > claim.above, high < claim.above
    else:
        assert claim.below is not None
        more, less = high < claim.below, low > claim.below
    return "held" if more else "did not hold" if less else "too close to tell"


def _common(found: Found, own: Mapping[int, Outcomes], exam: str, missions: str) -> list[str]:
    """Episodes of these missions that all seeds walked, in the order of their ids."""
    shared = set.intersection(*(set(one.walks) for one in own.values())) if own else set()
    some = next(iter(own.values()), None)
    if some is None:
        return []
    return sorted(name for name in shared if found.belongs(some.walks[name], exam, missions))


def _pair_seeds(
    a: Arm, b: Arm, mine: Mapping[int, Outcomes], theirs: Mapping[int, Outcomes]
) -> list[tuple[int, int]]:
    if mine and theirs and not a.trained:
        return [(next(iter(mine)), seed) for seed in theirs]
    if mine and theirs and not b.trained:
        return [(seed, next(iter(theirs))) for seed in mine]
    return [(seed, seed) for seed in mine if seed in theirs]


def _pair(
    found: Found, mine: Outcomes, theirs: Outcomes, what: Difference | Claim
) -> dict[str, tuple[Walk, Walk]]:
    if what.exam_b and what.exam_b != what.exam:
        both = {
            f"{path} {kind}": (walk, theirs.by_path[path, kind])
            for (path, kind), walk in mine.by_path.items()
            if (path, kind) in theirs.by_path
        }
    else:
        both = {n: (w, theirs.walks[n]) for n, w in mine.walks.items() if n in theirs.walks}
    return {
        name: pair
        for name, pair in both.items()
        if found.belongs(pair[0], what.exam, what.missions)
    }


def _figures(found: Found, arm: Arm, key: str) -> dict[int, float]:
    figure = next(figure for figure in found.study.figures if figure.key == key)
    return found.figures(arm, figure)


def _compare_figures(found: Found, a: Arm, b: Arm, key: str) -> Estimate | None:
    mine, theirs = _figures(found, a, key), _figures(found, b, key)
    both = [mine[seed] - theirs[seed] for seed in mine if seed in theirs]
    return estimate_seeds(both) if both else None
