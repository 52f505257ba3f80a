"""What makes room where not everything fits: what will be missed last, by when it was asked for.

The time between the last two requests of a thing is taken for the time to its next one, or the time
since the last, if that is longer; whatever has been asked for once may never be again. So a cycle
that is larger than the room keeps as much of itself as fits, where dropping the least recent keeps
nothing, and what is no more asked for grows old and goes. (The measure is that of LIRS: Jiang and
Zhang, SIGMETRICS 2002.) Nothing is random: the same requests, the same order.
"""

from __future__ import annotations

import math
from collections import OrderedDict
from collections.abc import Hashable, Iterable
from heapq import heapify, heappop, heappush

GONE = 4096  # requests that are remembered of what is gone


class ReuseOrder:
    """Requests of things that are held, or were. For one thread."""

    def __init__(self) -> None:
        self._clock = self._since = 0  # requests so far, and before this call
        self._last: OrderedDict[Hashable, int] = OrderedDict()  # of what is held, oldest first
        self._gap: dict[Hashable, float] = {}
        self._gone: OrderedDict[Hashable, int] = OrderedDict()
        # (-gap, -last, key) of requests of earlier calls; those with another last are void
        self._ranked: list[tuple[float, int, Hashable]] = []

    def ask(self, keys: Iterable[Hashable]) -> None:
        """Begin a call that asks for things; none of them makes room before the next call."""
        for key, last in reversed(self._last.items()):
            if last <= self._since:
                break
            heappush(self._ranked, (-self._gap[key], -last, key))
        if len(self._ranked) > 2 * len(self._last) + 64:
            self._ranked = [(-self._gap[key], -last, key) for key, last in self._last.items()]
            heapify(self._ranked)
        self._since = self._clock
        for key in keys:
            self._clock += 1
            before = self._last.pop(key, None) or self._gone.pop(key, None)
            self._gap[key] = math.inf if before is None else self._clock - before
            self._last[key] = self._clock

    def choose(self) -> Hashable | None:
        """What is to make room next; None if all that is held was asked for in this call."""
        oldest, last = next(iter(self._last.items()), (None, self._clock))
        if last > self._since:
            return None
        while self._last.get(self._ranked[0][2]) != -self._ranked[0][1]:
            heappop(self._ranked)
        gap, _, longest = self._ranked[0]
        return oldest if self._clock - last > -gap else longest

    def drop(self, key: Hashable) -> None:
        """A thing is no more held."""
        self._gone[key] = self._last.pop(key)
        del self._gap[key]
        if len(self._gone) > GONE:
            self._gone.popitem(last=False)
