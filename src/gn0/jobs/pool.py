"""A pool of workers that exchange messages with their parent, wherever they live; its one loop."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from types import TracebackType
from typing import Any, Generic, Protocol, Self, TypeVar

import msgspec

from gn0.jobs.hosts import Goods, Hosts
from gn0.jobs.process import Ended

HEED = 1.0  # s at most that messages are read before somebody looks for hung workers
_WAIT = 60.0  # s at most that nothing may be heard before somebody looks at the clock


@dataclass(eq=False)
class Worker:
    """One worker as who gives it work sees it.

    Attributes:
        number: its id in this pool.
        slot: its place among its fellows; a successor takes it over.
        due: monotonic time [s] after which it counts as hung.
    """

    number: int
    slot: int = 0
    due: float = float("inf")

    @property
    def deadline(self) -> float:
        """Monotonic time [s] after which it counts as hung."""
        return self.due


W = TypeVar("W", bound=Worker)
M = TypeVar("M")


def free_slot(workers: Mapping[int, Worker]) -> int:
    """The first place that no worker has."""
    taken = {worker.slot for worker in workers.values()}
    return min(set(range(len(taken) + 1)) - taken)


def _nothing(_: Any) -> None:
    """Neither a greeting nor goods."""


@dataclass(frozen=True)
class Heard(Generic[M]):
    """A message of a worker; None when it is gone, or says what no worker says and so must go."""

    worker: int
    message: M | None


class Pool(Generic[W, M]):
    """Starts, hears and ends workers; a context manager that ends all of them on the way out.

    Args:
        hosts: where they live.
        size: how many are wanted at a time.
        make: a worker of (number, slot).
        hears: type of what workers say.
        greet: the first message to a worker, or None.
        goods: the folder that a message speaks of, or None.

    Attributes:
        workers: those that have been started and not ended, by number.
    """

    def __init__(
        self,
        hosts: Hosts,
        size: int,
        make: Callable[[int, int], W],
        hears: Any,
        *,
        greet: Callable[[W], Any] = _nothing,
        goods: Callable[[Any], Goods | None] = _nothing,
    ) -> None:
        self.hosts = hosts
        self.size = size
        self.workers: dict[int, W] = {}
        self._make = make
        self._greet = greet
        self._goods = goods
        self._decoder: msgspec.json.Decoder[M] = msgspec.json.Decoder(hears)
        self._next = 0

    def start(self) -> W:
        """Start one worker, in the first place that is free, and greet it."""
        worker = self._make(self._next, free_slot(self.workers))
        self._next += 1
        self.hosts.start(worker.number)
        self.workers[worker.number] = worker
        greeting = self._greet(worker)
        if greeting is not None:
            self.send(worker, greeting)
        return worker

    def send(self, worker: W, message: Any) -> None:
        """Send a message; a worker that is gone is noticed by `hear`, not here."""
        self.hosts.send(worker.number, msgspec.json.encode(message), self._goods(message))

    def hear(self, timeout: float) -> Heard[M] | None:
        """The next message within `timeout` [s], or None."""
        heard = self.hosts.hear(timeout)
        if heard is None:
            return None
        number, line = heard
        try:
            return Heard(number, None if line is None else self._decoder.decode(line))
        except msgspec.DecodeError:
            return Heard(number, None)

    def ask_where(self, worker: W) -> str:
        """Where a hung worker is: its Python stacks, as far as it can still tell them."""
        return self.hosts.ask_where(worker.number)

    def end(self, worker: W) -> Ended:
        """End one worker with whatever it started, however stuck it is."""
        self.workers.pop(worker.number, None)
        return self.hosts.end(worker.number)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.workers.clear()
        self.hosts.close()


class Crew(Protocol[W, M]):
    """Who knows what the workers of a pool are to do, and keeps what comes of it."""

    @property
    def is_done(self) -> bool:
        """Whether all has been done."""
        ...

    def staff(self, pool: Pool[W, M]) -> None:
        """Give idle workers something to do; start workers while there is work for them."""
        ...

    def hear(self, pool: Pool[W, M], worker: W, message: M) -> None:
        """Take a worker's message."""
        ...

    def lose(self, worker: W, ended: Ended) -> None:
        """A worker is gone, and what it held is to be done again or given up."""
        ...

    def give_up(self, worker: W, stacks: str) -> None:
        """A worker hung, and has been ended."""
        ...


def drive(pool: Pool[W, M], crew: Crew[W, M]) -> None:
    """Have a pool do what its crew wants done; returns when all is done."""
    crew.staff(pool)
    while not crew.is_done:
        now = time.monotonic()
        nearest = min((worker.deadline for worker in pool.workers.values()), default=now)
        heard = pool.hear(min(nearest - now, _WAIT))
        heed = time.monotonic() + HEED
        while heard is not None:  # what was said in time counts, however late we read it
            worker = pool.workers.get(heard.worker)
            if worker is not None and heard.message is None:
                crew.lose(worker, pool.end(worker))
            elif worker is not None and heard.message is not None:
                crew.hear(pool, worker, heard.message)
            crew.staff(pool)
            heard = pool.hear(0.0) if time.monotonic() < heed else None
        now = time.monotonic()
        for worker in [w for w in pool.workers.values() if w.deadline <= now]:
            stacks = pool.ask_where(worker)
            pool.end(worker)
            crew.give_up(worker, stacks)
        crew.staff(pool)
