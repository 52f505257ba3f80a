"""A worker process: started, spoken to in lines, watched and ended by its parent.

Closing a worker's stdin ends it, so no worker outlives its parent, however the parent dies.
"""

from __future__ import annotations

import contextlib
import os
import signal
import subprocess
import sys
import threading
import time
from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import IO

LAST_WORDS = 200  # lines of a worker's stderr that are kept
_LAST_STEPS = 2.0  # seconds that an interpreter on its way out may take


@dataclass(frozen=True)
class Ended:
    """How a worker ended, in words, and the tail of what it wrote to stderr."""

    how: str
    last_words: str


def describe_end(returncode: int | None) -> str:
    """How a process ended, in words."""
    if returncode is None:
        return "stopped answering"
    if returncode < 0:
        try:
            return f"was killed by {signal.Signals(-returncode).name}"
        except ValueError:
            return f"was killed by signal {-returncode}"
    return f"ended with exit code {returncode}"


def count_cores() -> int:
    """CPU cores that this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


class WorkerProcess:
    """One `python -m MODULE`.

    Args:
        module: what it runs.
        hear: called from another thread with each line it says, and with None when it is gone.
        threads: compute threads it may use.
        paths: its import path.
        arguments: its command line.
        folder: where it runs; here by default.
        left_out: environment variables that it does not inherit.
    """

    def __init__(
        self,
        module: str,
        hear: Callable[[bytes | None], None],
        threads: int,
        paths: Sequence[str],
        *,
        arguments: Sequence[str] = (),
        folder: Path | None = None,
        left_out: Sequence[str] = (),
    ) -> None:
        environment = {
            **{name: value for name, value in os.environ.items() if name not in left_out},
            "PYTHONPATH": os.pathsep.join(path or os.getcwd() for path in paths),
            "NUMBA_NUM_THREADS": str(threads),
            "OMP_NUM_THREADS": str(threads),
        }
        self._last_words: deque[str] = deque(maxlen=LAST_WORDS)
        self._process = subprocess.Popen(
            [sys.executable, "-m", module, *arguments],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            env=environment,
            cwd=folder,
            start_new_session=True,  # Ctrl-C reaches the parent alone, which then ends us
        )
        self._listeners = [
            threading.Thread(target=self._hear, args=(self._process.stdout, hear), daemon=True),
            threading.Thread(target=self._hear_stderr, args=(self._process.stderr,), daemon=True),
        ]
        for thread in self._listeners:
            thread.start()

    @property
    def pid(self) -> int:
        """Process id."""
        return self._process.pid

    def _hear(self, stream: IO[bytes], hear: Callable[[bytes | None], None]) -> None:
        with contextlib.suppress(ValueError, OSError):
            for line in stream:
                hear(line)
        hear(None)

    def _hear_stderr(self, stream: IO[bytes]) -> None:
        with contextlib.suppress(ValueError, OSError):
            for line in stream:
                self._last_words.append(line.decode("utf-8", "replace").rstrip("\n")[:2000])

    def send(self, line: bytes) -> None:
        """Send one message; a worker that is gone is noticed by its listener."""
        assert self._process.stdin is not None
        with contextlib.suppress(OSError, ValueError):
            self._process.stdin.write(line + b"\n")
            self._process.stdin.flush()

    def ask_where(self) -> str:
        """Its Python stacks on top of its last words; it tells them even with the GIL held."""
        if hasattr(signal, "SIGUSR1"):
            before = len(self._last_words)
            with contextlib.suppress(ProcessLookupError):
                self._process.send_signal(signal.SIGUSR1)
            until = time.monotonic() + 0.5
            while time.monotonic() < until and len(self._last_words) == before:
                time.sleep(0.02)
            time.sleep(0.05)
        return "\n".join(self._last_words)

    def kill(self) -> None:
        """Kill it with whatever it started; does not wait."""
        with contextlib.suppress(ProcessLookupError, PermissionError):
            if hasattr(os, "killpg"):
                os.killpg(self._process.pid, signal.SIGKILL)
            else:
                self._process.kill()

    def end(self) -> Ended:
        """Kill it, and say how it ended: by itself, where it has closed its stdout already."""
        if not self._listeners[0].is_alive() or self._process.poll() is not None:
            with contextlib.suppress(subprocess.TimeoutExpired):
                self._process.wait(timeout=_LAST_STEPS)  # else our kill would be told as its end
        self.kill()
        self._process.wait()
        for thread in self._listeners:
            thread.join(timeout=1.0)
        for stream in (self._process.stdin, self._process.stdout, self._process.stderr):
            if stream is not None:
                with contextlib.suppress(OSError):
                    stream.close()
        return Ended(describe_end(self._process.returncode), "\n".join(self._last_words))
