"""NaN and infinite losses stop a run before it writes down what they made of the weights."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from gn0.errors import TrainingError

if TYPE_CHECKING:
    from torch import Tensor

_LAG = 2  # steps that a card may be ahead of who reads its losses


def check_finite(
    values: Mapping[str, float], *, step: int, batch: str, last_good: Path | None = None
) -> None:
    """Make sure that what was measured of a step are numbers.

    Args:
        values: by name, e.g. "loss", "gradient norm".
        step: counted from 1.
        batch: which samples it learned from, in words.
        last_good: the last state on disk.

    Raises:
        TrainingError: names value, step, batch and the last good state.
    """
    for name, value in values.items():
        if not math.isfinite(value):
            kept = f"the last good checkpoint is {last_good}" if last_good else "none was saved yet"
            raise TrainingError(
                f"{name} is {value} at step {step}",
                where=f"batch {batch}",
                remedy=f"{kept}; lower the rate, or look at that batch",
            )


class LossGuard:
    """`check_finite` without waiting for a card: numbers are read while the next steps run.

    A number on the CPU is checked at once; one on a card at most two steps later, and always
    before a state is saved (`settle`).

    Attributes:
        last_good: the last state on disk, named in the error.
    """

    def __init__(self, last_good: Path | None = None) -> None:
        self.last_good = last_good
        self._waiting: deque[tuple[int, str, list[str], Any, Any]] = deque()

    def watch(self, step: int, batch: str, **values: Tensor) -> None:
        """Have numbers of a step checked.

        Args:
            step: counted from 1.
            batch: which samples it learned from, in words.
            values: tensors [], by name.

        Raises:
            TrainingError: one of this step or of one before is NaN or infinite.
        """
        import torch

        both = torch.stack([value.detach().float() for value in values.values()])
        done = None
        if both.is_cuda:
            here = torch.empty(both.shape, pin_memory=True)
            here.copy_(both, non_blocking=True)
            done = torch.cuda.Event()
            done.record()
            both = here
        self._waiting.append((step, batch, list(values), both, done))
        while self._waiting:
            event = self._waiting[0][4]
            if event is not None and len(self._waiting) <= _LAG and not event.query():
                return
            self._check_first()

    def settle(self) -> None:
        """Wait for all that is watched; call it before a state is saved.

        Raises:
            TrainingError: a number is NaN or infinite.
        """
        while self._waiting:
            self._check_first()

    def _check_first(self) -> None:
        step, batch, names, numbers, done = self._waiting.popleft()
        if done is not None:
            done.synchronize()
        values = dict(zip(names, numbers.tolist(), strict=True))
        check_finite(values, step=step, batch=batch, last_good=self.last_good)
