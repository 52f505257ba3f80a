"""Learning rates over a run: warm-up, stable, decay, so that a run can stop anywhere."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Literal, Protocol


class Rates(Protocol):
    """What a recipe says of its rates over a run; see `gn0.training.recipe.Recipe`."""

    @property
    def warm_steps(self) -> int: ...  # noqa: D102
    @property
    def schedule(self) -> Literal["stable", "cosine"]: ...  # noqa: D102
    @property
    def tail(self) -> float: ...  # noqa: D102
    @property
    def floor(self) -> float: ...  # noqa: D102


@dataclass(frozen=True)
class Schedule:
    """Where a run stands on its way; part of its checkpoints.

    Attributes:
        end: steps of the whole run; None while nobody knows.
        tail: step at which the rate begins to fall; None while nobody knows.
        warm: step from which the rate rises: not 0 where a run went on from weights alone.
    """

    end: int | None = None
    tail: int | None = None
    warm: int = 0

    def end_at(self, step: int, recipe: Rates) -> Schedule:
        """The same run, to end at a step, its tail the recipe's share of all steps."""
        return replace(self, end=step, tail=step - round(recipe.tail * step))

    def end_soon(self, step: int, recipe: Rates) -> Schedule:
        """The same run, whose tail begins now and is the recipe's share of all steps."""
        share = recipe.tail / (1 - recipe.tail) if recipe.tail < 1 else 1.0
        return replace(self, end=step + max(1, round(share * step)), tail=step)

    def seconds_left(self, step: int, seconds: float, minutes: float | None) -> float | None:
        """Of a run's minutes, `seconds` after it began.

        None where there is no limit, and from the tail on, when it is known at which step it ends.
        """
        if minutes is None or self.tail is None or step >= self.tail:
            return None
        return max(60 * minutes - seconds, 0.0)

    def warm_again(self, step: int) -> Schedule:
        """The same run, the rate rising from 0 again: AdamW's moments are gone."""
        return replace(self, warm=step)

    def share(self, step: int, recipe: Rates) -> float:
        """The share of the recipe's rates at which step `step` (from 0) is taken."""
        warm = min(1.0, (step - self.warm + 1) / recipe.warm_steps) if recipe.warm_steps else 1.0
        if self.end is None or self.tail is None:
            return warm
        if recipe.schedule == "cosine":
            return warm * 0.5 * (1 + math.cos(math.pi * min(1.0, step / self.end)))
        if step < self.tail:
            return warm
        left = (self.end - step) / max(1, self.end - self.tail)
        return warm * (recipe.floor + (1 - recipe.floor) * max(0.0, left))
