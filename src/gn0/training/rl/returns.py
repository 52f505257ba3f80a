"""The return of a whole episode, and what it is worth among those of its group.

    R = success + SPL − (distance left / distance at the start) − 0.05 · actions cut short

Plain functions of walks side by side. Ours, not the paper's: its rewards are of one answer.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated, Literal

import msgspec
import numpy as np
import torch
from numpy.typing import NDArray

from gn0.config import Config
from gn0.training.exams.walks import Walk
from gn0.training.rl.policy_gradient import group_advantages

F64 = NDArray[np.float64]
Weight = Annotated[float, msgspec.Meta(ge=0)]
Judged = Literal["return", "task"]

_EVEN = 1e-6  # a group whose standard deviation is at most this says nothing
_SHORTEST = 1e-3  # m: a start at the goal itself


class ReturnWeights(Config, frozen=True):
    """What the terms weigh.

    Attributes:
        success: of STOP within 3 m of the goal on foot.
        spl: of that, by the way walked.
        left: of the share of the way that is left at the end.
        cut_short: of each FORWARD that an obstacle cut short.
    """

    success: Weight = 1.0
    spl: Weight = 1.0
    left: Weight = 1.0
    cut_short: Weight = 0.05


@dataclass(frozen=True)
class Returns:
    """Returns float64 [N] and their terms.

    Attributes:
        total: R.
        success: 0 or 1.
        spl: 0 to 1.
        left: distance left by distance at the start, on foot; above 1 for who walked away.
        cut_short: actions.
    """

    total: F64
    success: F64
    spl: F64
    left: F64
    cut_short: F64


def score_walks(walks: Sequence[Walk], weights: ReturnWeights | None = None) -> Returns:
    """Returns of N walks."""
    weights = weights or ReturnWeights()
    success = np.array([walk.success for walk in walks], np.float64)
    spl = np.array([walk.spl for walk in walks], np.float64)
    left = np.array([walk.left / max(walk.shortest, _SHORTEST) for walk in walks], np.float64)
    cut_short = np.array([walk.cut_short for walk in walks], np.float64)
    total = weights.success * success + weights.spl * spl
    total = total - weights.left * left - weights.cut_short * cut_short
    return Returns(total, success, spl, left, cut_short)


def weigh_groups(
    returns: Returns, group: int, judged: Judged = "return"
) -> tuple[F64, NDArray[np.bool_], F64]:
    """Advantages of N walks, those of an episode in a row, and which groups say something.

    Args:
        returns: of the walks.
        group: walks of one episode.
        judged: by the variance of what a group is kept: its returns', or that of success and SPL
            alone, so that groups which never arrive, or always alike, are dropped.

    Returns:
        advantages [N], 0 in groups that are dropped; kept bool [N / group]; the standard deviation
        of returns [N / group].
    """
    rows = returns.total.reshape(-1, group)
    task = (returns.success + returns.spl).reshape(-1, group)
    kept = (rows if judged == "return" else task).std(1) > _EVEN
    gains = group_advantages(torch.from_numpy(rows)).numpy() * kept[:, None]
    return gains.ravel(), kept, rows.std(1)
