"""Executors: where the workers of a run live. The runner speaks to all of them in the same words.

`process` keeps them on this machine as child processes; `ray` spreads them over a Ray cluster. An
executor only carries messages (see `gn0.bench.worker_messages`): what a worker does, and so every
byte of a result, is the same on each of them.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from types import TracebackType
from typing import Any, Protocol, Self

from gn0.bench.worker_messages import FromWorker
from gn0.errors import BenchError
from gn0.jobs.process import Ended


@dataclass(eq=False)
class Worker:
    """One worker as the runner sees it.

    Attributes:
        number: its id in this run.
        scene: the scene it has loaded, or is loading.
        leased: the episodes it holds a lease of, and by when each that has begun must have ended
            (monotonic time [s]); infinity for one that has not.
        alone: its one episode is not to run beside others.
        loading: by when it must have built its policy, or begun an episode.
        ready: its policy is built.
        slot: its place among its fellows.
    """

    number: int
    scene: str = ""
    leased: dict[str, float] = field(default_factory=dict)
    alone: bool = False
    loading: float = float("inf")
    ready: bool = False
    slot: int = 0

    @property
    def deadline(self) -> float:
        """Monotonic time [s] after which it counts as hung."""
        begun = min(self.leased.values(), default=float("inf"))
        waits = not self.ready or (bool(self.leased) and begun == float("inf"))
        return self.loading if waits else begun


def next_worker(number: int, workers: Mapping[int, Worker]) -> Worker:
    """A new worker, in the first place that is free among `workers`."""
    taken = {worker.slot for worker in workers.values()}
    return Worker(number, slot=min(set(range(len(taken) + 1)) - taken))


@dataclass(frozen=True)
class Heard:
    """A message of a worker; None when it is gone."""

    worker: int
    message: FromWorker | None


class Pool(Protocol):
    """Starts, hears and ends workers; a context manager that ends all of them on the way out.

    Attributes:
        size: how many workers are wanted at a time.
        workers: those that have been started and not ended, by number.
    """

    size: int
    workers: dict[int, Worker]

    def start(self) -> Worker:
        """Start one worker and tell it which policy to build."""
        ...

    def send(self, worker: Worker, message: Any) -> None:
        """Send a message; a worker that is gone is noticed by `hear`, not here."""
        ...

    def hear(self, timeout: float) -> Heard | None:
        """The next message within `timeout` [s], or None."""
        ...

    def ask_where(self, worker: Worker) -> str:
        """Where a hung worker is: its Python stacks, as far as it can still tell them."""
        ...

    def end(self, worker: Worker) -> Ended:
        """End one worker with whatever it started, however stuck it is."""
        ...

    def __enter__(self) -> Self: ...

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None: ...


def check_workers(workers: int) -> int:
    """The number of workers, if it makes sense.

    Raises:
        BenchError: less than one, or beyond reason.
    """
    if not 1 <= workers <= 1024:
        raise BenchError(f"{workers} workers", where="--workers", remedy="give 1 to 1024")
    return workers


def check_agents(agents: int) -> int:
    """The number of agents a worker, if it makes sense.

    Raises:
        BenchError: less than one, or beyond reason.
    """
    if not 1 <= agents <= 4096:
        raise BenchError(f"{agents} agents", where="--agents", remedy="give 1 to 4096")
    return agents
