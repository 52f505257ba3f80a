"""The device suite as a figure: a process a file, so that a lost card costs no more than one."""

from __future__ import annotations

import contextlib
import os
import re
import signal
import subprocess
import sys
import time
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

from gn0_figures.board import Figure, FigureContext, FigureRow, FigureSkipped, row_at_most
from gn0_figures.device import is_emulation

SUITE = Path(__file__).resolve().parents[2] / "tests" / "gpu"
CARD = SUITE.parent / "device" / "test_card.py"  # what only a card can answer
FILE_LIMIT = 150.0  # s, for a file of the suite
_DEATH = 10.0  # s that a killed process may take to be gone: a driver may hold it for ever
_LAST = re.compile(r"^=+ (.*) in [\d.]+s.*$", re.MULTILINE)
_COUNTS = re.compile(r"(\d+) (passed|failed|skipped|errors?|deselected)")
_RESULT = re.compile(r" (PASSED|FAILED|SKIPPED|ERROR)\b.*\[ *\d+%\]")
_SKIPPED = re.compile(r"^SKIPPED \[\d+\] \S+ (.*)$", re.MULTILINE)
_FAILED = re.compile(r"^(?:FAILED|ERROR) (.*)$", re.MULTILINE)
_TOLD = (0, 1, 5)  # exit codes of pytest that its last line explains; 5: all were deselected


class Run(NamedTuple):
    """A run of pytest: all that it said, its exit code (None: stopped), and its seconds."""

    said: str
    code: int | None
    seconds: float

    @property
    def end(self) -> str:
        """How it ended, in words."""
        return "ran out of time" if self.code is None else f"ended with {self.code}"


class PytestProcess:
    """pytest under way, in a process group of its own that `end()` ends as a whole.

    Args:
        ctx: the figure's context; its device, data and scenes are handed on.
        arguments: of pytest.
        said: file that takes what it says, so that this outlives a kill.
        before: a program that runs it, with options.
        threads: of compute libraries, as many as there are cores when 0.

    Raises:
        FigureSkipped: this is no checkout.
    """

    def __init__(
        self,
        ctx: FigureContext,
        arguments: Sequence[str],
        said: Path,
        before: Sequence[str] = (),
        threads: int = 0,
    ) -> None:
        if not SUITE.is_dir():
            raise FigureSkipped("needs a checkout: tests/gpu is not part of the package")
        environment = {**os.environ, "PYTHONUNBUFFERED": "1"}
        if is_emulation(ctx.device):
            environment["GN0_DEVICE"] = "host"
        if ctx.data is not None:
            environment["GN0_DATA"] = str(ctx.data)
        if ctx.scenes is not None:
            environment["GN0_FIGURE_SCENES"] = str(ctx.scenes.resolve())
        if threads:
            for library in ("NUMBA", "OMP", "OPENBLAS", "MKL"):
                environment[f"{library}_NUM_THREADS"] = str(threads)
        self._begin, self._said = time.monotonic(), said
        with said.open("w") as stream:
            self._process = subprocess.Popen(
                [*before, sys.executable, "-m", "pytest", "-p", "no:cacheprovider", *arguments],
                cwd=SUITE.parent.parent,
                env=environment,
                stdout=stream,
                stderr=subprocess.STDOUT,
                process_group=0,
            )

    @property
    def is_over(self) -> bool:
        """Whether it has ended by itself."""
        return self._process.poll() is not None

    @property
    def seconds(self) -> float:
        """Since it began [s]."""
        return time.monotonic() - self._begin

    def wait(self, limit: float) -> None:
        """Until it has ended, at most `limit` seconds."""
        with contextlib.suppress(subprocess.TimeoutExpired):
            self._process.wait(limit)

    def end(self) -> Run:
        """End all that is left of it: a kernel that never ends ends with its process."""
        code, seconds = self._process.poll(), self.seconds
        with contextlib.suppress(ProcessLookupError):
            os.killpg(self._process.pid, signal.SIGKILL)
        self.wait(_DEATH)
        return Run(self._said.read_text(errors="replace"), code, seconds)


def run_pytest(ctx: FigureContext, arguments: Sequence[str], limit: float) -> Run:
    """Pytest with these arguments, ended after `limit` seconds.

    Raises:
        FigureSkipped: this is no checkout.
    """
    process = PytestProcess(ctx, arguments, ctx.work / "said.txt")
    try:
        process.wait(limit)
    finally:
        done = process.end()
    return done


def show_hang(seconds: float) -> tuple[str, str]:
    """Options of pytest that say where a test is that takes longer than this."""
    return "-o", f"faulthandler_timeout={seconds:.0f}"


def measure_suite(ctx: FigureContext) -> list[FigureRow]:
    """`pytest tests/gpu tests/device/test_card.py`, a process a file, from a checkout.

    So a lost card, or a kernel that never ends, costs the rest of one file.

    Raises:
        FigureSkipped: this is no checkout.
    """
    paths, rows = [CARD, *sorted(SUITE.glob("test_*.py"))], []
    if is_emulation(ctx.device):  # the normal tests run them all
        paths = [CARD, SUITE / "test_input.py"]
    for path in paths:
        rows.append(_run_file(ctx, path))
        ctx.report(rows[-1])
    return rows


def _run_file(ctx: FigureContext, path: Path) -> FigureRow:
    """How many tests of a file fail; those that it did not come to count as one."""
    arguments = [str(path), "-v", "--tb=short", *show_hang(FILE_LIMIT - 50)]
    done = run_pytest(ctx, arguments, FILE_LIMIT)
    last = (_LAST.findall(done.said) or [""])[-1]
    counts = {word: int(n) for n, word in _COUNTS.findall(last)}
    failed = sum(counts.get(word, 0) for word in ("failed", "error", "errors"))
    failed = max(failed, int(done.code == 1))
    ended = ", ".join(f"{n} {word}" for word, n in counts.items()) + f", {done.seconds:.0f} s"
    if done.code not in _TOLD:
        seen = _RESULT.findall(done.said)
        failed = 1 + sum(word in ("FAILED", "ERROR") for word in seen)
        ended = f"{done.end} after {len(seen)} tests, {done.seconds:.0f} s"
    reasons = sorted(set(_SKIPPED.findall(done.said)))
    detail = "; ".join([ended, *_FAILED.findall(done.said), *reasons])
    if failed:
        print(done.said[-6000:])
    return row_at_most(f"tests that fail, {path.name}", failed, 0, "tests", detail[:1500])


FIGURES = [
    Figure("render.cuda.suite", "CUDA: the device suite", measure_suite, 3.0, backend="cuda")
]
