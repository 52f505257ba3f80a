"""What happened since the last report, summed up on the device: one wait a report, none a step."""

from __future__ import annotations

from collections.abc import Collection, Mapping

import torch
from torch import Tensor

from gn0.training.learner import GROUPS, Losses

NAMES = ("loss", *(f"loss_{name}" for name in GROUPS), "first_taught", "distance_loss", "gradient")


class Tally:
    """Sums of a run's losses since they were last read.

    Args:
        device: of the losses.
        lacks: names of `NAMES` that steps of an input do not have, by input: losses of waypoints
            where none are asked for.
    """

    def __init__(
        self, device: torch.device | str, lacks: Mapping[str, Collection[str]] | None = None
    ) -> None:
        self._device, self._lacks = device, lacks or {}
        self._sums: dict[str, Tensor] = {}
        self._counts: dict[str, int] = {}

    @torch.no_grad()
    def add(self, losses: Losses, norm: Tensor, input: str = "") -> None:
        """Add a step, of one of the policy's inputs; waits for nothing."""
        told = (losses.loss.detach(), *losses.groups, losses.first, losses.distance, norm)
        if input not in self._sums:
            self._counts[input] = 0
            self._sums[input] = torch.zeros(len(NAMES), dtype=torch.float64, device=self._device)
        self._sums[input] += torch.stack([one.double() for one in told])
        self._counts[input] += 1

    def read(self) -> dict[str, float]:
        """Means by name since the last reading, over all steps and, as NAME_INPUT, by input."""
        rows = [*self._sums.values()] or [torch.zeros(len(NAMES), dtype=torch.float64)]
        every = torch.stack(rows).cpu()
        counts = torch.tensor([[count] for count in self._counts.values()] or [[0]])
        there = torch.tensor(
            [[n not in self._lacks.get(one, ()) for n in NAMES] for one in self._counts or [""]]
        )
        means = every.sum(0) / (there * counts).sum(0).clamp(min=1)
        found = dict(zip(NAMES, means.tolist(), strict=True))
        for k, name in enumerate(self._counts):
            if name:
                told = zip(NAMES, (every[k] / counts[k]).tolist(), there[k].tolist(), strict=True)
                found |= {f"{what}_{name}": value for what, value, is_there in told if is_there}
        self._sums.clear()
        self._counts.clear()
        return found
