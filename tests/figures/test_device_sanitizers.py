"""The checkers' figure with a pretended checker: dealing out, collecting, and what hangs."""

from __future__ import annotations

import time
from pathlib import Path
from typing import Any

import pytest

from gn0_figures import device_sanitizers, device_suite
from gn0_figures.board import FigureContext, FigureRow
from gn0_figures.device_sanitizers import Job, count_workers, deal_tests, read_job, sum_up
from gn0_figures.device_suite import Run

TESTS = {
    "test_a.py": "def test_one(): pass\n"
    "@pytest.mark.parametrize('how', ['a b', 'a'])\ndef test_many(how): pass\n",
    "test_b.py": "def test_other(): pass\ndef test_absent(): pytest.skip('no card')\n",
}
CHECKER = """#!/bin/sh
tool=$2
while [ "${1#-}" != "$1" ]; do shift 2; done
echo ========= COMPUTE-SANITIZER
case "$tool $*" in
  MUTE*one*) sleep 600 & echo $! > "$0.pid"; wait ;;
esac
"$@"
code=$?
case "$tool $*" in
  BAD*one*) echo ========= Invalid read; echo ========= ERROR SUMMARY: 2 errors ;;
  racecheck*) echo "========= RACECHECK SUMMARY: 0 hazards displayed (0 errors, 0 warnings)" ;;
  *) echo ========= ERROR SUMMARY: 0 errors ;;
esac
exit $code
"""


class Card:
    """In a card's place: it has a name and memory."""

    kind = "pretended"

    def memory(self) -> tuple[int, int]:
        return 9 << 30, 9 << 30


@pytest.fixture
def ctx(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> FigureContext:
    """A checkout with a suite of five tests, and a checker that checks nothing."""
    suite = tmp_path / "checkout" / "tests" / "gpu"
    suite.mkdir(parents=True)
    (tmp_path / "checkout" / "pytest.ini").write_text("[pytest]\nmarkers = small\naddopts = -ra\n")
    for name, text in TESTS.items():
        (suite / name).write_text(f"import pytest\npytestmark = pytest.mark.small\n{text}")
    (suite / "test_large.py").write_text("def test_large(): assert False\n")
    checker = tmp_path / "bin" / "compute-sanitizer"
    checker.parent.mkdir()
    checker.write_text(CHECKER)
    checker.chmod(0o755)
    monkeypatch.setenv("PATH", str(checker.parent), prepend=":")
    monkeypatch.setattr(device_sanitizers, "SUITE", suite)
    monkeypatch.setattr(device_suite, "SUITE", suite)
    said: list[FigureRow] = []
    context = FigureContext(data=None, work=tmp_path, device=Card(), report=said.append)
    object.__setattr__(context, "said", said)
    return context


def _said(ctx: FigureContext) -> list[FigureRow]:
    said: list[FigureRow] = ctx.said  # type: ignore[attr-defined]
    return said


@pytest.mark.slow
def test_every_tool_covers_all_tests(ctx: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(device_sanitizers, "TOOLS", ("memcheck", "racecheck"))
    monkeypatch.setattr(device_sanitizers, "count_workers", lambda cores, memory: 3)
    rows = device_sanitizers.measure_sanitizers(ctx)
    assert _said(ctx) == rows
    assert [row.name for row in rows] == ["memcheck, errors", "racecheck, errors"]
    for row in rows:
        assert (row.value, row.passed) == (0, True)
        assert row.detail.startswith("4 tests pass, 1 are skipped, ")
        assert " s in 2 processes, the longest " in row.detail


@pytest.mark.slow  # waits for a hang to be noticed
def test_errors_and_hangs_are_told(
    ctx: Any, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(device_sanitizers, "TOOLS", ("BAD", "MUTE"))
    monkeypatch.setattr(device_sanitizers, "JOB_LIMIT", 15.0)
    monkeypatch.setattr(device_sanitizers, "count_workers", lambda cores, memory: 3)
    with pytest.raises(RuntimeError, match=r"^MUTE: 1 of 2 .*a\.py::test_one") as raised:
        device_sanitizers.measure_sanitizers(ctx)
    hung = Path(
        "/proc", (ctx.work / "bin" / "compute-sanitizer.pid").read_text().strip(), "cmdline"
    )
    while hung.exists() and hung.read_bytes():
        time.sleep(0.05)  # until who hangs is ended, with all that it began
    assert "BAD" not in str(raised.value)
    bad, mute = _said(ctx)
    assert (bad.value, bad.passed) == (2, False)
    assert (mute.value, mute.passed) == (0, False)
    assert "no summary of 1 processes" in mute.detail
    assert "test_a.py::test_one" in mute.detail
    told = capsys.readouterr().out
    assert "BAD, errors, ended with 0" in told
    assert "========= Invalid read" in told
    assert "MUTE ran out of time, without " in told


def test_what_does_not_begin_in_time_is_named(ctx: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(device_sanitizers, "TOOLS", ("memcheck",))
    monkeypatch.setenv(device_sanitizers.LIMIT, "0")
    with pytest.raises(RuntimeError, match=r"5 tests were not reached: test_a\.py"):
        device_sanitizers.measure_sanitizers(ctx)
    assert not _said(ctx), "a tool without any summary has no row"


def test_shares_are_fair() -> None:
    weights = {"a": 9.0, "b": 1.0, "c": 2.0, "d": 5.0, "e": 3.0}
    shares = deal_tests(weights, 2)
    assert sorted(test for share in shares for test in share) == sorted(weights)
    assert sorted(sum(weights[test] for test in share) for share in shares) == [10, 10]
    assert all(list(share) == sorted(share, key=weights.__getitem__) for share in shares)
    assert deal_tests(weights, 9)[0] == ("a",), "no share is empty, the heaviest is begun first"
    assert len(deal_tests(weights, 9)) == 5
    assert count_workers(16, 100 << 30) == 12
    assert count_workers(16, 7 << 30) == 3
    assert count_workers(2, 100 << 30) == count_workers(1, 0) == 1


def test_an_outcome_belongs_to_its_test() -> None:
    """A checker speaks in between; a test that was begun and never ended was not reached."""
    job = Job("memcheck", ("t.py::a", "t.py::a[1]", "t.py::b", "t.py::c"))
    said = """t.py::a ========= Invalid __global__ read: LAUNCH_FAILED
========= at FAILED
PASSED                 [ 25%]
t.py::a[1] FAILED      [ 50%]
t.py::b SKIPPED (none) [ 75%]
t.py::c ========= ERROR SUMMARY: 1 error
FAILED t.py::c - x
"""
    part = read_job(job, Run(said, 1, 2.0))
    assert part.outcomes == {"t.py::a": "PASSED", "t.py::a[1]": "FAILED", "t.py::b": "SKIPPED"}
    assert part.errors == 1
    assert part.missed == ["t.py::c"]
    row = sum_up("memcheck", [part])
    assert row is not None
    assert row.passed is False
    assert "1 not reached: t.py::c" in row.detail
    assert "1 fail" in row.detail
    clean = read_job(Job("m", ("t.py::b",)), Run("t.py::b SKIPPED [100%]\nERROR SUMMARY: 0", 0, 1))
    row = sum_up("m", [clean])
    assert row is not None
    assert row.passed is False, "nothing was checked"
