"""Worker processes as the runner sees them: started, spoken to, watched and ended by one parent."""

from __future__ import annotations

import contextlib
import os
import queue
import signal
import subprocess
import sys
import threading
import time
from collections import deque
from dataclasses import dataclass, field
from typing import IO, Any

import msgspec

from gn0.bench.messages import FromWorker, Open
from gn0.errors import BenchError

LAST_WORDS = 200  # lines of a worker's stderr that are kept
GRACE = 1.0  # s between asking a worker to end and ending it


@dataclass(frozen=True)
class Heard:
    """A message of a worker; None when it is gone."""

    worker: int
    message: FromWorker | None


@dataclass
class Worker:
    """One process.

    Attributes:
        number: its id in this run.
        process: the process.
        scene: hash of the scene it has loaded, or is loading.
        episode: the episode it holds a lease of, "" when idle.
        deadline: monotonic time [s] after which it counts as hung.
        last_words: the tail of its stderr.
    """

    number: int
    process: subprocess.Popen[bytes]
    scene: str = ""
    episode: str = ""
    deadline: float = float("inf")
    ready: bool = False
    last_words: deque[str] = field(default_factory=lambda: deque(maxlen=LAST_WORDS))
    listeners: list[threading.Thread] = field(default_factory=list)


class WorkerPool:
    """Starts and ends workers; use as a context manager, which ends all of them on the way out."""

    def __init__(self, settings: Open, workers: int) -> None:
        self.settings = settings
        self.size = workers
        self.heard: queue.Queue[Heard] = queue.Queue()
        self.workers: dict[int, Worker] = {}
        self._next = 0
        self._decoder = msgspec.json.Decoder(FromWorker)

    def start(self) -> Worker:
        """Start one worker and tell it which policy to build."""
        threads = str(max(1, len(os.sched_getaffinity(0)) // self.size)) if hasattr(
            os, "sched_getaffinity"
        ) else "1"  # fmt: skip
        environment = {
            **os.environ,
            "PYTHONPATH": os.pathsep.join(path or os.getcwd() for path in sys.path),
            "NUMBA_NUM_THREADS": threads,
            "OMP_NUM_THREADS": threads,
        }
        process = subprocess.Popen(
            [sys.executable, "-m", "gn0.bench.worker"],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            env=environment,
            start_new_session=True,  # Ctrl-C reaches the parent alone, which then ends us
        )
        worker = Worker(self._next, process)
        self._next += 1
        self.workers[worker.number] = worker
        for target, stream in ((self._hear, process.stdout), (self._hear_stderr, process.stderr)):
            thread = threading.Thread(target=target, args=(worker, stream), daemon=True)
            thread.start()
            worker.listeners.append(thread)
        self.send(worker, self.settings)
        return worker

    def _hear(self, worker: Worker, stream: IO[bytes]) -> None:
        with contextlib.suppress(ValueError, OSError, msgspec.DecodeError):
            for line in stream:
                self.heard.put(Heard(worker.number, self._decoder.decode(line)))
        self.heard.put(Heard(worker.number, None))

    def _hear_stderr(self, worker: Worker, stream: IO[bytes]) -> None:
        with contextlib.suppress(ValueError, OSError):
            for line in stream:
                worker.last_words.append(line.decode("utf-8", "replace").rstrip("\n")[:2000])

    def send(self, worker: Worker, message: Any) -> None:
        """Send a message; a worker that is gone is noticed by its listener."""
        assert worker.process.stdin is not None
        with contextlib.suppress(BrokenPipeError, OSError):
            worker.process.stdin.write(msgspec.json.encode(message) + b"\n")
            worker.process.stdin.flush()

    def hear(self, timeout: float) -> Heard | None:
        """The next message within `timeout` [s], or None."""
        try:
            return self.heard.get(timeout=max(0.0, timeout))
        except queue.Empty:
            return None

    def ask_where(self, worker: Worker) -> str:
        """Where a hung worker is: its Python stacks, as far as it can still tell them."""
        if hasattr(signal, "SIGUSR1"):
            before = len(worker.last_words)
            with contextlib.suppress(ProcessLookupError):
                worker.process.send_signal(signal.SIGUSR1)
            until = time.monotonic() + 0.5
            while time.monotonic() < until and len(worker.last_words) == before:
                time.sleep(0.02)
            time.sleep(0.05)
        return "\n".join(worker.last_words)

    def end(self, worker: Worker) -> str:
        """Kill one worker with whatever it started, and return its last words."""
        self._kill(worker)
        worker.process.wait()
        for thread in worker.listeners:
            thread.join(timeout=1.0)
        for stream in (worker.process.stdin, worker.process.stdout, worker.process.stderr):
            if stream is not None:
                with contextlib.suppress(OSError):
                    stream.close()
        self.workers.pop(worker.number, None)
        return "\n".join(worker.last_words)

    def _kill(self, worker: Worker) -> None:
        with contextlib.suppress(ProcessLookupError, PermissionError):
            if hasattr(os, "killpg"):
                os.killpg(worker.process.pid, signal.SIGKILL)
            else:
                worker.process.kill()

    def __enter__(self) -> WorkerPool:
        return self

    def __exit__(self, *_: object) -> None:
        for worker in list(self.workers.values()):
            self._kill(worker)
        for worker in list(self.workers.values()):
            self.end(worker)


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


def check_workers(workers: int) -> int:
    """The number of workers, if it makes sense.

    Raises:
        BenchError: less than one, or beyond reason.
    """
    if not 1 <= workers <= 1024:
        raise BenchError(f"{workers} workers", where="--workers", remedy="give 1 to 1024")
    return workers
