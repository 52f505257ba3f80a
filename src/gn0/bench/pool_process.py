"""Workers as child processes of this machine."""

from __future__ import annotations

import queue
import sys
from types import TracebackType
from typing import Any, Self

import msgspec

from gn0.bench.executors import Heard, Worker, next_worker
from gn0.bench.worker_messages import FromWorker, Open
from gn0.jobs.process import Ended, WorkerProcess, count_cores


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
            "gn0.bench.episode_worker",
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
