"""A recorded walk becomes a dataset of its own: labelled with what was done, taken by exporters."""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np
import pytest

from gn0.bench.report import load_run
from gn0.bench.results import recorded_actions
from gn0.bench.runner import run_suite
from gn0.bench.walk_recording import open_recorder
from gn0.cli.main import main
from gn0.data.dagger import walked_way
from gn0.data.dataset import Dataset, open_dataset
from gn0.data.settings import DaggerSettings
from gn0.errors import ConfigError, PolicyError
from gn0.export.dataset_source import open_source
from gn0.export.export_run import plan_export
from gn0.export.exporter import ExportSettings, Job, get_dataset_exporter
from gn0.plugins import plugin_names
from gn0.policies.recorded import PolicyRecorded
from gn0.sim.state import Action
from gn0.suites.suite import Suite

pytestmark = pytest.mark.usefixtures("workers_here")


@pytest.fixture(scope="module")
def by_hand(data_suite: Suite, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Walks of all episodes but the last, a turn to and fro before each."""
    root = tmp_path_factory.mktemp("walks")
    run_suite(data_suite, "oracle", root / "oracle")
    traces = load_run(root / "oracle").traces
    with open_recorder(data_suite, root / "by_hand") as recorder:
        for episode in recorder.episodes[:-1]:
            said = [a for a in recorded_actions(traces[episode.id]) if isinstance(a, Action)]
            actions = [Action.LEFT, Action.RIGHT, *said]
            recorder.save(episode, actions, seconds=9.0, attempts=1)
    return root / "by_hand"


def demonstrate(suite: Suite, run: Path, out: Path, *more: str) -> int:
    return main(
        ["data", "dagger", str(suite.folder), "--policy", "recorded", "--policy-option",
         f"run={run}", "--beta", "0", "--halting", "none", "--labels", "own", "--out", str(out),
         *more]
    )  # fmt: skip


@pytest.fixture(scope="module")
def dataset(data_suite: Suite, by_hand: Path) -> Dataset:
    assert demonstrate(data_suite, by_hand, by_hand.parent / "data") == 0
    return open_dataset(by_hand.parent / "data")


def test_the_verb_says_where_the_dataset_is_and_what_to_do_next(
    dataset, data_suite, by_hand, capsys
) -> None:
    assert demonstrate(data_suite, by_hand, by_hand.parent / "data") == 0
    told = capsys.readouterr().out
    assert f"dataset: {by_hand.parent / 'data'}" in told
    assert f"gn0 data balance {by_hand.parent / 'data'}" in told


def test_samples_say_what_was_done_not_what_should_have_been(dataset, by_hand, data_suite) -> None:
    traces = load_run(by_hand).traces
    rows = [r for part in dataset.about.parts for r in dataset.part_rows(part)]
    assert len(rows) == len(traces) == len(data_suite.episodes) - 1
    for own in rows:
        done = traces[own.episode_id]
        assert own.source == "demonstration" and own.executed.tolist() == list(done.actions)
        assert own.actions[0].tolist() == list(done.actions[:6])
        assert own.actions[-1].tolist() == [0] * 6
        np.testing.assert_allclose(own.poses, np.array(done.poses[:-1]))
        ahead = own.waypoints[0, own.valid[0] - 1]
        assert np.hypot(*ahead) <= 3.0 + 1e-5 and own.valid[-1] == 1
    skipped = [own for part in dataset.about.parts for own in part.skipped]
    assert [own.reason for own in skipped] == ["the run has no walk of it"]


def test_every_exporter_takes_a_demonstration(dataset) -> None:
    source = open_source(dataset.folder)
    for name in plugin_names("dataset_exporter"):
        exporter = get_dataset_exporter(name)
        if exporter.name in ("navid", "uninavid"):
            continue  # want a body that turns by 30 degrees
        plan = plan_export(exporter, Job(source, ExportSettings(), dataset.folder / "x"))
        assert plan.trips, (name, plan.skipped)
        assert not any("policy" in why for why in plan.skipped)


def test_a_demonstration_is_exported_and_checked(dataset, tmp_path, capsys) -> None:
    out = tmp_path / "streamvln"
    assert (
        main(["export", "streamvln", str(dataset.folder), "--limit", "1", "--out", str(out)]) == 0
    )
    assert main(["export", "check", str(out)]) == 0
    capsys.readouterr()


def test_another_recording_is_another_dataset(
    data_suite, by_hand, dataset, tmp_path, capsys
) -> None:
    again = Path(shutil.copytree(by_hand, tmp_path / "again"))
    lines = (again / "trajectories.jsonl").read_bytes().splitlines(keepends=True)
    (again / "trajectories.jsonl").write_bytes(b"".join(lines[1:]))
    assert demonstrate(data_suite, by_hand, dataset.folder) == 0  # nothing to do
    shutil.rmtree(by_hand.parent / "kept", ignore_errors=True)
    by_hand.rename(by_hand.parent / "kept")
    again.rename(by_hand)
    try:
        assert demonstrate(data_suite, by_hand, dataset.folder) != 0
        assert "holds another dataset" in capsys.readouterr().err
    finally:
        by_hand.rename(again)
        (by_hand.parent / "kept").rename(by_hand)
    with pytest.raises(ConfigError, match="walked by the policy alone"):
        DaggerSettings(policy="recorded", demonstrate=True)


def test_a_part_without_a_walk_is_balanced_and_verified(data_suite, by_hand, tmp_path) -> None:
    assert demonstrate(data_suite, by_hand, tmp_path / "data", "--chunk", "1") == 0
    assert 0 in [part.rows for part in open_dataset(tmp_path / "data").about.parts]
    assert main(["data", "balance", str(tmp_path / "data")]) == 0
    assert main(["data", "verify", str(tmp_path / "data")]) == 0


def test_a_record_of_another_run_or_start_is_not_walked(data_suite, by_hand, tmp_path) -> None:
    with pytest.raises(PolicyError, match="other trajectories than those meant"):
        PolicyRecorded(str(by_hand), digest="0")
    summary = run_suite(
        data_suite, "recorded", tmp_path / "again", policy_options={"run": str(by_hand)}
    )
    assert summary.standing == "oracle" and summary.valid == summary.expected - 1
    assert [own.reason for own in summary.failed] == ["the run has no walk of it"]
    again = {r.episode: r for r in load_run(tmp_path / "again").results if r.metrics}
    assert again == {r.episode: r for r in load_run(by_hand).results}
    moved = Path(shutil.copytree(by_hand, tmp_path / "moved"))
    text = (moved / "trajectories.jsonl").read_text()
    (moved / "trajectories.jsonl").write_text(text.replace('"poses":[[', '"poses":[[9', 1))
    summary = run_suite(
        data_suite,
        "recorded",
        tmp_path / "other",
        policy_options={"run": str(moved)},
        max_episodes=1,
    )
    assert summary.failed[0].reason == "the run recorded it from another start"


def test_the_way_ahead_is_the_walk_itself() -> None:
    poses = np.array([(0, 0, 0), (1, 0, 0), (1, 0, np.pi / 2), (1, 0.6, np.pi / 2)], float)
    points, valid = walked_way(poses, (1.0, 0.6))
    assert valid.tolist() == [8, 4, 4, 1]
    np.testing.assert_allclose(points[0, 4], (1.0, 0.0), atol=1e-6)
    np.testing.assert_allclose(points[0, -1], (1.0, 0.6), atol=1e-6)
    np.testing.assert_allclose(points[2, 1], (0.25, 0.0), atol=1e-6)
    np.testing.assert_allclose(points[2, 3:], [(0.6, 0.0)] * 10, atol=1e-6)
