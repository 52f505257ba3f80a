"""NVIDIA's checkers over the small device tests, as many processes side by side as there are cores.

A checker makes a kernel slow, and even more so what leads to it: patching each module takes a core
for seconds. So every tool's tests are dealt out into shares, and a share is a process.
"""

from __future__ import annotations

import os
import re
import shutil
import time
from collections import deque
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import NamedTuple

from msgspec.structs import replace

from gn0.jobs.process import count_cores
from gn0_figures.board import Figure, FigureContext, FigureRow, FigureSkipped, row_at_most
from gn0_figures.device import is_emulation, memory_left, trim_memory
from gn0_figures.device_suite import SUITE, PytestProcess, Run, run_pytest, show_hang

TOOLS = ("memcheck", "racecheck", "initcheck", "synccheck")
LIMIT = "GN0_FIGURE_SECONDS"  # for all, where less is left than ALL_LIMIT
ALL_LIMIT, JOB_LIMIT, PLAIN_LIMIT = 500.0, 460.0, 120.0  # s
_MEMORY = 2 << 30  # bytes of the card that a process may need
_PORTS = 16  # a checker and its process talk over one; by default they all try the same ten
_PORT = 20_000  # the first: below those that systems give away by themselves
_ATTACH = 60  # s to find its process; the ten by default are short for a loaded machine
_LOAD = 1.0  # s of a plain run that a test weighs beyond its own, for the modules it loads
_SUMMARY = re.compile(r"(?:ERROR|RACECHECK) SUMMARY: (\d+)")
_FOUND = re.compile(r"^=========(?! (?:COMPUTE-SANITIZER|ERROR SUMMARY|RACECHECK SUMMARY))", re.M)
_TEST = re.compile(r"^(\S+\.py::.+?) *$", re.M)
_SECONDS = re.compile(r"^([\d.]+)s (?:call|setup|teardown) +(\S+\.py::.+?) *$", re.M)
_OUTCOME = r"\b(PASSED|FAILED|SKIPPED|ERROR)\b[^\n]*\[ *\d+%\]"


class Job(NamedTuple):
    """Tests that one process runs under one tool."""

    tool: str
    tests: tuple[str, ...]


class Checked(NamedTuple):
    """A job that is over.

    Attributes:
        job: what was to be run.
        run: what came of it.
        errors: those that the tool counted; None without its summary.
        outcomes: PASSED, FAILED, SKIPPED or ERROR of each test that was reached.
    """

    job: Job
    run: Run
    errors: int | None
    outcomes: dict[str, str]

    @property
    def missed(self) -> list[str]:
        """Tests that it did not come to, or that did not come to an end."""
        return [test for test in self.job.tests if test not in self.outcomes]


