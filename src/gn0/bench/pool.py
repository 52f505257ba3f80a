"""Workers as child processes of this machine: started, spoken to, watched and ended by one parent.

Closing a worker's stdin ends it, so no worker outlives its parent, however the parent dies.
"""

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
from collections.abc import Callable, Sequence
from types import TracebackType
from typing import IO, Any, Self

import msgspec

from gn0.bench.executors import Ended, Heard, Worker, count_cores, describe_end, next_worker
from gn0.bench.messages import FromWorker, Open

LAST_WORDS = 200  # lines of a worker's stderr that are kept


class WorkerProcess:
    """One `python -m gn0.bench.worker`.

    Args:
        hear: called from another thread with each line it says, and with None when it is gone.
        threads: compute threads it may use.
        paths: its import path.
    """

    def __init__(
        self, hear: Callable[[bytes | None], None], threads: int, paths: Sequence[str]
    ) -> None:
        environment = {
            **os.environ,
            "PYTHONPATH": os.pathsep.join(path or os.getcwd() for path in paths),
            "NUMBA_NUM_THREADS": str(threads),
            "OMP_NUM_THREADS": str(threads),
        }
        self._last_words: deque[str] = deque(maxlen=LAST_WORDS)
        self._process = subprocess.Popen(
            [sys.executable, "-m", "gn0.bench.worker"],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            env=environment,
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
        """Kill it, and say how it ended."""
        self.kill()
        self._process.wait()
        for thread in self._listeners:
            thread.join(timeout=1.0)
        for stream in (self._process.stdin, self._process.stdout, self._process.stderr):
            if stream is not None:
                with contextlib.suppress(OSError):
                    stream.close()
        return Ended(describe_end(self._process.returncode), "\n".join(self._last_words))


class PoolProcess:
    """The executor `process`: see `gn0.bench.executors.Pool`."""

    def __init__(self, settings: Open, workers: int) -> None:
        self.size = workers
        self.workers: dict[int, Worker] = {}
        self._settings = settings
        self._processes: dict[int, WorkerProcess] = {}
        self._heard: queue.Queue[tuple[int, bytes | None]] = queue.Queue()
        self._decoder = msgspec.json.Decoder(FromWorker)
        self._next = 0

    def start(self) -> Worker:
        """Start one worker and tell it which policy to build."""
        worker = next_worker(self._next, self.workers)
        self._next += 1
        self._processes[worker.number] = WorkerProcess(
            lambda line: self._heard.put((worker.number, line)),
            max(1, count_cores() // self.size),
            sys.path,
        )
        self.workers[worker.number] = worker
        self.send(worker, msgspec.structs.replace(self._settings, slot=worker.slot))
        return worker

    def send(self, worker: Worker, message: Any) -> None:
        """Send a message."""
        self._processes[worker.number].send(msgspec.json.encode(message))

    def hear(self, timeout: float) -> Heard | None:
        """The next message within `timeout` [s], or None."""
        try:
            number, line = self._heard.get(timeout=max(0.0, timeout))
        except queue.Empty:
            return None
        return Heard(number, decode_line(self._decoder, line))

    def ask_where(self, worker: Worker) -> str:
        """Where a hung worker is."""
        return self._processes[worker.number].ask_where()

    def end(self, worker: Worker) -> Ended:
        """End one worker."""
        self.workers.pop(worker.number, None)
        return self._processes.pop(worker.number).end()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        for process in self._processes.values():
            process.kill()
        for worker in list(self.workers.values()):
            self.end(worker)


def decode_line(decoder: msgspec.json.Decoder[FromWorker], line: bytes | None) -> FromWorker | None:
    """A message; None when the worker is gone, or says what no worker says and so must go."""
    if line is None:
        return None
    try:
        return decoder.decode(line)
    except msgspec.DecodeError:
        return None
