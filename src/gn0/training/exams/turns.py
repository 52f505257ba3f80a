"""`Turns`: many episodes, played by few agents: who has come to an end begins the next one."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

_TOGETHER = 8  # one part of so many of all agents begins together: a beginning is a picture of all


class Turns:
    """Which of the episodes that are wanted each of N agents plays.

    Args:
        wanted: numbers of the episodes, at least one.
        count: N.

    Attributes:
        numbers: int64 [N] episodes that agents play.
        counted: bool [N], who plays one of those that are wanted; the others play for nobody.
        ended: how many of the wanted ones are over.
    """

    def __init__(self, wanted: Sequence[int], count: int) -> None:
        self._wanted = np.array(wanted, np.int64)
        self._begun = min(count, len(wanted))
        self._place = np.where(np.arange(count) < self._begun, np.arange(count), -1)
        self.numbers = self._wanted[np.where(self._place < 0, self._begun - 1, self._place)]
        self.ended = 0

    @property
    def counted(self) -> NDArray[np.bool_]:
        """See the class."""
        return self._place >= 0

    def list_over(self, done: NDArray[np.bool_]) -> NDArray[np.int64]:
        """Agents [K] who have come to an end of what is wanted, of N whose episode is `done`."""
        return np.flatnonzero(done & self.counted)

    def is_due(self, over: NDArray[np.int64]) -> bool:
        """Whether those who are `over` are heard and go on now: all are, or enough of them."""
        return len(over) == self.counted.sum() or len(over) * _TOGETHER >= len(self._place)

    def end(self, over: NDArray[np.int64]) -> list[int]:
        """Agents `over` [K] play nothing any more; places among the wanted of what they played."""
        places: list[int] = self._place[over].tolist()
        self._place[over] = -1
        self.ended += len(over)
        return places

    def seat(self, over: NDArray[np.int64]) -> NDArray[np.int64]:
        """Give agents `over` the next episodes; those of them [K] for whom there is one."""
        seated = over[: len(self._wanted) - self._begun]
        self._place[seated] = self._begun + np.arange(len(seated))
        self._begun += len(seated)
        self.numbers[seated] = self._wanted[self._place[seated]]
        return seated
