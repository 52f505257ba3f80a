"""Walks by hand are a run like any other: driven, scored and written by the benchmark itself."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from gn0.bench.compare import compare_runs
from gn0.bench.replay import replay_run
from gn0.bench.report import load_run, write_report
from gn0.bench.results import recorded_actions
from gn0.bench.runner import run_suite
from gn0.bench.standing import tell_standings
from gn0.bench.walk_recording import HUMAN, open_recorder, shown_sensors
from gn0.errors import BenchError
from gn0.sim.state import Action
from gn0.suites.suite import Suite
from gn0.suites.track import Track

pytestmark = pytest.mark.usefixtures("workers_here")


@pytest.fixture(scope="module")
def oracle(flats_suite: Suite, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """What a person copies."""
    out = tmp_path_factory.mktemp("oracle") / "run"
    run_suite(flats_suite, "oracle", out, max_episodes=3)
    return out


def walk(suite: Suite, out: Path, oracle: Path, count: int = 3) -> None:
    """Walk as the oracle did, as many episodes as are wanted."""
    traces = load_run(oracle).traces
    with open_recorder(suite, out, name="Ada", max_episodes=3) as recorder:
        left = [e for e in recorder.episodes if not recorder.is_walked(e)]
        for episode in left[:count]:
            actions = [a for a in recorded_actions(traces[episode.id]) if isinstance(a, Action)]
            recorder.save(episode, actions, seconds=12.0, attempts=2)


def test_a_walk_by_hand_scores_what_a_policy_of_the_same_actions_does(
    flats_suite: Suite, oracle: Path, tmp_path: Path
) -> None:
    walk(flats_suite, tmp_path / "hand", oracle)
    for name in ("results.jsonl", "trajectories.jsonl"):
        assert (tmp_path / "hand" / name).read_bytes() == (oracle / name).read_bytes()
    run = load_run(tmp_path / "hand")
    assert run.summary.ok and run.summary.policy == HUMAN and run.summary.name == "Ada"
    assert run.summary.isolation == "a person" and run.summary.standing != "oracle"
    card = dict(run.summary.protocol)
    assert "bev" in card["the policy sees"] and "a person" in card["isolation"]
    assert "walked by" in card and run.about["episodes"][run.results[0].episode]["attempts"] == 2
    assert replay_run(tmp_path / "hand", flats_suite.folder).ok
    page = write_report([tmp_path / "hand", oracle], tmp_path / "r.html", videos=0)
    assert "Ada" in page.read_text()
    assert compare_runs(tmp_path / "hand", oracle)
    told = tell_standings(run.summary, load_run(oracle).summary)
    assert "A ran by hand, B in-process" in told


def test_a_recording_goes_on_and_a_walk_that_ended_stays(
    flats_suite: Suite, oracle: Path, tmp_path: Path
) -> None:
    walk(flats_suite, tmp_path / "hand", oracle, count=1)
    summary = load_run(tmp_path / "hand").summary
    assert (summary.valid, summary.expected) == (1, 3) and not summary.ok
    with open_recorder(flats_suite, tmp_path / "hand", max_episodes=3) as recorder:
        first = recorder.episodes[0]
        assert recorder.is_walked(first) and recorder.results[first.id].metrics
        with pytest.raises(BenchError, match="has its result already"):
            recorder.save(first, [Action.STOP], seconds=1.0, attempts=1)
        with pytest.raises(BenchError, match="goes on after its 1 recorded"):
            recorder.save(recorder.episodes[1], [Action.LEFT], seconds=1.0, attempts=1)
        with pytest.raises(BenchError):  # in use
            open_recorder(flats_suite, tmp_path / "hand", max_episodes=3).__enter__()
    walk(flats_suite, tmp_path / "hand", oracle)
    results = (tmp_path / "hand" / "results.jsonl").read_bytes()
    assert results == (oracle / "results.jsonl").read_bytes()
    with pytest.raises(BenchError, match="holds a run of another"):
        open_recorder(flats_suite, oracle, max_episodes=3).__enter__()
    assert json.loads((tmp_path / "hand" / "run.json").read_text())["sessions"][1]["executor"]


def test_a_person_is_shown_what_the_track_allows(flats_suite: Suite) -> None:
    bare = flats_suite.with_map_mode("none").with_track(Track(goal="object"))
    assert shown_sensors(bare) == {"rgb"}
    told = flats_suite.with_map_mode("prior").with_track(Track(goal="point", pose=True))
    assert shown_sensors(told) == {"rgb", "bev", "occupancy", "pose", "goal_vector"}
    assert "goal_picture" in shown_sensors(told.with_track(Track(goal="image")))
