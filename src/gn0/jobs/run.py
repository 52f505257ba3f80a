"""Run one function over many payloads, in worker processes or on a Ray cluster.

A unit writes its own files, atomically, and answers with what its parent should note; the parent
keeps the journal. Units know nothing of each other, so their order and the number of workers decide
nothing but the time. A worker that dies takes no more than its unit with it, which is tried once
more in a new process.
"""

from __future__ import annotations

import time
from collections import Counter, deque
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

from gn0 import errors
from gn0.errors import Gn0Error, JobError
from gn0.jobs.executors import ExecutorName, check_executor, check_gpus, open_hosts
from gn0.jobs.pool import Pool, Worker, drive
from gn0.jobs.process import Ended
from gn0.jobs.worker import Answer, Told, Unit, work
from gn0.progress import Progress, no_progress

TRIES = 2  # of a unit whose worker dies or hangs
CODE = "gn0.jobs.worker:name_package"


def ignore_answer(index: int, answer: dict[str, Any]) -> None:
    """Note nothing."""


def run_jobs(
    function: str,
    payloads: Sequence[Mapping[str, Any]],
    *,
    workers: int = 1,
    executor: ExecutorName = "process",
    ray_address: str = "",
    gpus: float = 0,
    names: Sequence[str] | None = None,
    limit: float = float("inf"),
    done: Callable[[int, dict[str, Any]], None] = ignore_answer,
    failed: Callable[[int, Gn0Error], None] | None = None,
    what: str = "units",
    progress: Progress = no_progress,
    steps: Progress = no_progress,
) -> None:
    """Call `function` on every payload; `done(index, answer)` is called as they end.

    One worker on this machine is this very process. Several share its cores.

    Args:
        function: "module:name" of a function that takes and returns a dict of plain JSON values;
            one that takes `progress`, too, can tell of its steps.
        payloads: one a unit, tried in this order.
        workers: how many at a time.
        executor: "process" on this machine, "ray" on a cluster whose machines see the same files.
        ray_address: of a running cluster; "" starts one of this machine.
        gpus: cards that Ray sets aside for each worker.
        names: what to call units in errors; their numbers by default.
        limit: seconds that a unit may take before its worker counts as hung.
        done: hears of each unit once, in this process.
        failed: hears, instead, of one that raised; the others go on unless it raises, too. None:
            the first that raises ends all. One whose worker died or hung twice ends all in any
            case.
        what: the units' name in the progress bar.
        progress: progress sink.
        steps: progress sink of the steps within units, added up over all of them; their totals are
            not known where there are several units.

    Raises:
        ConfigError: fewer than one worker, or no such executor.
        JobError: a unit raised something unforeseen, or its worker died or hung twice.
        Gn0Error: what a unit raised on purpose, or `failed`; units that are running are given up.
        BenchError: Ray is not installed, does not answer, or has too few CPUs.
    """
    check_executor(executor, workers)
    check_gpus(executor, gpus)
    units = [Unit(i, function, dict(payload)) for i, payload in enumerate(payloads)]
    labels = list(names) if names is not None else [f"unit {i}" for i in range(len(units))]
    finished = 0

    def settle(answer: Answer) -> None:
        nonlocal finished
        if answer.value is not None:
            done(answer.index, answer.value)
        elif failed is not None:
            failed(answer.index, error_of(answer, labels[answer.index]))
        else:
            raise error_of(answer, labels[answer.index])
        finished += 1
        progress(what, finished, len(units))

    sums = _Sums(steps, alone=len(units) == 1)
    progress(what, 0, len(units))
    if executor == "process" and (workers == 1 or len(units) <= 1):
        for unit in units:
            settle(work(unit, sums.of(unit.index)))
    elif units:
        size = min(workers, len(units))
        hosts = open_hosts(
            executor, "gn0.jobs.worker", size, code=CODE, ray_address=ray_address, gpus=gpus
        )
        pool: Pool[_Seat, Answer | Told] = Pool(hosts, size, _Seat, Answer | Told)
        with pool:
            drive(pool, _Units(units, labels, limit, settle, sums))


