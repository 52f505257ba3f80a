"""Comparing runs: a difference counts only when chance cannot explain it."""

from __future__ import annotations

from pathlib import Path

import pytest

from gn0.bench.compare import compare_runs
from gn0.bench.runner import run_suite
from gn0.bench.suite import Suite, build_suite
from gn0.errors import BenchError, StorageError


def test_the_oracle_beats_chance_and_nothing_beats_itself(
    flats_suite: Suite, tmp_path: Path
) -> None:
    run_suite(flats_suite, "oracle", tmp_path / "oracle")
    run_suite(flats_suite, "random", tmp_path / "random")
    rows = {r.metric.key: r for r in compare_runs(tmp_path / "oracle", tmp_path / "random")}
    for key in ("SR", "SPL", "NE_geo", "nDTW"):
        assert rows[key].verdict == "A is better", str(rows[key])
    assert rows["SR"].episodes == 12
    assert rows["SR"].low <= rows["SR"].difference <= rows["SR"].high
    swapped = {r.metric.key: r for r in compare_runs(tmp_path / "random", tmp_path / "oracle")}
    assert swapped["NE_geo"].verdict == "B is better"
    assert swapped["SR"].difference == -rows["SR"].difference
    for row in compare_runs(tmp_path / "oracle", tmp_path / "oracle"):
        assert (row.difference, row.verdict) == (0.0, "nobody can tell")
        assert "nobody can tell" in str(row)


def test_runs_of_different_suites_are_not_compared(
    flats_suite: Suite, flat_folder: Path, tmp_path: Path
) -> None:
    other = build_suite([flat_folder], tmp_path / "suite", 2)
    run_suite(other, "random", tmp_path / "a")
    run_suite(flats_suite, "random", tmp_path / "b", max_episodes=2)
    with pytest.raises(BenchError, match="compare runs of one suite"):
        compare_runs(tmp_path / "a", tmp_path / "b")
    with pytest.raises(StorageError):
        compare_runs(tmp_path / "a", tmp_path / "nothing")
