"""Comparing runs: a difference counts only when chance cannot explain it."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import stats

from gn0.bench.compare import compare_runs, name_pairing, paired_interval, sign_flip_chance
from gn0.bench.results import load_summary
from gn0.bench.runner import run_suite
from gn0.cli.main import main
from gn0.errors import BenchError, StorageError
from gn0.suites.suite import Suite, build_suite
from gn0_trials.simulated_suites import told_apart

pytestmark = pytest.mark.usefixtures("workers_here")


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


def test_an_interval_is_as_wide_as_a_t_interval() -> None:
    """Percentiles of a bootstrap are too narrow on few values: here by 2.5 % for twenty."""
    ratios = []
    for seed in range(30):
        d = np.random.default_rng(seed).normal(0.3, 1.0, 20)
        low, high = paired_interval(d, None, seed=seed, name="x")
        half = stats.t.ppf(0.975, 19) * d.std(ddof=1) / np.sqrt(20)
        ratios.append((high - low) / 2 / half)
    assert 0.985 < np.mean(ratios) < 1.01


def test_equal_policies_are_told_apart_at_most_once_in_twenty_times() -> None:
    suites = 100
    called = [
        round(suites * told_apart(suites, episodes, scenes, rate=rate))
        for episodes, scenes, rate in ((8, 1, False), (40, 3, True), (48, 8, False))
    ]
    # what a rate of 5 % gives in 300 draws but for once in a thousand times
    assert sum(called) <= stats.binom.ppf(0.999, 3 * suites, 0.05)
    assert told_apart(40, 60, 10, better=2.0) >= 0.8, "and a real difference is seen"


@pytest.mark.parametrize("units", [2, 3, 5])
def test_so_few_units_that_chance_explains_anything_tell_nothing(units: int) -> None:
    d = np.arange(1.0, units + 1)
    assert sign_flip_chance(d, None, seed=0, name="x") > 0.05
    scenes = [f"s{i % units}" for i in range(40)]
    ones = np.ones(40)
    assert sign_flip_chance(ones, scenes, seed=0, name="x") > 0.05
    assert sign_flip_chance(ones, None, seed=0, name="x") < 0.001


@given(values=st.lists(st.floats(-10, 10), min_size=1, max_size=40), seed=st.integers(0, 10))
def test_swapping_a_and_b_mirrors_the_answer(values: list[float], seed: int) -> None:
    d = np.array(values)
    low, high = paired_interval(d, None, seed=seed, name="x")
    assert low - 1e-12 <= d.mean() <= high + 1e-12 or len(d) > 5
    mirrored = paired_interval(-d, None, seed=seed, name="x")
    assert mirrored == pytest.approx((-high, -low))
    chance = sign_flip_chance(d, None, seed=seed, name="x")
    assert 0 < chance <= 1 and chance == sign_flip_chance(-d, None, seed=seed, name="x")


def test_a_sign_flip_chance_is_that_of_counting_all_flips() -> None:
    d = np.array([0.3, -0.1, 0.5, 0.8, 0.2, -0.4, 0.6, 0.1])
    flips = (2 * ((np.arange(256)[:, None] >> np.arange(8)) & 1) - 1) @ d
    exact = float((np.abs(flips) >= abs(d.sum()) - 1e-12).mean())
    assert sign_flip_chance(d, None, seed=3, name="x") == pytest.approx(exact, abs=0.015)
    assert sign_flip_chance(np.zeros(9), None, seed=0, name="x") == 1.0


def test_what_a_comparison_rests_on_is_said(
    flats_suite: Suite, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    run_suite(flats_suite, "oracle", tmp_path / "a")
    run_suite(flats_suite, "random", tmp_path / "b", max_episodes=9)
    assert name_pairing(tmp_path / "a", tmp_path / "a") == ""
    assert main(["bench", "compare", str(tmp_path / "a"), str(tmp_path / "b")]) == 0
    said = capsys.readouterr().out
    assert "9 episodes were scored by both; left out: 3 that only A scored, 0 that only B" in said
    assert "a verdict holds for these scenes, other episodes" in said
    rows = {r.metric.key: r for r in compare_runs(tmp_path / "a", tmp_path / "b")}
    assert rows["SR"].wins + rows["SR"].losses <= rows["SR"].episodes == 9
    assert rows["SPL"].chance <= 0.05 and rows["SPL"].unit == "episode"
    by_scene = {r.metric.key: r for r in compare_runs(tmp_path / "a", tmp_path / "b", unit="scene")}
    assert by_scene["SPL"].verdict == "nobody can tell", "two scenes say nothing of a third"


def test_a_refusal_names_what_differs(flat_folder: Path, tmp_path: Path) -> None:
    for name, more in (("a", {}), ("b", {"max_steps": 40, "profile": "paper"})):
        suite = build_suite([flat_folder], tmp_path / f"suite-{name}", 2, **more)  # type: ignore[arg-type]
        run_suite(suite, "random", tmp_path / name)
    with pytest.raises(BenchError, match=r"they differ in .*step limit") as caught:
        compare_runs(tmp_path / "a", tmp_path / "b")
    assert "navigation error" in str(caught.value)


def test_walks_of_an_examination_and_other_folders_are_no_runs(tmp_path: Path) -> None:
    with pytest.raises(StorageError, match="no run there") as caught:
        load_summary(tmp_path)
    assert "gn0 bench run" in caught.value.remedy
    (tmp_path / "walks.jsonl").touch()
    with pytest.raises(StorageError, match="walks of gn0 policy examine") as caught:
        load_summary(tmp_path)
    assert "gn0 policy study" in caught.value.remedy
