"""Tracks: who was told more stands apart."""

from __future__ import annotations

from pathlib import Path

import msgspec
import pytest

from gn0.bench.report import find_suite, load_run, write_report
from gn0.bench.runner import run_suite
from gn0.bench.standing import group_runs, tell_standings
from gn0.cli.main import main
from gn0.cli.result_tables import print_summaries
from gn0.errors import ConfigError
from gn0.suites.suite import Suite, SuiteFile, load_suite
from gn0.suites.track import Track, choose_track, judge_policy, read_track, tell_track

pytestmark = pytest.mark.usefixtures("workers_here")

OBJECT = Track(goal="object")


def test_a_track_is_written_as_its_goal_and_its_pose() -> None:
    for text in ("object", "instruction", "image+pose", "point+pose"):
        assert str(read_track(text)) == text
    assert read_track("") is None
    for wrong in ("pose", "+pose", "objects", "point+map", "Point"):
        with pytest.raises(ConfigError, match="no track"):
            read_track(wrong)
    assert tell_track(read_track("image+pose"), "explored") == (
        "goal by image × map explored × pose known"
    )


@pytest.mark.parametrize(
    ("track", "sensors", "beyond"),
    [
        ("object", ("bev", "depth", "history", "occupancy", "ranges", "rgb"), ()),
        ("object", ("goal_vector", "pose"), ("goal_vector", "pose")),
        ("instruction", ("goal_picture",), ("goal_picture",)),
        ("image", ("goal_picture", "rgb"), ()),
        ("image", ("goal_vector",), ("goal_vector",)),
        ("point", ("goal_vector",), ()),
        ("point", ("goal_picture", "pose"), ("goal_picture", "pose")),
        ("point+pose", ("goal_vector", "pose"), ()),
    ],
)
def test_a_policy_that_asks_for_more_than_its_track_is_off_it(
    track: str, sensors: tuple[str, ...], beyond: tuple[str, ...]
) -> None:
    standing = "off the track" if beyond else "on the track"
    assert judge_policy(read_track(track), sensors, False) == (standing, beyond)
    assert judge_policy(read_track(track), sensors, True) == ("oracle", ())
    assert judge_policy(None, sensors, False) == ("no track", ())
    assert judge_policy(None, sensors, True) == ("oracle", ())


def test_suites_of_before_keep_their_hash_and_say_that_they_have_no_track(
    flats_suite: Suite,
) -> None:
    assert flats_suite.track == OBJECT
    before = flats_suite.with_track(None)
    written = msgspec.json.encode(before.about)
    assert b"track" not in written and msgspec.json.decode(written, type=SuiteFile) == before.about
    hashes = {before.hash, flats_suite.hash, flats_suite.with_track(read_track("point")).hash}
    assert len(hashes) == 3 and before.with_track(OBJECT).hash == flats_suite.hash
    assert tell_track(before.track, "prior").startswith("no track")


def test_missions_choose_the_track_that_asks_for_least() -> None:
    assert choose_track(["goal", "goal"]) == OBJECT
    assert choose_track(["goal", "instruction"]) == Track(goal="instruction")


@pytest.fixture(scope="module")
def runs(flats_suite: Suite, tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    root = tmp_path_factory.mktemp("tracks")
    for name in ("oracle", "random", "straight", "wall_follower"):
        run_suite(flats_suite, name, root / name, max_episodes=2)
    return {path.name: path for path in root.iterdir()}


def test_who_was_told_more_never_shares_a_table(
    flats_suite: Suite, runs: dict[str, Path], capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    order = ["oracle", "random", "straight", "wall_follower"]
    summaries = [load_run(runs[name]).summary for name in order]
    groups = group_runs(summaries)
    assert [group.members for group in groups] == [(1, 3), (2,), (0,)]
    assert "also told goal_vector" in groups[1].title and "oracle" in groups[2].title
    print_summaries(summaries)
    said = capsys.readouterr().out
    assert said.count(" SR % ") == 3 and "off the track" in said
    page = write_report([runs[n] for n in order], tmp_path / "x.html", videos=0).read_text()
    tables = [part.split("</table>")[0] for part in page.split('<table class="headline">')[1:]]
    inside = [[name for name in order if f"<span>{name}</span>" in table] for table in tables]
    assert inside == [["random", "wall_follower"], ["straight"], ["oracle"]]
    assert "best" not in tables[1] + tables[2], "nothing to be better than"
    cards = [dict(s.protocol) for s in summaries]
    assert cards[0]["policy and track"].startswith("an oracle")
    assert "also told goal_vector" in cards[2]["policy and track"]
    assert all(card["track"] == tell_track(OBJECT, "prior") for card in cards)


def test_compare_says_who_was_told_more(
    runs: dict[str, Path], capsys: pytest.CaptureFixture[str]
) -> None:
    straight, chance, oracle = (load_run(runs[n]).summary for n in ("straight", "random", "oracle"))
    assert tell_standings(chance, chance) == ""
    assert "A is off the track" in tell_standings(straight, chance)
    assert "B is an oracle" in tell_standings(chance, oracle)
    assert main(["bench", "compare", str(runs["straight"]), str(runs["random"])]) == 0
    assert "note: not told alike: A is off the track" in capsys.readouterr().out


def test_a_run_in_another_track_than_its_suites_is_reported_from_its_folder(
    flats_suite: Suite, tmp_path: Path
) -> None:
    out = str(tmp_path / "run")
    given = ["bench", "run", str(flats_suite.folder), "--policy", "straight", "--episodes", "2",
             "--no-report", "--track", "point", "--out", out]  # fmt: skip
    assert main(given) == 0
    run = load_run(out)
    assert (run.summary.track, run.summary.standing) == ("point", "on the track")
    assert find_suite(run).track == Track(goal="point")
    assert load_suite(flats_suite.folder).track == OBJECT
    assert main([*given[:-4], "--track", "nowhere", "--out", out]) == 2
