"""Compile the kernels that a job will need, in processes beside it, on idle cores.

A fresh machine compiles every kernel once, and one process compiles one at a time. So others
compile what the job is known to call (`gn0.kernels.kernel_list`), from the end of that list: the
job itself begins at its front, and where they meet all is there. What was compiled stays in the
cache, so whoever is stopped goes on there the next time.
"""

from __future__ import annotations

import contextlib
import os
import queue
import sys
import threading
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from gn0.jobs.process import WorkerProcess, count_cores
from gn0.progress import Progress, no_progress

MOST = 8  # processes: more are not quicker, as kernels wait for those that they call
_PATIENCE = 600.0  # s that a kernel may take
_TRIES = 3  # processes that may fail, one after another: then the list is of other code
_PAUSE = 0.2  # s between two looks at what others compile
STAGE = "compiling kernels (once)"


@dataclass(frozen=True)
class Compiled:
    """What came of a list of calls: how many were compiled, were there, and did not compile."""

    made: int = 0
    kept: int = 0
    failed: int = 0


@contextlib.contextmanager
def compile_ahead(*jobs: str, cores: int = 4) -> Iterator[None]:
    """Compile what some jobs call while a block runs, where cores are free and anything is left.

    Args:
        jobs: sections of the list of calls.
        cores: fewer than these are left alone.
    """
    count = min(count_cores() - 1, MOST)
    first = os.environ.get("LOCAL_RANK", "0") == "0"  # of the processes of one job on this machine
    if count_cores() < cores or not first or is_compiled(*jobs):
        yield
        return
    ended = threading.Event()
    thread = threading.Thread(
        target=_compile, args=(jobs, count, no_progress, ended), daemon=True, name="gn0 compile"
    )
    thread.start()
    try:
        yield
    finally:
        ended.set()
        thread.join()


def compile_all(
    *jobs: str, processes: int | None = None, progress: Progress = no_progress
) -> Compiled:
    """Compile what some jobs call, or all jobs, in so many processes.

    Args:
        jobs: sections of the list of calls; all when none is named.
        processes: as many as there are cores, at most `MOST`, by default.
        progress: told of each call that is done.
    """
    return _compile(jobs, processes or min(count_cores(), MOST), progress, threading.Event())


def is_compiled(*jobs: str) -> bool:
    """Whether what some jobs call was compiled of this very source, as far as is known."""
    return _find_stamp(jobs).exists()


def _compile(
    jobs: Sequence[str], count: int, progress: Progress, ended: threading.Event
) -> Compiled:
    from gn0.kernels.kernel_list import list_calls

    crew = _Crew(list_calls(*jobs), progress, ended)
    threads = [threading.Thread(target=crew.work, daemon=True) for _ in range(count)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    done = crew.done
    if len(done) == crew.total and "failed" not in done:
        with contextlib.suppress(OSError):
            _find_stamp(jobs).touch()
    return Compiled(*(done.count(word) for word in ("compiled", "kept", "failed")))


class _Crew:
    """The calls that are left, and what became of the others; each thread has a process."""

    def __init__(self, calls: Sequence[str], progress: Progress, ended: threading.Event) -> None:
        self.total = len(calls)
        self.done: list[str] = []
        self._left = list(calls)
        self._later: list[str] = []  # others were at them
        self._progress = progress
        self._ended = ended
        self._lock = threading.Lock()

    def work(self) -> None:
        """Let a process compile one call after another until none is left."""
        for _ in range(_TRIES):
            if self._ended.is_set() or not (self._left or self._later):
                return
            said: queue.Queue[bytes | None] = queue.Queue()
            worker = WorkerProcess("gn0.kernels.kernel_worker", said.put, 1, sys.path)
            try:
                while self._ask_next(worker, said):
                    pass
            finally:
                worker.end()

    def _ask_next(self, worker: WorkerProcess, said: queue.Queue[bytes | None]) -> bool:
        """One call; whether the process can take another."""
        with self._lock:
            if not self._left:
                self._left, self._later = self._later, []
            call = self._left.pop() if self._left else ""
        if not call or self._ended.is_set():
            return False
        worker.send(call.encode())
        word = self._hear(said)
        with self._lock:
            if word == "nowhere":
                self._ended.set()
            if word in ("nowhere", "ended"):
                return False
            if word != "busy":
                self.done.append(word)
                self._progress(STAGE, len(self.done), self.total)
                return word != "failed"
            self._later.append(call)
        self._ended.wait(_PAUSE)  # or it would be asked for again and again, when it is the last
        return True

    def _hear(self, said: queue.Queue[bytes | None]) -> str:
        """Its answer, "failed" when it is gone or silent, or "ended" when none is wanted."""
        waited = 0.0
        while not self._ended.is_set() and waited < _PATIENCE:
            with contextlib.suppress(queue.Empty):
                return (said.get(timeout=0.2) or b"failed").decode().strip()
            waited += 0.2
        return "ended" if self._ended.is_set() else "failed"


def _find_stamp(jobs: Sequence[str]) -> Path:
    """A file of the kernel cache that is there when all was compiled; elsewhere there is none."""
    from importlib.metadata import version

    from gn0.kernels.kernel_list import list_calls, list_digest
    from gn0.storage import cache_dir
    from gn0.version import source_version

    folder = Path(os.environ.get("NUMBA_CACHE_DIR", "") or cache_dir() / "numba")
    ours = (source_version(("",)), version("numba"), version("llvmlite"), sys.version, *jobs)
    return folder / f"compiled-{list_digest((*ours, *list_calls(*jobs)))}"
