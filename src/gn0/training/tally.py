"""What happened since the last report, summed up on the device: one wait a report, none a step."""

from __future__ import annotations

import torch
from torch import Tensor

from gn0.training.learner import GROUPS, Losses

NAMES = ("loss", *(f"loss_{name}" for name in GROUPS), "first_taught", "distance_loss", "gradient")


class Tally:
    """Sums of a run's losses since they were last read.

    Args:
        device: of the losses.
    """

    def __init__(self, device: torch.device | str) -> None:
        self._sums = torch.zeros(len(NAMES), dtype=torch.float64, device=device)
        self._bad = torch.full((), -1, dtype=torch.int64, device=device)
        self._count = 0

    @torch.no_grad()
    def add(self, step: int, losses: Losses, norm: Tensor) -> None:
        """Add a step; waits for nothing."""
        told = (losses.loss.detach(), *losses.groups, losses.first, losses.distance, norm)
        values = torch.stack([one.double() for one in told])
        self._sums += values
        fine = torch.isfinite(values).all()
        self._bad = torch.where((self._bad < 0) & ~fine, step, self._bad)
        self._count += 1

    def read(self) -> tuple[dict[str, float], int | None]:
        """Means by name since the last reading, and the first step that was not finite, if any."""
        if not self._count:
            return {}, None
        values = torch.cat([self._sums / self._count, self._bad[None].double()]).tolist()
        bad = int(values.pop())
        self._sums.zero_()
        self._bad.fill_(-1)
        self._count = 0
        return dict(zip(NAMES, values, strict=True)), None if bad < 0 else bad
