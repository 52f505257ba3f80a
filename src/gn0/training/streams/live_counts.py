"""What walks beside a learner came to: how far they agree with the expert, and arrive."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import astuple, dataclass, fields


@dataclass(frozen=True)
class LiveCounts:
    """What happened on the way, since the stream was made or `StreamLive.tell` reset it.

    Attributes:
        steps: of all agents.
        asked: actions of the policy that might have been carried out.
        agreed: of these, the same as the expert's.
        forwards, cut_short: FORWARDs carried out, and those that hit something.
        ended, arrived: episodes, and those that ended with STOP near the goal.
        due: of `asked`, those where the expert stops.
        stopped, stopped_right: of `asked`, STOPs, and those that are the expert's, too.
    """

    steps: int = 0
    asked: int = 0
    agreed: int = 0
    forwards: int = 0
    cut_short: int = 0
    ended: int = 0
    arrived: int = 0
    due: int = 0
    stopped: int = 0
    stopped_right: int = 0

    def __add__(self, other: LiveCounts) -> LiveCounts:
        return LiveCounts(*map(sum, zip(astuple(self), astuple(other), strict=True)))


COUNTED = tuple(field.name for field in fields(LiveCounts))
_SHARES = {
    "driven": ("asked", "steps"),
    "agreement": ("agreed", "asked"),
    "walks_cut_short": ("cut_short", "forwards"),
    "walks_arrived": ("arrived", "ended"),
    "walks_stop_recall": ("stopped_right", "due"),
    "walks_stop_precision": ("stopped_right", "stopped"),
}


def share_counts(counts: Mapping[str, float]) -> dict[str, float]:
    """Shares of counts by name, as reports have them; NaN where there was nothing to share.

    `driven` of the steps are the policy's own, of which `agreement` are the expert's, too;
    `walks_cut_short` of the FORWARDs hit something; `walks_arrived` of the episodes that ended did
    so with STOP near the goal; of the states where the expert stops, the policy stops in
    `walks_stop_recall`, and of its STOPs `walks_stop_precision` are the expert's.
    """
    return {
        name: counts[part] / counts[whole] if counts[whole] else float("nan")
        for name, (part, whole) in _SHARES.items()
    }
