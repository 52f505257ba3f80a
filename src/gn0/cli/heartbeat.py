"""No step is silent: a long step is reported again every few seconds, and so is compiling.

Long steps tell nothing of themselves while they compute, and a fresh machine compiles kernels
inside of whatever needs them first. So a clock beside them speaks where a log would stay silent,
and a listener counts the kernels that Numba compiles.
"""

from __future__ import annotations

import contextlib
import sys
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

from gn0.progress import Progress

COMPILING = "compiling kernels (once)"
SILENCE = 5.0  # s after which a step that says nothing is said to go on
_TICK = 0.25  # s
_EVENT = "numba:compile"
# (stage, done and total as "1/3" or "" once it has ended, seconds without a word)
Still = Callable[[str, str, float], None]


class Heartbeat:
    """A progress sink before another one, which hears of the time between two events, too.

    Args:
        sink: who draws; called by one thread at a time.
        still: called when a step, or what follows it unnamed, has been silent for `SILENCE`, and
            again each time that it has.
        clock: seconds, as `time.monotonic`.
        begun: a step that is under way, of which nothing is said unless it takes long.
    """

    def __init__(
        self,
        sink: Progress,
        still: Still,
        clock: Callable[[], float] = time.monotonic,
        begun: str = "",
    ) -> None:
        self._sink = sink
        self._still = still
        self._clock = clock
        self._lock = threading.RLock()
        self._step: tuple[str, int, int] | None = (begun, 0, 0) if begun else None
        self._since = self._spoken = clock()
        self._compiled = self._depth = 0
        self._born = time.time()
        self._listener: Any = None

    def __call__(self, stage: str, done: int, total: int) -> None:
        """A step has begun or moved."""
        with self._lock:
            self._step = (stage, done, total)
            self._since = self._spoken = self._clock()
            self._sink(stage, done, total)

    def beat(self) -> None:
        """Look at the clock; says that a silent step goes on, and that others compile for it."""
        if self._listener is None:
            self._listener = _listen(self._hear)
        with self._lock:
            now = self._clock()
            if self._step is None or now - self._spoken < SILENCE:
                return
            stage, done, total = self._step
            ended = 0 < total <= done
            if not self._depth and _kernels_came(now - self._spoken):
                # in a process that works for this one: the cache says how many they are
                self._compiled = max(self._compiled, _count_kernels(self._born))
                self._sink(COMPILING, self._compiled, 0)
            self._still(stage, "" if ended else f"{done}/{total or '?'}", now - self._since)
            self._spoken = now

    def _hear(self, begins: bool) -> None:
        """Numba begins or ends to compile a kernel, perhaps inside of another."""
        with self._lock:
            self._depth += 1 if begins else -1
            self._compiled += not begins
            # the bar is full while nothing is compiled, and runs to and fro while something is
            self._sink(COMPILING, self._compiled, 0 if self._depth else self._compiled)

    def close(self) -> None:
        """Hear nothing more of Numba."""
        if self._listener is not None:
            with contextlib.suppress(Exception):
                sys.modules["numba.core.event"].unregister(_EVENT, self._listener)


@contextlib.contextmanager
def beating(sink: Progress, still: Still, begun: str = "") -> Iterator[Progress]:
    """A sink that is never silent for long; a thread looks at the clock until the block ends."""
    heart = Heartbeat(sink, still, begun=begun)
    ended = threading.Event()

    def run() -> None:
        while not ended.wait(_TICK):
            heart.beat()

    thread = threading.Thread(target=run, name="gn0 heartbeat", daemon=True)
    thread.start()
    try:
        yield heart
    finally:
        ended.set()
        thread.join()
        heart.close()


def _listen(hear: Callable[[bool], None]) -> Any:
    """Register with Numba once it is there; it is never imported for this."""
    event = sys.modules.get("numba.core.event")
    if not hasattr(sys.modules.get("numba"), "njit") or not hasattr(event, "install_listener"):
        return None
    assert event is not None

    class Listener(event.Listener):  # type: ignore[name-defined]
        def on_start(self, event: Any) -> None:
            hear(True)

        def on_end(self, event: Any) -> None:
            hear(False)

    listener = Listener()
    event.register(_EVENT, listener)
    return listener


def _kernels_came(seconds: float) -> bool:
    """Whether the cache of kernels has grown within the last so many seconds.

    Workers compile in processes of their own, which keep what they compiled in the same cache.
    """
    folder = _kernel_folder()
    if folder is None:
        return False
    least = time.time() - seconds
    with contextlib.suppress(OSError):
        return any(child.stat().st_mtime >= least for child in folder.iterdir() if child.is_dir())
    return False


def _count_kernels(since: float) -> int:
    """How many kernels were put into the cache since a time [s]."""
    folder = _kernel_folder()
    if folder is None:
        return 0
    with contextlib.suppress(OSError):
        return sum(kernel.stat().st_mtime >= since for kernel in folder.rglob("*.nbc"))
    return 0


def _kernel_folder() -> Path | None:
    jit = sys.modules.get("gn0.jit")
    folder: Path | None = getattr(jit, "kernel_cache", lambda: None)()
    return folder
