"""What a user sees while a step computes: never nothing, and that kernels are compiled."""

from __future__ import annotations

import io
import os
import subprocess
import sys
import time
from pathlib import Path

import pytest

import gn0.cli.console as console
import gn0.cli.heartbeat as heartbeat
from gn0.cli.console import draw_progress
from gn0.cli.heartbeat import COMPILING, Heartbeat


class Recorder:
    """A sink, a clock and what was said."""

    def __init__(self) -> None:
        self.now = 0.0
        self.said: list[tuple[str, str, float]] = []
        self.shown: list[tuple[str, int, int]] = []
        self.heart = Heartbeat(
            lambda *step: self.shown.append(step),
            lambda *words: self.said.append(words),
            lambda: self.now,
        )

    def wait(self, seconds: float) -> None:
        for _ in range(int(seconds / 0.25)):
            self.now += 0.25
            self.heart.beat()


@pytest.fixture
def recorder(monkeypatch: pytest.MonkeyPatch) -> Recorder:
    monkeypatch.setattr(heartbeat, "_kernels_came", lambda seconds: False)
    return Recorder()


def test_a_step_of_17_seconds_is_said_to_go_on_every_5(recorder: Recorder) -> None:
    recorder.heart("light", 1, 4)
    recorder.wait(17)
    assert recorder.said == [("light", "1/4", 5.0), ("light", "1/4", 10.0), ("light", "1/4", 15.0)]
    assert recorder.shown == [("light", 1, 4)]


def test_a_step_that_moves_is_left_alone(recorder: Recorder) -> None:
    for done in range(5):
        recorder.heart("episodes", done, 9)
        recorder.wait(4)
    assert not recorder.said


def test_the_work_after_a_step_that_ended_is_not_silent_either(recorder: Recorder) -> None:
    recorder.heart("surfels", 3, 3)
    recorder.wait(6)
    assert recorder.said == [("surfels", "", 5.0)]


def test_a_verb_that_ends_at_once_says_nothing_and_a_long_one_does(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    with draw_progress("checking"):
        pass
    assert capsys.readouterr().err == ""
    monkeypatch.setattr(heartbeat, "SILENCE", 0.0)
    with draw_progress("checking") as progress:
        assert isinstance(progress, Heartbeat)
        progress.beat()
    assert "checking: 0/?, going on for 0 s" in capsys.readouterr().err


def test_workers_that_compile_are_spoken_for(
    recorder: Recorder, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    """What they have put into the cache is counted, so that the bar moves."""
    import gn0.jit

    monkeypatch.setattr(heartbeat, "_kernels_came", lambda seconds: seconds <= 5.5)
    monkeypatch.setattr(gn0.jit, "kernel_cache", lambda: tmp_path)
    recorder.heart("episodes", 0, 9)
    for kernels in range(2):
        recorder.wait(5)
        assert recorder.shown[-1] == (COMPILING, kernels, 0)
        new = tmp_path / f"module_{kernels}" / "kernel.nbc"
        new.parent.mkdir()
        new.touch()
        os.utime(new, (time.time() + 1, time.time() + 1))  # a file's clock may be a tick behind


def test_compiling_is_said_once_and_counted(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Kernels that call kernels, compiled within one step, as on a fresh machine."""
    import numba

    @numba.njit
    def inner(x):  # type: ignore[no-untyped-def]
        return x + 1

    @numba.njit
    def outer(x):  # type: ignore[no-untyped-def]
        return inner(x) * 2

    monkeypatch.setattr(console, "_QUIET_SECONDS", 1e9)  # however slow the machine is
    monkeypatch.setattr(heartbeat, "SILENCE", 1e9)
    with draw_progress() as progress:
        progress("planning", 0, 1)
        assert isinstance(progress, Heartbeat)
        progress.beat()  # Numba is listened to now
        assert outer(1) == 4
        progress("planning", 1, 1)
    lines = capsys.readouterr().err.splitlines()
    assert lines[:2] == ["planning: 0/1", COMPILING] and lines[-1].startswith("planning: 1/1")
    assert lines.count(COMPILING) == 1


class Terminal(io.StringIO):
    """A screen that remembers."""

    def isatty(self) -> bool:
        return True


def test_a_terminal_shows_a_verb_that_takes_long(monkeypatch: pytest.MonkeyPatch) -> None:
    screen = Terminal()
    monkeypatch.setattr(sys, "stderr", screen)
    with draw_progress("checking"):
        pass
    assert "checking" not in screen.getvalue()
    monkeypatch.setattr(heartbeat, "SILENCE", 0.0)
    with draw_progress("checking") as progress:
        assert isinstance(progress, Heartbeat)
        progress.beat()
    assert "checking" in screen.getvalue()


def test_a_terminal_shows_what_follows_a_step_that_ended(monkeypatch: pytest.MonkeyPatch) -> None:
    screen = Terminal()
    monkeypatch.setattr(sys, "stderr", screen)
    monkeypatch.setattr(heartbeat, "SILENCE", 0.0)
    monkeypatch.setattr(heartbeat, "_TICK", 0.01)
    with draw_progress() as progress:
        progress("surfels", 3, 3)
        deadline = time.monotonic() + 10
        while "after surfels" not in screen.getvalue():
            assert time.monotonic() < deadline, screen.getvalue()
        progress("writing", 1, 1)
    assert "writing" in screen.getvalue()


def test_the_clock_ends_with_the_command(tmp_path: Path) -> None:
    """No thread is left, and Numba is not imported for the sake of listening to it."""
    code = (
        "import sys, threading\n"
        "from gn0.cli.console import draw_progress\n"
        "with draw_progress() as p: p('x', 1, 1)\n"
        "assert threading.active_count() == 1 and 'numba' not in sys.modules\n"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr


def test_a_log_says_a_number_of_kernels_once(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """A worker's cache may be touched for minutes without anything new in it."""
    clock = iter(range(0, 1000, 10))
    monkeypatch.setattr(console.time, "monotonic", lambda: float(next(clock)))
    show = console._lines()
    for kernels in (0, 3, 3, 3, 7, 7):
        show(COMPILING, kernels, 0)
        show("episodes", 0, 10)
    lines = [line.split(",")[0] for line in capsys.readouterr().err.splitlines()]
    assert lines.count(f"{COMPILING}: 3 so far") == lines.count(f"{COMPILING}: 7 so far") == 1
    assert lines.count("episodes: 0/10") == 6
