"""Episodes as a policy walked them, and their means; known to whoever has no torch, too."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class Walk:
    """An episode as it was walked.

    Attributes:
        episode: its id.
        scene: of it.
        path: id of the path that the episode was made of; missions of one path share it.
        kind: of the mission, see `gn0.missions.episode.mission_name`.
        tier: of the goal: "visible from above", or "".
        steps: actions, STOP included.
        stopped: the policy said STOP.
        length: metres walked, TL.
        shortest: walking distance to the goal at the start [m].
        left: the same at the end [m].
        left_straight: straight distance to the goal at the end [m], the paper's NE.
        least: the least walking distance on the way [m].
        success, success_straight, success_near: STOP within 3 m on foot; within 3 m as the crow
            flies, the paper's; within 1 m on foot.
        spl, spl_straight, spl_near: of each of these, by the shortest way on foot.
        oracle: ever within 3 m on foot.
        forwards, cut_short: FORWARDs, and those that an obstacle cut short.
        decisions: how often the policy was asked.
        seconds: its share of the wall time of those that walked beside it [s].
    """

    episode: str
    scene: str
    path: str
    kind: str
    tier: str
    steps: int
    stopped: bool
    length: float
    shortest: float
    left: float
    left_straight: float
    least: float
    success: bool
    success_straight: bool
    success_near: bool
    spl: float
    spl_straight: float
    spl_near: float
    oracle: bool
    forwards: int
    cut_short: int
    decisions: int
    seconds: float = 0.0


MEANS = {
    "SR": "success", "SPL": "spl", "OS": "oracle",
    "SR_straight": "success_straight", "SPL_straight": "spl_straight",
    "SR_1m": "success_near", "SPL_1m": "spl_near",
    "TL": "length", "NE": "left", "NE_straight": "left_straight",
    "STOP": "stopped", "steps": "steps", "decisions": "decisions",
}  # fmt: skip
"""Names of means, and what they are means of."""


def summarise_walks(walks: Iterable[Walk]) -> dict[str, dict[str, float]]:
    """Means by mission kind, and of `all`: shares from 0 to 1, lengths in m.

    `cut_short` is the share of FORWARDs, `STOP` the share of episodes that ended with one.
    """
    groups: dict[str, list[Walk]] = {"all": []}
    for walk in walks:
        groups["all"].append(walk)
        groups.setdefault(walk.kind, []).append(walk)
    return {kind: _summarise(some) for kind, some in groups.items() if some}


def _summarise(walks: Sequence[Walk]) -> dict[str, float]:
    means = {
        name: float(np.mean([float(getattr(walk, field)) for walk in walks]))
        for name, field in MEANS.items()
    }
    forwards = sum(walk.forwards for walk in walks)
    cut = sum(walk.cut_short for walk in walks)
    return {"episodes": float(len(walks)), **means, "cut_short": cut / max(forwards, 1)}
