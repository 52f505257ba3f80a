"""The map mode is part of a suite, of a run's identity, and of what is said about its numbers."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from gn0.bench.compare import compare_runs, name_difference
from gn0.bench.report import write_report
from gn0.bench.results import load_summary
from gn0.bench.runner import run_suite
from gn0.cli.main import main
from gn0.errors import BenchError, ConfigError, PolicyError
from gn0.sim.tasks import load_tasks
from gn0.suites.suite import Suite, load_suite

pytestmark = pytest.mark.usefixtures("workers_here")


def rewrite(suite: Suite, **changes: object) -> Path:
    path = suite.folder / "suite.json"
    path.write_text(json.dumps(json.loads(path.read_text()) | changes))
    return suite.folder


def test_a_mode_is_in_name_and_hash_and_nothing_else_changes(flats_suite: Suite) -> None:
    explored = flats_suite.with_map_mode("explored")
    assert flats_suite.map_mode == "prior" and explored.map_mode == "explored"
    assert explored.name == f"{flats_suite.name}+explored"
    assert flats_suite.with_map_mode("none").name.endswith("+none")
    assert explored.hash != flats_suite.hash
    assert explored.task_hash == flats_suite.task_hash == flats_suite.hash
    assert explored.episodes == flats_suite.episodes
    assert flats_suite.with_map_mode("prior") is flats_suite
    with pytest.raises(ConfigError, match="no map mode 'all'"):
        flats_suite.with_map_mode("all")


def test_a_suite_on_disk_keeps_its_mode(flat_folder: Path, tmp_path: Path) -> None:
    out = tmp_path / "suite"
    arguments = [str(flat_folder), "--episodes", "2", "--map-mode", "explored", "--out", str(out)]
    assert main(["bench", "suite", *arguments]) == 0
    assert load_suite(out).map_mode == "explored"
    assert load_tasks(suite=out).map_mode == "explored"


def test_a_suite_of_before_there_were_modes_means_prior(flat_folder: Path, tmp_path: Path) -> None:
    out = tmp_path / "suite"
    assert main(["bench", "suite", str(flat_folder), "--episodes", "2", "--out", str(out)]) == 0
    now = load_suite(out)
    older = load_suite(rewrite(now, map_mode="unknown_is_occupied"))
    assert older.map_mode == "prior" and older.hash == now.hash
    assert load_tasks(suite=out).map_mode == "prior"


@pytest.mark.slow
def test_runs_of_two_modes_are_compared_knowingly(
    flats_suite: Suite, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    places = {mode: tmp_path / mode for mode in ("prior", "explored", "none")}
    for mode, place in places.items():
        run_suite(flats_suite.with_map_mode(mode), "random", place, max_episodes=2)
        summary = load_summary(place)
        assert summary.map_mode == mode
        assert dict(summary.protocol)["map mode"].startswith(mode)
        assert "unknown cells count as occupied" in dict(summary.protocol)["the scene's map"]
    assert (places["prior"] / "results.jsonl").read_bytes() == (
        places["none"] / "results.jsonl"
    ).read_bytes(), "a policy that reads no map does not care"
    assert compare_runs(places["prior"], places["none"])
    assert name_difference(places["prior"], places["prior"]) == ""
    assert main(["bench", "compare", str(places["prior"]), str(places["explored"])]) == 0
    told = capsys.readouterr().out
    assert "A ran with map mode 'prior', B with 'explored'" in told
    page = write_report([places["prior"], places["none"]], tmp_path / "r.html", videos=0)
    text = page.read_text()
    assert "random, map prior" in text and "random, map none" in text


def test_a_folder_holds_runs_of_one_mode(flats_suite: Suite, tmp_path: Path) -> None:
    run_suite(flats_suite, "random", tmp_path / "run", max_episodes=1)
    with pytest.raises(BenchError, match="holds a run of another suite"):
        run_suite(flats_suite.with_map_mode("none"), "random", tmp_path / "run", max_episodes=1)


def test_a_map_policy_without_maps_is_refused_before_any_episode(
    flats_suite: Suite, tmp_path: Path
) -> None:
    with pytest.raises((PolicyError, ConfigError), match="map mode 'none' has no occupancy"):
        run_suite(flats_suite.with_map_mode("none"), "explorer", tmp_path / "run", max_episodes=1)
