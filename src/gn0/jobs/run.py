"""Run one function over many payloads, in worker processes or on a Ray cluster.

A unit writes its own files, atomically, and answers with what its parent should note; the parent
keeps the journal. Units know nothing of each other, so their order and the number of workers decide
nothing but the time. A worker that dies takes no more than its unit with it, which is tried once
more in a new process.
"""

from __future__ import annotations

import queue
import sys
import time
from collections import Counter, deque
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any, Literal

import msgspec

from gn0 import errors
from gn0.errors import ConfigError, Gn0Error, JobError
from gn0.jobs.cluster import import_ray, join_cluster
from gn0.jobs.process import WorkerProcess, count_cores
from gn0.jobs.worker import Answer, Told, Unit, work
from gn0.progress import Progress, no_progress

ExecutorName = Literal["process", "ray"]
TRIES = 2  # of a unit whose worker dies
_WAKE = 0.5  # s between looks at the clock


def ignore_answer(index: int, answer: dict[str, Any]) -> None:
    """Note nothing."""


def run_jobs(
    function: str,
    payloads: Sequence[Mapping[str, Any]],
    *,
    workers: int = 1,
    executor: ExecutorName = "process",
    ray_address: str = "",
    names: Sequence[str] | None = None,
    limit: float = float("inf"),
    done: Callable[[int, dict[str, Any]], None] = ignore_answer,
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
        names: what to call units in errors; their numbers by default.
        limit: seconds that a unit may take before its worker counts as hung.
        done: hears of each unit once, in this process.
        what: the units' name in the progress bar.
        progress: progress sink.
        steps: progress sink of the steps within units, added up over all of them; their totals are
            not known where there are several units. Nothing is heard from a cluster.

    Raises:
        ConfigError: fewer than one worker, or no such executor.
        JobError: a unit raised something unforeseen, or its worker died or hung twice.
        Gn0Error: what a unit raised on purpose; units that are running are given up.
        BenchError: Ray is not installed, or does not answer.
    """
    if not 1 <= workers <= 1024:
        raise ConfigError(f"{workers} workers", where="--workers", remedy="give 1 to 1024")
    if executor not in ("process", "ray"):
        raise ConfigError(f"no executor {executor!r}", where="--executor", remedy="process or ray")
    units = [Unit(i, function, dict(payload)) for i, payload in enumerate(payloads)]
    labels = list(names) if names is not None else [f"unit {i}" for i in range(len(units))]
    finished = 0

    def settle(answer: Answer) -> None:
        nonlocal finished
        if answer.value is None:
            raise _error_of(answer, labels[answer.index])
        done(answer.index, answer.value)
        finished += 1
        progress(what, finished, len(units))

    sums = _Sums(steps, alone=len(units) == 1)
    progress(what, 0, len(units))
    if executor == "ray":
        _run_on_ray(units, min(workers, max(len(units), 1)), ray_address, labels, settle)
    elif workers == 1 or len(units) <= 1:
        for unit in units:
            settle(work(unit, sums.of(unit.index)))
    else:
        _run_in_processes(units, min(workers, len(units)), limit, labels, settle, sums)


def _error_of(answer: Answer, label: str) -> Gn0Error:
    """The error that a unit raised, as it would have been without a worker."""
    if answer.code == JobError.code:
        return JobError(
            f"{label} failed: {answer.what}",
            where=label,
            remedy="this is a fault of the program; the trace:\n" + answer.remedy,
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
class _Seat:
    """A place at the work bench: a process and the unit that it holds."""

    process: WorkerProcess
    unit: Unit
    deadline: float


def _run_in_processes(
    units: Sequence[Unit],
    workers: int,
    limit: float,
    labels: Sequence[str],
    settle: Callable[[Answer], None],
    sums: _Sums,
) -> None:
    heard: queue.Queue[tuple[int, bytes | None]] = queue.Queue()
    waiting = deque(units)
    tries = dict.fromkeys(range(len(units)), 0)
    seats: dict[int, _Seat] = {}
    threads = max(1, count_cores() // workers)
    number = 0
    decoder: msgspec.json.Decoder[Answer | Told] = msgspec.json.Decoder(Answer | Told)

    def lease(process: WorkerProcess) -> _Seat:
        unit = waiting.popleft()
        tries[unit.index] += 1
        process.send(msgspec.json.encode(unit))
        return _Seat(process, unit, time.monotonic() + limit)

    def start(number: int) -> None:
        process = WorkerProcess(
            "gn0.jobs.worker", lambda line: heard.put((number, line)), threads, sys.path
        )
        seats[number] = lease(process)

    try:
        while waiting or seats:
            while waiting and len(seats) < workers:
                start(number)
                number += 1
            try:
                at, line = heard.get(timeout=_WAKE)
            except queue.Empty:
                now = time.monotonic()
                for late in [n for n, seat in seats.items() if seat.deadline < now]:
                    stacks = seats[late].process.ask_where()
                    _give_back(seats.pop(late), waiting, tries, labels, f"hung\n{stacks}")
                continue
            if at not in seats:
                continue
            if line is None:
                _give_back(seats.pop(at), waiting, tries, labels, "")
                continue
            message = decoder.decode(line)
            if isinstance(message, Told):
                sums.hear(message.index, message.stage, message.done, message.total)
                continue
            settle(message)
            seat = seats.pop(at)
            if waiting:
                seats[at] = lease(seat.process)
            else:
                seat.process.end()
    finally:
        for seat in seats.values():
            seat.process.kill()
        for seat in seats.values():
            seat.process.end()


def _give_back(
    seat: _Seat, waiting: deque[Unit], tries: Mapping[int, int], labels: Sequence[str], how: str
) -> None:
    """Put a lost worker's unit in front again, or give up on it."""
    ended = seat.process.end()
    label = labels[seat.unit.index]
    if tries[seat.unit.index] >= TRIES:
        words = how or f"{ended.how}\n{ended.last_words}"
        first, _, rest = words.partition("\n")
        raise JobError(
            f"the worker of {label} {first}, {TRIES} times",
            where=label,
            remedy=f"its last words:\n{rest}" if rest.strip() else "is there enough memory?",
        )
    waiting.appendleft(seat.unit)


def _work_on_ray(line: bytes) -> bytes:
    """One unit on a machine of a cluster: bytes in, bytes out."""
    return msgspec.json.encode(work(msgspec.json.decode(line, type=Unit)))


def _run_on_ray(
    units: Sequence[Unit],
    workers: int,
    address: str,
    labels: Sequence[str],
    settle: Callable[[Answer], None],
) -> None:
    ray = import_ray()
    ours = not ray.is_initialized()
    if ours:
        join_cluster(ray, workers, address)
    try:
        task = ray.remote(_work_on_ray).options(num_cpus=1, max_retries=TRIES - 1)
        waiting = deque(units)
        running: dict[Any, Unit] = {}
        while waiting or running:
            while waiting and len(running) < workers:
                unit = waiting.popleft()
                running[task.remote(msgspec.json.encode(unit))] = unit
            ended, _ = ray.wait(list(running), num_returns=1)
            for reference in ended:
                unit = running.pop(reference)
                try:
                    line = bytes(ray.get(reference))
                except ray.exceptions.RayError as error:
                    first = (str(error).splitlines() or [type(error).__name__])[0]
                    raise JobError(
                        f"the worker of {labels[unit.index]} was lost: {first}",
                        where=labels[unit.index],
                        remedy="is there enough memory?",
                    ) from None
                settle(msgspec.json.decode(line, type=Answer))
    finally:
        if ours:
            ray.shutdown()
