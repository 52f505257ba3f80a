"""Workers without processes, for tests whose matter is what a run makes and not who runs it.

A process costs a second before its first episode. What crosses is encoded and decoded as it would
be on its way to one.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import msgspec
import pytest

from gn0.bench import runner
from gn0.bench.episode_worker import WorkerObedient
from gn0.bench.executors import EpisodePool, open_pool, pool_of
from gn0.bench.worker_messages import Open, ToWorker
from gn0.jobs.hosts import Goods
from gn0.jobs.process import Ended
from gn0.sim.policy import SLOT_VARIABLE


class HostsHere:
    """Workers that do at once, and in this process, what they are told."""

    def __init__(self) -> None:
        self._obeying: dict[int, WorkerObedient] = {}
        self._said: deque[tuple[int, bytes]] = deque()

    def start(self, number: int) -> None:
        self._obeying[number] = WorkerObedient(
            lambda said: self._said.append((number, msgspec.json.encode(said)))
        )

    def send(self, number: int, line: bytes, goods: Goods | None = None) -> None:
        self._obeying[number].obey(msgspec.json.decode(line, type=ToWorker))

    def hear(self, timeout: float) -> tuple[int, bytes | None] | None:
        while not self._said:
            busy = [worker for worker in self._obeying.values() if worker.is_busy]
            if not busy:
                return None
            for worker in busy:
                worker.step()
        return self._said.popleft()

    def ask_where(self, number: int) -> str:
        return ""

    def end(self, number: int) -> Ended:
        self._obeying.pop(number, None)
        return Ended("was ended", "")

    def close(self) -> None:
        self._obeying.clear()


@contextmanager
def no_processes() -> Iterator[None]:
    """Runs by one worker stay in this process; several workers are processes, as for users."""

    def open_here(executor: str, settings: Open, workers: int, **more: Any) -> EpisodePool:
        if executor == "process" and workers == 1 and not settings.drawing:
            return pool_of(HostsHere(), settings, workers)
        return open_pool(executor, settings, workers, **more)  # type: ignore[arg-type]

    with pytest.MonkeyPatch.context() as patch:
        patch.setenv(SLOT_VARIABLE, "0")  # a worker sets it
        patch.setattr(runner, "open_pool", open_here)
        yield
