"""Controls of a run: words and pictures taken away, and results that cannot be mixed up."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from gn0.bench.compare import compare_runs, name_difference
from gn0.bench.results import load_results, load_summary
from gn0.bench.runner import run_suite
from gn0.cli.main import main
from gn0.errors import BenchError, ConfigError
from gn0.suites.suite import Suite

pytestmark = pytest.mark.usefixtures("workers_here")
SAME = ("results.jsonl", "trajectories.jsonl", "summary.json")


@pytest.fixture(autouse=True)
def own_policies(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(str(Path(__file__).parent / "plugin"))


def run(suite: Suite, out: Path, control: str = "none", **more: Any) -> Path:
    modules = ("listening_policies",)
    run_suite(suite, "listening", out, control=control, plugin_modules=modules, **more)
    return out


def told(out: Path) -> dict[str, str]:
    notes = {r.episode: r.notes for r in load_results(out)}
    return {
        name: next(key[5:] for key in some if key.startswith("told "))  # type: ignore[union-attr]
        for name, some in notes.items()
    }


def light(out: Path) -> set[int]:
    return {r.notes["light"] for r in load_results(out)}  # type: ignore[index]


def test_words_and_pictures_are_taken_away_one_by_one(flats_suite: Suite, tmp_path: Path) -> None:
    texts = {e.id: e.instruction for e in flats_suite.episodes}
    plain = run(flats_suite, tmp_path / "plain")
    assert told(plain) == texts and light(plain) == {255}
    silent = run(flats_suite, tmp_path / "silent", "no_words")
    assert set(told(silent).values()) == {"go"} and light(silent) == {255}
    shuffled = run(flats_suite, tmp_path / "shuffled", "shuffled")
    assert all(told(shuffled)[name] != text for name, text in texts.items())
    assert light(shuffled) == {255}
    dark = run(flats_suite, tmp_path / "dark", "no_pictures")
    assert told(dark) == texts and light(dark) == {0}


@pytest.mark.parametrize("control", ["shuffled", "no_pictures"])
def test_agents_and_limits_change_nothing(
    flats_suite: Suite, tmp_path: Path, control: str, worker_here: None
) -> None:
    alone = run(flats_suite, tmp_path / "1", control, max_episodes=5)
    beside = run(flats_suite, tmp_path / "3", control, max_episodes=5, agents=3)
    for name in SAME:
        assert (alone / name).read_bytes() == (beside / name).read_bytes()
    whole = told(run(flats_suite, tmp_path / "all", control))
    assert told(alone).items() <= whole.items()


def test_a_control_is_in_name_card_and_identity(flats_suite: Suite, tmp_path: Path) -> None:
    plain, out = run(flats_suite, tmp_path / "plain"), run(flats_suite, tmp_path / "a", "no_words")
    summary = load_summary(out)
    assert summary.label == "listening (no words)"
    assert "“go”" in dict(summary.protocol)["control"]
    assert "control" not in dict(load_summary(plain).protocol)
    with pytest.raises(BenchError, match="another config"):
        run(flats_suite, out, "shuffled")
    with pytest.raises(BenchError, match="another config"):
        run(flats_suite, out)
    assert compare_runs(plain, out)
    assert "'none', B with 'no_words'" in name_difference(plain, out)
    with pytest.raises(ConfigError, match="no control 'silence'"):
        run(flats_suite, tmp_path / "b", "silence")


def test_who_is_shown_painted_maps_is_said_to_be_told_labels(
    flats_suite: Suite, tmp_path: Path
) -> None:
    told = [
        load_summary(run(flats_suite, tmp_path / str(on), policy_options={"painted": on}))
        for on in (False, True)
    ]
    assert "labels" not in dict(told[0].protocol)["the policy sees"]
    assert dict(told[1].protocol)["the policy sees"] == "ego_map, labels of the scene"
    assert told[0].standing == "on the track"
    assert told[1].standing == "off the track" and told[1].beyond == ("labels of the scene",)


def test_a_run_ends_with_what_the_policy_said_was_odd(
    flats_suite: Suite, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    command = ["bench", "run", str(flats_suite.folder), "--policy", "listening", "--limit", "1"]
    more = ["--plugin", "listening_policies", "--no-report", "--out", str(tmp_path / "run")]
    assert main([*command, *more]) == 0
    said = capsys.readouterr().out
    assert "note: the policy says: light, " in said and "in 1 of the episodes" in said