def error_of(answer: Answer, label: str) -> Gn0Error:
    """The error that a unit raised, as it would have been without a worker."""
    if answer.code == JobError.code:
        return JobError(
            f"{label} failed: {answer.what}",
            where=label,
            remedy="this is a bug in the program; its trace:\n" + answer.remedy,
        )
    kinds = [k for k in vars(errors).values() if isinstance(k, type) and issubclass(k, Gn0Error)]
    kind = next((k for k in kinds if k.code == answer.code), Gn0Error)
    return kind(answer.what, where=answer.where, remedy=answer.remedy)


class _Sums:
    """The steps within units, added up: one bar, however many are at work.

    Args:
        sink: who draws.
        alone: there is but one unit, whose totals are those of all.
    """

    def __init__(self, sink: Progress, *, alone: bool) -> None:
        self._sink = sink
        self._alone = alone
        self._of: dict[tuple[str, int], int] = {}
        self._all: Counter[str] = Counter()

    def hear(self, index: int, stage: str, done: int, total: int) -> None:
        """A unit has come so far."""
        self._all[stage] += done - self._of.get((stage, index), 0)
        self._of[stage, index] = done
        self._sink(stage, self._all[stage], total if self._alone else 0)

    def of(self, index: int) -> Progress:
        """The sink of one unit."""
        return partial(self.hear, index)


@dataclass(eq=False)
class _Seat(Worker):
    """A worker and the unit that it holds."""

    unit: Unit | None = None


class _Units:
    """The crew of a pool that does units: see `gn0.jobs.pool.Crew`."""

    def __init__(
        self,
        units: Sequence[Unit],
        labels: Sequence[str],
        limit: float,
        settle: Callable[[Answer], None],
        sums: _Sums,
    ) -> None:
        self._waiting = deque(units)
        self._labels = labels
        self._limit = limit
        self._settle = settle
        self._sums = sums
        self._tries = dict.fromkeys(range(len(units)), 0)
        self._left = len(units)

    @property
    def is_done(self) -> bool:
        """Whether each unit was answered."""
        return not self._left

    def staff(self, pool: Pool[_Seat, Answer | Told]) -> None:
        """Give idle workers a unit; end those for whom there is none."""
        for worker in [w for w in pool.workers.values() if w.unit is None]:
            if self._waiting:
                self._lease(pool, worker)
            else:
                pool.end(worker)
        while self._waiting and len(pool.workers) < pool.size:
            self._lease(pool, pool.start())

    def _lease(self, pool: Pool[_Seat, Answer | Told], worker: _Seat) -> None:
        worker.unit = unit = self._waiting.popleft()
        worker.due = time.monotonic() + self._limit
        self._tries[unit.index] += 1
        pool.send(worker, unit)

    def hear(self, pool: Pool[_Seat, Answer | Told], worker: _Seat, message: Answer | Told) -> None:
        """Take an answer, or word of a step."""
        if isinstance(message, Told):
            self._sums.hear(message.index, message.stage, message.done, message.total)
            return
        self._settle(message)
        self._left -= 1
        worker.unit, worker.due = None, float("inf")

    def lose(self, worker: _Seat, ended: Ended) -> None:
        """Put a lost worker's unit in front again, or give up on it."""
        self._give_back(worker, ended.how, ended.last_words)

    def give_up(self, worker: _Seat, stacks: str) -> None:
        """A unit took too long."""
        self._give_back(worker, "hung", stacks)

    def _give_back(self, worker: _Seat, how: str, words: str) -> None:
        if worker.unit is None:
            return
        label = self._labels[worker.unit.index]
        if self._tries[worker.unit.index] >= TRIES:
            raise JobError(
                f"the worker of {label} {how}, {TRIES} times",
                where=label,
                remedy=f"its last words:\n{words}" if words.strip() else "is there enough memory?",
            )
        self._waiting.appendleft(worker.unit)
