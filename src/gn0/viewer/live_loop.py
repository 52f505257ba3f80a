"""One thread does the live view's work; what a browser asks for is noted and done in turn.

A renderer serves one thread at a time, and viser calls back from many. A request with a key takes
the place of an older one with that key which has not begun: a slider that is dragged costs one
picture, not fifty.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable

Work = Callable[[], None]


class LiveLoop:
    """A queue of work for the thread that calls `run`."""

    def __init__(self) -> None:
        self._waiting: list[tuple[str, Work]] = []
        self._awake = threading.Condition()
        self._ended = False

    def post(self, work: Work, *, key: str = "") -> None:
        """Have something done soon; from any thread."""
        with self._awake:
            if key:
                self._waiting = [entry for entry in self._waiting if entry[0] != key]
            self._waiting.append((key, work))
            self._awake.notify()

    @property
    def pending(self) -> int:
        """How many requests wait."""
        with self._awake:
            return len(self._waiting)

    def stop(self) -> None:
        """Let `run` return after the work in hand."""
        with self._awake:
            self._ended = True
            self._awake.notify()

    def run(self, tick: Callable[[float], float | None] | None = None) -> None:
        """Do the work as it comes, until `stop` or an exception of the work itself.

        Args:
            tick: called when nothing waits, with the time [s]; returns after how many seconds it
                wants to be called again, or None when only new work can change that.
        """
        while True:
            with self._awake:
                if self._ended:
                    return
                entry = self._waiting.pop(0) if self._waiting else None
            if entry is not None:
                entry[1]()
                continue
            rest = tick(time.monotonic()) if tick is not None else None
            with self._awake:
                if not self._waiting and not self._ended:
                    # a wait with a limit, for without one Ctrl-C is not heard on every system
                    self._awake.wait(min(rest, 1.0) if rest is not None else 1.0)
