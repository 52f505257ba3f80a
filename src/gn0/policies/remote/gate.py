"""Who may wait for a policy: a queue with an end, so that nobody waits without bound.

A server asks one policy at a time. Who finds the queue full, or the memory for questions used up,
is told at once when to come again; those inside wait no longer than the queue is long.
"""

from __future__ import annotations

import contextlib
import threading
import time
from collections.abc import Iterator

from gn0.errors import PolicyError

QUEUE_LIMIT = 8  # questions that wait while one is answered
BYTES_LIMIT = 128 << 20  # of all questions that are held
FIRST_GUESS = 0.05  # s a question takes, before any was answered
SHORTEST, LONGEST = 0.02, 30.0  # s after which to come again
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
        self._inside = self._held = self._turned_away = 0
        self._mean = FIRST_GUESS

    @property
    def is_full(self) -> bool:
        """Whether the next question would be turned away."""
        return self._inside > self.queue

    @property
    def inside(self) -> int:
        """Questions that are answered or wait."""
        return self._inside

    def retry_after(self) -> float:
        """Seconds until it is worth asking again; not the same for all who ask at once."""
        spread = 1.0 + (self._turned_away % 8) / 8
        return min(max(self._mean * (1 + self._inside) * spread / 2, SHORTEST), LONGEST)

    @contextlib.contextmanager
    def enter(self, size: int) -> Iterator[None]:
        """Wait for the turn of a question of so many bytes, and take it.

        Raises:
            BusyError: at once, when too many wait or too much is held.
        """
        with self._count:
            if self._inside > self.queue or (self._inside and self._held + size > self.size):
                self._turned_away += 1
                raise BusyError(self.retry_after())
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
