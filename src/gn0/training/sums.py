"""Means of what a run measures, summed up on its device: one wait a report, none a step."""

from __future__ import annotations

from collections.abc import Mapping

import torch
from torch import Tensor


class Sums:
    """Sums by name since they were last read; names may be told at different times."""

    def __init__(self) -> None:
        self._sums: dict[str, Tensor] = {}
        self._counts: dict[str, int] = {}

    @torch.no_grad()
    def add(self, values: Mapping[str, Tensor]) -> None:
        """Add scalars of a device; waits for nothing."""
        for name, value in values.items():
            told = value.detach().double()
            self._sums[name] = self._sums[name] + told if name in self._sums else told
            self._counts[name] = self._counts.get(name, 0) + 1

    def read(self) -> dict[str, float]:
        """Means by name since the last reading, in the order in which names first came."""
        names = list(self._sums)
        values = torch.stack([*self._sums.values()]).tolist() if names else []
        found = {n: v / self._counts[n] for n, v in zip(names, values, strict=True)}
        self._sums, self._counts = {}, {}
        return found
