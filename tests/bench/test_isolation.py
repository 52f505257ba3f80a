"""A policy in a process of its own: the same numbers, and nothing to peep at."""

from __future__ import annotations

import importlib
import json
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from gn0.bench import runner
from gn0.bench.report import write_report
from gn0.bench.results import RunSummary
from gn0.bench.runner import run_suite
from gn0.cli.main import main
from gn0.errors import BenchError, ConfigError, FormatError, PolicyError
from gn0.geometry import Pose2D
from gn0.policies.remote.isolated import PolicyIsolated
from gn0.seeds import load_stream, random_stream, save_stream
from gn0.sim.state import Observation
from gn0.suites.suite import Suite

pytestmark = pytest.mark.usefixtures("workers_here")

PLUGIN = Path(__file__).parent / "plugin"
SAME = ("results.jsonl", "trajectories.jsonl")


@pytest.fixture(scope="module", autouse=True)
def still_code() -> Iterator[None]:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(runner, "code_version", lambda: "1.0+still")
        yield


@pytest.fixture(autouse=True)
def plugins(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.syspath_prepend(str(PLUGIN))
    (tmp_path / "temporary").mkdir()
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path / "temporary"))


def run_plugin(suite: Suite, policy: str, module: str, out: Path, **more: Any) -> RunSummary:
    options = more.pop("options", {})
    more = {"max_episodes": 2, "plugin_modules": (module,), "isolate": True} | more
    return run_suite(suite, policy, out, policy_options=options, **more)


