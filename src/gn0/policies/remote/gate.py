"""Who may wait for a policy: a bounded queue, so that no client waits forever.

A server asks one policy at a time. Who finds the queue full, or the memory for questions used up,
is told at once when to come again; those inside wait no longer than the queue is long. The times
told are one question apart, and places are kept for those whose time has come, so a crowd neither
knocks all the time nor is kept out by two who never pause.
"""

from __future__ import annotations

import contextlib
import threading
import time
from collections.abc import Hashable, Iterator

from gn0.errors import PolicyError

QUEUE_LIMIT = 8  # questions that wait while one is answered
BYTES_LIMIT = 128 << 20  # of all questions that are held
FIRST_GUESS = 0.05  # s a question takes, before any was answered
SHORTEST, LONGEST = 0.02, 30.0  # s after which to come again
_LATE = 0.1  # s after its time that a place is kept: the way of a message, and a sleep's slack
_SMOOTHING = 0.2  # share of the newest question in the mean


class BusyError(PolicyError):
    """The server has as many questions as it takes.

    Attributes:
        retry_after: seconds until it is worth asking again.
    """

    def __init__(self, retry_after: float) -> None:
        super().__init__(f"busy, retry after {retry_after:.2f} s")
        self.retry_after = retry_after


class Gate:
    """One question at a time, a few waiting, all others told to come again.

    Args:
        queue: how many may wait.
        size: bytes of questions held at a time.
    """

    def __init__(self, queue: int = QUEUE_LIMIT, size: int = BYTES_LIMIT) -> None:
        self.queue, self.size = queue, size
        self._turn = threading.Lock()
        self._count = threading.Lock()
        self._inside = self._held = 0
        self._mean = FIRST_GUESS
        self._booked: dict[Hashable, float] = {}  # when each of those told is to come again

    @property
    def is_full(self) -> bool:
        """Whether the next question would be turned away."""
        return self._inside > self.queue

    @property
    def inside(self) -> int:
        """Questions that are answered or wait."""
        return self._inside

    def retry_after(self) -> float:
        """Seconds until somebody without a place should ask: when all those before have been."""
        waiting = self._inside + len(self._booked)
        return min(max(self._mean * waiting, SHORTEST), LONGEST)

    def forget(self, who: Hashable) -> None:
        """Keep no place for somebody who has left."""
        with self._count:
            self._booked.pop(who, None)

    def _turn_away(self, who: Hashable, now: float, early: bool) -> BusyError:
        """Book a time after all others', or the next one for who came when told."""
        seconds = self.retry_after() if early else min(max(self._mean, SHORTEST), LONGEST)
        if who is not None:
            self._booked[who] = now + seconds
        return BusyError(seconds)

    @contextlib.contextmanager
    def enter(self, size: int, who: Hashable = None) -> Iterator[None]:
        """Wait for the turn of a question of so many bytes, and take it.

        Args:
            size: bytes of the question.
            who: asks; a place is kept for who comes again when told. None: nobody known.

        Raises:
            BusyError: at once, when too many wait or too much is held.
        """
        with self._count:
            now = time.monotonic()
            self._booked = {w: t for w, t in self._booked.items() if now < t + _LATE}
            early = now < self._booked.pop(who, now + LONGEST)
            due = sum(t < now + self._mean for t in self._booked.values()) if early else 0
            if self._inside + due > self.queue or (self._inside and self._held + size > self.size):
                raise self._turn_away(who, now, early)
            self._inside += 1
            self._held += size
        try:
            with self._turn:
                begun = time.monotonic()
                try:
                    yield
                finally:
                    took = time.monotonic() - begun
                    self._mean += _SMOOTHING * (took - self._mean)
        finally:
            with self._count:
                self._inside -= 1
                self._held -= size
