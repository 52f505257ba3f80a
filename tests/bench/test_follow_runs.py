"""Runs with people: following from start to end, touches on the way to a goal, and their proof."""

from __future__ import annotations

import json
import math
from pathlib import Path

import msgspec
import numpy as np
import pytest

from gn0.bench.compare import compare_runs, name_pairing
from gn0.bench.follow_metrics import FollowMetrics
from gn0.bench.replay import replay_run, rerun_policy
from gn0.bench.report import write_report
from gn0.bench.results import EpisodeResult, EpisodeTrace, load_results, load_traces
from gn0.bench.runner import run_suite
from gn0.cli.main import main
from gn0.cli.result_tables import print_summaries
from gn0.errors import EpisodeError, Gn0Error
from gn0.missions.episode import MissionFollow
from gn0.people.walk import walk_alone
from gn0.suites.suite import Suite
from gn0.viewer.recorded_runs import load_replay
from gn0_trials import people_samples
from gn0_trials.follow_suite_small import WALKER, follow_episode, save_small

pytestmark = pytest.mark.usefixtures("workers_here")


@pytest.fixture(scope="module")
def small(tmp_path_factory: pytest.TempPathFactory) -> Suite:
    return save_small(tmp_path_factory.mktemp("small") / "suite")


@pytest.fixture(scope="module")
def oracle(small: Suite, tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("oracle") / "run"
    run_suite(small, "oracle", out)
    return out


def of(run: Path) -> dict[str, tuple[EpisodeResult, EpisodeTrace]]:
    traces = load_traces(run)
    return {r.episode[:1]: (r, traces[r.episode]) for r in load_results(run)}


def scored(result: EpisodeResult) -> FollowMetrics:
    assert isinstance(result.follow, FollowMetrics), result.reason
    return result.follow


def test_the_oracle_follows_to_three_seconds_after_the_end_and_touches_nobody(oracle: Path) -> None:
    result, trace = of(oracle)["a"]
    follow = scored(result)
    assert follow.success and follow.end == "over" and not follow.touched and follow.by_pictures
    assert follow.following_rate >= 0.95 and follow.visible_share
    assert result.metrics is None and not result.stopped
    # who walks undisturbed is where the walk alone has it, two ticks of 0.1 s a step
    record = trace.follow_record()
    assert record is not None
    alone = walk_alone(WALKER, 60.0)
    rows = len(record.poses)
    np.testing.assert_allclose(record.people[0], alone.place[: 2 * rows : 2], rtol=0, atol=1e-9)
    ticks = int(np.flatnonzero(alone.arrived)[0])
    assert record.over_at == pytest.approx(0.2 * math.ceil(ticks / 2))
    assert 0.2 * (rows - 1) == pytest.approx(0.2 * math.ceil((record.over_at + 3.0) / 0.2 - 1e-6))


def test_the_oracle_goes_round_who_stands_in_its_way(oracle: Path) -> None:
    result, trace = of(oracle)["b"]
    assert result.metrics is not None and result.metrics.success
    assert result.touches == 0 and trace.touches == ()
    away = np.hypot(*(np.array(trace.poses)[:, :2] - (3.2, 2.2)).T)
    assert away.min() >= 0.25 + 0.25


def test_a_replay_proves_the_tracks_of_people_too(
    oracle: Path, small: Suite, tmp_path: Path
) -> None:
    assert replay_run(oracle, small.folder).ok
    lines = (oracle / "trajectories.jsonl").read_text().splitlines()
    for line, where in ((0, "follow"), (1, "people")):
        copy = tmp_path / str(line)
        copy.mkdir()
        for file in oracle.iterdir():
            (copy / file.name).write_bytes(file.read_bytes())
        record = json.loads(lines[line])
        if where == "follow":
            record["follow"]["people"][0][7][0] += 1e-9
        else:
            record["people"] = "0" * 32
        changed = [*lines]
        changed[line] = msgspec.json.encode(record, order="sorted").decode()
        (copy / "trajectories.jsonl").write_text("\n".join(changed) + "\n")
        found = replay_run(copy, small.folder)
        assert not found.ok and where in found.partings[0].field


def test_side_by_side_and_resumed_it_is_the_same(
    oracle: Path, small: Suite, tmp_path: Path
) -> None:
    run_suite(small, "oracle", tmp_path, max_episodes=2, agents=2)
    for name in ("results.jsonl", "trajectories.jsonl", "summary.json"):
        assert (tmp_path / name).read_bytes() == (oracle / name).read_bytes(), name
    told: list[str] = []
    run_suite(small, "oracle", tmp_path, max_episodes=2, agents=2, tell=told.append)
    assert "nothing was run" in told[0]


def test_floors_stay_on_the_floor(
    small: Suite, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    stands = run_suite(small, "always_stop", tmp_path / "stands", max_episodes=1)
    follow = scored(of(tmp_path / "stands")["a"][0])
    assert not follow.success and follow.following_rate < 0.5 and follow.steps > 20
    runs = run_suite(small, "straight_at_the_person", tmp_path / "runs", max_episodes=1)
    follow = scored(of(tmp_path / "runs")["a"][0])
    assert follow.touched and follow.end == "touch" and not follow.success
    print_summaries([stands, runs])
    table = capsys.readouterr().out
    assert "TR_pooled" in table and "wrong_person" in table


def test_following_is_compared_by_measures_of_its_own(
    oracle: Path, small: Suite, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    run_suite(small, "always_stop", tmp_path)
    rows = compare_runs(oracle, tmp_path)
    going = {row.metric.key: row for row in rows if not row.following}
    following = {row.metric.key: row for row in rows if row.following}
    assert len(going) + len(following) == len(rows)
    assert {"SR", "SPL", "CR"} <= going.keys() and going["SR"].episodes == 1
    assert (going["CR"].a, going["SPL"].b) == (0.0, 0.0)
    ours, stands = (scored(of(run)["a"][0]) for run in (oracle, tmp_path))
    rate = following["TR_mean"]
    assert (rate.a, rate.b, rate.episodes) == (ours.following_rate, stands.following_rate, 1)
    assert ours.losses == 0 and "first_loss" not in following  # no pair has one
    assert "TR_pooled" not in following  # no mean of episodes
    assert name_pairing(oracle, tmp_path) == ""
    assert main(["bench", "compare", str(oracle), str(tmp_path)]) == 0
    table = capsys.readouterr().out
    assert "1 pair of episodes;" in table and "1 pair of episodes of following;" in table


def test_boxes_are_followed(small: Suite, tmp_path: Path) -> None:
    summary = run_suite(
        small, "box_follower", tmp_path, max_episodes=1,
        policy_options={"preset": "follower_small"},
    )  # fmt: skip
    follow = scored(of(tmp_path)["a"][0])
    assert follow.success and follow.following_rate > 0.8
    assert summary.standing == "off the track" and "who" in summary.beyond


def test_moves_that_somebody_cuts_short_are_counted_on_the_way_to_a_goal(
    small: Suite, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    walks, run_folder = save_small(tmp_path / "suite", small.episodes[1]), tmp_path / "run"
    summary = run_suite(walks, "straight", run_folder)
    result, trace = of(run_folder)["b"]
    assert isinstance(result.touches, int) and result.touches > 0
    assert {number for _, number in trace.touches or ()} == {8}
    said = str(replay_run(run_folder, walks.folder))
    assert f"people touched {result.touches} times, in 1 of 1 episode with people" in said
    replay = load_replay([run_folder])
    (run,), (episode,) = replay.runs, replay.episodes
    assert f"| touches | {result.touches}: person 8 at " in replay.metrics_table(episode)
    first = trace.touches[0][0]
    assert replay.word(run, episode, first + 1).endswith(", touches person 8")
    page = write_report(run_folder, tmp_path / "report.html", videos=0).read_text()
    assert f">{result.touches} touches<" in page
    assert {index for index, _ in trace.touches or ()} <= set(trace.collided)
    assert summary.metrics["CR"].mean == 1.0
    print_summaries([summary])
    table = capsys.readouterr().out
    assert "CR %" in table and "…" not in table  # all of its columns fit


def test_in_profile_evt_stop_ends_and_pixels_count(small: Suite, tmp_path: Path) -> None:
    theirs = small.with_profile("evt")
    assert theirs.about.camera == "evt" and theirs.hash != small.hash
    summary = run_suite(theirs, "always_stop", tmp_path, max_episodes=1)
    result, trace = of(tmp_path)["a"]
    follow = scored(result)
    assert summary.profile == "evt" and result.stopped
    assert (follow.end, follow.steps, follow.success, follow.reference_steps) == (
        "stop",
        1,
        False,
        0,
    )
    record = trace.follow_record()
    assert record is not None and record.picture == 640 * 480


def test_what_is_wrong_is_said(small: Suite, tmp_path: Path) -> None:
    alone = follow_episode()
    mission = alone.mission
    assert isinstance(mission, MissionFollow)
    alone = msgspec.structs.replace(
        alone, people=(), mission=msgspec.structs.replace(mission, person=0)
    )
    without = save_small(tmp_path / "suite", alone)
    summary = run_suite(without, "always_stop", tmp_path / "alone")
    assert "does not say whom to follow" in summary.failed[0].reason
    walks = Suite(small.folder, small.about, small.episodes[1:])
    summary = run_suite(walks, "straight_at_the_person", tmp_path / "goal")
    assert "nobody to run at" in summary.failed[0].reason
    summary = run_suite(small, "box_follower", tmp_path / "boxes", max_episodes=1)
    assert "preset=follower_small" in summary.failed[0].reason


def test_people_of_a_bank_are_shown_from_it_and_another_bank_is_refused(tmp_path: Path) -> None:
    bank, run = people_samples.save_bank(tmp_path / "bank"), tmp_path / "run"
    listed = json.loads((bank / "bank.json").read_text())
    suite = people_samples.save_some(
        tmp_path / "suite", people_samples.follow_episode(listed["hash"])
    )
    with pytest.raises(EpisodeError, match="none was given") as caught:
        run_suite(suite, "oracle", run)
    assert "--bank" in caught.value.remedy and not run.exists()
    run_suite(suite, "oracle", run, bank=bank)
    (result,) = load_results(run)
    follow = scored(result)
    assert follow.by_pictures and follow.visible_share
    assert str(bank) not in (run / "run.json").read_text()
    write_report(run, run / "report.html", videos=1, bank=bank)
    with pytest.raises(EpisodeError, match="none was given"):
        replay_run(run, suite.folder)
    assert replay_run(run, suite.folder, bank=bank).ok
    assert rerun_policy(run, "oracle", suite.folder, bank=bank).ok
    (bank / "bank.json").write_text(json.dumps({**listed, "hash": "another"}))
    with pytest.raises(EpisodeError, match=f"is of bank {listed['hash']}, this is another") as told:
        run_suite(suite, "oracle", tmp_path / "other", bank=bank)
    assert "c-follow" in told.value.where and not (tmp_path / "other").exists()


@pytest.mark.parametrize("policy", ["seeing", "seeing_late"])
def test_a_goal_run_that_shows_people_of_a_bank_says_that_it_needs_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, policy: str
) -> None:
    """Before anything is played, as well where only the built policy says that it sees pictures."""
    monkeypatch.syspath_prepend(str(Path(__file__).parent / "plugin"))
    bank, run = people_samples.save_bank(tmp_path / "bank"), tmp_path / "run"
    alone, crossed = people_samples.goal_episode("a-alone"), people_samples.crossed_episode()
    suite = people_samples.save_some(tmp_path / "suite", alone, crossed)
    options = {"plugin_modules": ("seeing_policies",)}
    with pytest.raises(EpisodeError, match="'p0001' is of a bank of people, and none") as caught:
        run_suite(suite, policy, run, **options)
    assert caught.value.where == "episode 'b-crossed', person 3, identity"
    assert "--bank" in caught.value.remedy and not list(run.glob("*.json"))
    summary = run_suite(suite, policy, run, bank=bank, **options)  # the same folder
    assert summary.ok and len(load_results(run)) == 2
    with pytest.raises(Gn0Error) as told:  # a resumed one is told the same
        run_suite(suite, policy, run, **options)
    assert "--bank" in told.value.remedy
    assert run_suite(suite, policy, run, bank=bank, **options).ok
    # nothing is shown to who sees no pictures, or where nobody is of a bank
    assert run_suite(suite, "oracle", tmp_path / "blind").ok
    nobody = Suite(suite.folder, suite.about, suite.episodes[:1])
    assert run_suite(nobody, policy, tmp_path / "nobody", **options).ok


def test_a_run_whose_report_shows_people_of_a_bank_says_before_it_starts_that_it_needs_it(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The oracle sees no pictures; those of the report's clips are made when all is played."""
    crossed = people_samples.crossed_episode()
    suite = people_samples.save_some(tmp_path / "suite", crossed)
    command = ["bench", "run", str(suite.folder), "--policy", "oracle"]
    run = ["--out", str(tmp_path / "run")]
    assert main([*command, "--videos", "1", *run]) == 2
    said = " ".join(capsys.readouterr().err.split())
    assert "'p0001' is of a bank of people, and none was given" in said
    assert "--bank" in said and "--no-report" in said
    assert not list((tmp_path / "run").glob("*.json*"))  # so the same with --bank is no other run
    for name, less in (("bare", ["--no-report"]), ("still", ["--videos", "0"])):
        assert main([*command, *less, "--out", str(tmp_path / name)]) == 0
    assert (tmp_path / "still" / "report.html").is_file()
    bank = people_samples.save_bank(tmp_path / "bank")
    assert main([*command, "--videos", "1", "--bank", str(bank), *run]) == 0
    assert "<video" in (tmp_path / "run" / "report.html").read_text()


def test_a_report_tells_of_people_who_are_built_and_of_frames(
    oracle: Path, small: Suite, tmp_path: Path
) -> None:
    told: list[tuple[str, int, int]] = []
    write_report(
        oracle, tmp_path / "report.html", videos=2, suite=small,
        progress=lambda *event: told.append(event),
    )  # fmt: skip
    stages = [stage for stage, _, _ in told]
    clip = stages.index("rendering clips")
    assert stages[clip + 1 : clip + 4] == ["people of a clip"] * 2 + ["frames of a clip"]
    frames = [event[1:] for event in told if event[0] == "frames of a clip"]
    assert frames[0][0] == 0 and frames[-1][0] == frames[-1][1] > 2