def test_an_isolated_policy_finds_neither_the_simulator_nor_the_suite(
    flats_suite: Suite, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("GN0_DATA", str(flats_suite.folder))
    monkeypatch.setenv("PEEP_LOG", str(tmp_path / "log"))
    sys.modules.pop("peeping_policies", None)
    seen = []
    for isolate in (True, False):
        out, marks = tmp_path / f"run-{isolate}", tmp_path / f"marks-{isolate}"
        summary = run_plugin(
            flats_suite, "peeping", "peeping_policies", out, isolate=isolate, max_episodes=1,
            options={"marks": str(marks)},
        )  # fmt: skip
        assert summary.ok
        seen.append(json.loads(marks.read_text()))
        card = dict(summary.protocol)["isolation"]
        assert card.startswith("own process, same user" if isolate else "in-process")
        if isolate:
            assert "peeping_policies" not in sys.modules, "the harness imported it"
            log = (tmp_path / "log").read_text().splitlines()
            assert log and all("own_process" in line for line in log)
    isolated, inside = seen
    assert isolated["found"] == [] and isolated["here"] == []
    assert not any(str(flats_suite.folder) in text for text in isolated["told"])
    assert "GN0_DATA" not in isolated["variables"] and "GN0_TOKEN" not in isolated["variables"]
    assert {"Simulator", "Episode"} <= set(inside["found"]), "else this test shows nothing"
    assert not list((tmp_path / "temporary").iterdir())


def test_isolated_or_not_the_results_are_the_same_bytes(flats_suite: Suite, tmp_path: Path) -> None:
    for name, isolate in (("in", False), ("own", True)):
        options = {"odd": "jump"}
        run_plugin(
            flats_suite, "odd", "odd_policies", tmp_path / name, isolate=isolate, options=options,
            max_episodes=3, workers=1 + isolate,
        )  # fmt: skip
    for file in SAME:
        assert (tmp_path / "in" / file).read_bytes() == (tmp_path / "own" / file).read_bytes()
    with pytest.raises(BenchError, match="another config"):
        run_plugin(flats_suite, "odd", "odd_policies", tmp_path / "in", options={"odd": "jump"},
                   max_episodes=3)  # fmt: skip


def test_report_and_compare_say_which_run_was_isolated(
    flats_suite: Suite, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for name, isolate in (("in", False), ("own", True)):
        run_suite(flats_suite, "random", tmp_path / name, max_episodes=2, isolate=isolate)
    both = [tmp_path / "in", tmp_path / "own"]
    assert main(["bench", "compare", *map(str, both)]) == 0
    assert "note: A ran in-process, B in a process of its own" in capsys.readouterr().out
    page = write_report(both, tmp_path / "page.html", videos=0).read_text()
    assert ">in-process<" in page and ">own process<" in page and "same user" in page


def look(step: int, chance: np.random.Generator) -> Observation:
    """All that an observation can hold."""
    return Observation(
        step=step,
        time=step / 7,
        instruction="Geh zur Tür.",
        rgb=chance.integers(0, 256, (6, 8, 3), np.uint8),
        depth=chance.random((6, 8), np.float32),
        bev=chance.integers(0, 256, (4, 4, 3), np.uint8),
        bev_metres_per_pixel=1 / 3,
        map_origin=(chance.random(), -chance.random()),
        occupancy=chance.integers(0, 256, (4, 4, 3), np.uint8),
        history=chance.integers(0, 256, (4, 4, 3), np.uint8),
        ranges=chance.random(9, np.float32),
        goal_vector=(chance.random(), -chance.random()),
        goal_picture=chance.integers(0, 256, (4, 4, 3), np.uint8),
        pose=Pose2D(*chance.random(3).tolist()),
        collided=bool(step % 2),
    )


@pytest.mark.parametrize("answers", ["action", "moves", "nonsense"])
def test_every_bit_that_is_shown_arrives_and_every_answer_comes_back(
    tmp_path: Path, answers: str
) -> None:
    echo = importlib.import_module("peeping_policies").PolicyEcho(answers)
    policy = PolicyIsolated(
        "echo", {"answers": answers}, ("peeping_policies",), folder=tmp_path / "e", paths=sys.path
    )
    try:
        assert (policy.name, policy.sensors) == ("echo", echo.sensors)
        assert policy.card_rows == echo.card_rows and policy.identity() == echo.identity()
        for episode in range(2):
            chance = random_stream(5, "looks", episode)
            looks = [look(step, chance) for step in range(3)]
            for each in (policy, echo):
                each.reset("Geh zur Tür.", random_stream(7, "chance", episode))
            said = [[each.act(seen) for seen in looks] for each in (policy, echo)]
            if answers == "nonsense":
                assert said[0] == ["'onwards'"] * 3
            else:
                assert said[0] == said[1]
            if answers == "moves":
                assert [type(a) for a in said[0]] == [type(b) for b in said[1]]
            assert policy.notes() == echo.notes() == {"steps": 3}
    finally:
        policy.close()


def test_a_stream_goes_on_where_it_stood() -> None:
    stream = random_stream(3, "a")
    stream.random(5), stream.integers(0, 9, 3, np.uint8)  # half a word is left over
    again = load_stream(save_stream(stream))
    assert again.random(4).tolist() == stream.random(4).tolist()
    assert again.integers(0, 9, 5, np.uint8).tolist() == stream.integers(0, 9, 5, np.uint8).tolist()
    for wrong in ("", "[]", "{}", '{"state": {"counter": [1]}}', "[" * 9999):
        with pytest.raises(FormatError):
            load_stream(wrong)


@pytest.mark.parametrize(
    ("odd", "reason"),
    [
        ("raise", "ValueError: the policy lost its mind"),
        ("die", "its own process was killed by SIGKILL"),
    ],
)
def test_a_dying_policy_of_its_own_process_costs_its_episode_and_is_named(
    flats_suite: Suite, tmp_path: Path, odd: str, reason: str
) -> None:
    out = tmp_path / "run"
    summary = run_plugin(
        flats_suite, "odd", "odd_policies", out, options={"odd": odd}, max_episodes=1
    )
    (failed,) = summary.failed
    assert reason in failed.reason
    if odd == "raise":
        about = json.loads((out / "run.json").read_text())
        assert "in misbehave" in about["episodes"][failed.episode]["traceback"]
    assert not list((tmp_path / "temporary").iterdir())


def test_what_cannot_be_isolated_says_why(flats_suite: Suite, tmp_path: Path) -> None:
    with pytest.raises(PolicyError, match="is handed the simulator"):
        run_suite(flats_suite, "oracle", tmp_path / "a", isolate=True)
    with pytest.raises(ConfigError, match="behind a socket already"):
        run_suite(flats_suite, "remote", tmp_path / "b", isolate=True)
    with pytest.raises(ConfigError, match="cannot import the plug-in 'no_such'"):
        run_plugin(flats_suite, "odd", "no_such", tmp_path / "c")
    with pytest.raises(PolicyError, match="no policy named 'orakel'"):
        run_plugin(flats_suite, "orakel", "odd_policies", tmp_path / "d")
    with pytest.raises(PolicyError, match=r"weights are missing") as error:
        run_plugin(flats_suite, "odd", "odd_policies", tmp_path / "e",
                   options={"odd": "unbuildable"})  # fmt: skip
    assert "odd_policies.py" in str(error.value)
