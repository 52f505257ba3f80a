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
        self._count = 0

    @torch.no_grad()
    def add(self, losses: Losses, norm: Tensor) -> None:
        """Add a step; waits for nothing."""
        told = (losses.loss.detach(), *losses.groups, losses.first, losses.distance, norm)
        self._sums += torch.stack([one.double() for one in told])
        self._count += 1

    def read(self) -> dict[str, float]:
        """Means by name since the last reading."""
        values = (self._sums / max(self._count, 1)).tolist()
        self._sums.zero_()
        self._count = 0
        return dict(zip(NAMES, values, strict=True))
