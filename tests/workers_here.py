"""Workers without processes, for tests whose matter is what a run makes and not who runs it.

A process costs a second before its first episode. What crosses is encoded and decoded as it would
be on its way to one.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any, Self

import msgspec
import pytest

from gn0.bench import runner
from gn0.bench.episode_worker import WorkerObedient
from gn0.bench.executors import Heard, Pool, Worker, next_worker
from gn0.bench.pool_kinds import open_pool
from gn0.bench.worker_messages import FromWorker, Open, ToWorker
from gn0.jobs.process import Ended
from gn0.sim.policy import SLOT_VARIABLE


class PoolHere:
    """An executor whose workers do at once, and in this process, what they are told."""

    def __init__(self, settings: Open, workers: int) -> None:
        self.size = workers
        self.workers: dict[int, Worker] = {}
        self._settings = settings
        self._obeying: dict[int, WorkerObedient] = {}
        self._said: deque[tuple[int, bytes]] = deque()
        self._next = 0

    def start(self) -> Worker:
        worker = next_worker(self._next, self.workers)
        self._next += 1
        self.workers[worker.number] = worker
        self.send(worker, msgspec.structs.replace(self._settings, slot=worker.slot))
        return worker

    def send(self, worker: Worker, message: Any) -> None:
        number = worker.number
        heard: ToWorker = msgspec.json.decode(msgspec.json.encode(message), type=ToWorker)
        if number not in self._obeying:
            self._obeying[number] = WorkerObedient(
                lambda said: self._said.append((number, msgspec.json.encode(said)))
            )
        self._obeying[number].obey(heard)

    def hear(self, timeout: float) -> Heard | None:
        while not self._said:
            busy = [worker for worker in self._obeying.values() if worker.is_busy]
            if not busy:
                return None
            for worker in busy:
                worker.step()
        number, line = self._said.popleft()
        return Heard(number, msgspec.json.decode(line, type=FromWorker))

    def ask_where(self, worker: Worker) -> str:
        return ""

    def end(self, worker: Worker) -> Ended:
        self.workers.pop(worker.number, None)
        self._obeying.pop(worker.number, None)
        return Ended("was ended", "")

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.workers.clear()
        self._obeying.clear()


@contextmanager
def no_processes() -> Iterator[None]:
    """Runs by one worker stay in this process; several workers are processes, as for users."""

    def open_here(executor: str, settings: Open, workers: int, **more: Any) -> Pool:
        if executor == "process" and workers == 1 and not settings.drawing:
            return PoolHere(settings, workers)
        return open_pool(executor, settings, workers, **more)  # type: ignore[arg-type]

    with pytest.MonkeyPatch.context() as patch:
        patch.setenv(SLOT_VARIABLE, "0")  # a worker sets it
        patch.setattr(runner, "open_pool", open_here)
        yield