def measure_sanitizers(ctx: FigureContext) -> list[FigureRow]:
    """memcheck, racecheck, initcheck and synccheck over the tests marked `small`.

    Raises:
        FigureSkipped: no compute-sanitizer here, or no card for it, or no checkout.
        RuntimeError: a tool did not come to all tests; rows of what it came to are reported.
    """
    sanitizer = shutil.which("compute-sanitizer")
    if sanitizer is None:
        raise FigureSkipped("needs compute-sanitizer (of the CUDA toolkit)")
    if is_emulation(ctx.device):
        raise FigureSkipped("compute-sanitizer checks kernels on a card, not their emulation")
    deadline = time.monotonic() + min(ALL_LIMIT, float(os.environ.get(LIMIT, ALL_LIMIT)))
    trim_memory(ctx.device)
    workers = count_workers(count_cores(), memory_left(ctx.device))
    tests = _collect(ctx)
    weights = _run_plain(ctx, tests)
    shares = deal_tests(weights, max(1, 2 * workers // 3))
    jobs = [Job(tool, share) for tool in TOOLS for share in shares]
    report = _Report(ctx, jobs)
    run_jobs(ctx, sanitizer, jobs, workers, deadline, report.take)
    return report.finish()


def count_workers(cores: int, memory: int) -> int:
    """Processes at a time: some cores are left to the checkers' own threads and to this process."""
    return max(1, min(max(cores - 4, cores // 2), memory // _MEMORY))


def deal_tests(weights: Mapping[str, float], count: int) -> list[tuple[str, ...]]:
    """At most `count` shares of about the same weight, the heaviest first.

    In a share the light tests come first: what runs out of time has then missed few.
    """
    shares: list[list[str]] = [[] for _ in range(min(count, len(weights)))]
    loads = [0.0] * len(shares)
    for test in sorted(weights, key=lambda test: (-weights[test], test)):
        least = loads.index(min(loads))
        shares[least].insert(0, test)
        loads[least] += weights[test]
    order = sorted(range(len(shares)), key=lambda k: -loads[k])
    return [tuple(shares[k]) for k in order]


def run_jobs(
    ctx: FigureContext,
    sanitizer: str,
    jobs: Sequence[Job],
    workers: int,
    deadline: float,
    take: Callable[[Checked], None],
) -> None:
    """Run the jobs, `workers` at a time, in order; `take` gets each as it ends.

    A job has JOB_LIMIT seconds and none goes on beyond `deadline` (of the monotonic clock).
    """
    waiting, running = deque(enumerate(jobs)), dict[Job, PytestProcess]()
    threads = max(1, count_cores() // workers)
    try:
        while waiting or running:
            is_late = time.monotonic() > deadline
            while waiting and not is_late and len(running) < workers:
                k, job = waiting.popleft()
                before = [sanitizer, "--tool", job.tool, "--launch-timeout", str(_ATTACH)]
                before += ["--port", str(_PORT + _PORTS * k), "--max-connections", str(_PORTS)]
                if job.tool == "racecheck":  # would else take every core for itself
                    before += ["--racecheck-num-workers", "1"]
                running[job] = PytestProcess(
                    ctx,
                    [*job.tests, "-v", "--tb=short", *show_hang(JOB_LIMIT - 40)],
                    ctx.work / f"said-{k}.txt",
                    before,
                    threads,
                )
            for job, process in list(running.items()):
                if process.is_over or is_late or process.seconds > JOB_LIMIT:
                    take(read_job(job, process.end()))
                    del running[job]
            while waiting and is_late:
                take(read_job(waiting.popleft()[1], Run("", None, 0.0)))
            time.sleep(0.1)
    finally:
        for process in running.values():
            process.end()


def read_job(job: Job, run: Run) -> Checked:
    """What a job's output tells: the tool speaks between a test's name and its outcome."""
    names = "|".join(re.escape(test) for test in sorted(job.tests, key=len, reverse=True))
    outcomes: dict[str, str] = {}
    name = ""
    for match in re.finditer(f"({names})|{_OUTCOME}", run.said):
        if match[1]:
            name = match[1]
        elif name:
            outcomes.setdefault(name, match[2])
    found = _SUMMARY.findall(run.said)
    return Checked(job, run, sum(map(int, found)) if found else None, outcomes)


def sum_up(tool: str, parts: Sequence[Checked]) -> FigureRow | None:
    """A tool's row, met only if every test was reached and none failed; None without a summary."""
    counted = [part.errors for part in parts if part.errors is not None]
    if not counted:
        return None
    seen = [word for part in parts for word in part.outcomes.values()]
    missed = list_missed(parts)
    bad = seen.count("FAILED") + seen.count("ERROR")
    told = [f"{seen.count('PASSED')} tests pass"]
    told += [f"{bad} fail"] if bad else []
    told += [f"{seen.count('SKIPPED')} are skipped"] if "SKIPPED" in seen else []
    seconds = [part.run.seconds for part in parts]
    told.append(f"{sum(seconds):.0f} s in {len(parts)} processes, the longest {max(seconds):.0f} s")
    if len(counted) < len(parts):
        told.append(f"no summary of {len(parts) - len(counted)} processes")
    if missed:
        told.append(f"{len(missed)} not reached: {', '.join(missed)}")
    row = row_at_most(f"{tool}, errors", sum(counted), 0, "errors", ", ".join(told)[:1500])
    is_whole = len(counted) == len(parts) and not missed and not bad and "PASSED" in seen
    return replace(row, passed=bool(row.passed) and is_whole)


def list_missed(parts: Iterable[Checked]) -> list[str]:
    """Tests that were not reached, by file and name."""
    return sorted(test.rsplit("/", 1)[-1] for part in parts for test in part.missed)


class _Report:
    """Takes jobs as they end, says what is wrong, and a tool's row once it has all of them."""

    def __init__(self, ctx: FigureContext, jobs: Sequence[Job]) -> None:
        self._ctx = ctx
        self._left = [job.tool for job in jobs]
        self._parts: dict[str, list[Checked]] = {tool: [] for tool in TOOLS}
        self._shown: set[tuple[str, str]] = set()
        self._rows: list[FigureRow] = []

    def take(self, part: Checked) -> None:
        tool = part.job.tool
        self._parts[tool].append(part)
        self._left.remove(tool)
        self._show(part)
        row = None if tool in self._left else sum_up(tool, self._parts[tool])
        if row is not None:
            self._rows.append(row)
            self._ctx.report(row)

    def _show(self, part: Checked) -> None:
        if part.errors:
            kind = "errors"
        elif part.errors is None or part.missed:
            kind = "no end"
        elif part.run.code:
            kind = "failed tests"
        else:
            return
        tool, run = part.job.tool, part.run
        if part.missed:
            print(f"{tool} {run.end}, without {', '.join(part.missed)}")
        is_new = (tool, kind) not in self._shown
        size = 1500 if kind in {shown for _, shown in self._shown} or kind != "errors" else 4000
        self._shown.add((tool, kind))
        if is_new and run.said:
            found = _FOUND.search(run.said)
            said = run.said[found.start() :][:size] if found else run.said[-size:]
            print(f"{tool}, {kind}, {run.end} after {run.seconds:.0f} s: {said}")

    def finish(self) -> list[FigureRow]:
        """The rows.

        Raises:
            RuntimeError: they do not tell of all tests.
        """
        wrong = []
        for tool, parts in self._parts.items():
            missed, mute = list_missed(parts), sum(part.errors is None for part in parts)
            if missed or mute:
                some = ", ".join(missed[:8]) + (" ..." if len(missed) > 8 else "")
                wrong.append(
                    f"{tool}: {mute} of {len(parts)} processes came to no summary"
                    + (f", {len(missed)} tests were not reached: {some}" if missed else "")
                )
        if wrong:
            raise RuntimeError("; ".join(wrong))
        return self._rows


def _collect(ctx: FigureContext) -> list[str]:
    """Names of the tests marked `small`."""
    done = run_pytest(ctx, [str(SUITE), "-m", "small", "--collect-only", "-q"], PLAIN_LIMIT)
    tests = _TEST.findall(done.said)
    if done.code != 0 or not tests:
        raise RuntimeError(f"no tests were collected, pytest {done.end}: {done.said[-1500:]}")
    return tests


def _run_plain(ctx: FigureContext, tests: Sequence[str]) -> dict[str, float]:
    """A weight a test [s], from a run without a checker.

    That run compiles what is not in the cache, which every process would else do by itself.
    """
    arguments = [*tests, "-v", "--tb=short", "--durations=0", *show_hang(PLAIN_LIMIT - 20)]
    done = run_pytest(ctx, arguments, PLAIN_LIMIT)
    if done.code != 0:
        print(f"without a checker: {done.end} after {done.seconds:.0f} s: {done.said[-1500:]}")
    weights = dict.fromkeys(tests, _LOAD)
    for seconds, test in _SECONDS.findall(done.said):
        if test in weights:
            weights[test] += float(seconds)
    return weights


FIGURES = [
    Figure(
        "render.cuda.sanitizers",
        "CUDA: compute-sanitizer over the small device tests",
        measure_sanitizers,
        5.0,
        backend="cuda",
    )
]
