"""Replays read runs back: episodes in order of interest, poses step by step, and their words."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest

from gn0.bench.runner import run_suite
from gn0.cli import view
from gn0.errors import BenchError, ConfigError, StorageError
from gn0.scenes.example import build_example_scene
from gn0.scenes.folder import save_scene
from gn0.suites.suite import build_suite, load_suite
from gn0.viewer.recorded_runs import load_replay

pytestmark = pytest.mark.usefixtures("workers_here")


@pytest.fixture(scope="module")
def runs(tmp_path_factory) -> list[Path]:
    root = tmp_path_factory.mktemp("replay")
    save_scene(build_example_scene(spacing=0.1), root / "flat")
    suite = build_suite([root / "flat"], root / "suite", count=3, seed=1, max_steps=120)
    folders = [root / "oracle", root / "random"]
    for folder in folders:
        run_suite(suite, folder.name, folder, workers=1)
    return folders


def test_runs_stand_side_by_side(runs):
    replay = load_replay(runs)
    assert [run.name for run in replay.runs] == ["oracle", "random"]
    assert len({run.colour for run in replay.runs}) == 2
    assert len(replay.episodes) == 3
    for episode in replay.episodes:
        marks = replay.title(episode).split()[0]
        assert marks[0] == "✓" and marks[1] in "✓✗"
        assert replay.length(episode) == max(
            len(run.data.traces[episode.id].actions) for run in replay.runs
        )
        assert "**success**" in replay.metrics_table(episode)


def test_failures_come_first(runs):
    replay = load_replay(runs)
    lost = [replay.title(e).split()[0].count("✗") for e in replay.episodes]
    assert lost == sorted(lost, reverse=True)


def test_each_step_is_the_recorded_one(runs):
    replay = load_replay(runs)
    episode = replay.episodes[0]
    for run in replay.runs:
        trace = run.trace(episode.id)
        for step in range(replay.length(episode) + 3):
            at = min(step, len(trace.poses) - 1)
            pose = replay.pose(run, episode, step)
            assert pose is not None and tuple(pose) == trace.poses[at]
            assert replay.trail(run, episode, step)[-1] == trace.poses[at][:2]
            assert replay.bumped(run, episode, step) == (step - 1 in trace.collided)
        assert replay.word(run, episode, 0) == "start"
        assert replay.word(run, episode, len(trace.actions)) not in ("start", "ended")
        assert replay.word(run, episode, len(trace.actions) + 1) == "ended"


def test_protocols_are_compared_by_name(runs):
    replay = load_replay(runs)
    assert "| policy | oracle | random |" in replay.differences()
    assert "step limit" not in replay.differences()  # the same for both
    assert "nothing to compare" in load_replay(runs[:1]).differences()


def test_a_scene_narrows_the_choice(runs, tmp_path):
    assert len(load_replay(runs, runs[0].parent / "flat").episodes) == 3
    save_scene(build_example_scene(spacing=0.3), tmp_path / "flat")
    (tmp_path / "flat").rename(tmp_path / "x")
    assert len(load_replay(runs, runs[0].parent / "suite").episodes) == 3


def test_other_runs_are_refused_with_the_reason(runs, tmp_path):
    with pytest.raises(StorageError):
        load_replay([tmp_path])
    suite = build_suite([runs[0].parent / "flat"], tmp_path / "suite", count=2, seed=5)
    run_suite(suite, "oracle", tmp_path / "other", workers=1)
    with pytest.raises(BenchError, match="other tasks"):
        load_replay([runs[0], tmp_path / "other"])
    shutil.rmtree(tmp_path / "suite")
    with pytest.raises(BenchError, match="suite"):
        load_replay([tmp_path / "other"])


def test_an_episode_is_found_by_its_id_or_the_nearest_is_named(runs):
    replay = load_replay(runs)
    wanted = replay.episodes[-1]
    assert replay.find(wanted.id) == wanted
    with pytest.raises(BenchError, match=f"not recorded here .*did you mean '{wanted.id}'"):
        replay.find(wanted.id + "x")
    args = view.Args(paths=tuple(map(str, runs)), episode=wanted.id)
    assert view.find_view(args).keywords["first"] == wanted.id
    with pytest.raises(BenchError, match="not recorded"):
        view.find_view(view.Args(paths=(str(runs[0]),), episode="gone"))
    with pytest.raises(ConfigError, match="only a run or a suite has episodes"):
        view.find_view(view.Args(paths=(str(runs[0].parent / "flat"),), episode=wanted.id))


def test_two_runs_of_one_policy_get_names_of_their_own(runs):
    names = [run.name for run in load_replay([runs[0], runs[0]]).runs]
    assert names == ["oracle (oracle)", "oracle (oracle)"]


def test_what_a_run_never_came_to_counts_as_lost_and_comes_first(runs, tmp_path) -> None:
    suite = load_suite(runs[0].parent / "suite")
    run_suite(suite, "oracle", tmp_path / "partial", workers=1, max_episodes=2)
    replay = load_replay([runs[0], tmp_path / "partial"])
    missing = suite.episodes[2].id
    assert [e.id for e in replay.episodes] == [missing, *sorted(e.id for e in suite.episodes[:2])]
