"""Replays: a results folder is believed only when its actions lead to its numbers."""

from __future__ import annotations

import json
import math
import shutil
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from gn0.bench import replay, run_settings, runner
from gn0.bench.replay import differences, replay_run, rerun_policy
from gn0.bench.runner import run_suite
from gn0.cli.main import main
from gn0.errors import BenchError, FormatError, StorageError
from gn0.suites.suite import Suite, build_suite

pytestmark = pytest.mark.usefixtures("workers_here")

PLUGIN = Path(__file__).parent / "plugin"
RESULTS, TRAJECTORIES = "results.jsonl", "trajectories.jsonl"


@pytest.fixture(scope="module", autouse=True)
def still_code() -> Iterator[None]:
    """Pretend that nobody edits the package while these tests run."""
    with pytest.MonkeyPatch.context() as patch:
        for module in (runner, replay):
            patch.setattr(module, "code_version", lambda: "1.0+still")
        patch.syspath_prepend(str(PLUGIN))
        yield


@pytest.fixture(scope="module")
def recorded(
    still_code: None, flats_suite: Suite, tmp_path_factory: pytest.TempPathFactory
) -> Path:
    """Chance over both flats."""
    out = tmp_path_factory.mktemp("recorded") / "run"
    run_suite(flats_suite, "random", out)
    return out


@pytest.fixture
def copy(recorded: Path, tmp_path: Path, flats_suite: Suite) -> Path:
    """A copy of the run to be tampered with."""
    run = Path(shutil.copytree(recorded, tmp_path / "run"))
    about = json.loads((run / "run.json").read_text())
    about["suite_folder"] = str(flats_suite.folder)
    (run / "run.json").write_text(json.dumps(about))
    return run


def edit_line(path: Path, number: int, change: Callable[[dict[str, Any]], Any]) -> str:
    """Change one line as a forger would: the same spelling otherwise. Its episode."""
    lines = path.read_text().splitlines()
    record = json.loads(lines[number])
    change(record)
    lines[number] = json.dumps(record, separators=(",", ":"), sort_keys=True)
    path.write_text("\n".join(lines) + "\n")
    return str(record["episode"])


def test_an_honest_run_agrees_to_the_byte(recorded: Path) -> None:
    found = replay_run(recorded)
    assert found.ok and found.agreed == 12 and not found.unscored
    text = str(found)
    assert "12 episodes agree to the byte" in text and found.code == found.recorded_code
    for word in ("suite", "hash", "renderer auto", "numpy", "gn0 1.0+still"):
        assert word in text


def test_oracles_replay_too(flats_suite: Suite, tmp_path: Path) -> None:
    run_suite(flats_suite, "oracle", tmp_path / "run", max_episodes=6)
    found = replay_run(tmp_path / "run")
    assert found.ok and found.agreed == 6, str(found)
    assert b'"costs"' not in (tmp_path / "run" / TRAJECTORIES).read_bytes()


@pytest.mark.parametrize("profile", ["default", "paper", "gn0-release"])
def test_teleports_into_walls_replay_too_and_cost_what_the_profile_says(
    flats_suite: Suite, tmp_path: Path, profile: str
) -> None:
    """Jumps of any length were one step each; now that is so only where the profile says it."""
    suite = flats_suite.with_profile(profile)
    summary = run_suite(
        suite, "odd", tmp_path / "run", policy_options={"odd": "jump"},
        plugin_modules=("odd_policies",), max_episodes=4,
    )  # fmt: skip
    found = replay_run(tmp_path / "run")
    assert found.ok and found.agreed == 4, str(found)
    lines = [json.loads(s) for s in (tmp_path / "run" / TRAJECTORIES).read_text().splitlines()]
    results = [json.loads(s) for s in (tmp_path / "run" / RESULTS).read_text().splitlines()]
    assert any(line["collided"] and line["collided"][0] < 12 for line in lines), "one hit a wall"
    card = dict(summary.protocol)["moves"]
    jumps = sum(len(line["teleports"]) for line in lines)
    metres = sum(
        math.dist(line["poses"][i][:2], line["poses"][i + 1][:2])
        for line in lines for i, code in enumerate(line["actions"]) if code == -1
    )  # fmt: skip
    assert f"{jumps:,} in this run, {metres:,.1f} m in all" in card
    for line, result in zip(lines, results, strict=True):
        steps, costs = result["metrics"]["steps"], line.get("costs")
        assert steps <= suite.about.max_steps
        if profile == "default":
            assert steps == sum(costs) > len(line["actions"])
        else:
            assert costs is None and steps == len(line["actions"])
            assert len(line["teleports"]) == 12 and "takes one step whatever its length" in card


def test_a_run_of_the_official_harness_replays_with_its_forced_stops(
    flat_folder: Path, tmp_path: Path
) -> None:
    suite = build_suite([flat_folder], tmp_path / "suite", 4, profile="gn0-release", max_steps=80)
    run_suite(suite, "straight", tmp_path / "run")
    found = replay_run(tmp_path / "run")
    assert found.ok and found.agreed == 4, str(found)


def nudge(record: dict[str, Any]) -> None:
    record["poses"][7][1] += 1e-9


def turn(record: dict[str, Any]) -> None:
    record["actions"][4] = 2 if record["actions"][4] != 2 else 3


def last_to_forward(record: dict[str, Any]) -> None:
    record["actions"] = record["actions"][:9]
    record["poses"] = record["poses"][:10]


@pytest.mark.parametrize(
    ("file", "change", "field", "step"),
    [
        (TRAJECTORIES, nudge, "poses[7].y", 7),
        (TRAJECTORIES, turn, "poses[5]", 5),
        (TRAJECTORIES, last_to_forward, "actions", 9),
        (TRAJECTORIES, lambda r: r["collided"].append(10**6), "collided[", None),
        (TRAJECTORIES, lambda r: r["actions"].__setitem__(2, 9), "actions", 2),
        (RESULTS, lambda r: r["metrics"].update(spl=0.999), "metrics.spl", None),
        (RESULTS, lambda r: r["metrics"].update(success=True), "metrics.success", None),
        (RESULTS, lambda r: r.update(stopped=not r["stopped"]), "stopped", None),
    ],
)
def test_a_tampered_field_is_found_and_named(
    copy: Path, file: str, change: Callable[[dict[str, Any]], Any], field: str, step: int | None
) -> None:
    episode = edit_line(copy / file, 3, change)
    found = replay_run(copy)
    assert not found.ok and found.agreed == 11
    parting = next(p for p in found.partings if p.file == file)
    assert (parting.episode, parting.step) == (episode, step)
    assert parting.field.startswith(field)
    assert parting.recorded != parting.now
    assert f"differs at episode '{episode}'" in str(found) and field in str(found)


def test_equal_values_in_other_bytes_are_not_to_the_byte(copy: Path) -> None:
    lines = (copy / RESULTS).read_text().splitlines()
    lines[0] = lines[0].replace('"episode":', '"episode": ')
    (copy / RESULTS).write_text("\n".join(lines) + "\n")
    found = replay_run(copy)
    assert len(found.partings) == 1 and found.partings[0].field.startswith("byte ")


def test_a_missing_or_misplaced_line_is_found(copy: Path) -> None:
    lines = (copy / RESULTS).read_bytes().splitlines(keepends=True)
    (copy / RESULTS).write_bytes(b"".join([lines[1], lines[0], *lines[2:]]))
    assert [p.field for p in replay_run(copy).partings] == ["order of lines"]
    (copy / RESULTS).write_bytes(b"".join(lines[1:]))
    found = replay_run(copy)
    assert {p.file for p in found.partings} == {TRAJECTORIES, "summary.json"}
    (copy / RESULTS).write_bytes(b"".join(lines))
    traces = (copy / TRAJECTORIES).read_bytes().splitlines(keepends=True)
    (copy / TRAJECTORIES).write_bytes(b"".join(traces[:-1]))
    found = replay_run(copy)
    assert [p.now for p in found.partings] == ["not a trajectory"]


def test_a_mean_that_the_results_do_not_give_is_found(copy: Path) -> None:
    summary = json.loads((copy / "summary.json").read_text())
    summary["metrics"]["SR"]["mean"] += 0.01
    (copy / "summary.json").write_text(json.dumps(summary))
    found = replay_run(copy)
    assert [(p.file, p.field) for p in found.partings] == [("summary.json", "metrics.SR.mean")]
    assert "12 episodes agree to the byte; the summary does not" in str(found)


def test_a_moved_run_needs_its_own_suite(
    copy: Path,
    flats_suite: Suite,
    flat_folder: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    about = json.loads((copy / "run.json").read_text())
    about.update(suite_folder="/nowhere", suite_relative="../gone")
    (copy / "run.json").write_text(json.dumps(about))
    with monkeypatch.context() as patch:
        patch.setenv("GN0_CACHE", str(tmp_path / "of-another-person"))
        with pytest.raises(BenchError, match=r"is not known here .* it was at '/nowhere'"):
            replay_run(copy)
    assert replay_run(copy, flats_suite.folder).ok
    other = build_suite([flat_folder], tmp_path / "other", 2)
    with pytest.raises(BenchError, match=f"hash {other.hash}; the run is of suite .*, hash "):
        replay_run(copy, other.folder)


def test_a_failed_episode_has_nothing_to_drive_and_no_score(
    flats_suite: Suite, tmp_path: Path
) -> None:
    run_suite(
        flats_suite, "odd", tmp_path / "run", policy_options={"odd": "raise", "when": "sofa"},
        plugin_modules=("odd_policies",),
    )  # fmt: skip
    found = replay_run(tmp_path / "run")
    assert found.ok and found.unscored and found.agreed + len(found.unscored) == 12
    assert f"{len(found.unscored)} episodes failed when recorded" in str(found)
    lines = (tmp_path / "run" / RESULTS).read_text().splitlines()
    number = next(i for i, line in enumerate(lines) if '"failed"' in line)
    score = next(json.loads(line)["metrics"] for line in lines if '"valid"' in line)
    edit_line(tmp_path / "run" / RESULTS, number, lambda r: r.update(metrics=score))
    assert any(p.field == "metrics" for p in replay_run(tmp_path / "run").partings)


def test_the_policy_itself_can_be_asked_again(
    flats_suite: Suite, copy: Path, tmp_path: Path
) -> None:
    found = rerun_policy(copy, "random", workers=2)
    assert found.ok and found.notes == ("asked again: --policy random",)
    out = tmp_path / "odd"
    run_suite(
        flats_suite, "odd", out, policy_options={"odd": "", "when": "x"},
        plugin_modules=("odd_policies",), max_episodes=3,
    )  # fmt: skip
    asked = {"odd": "", "when": "x"}
    found = rerun_policy(out, "odd", policy_options=asked, plugin_modules=["odd_policies"])
    assert found.ok and len(found.notes) == 1
    found = rerun_policy(
        out, "odd", policy_options={"odd": "jump"}, plugin_modules=["odd_policies"]
    )
    assert "it was recorded with --policy odd --policy-option odd= --policy-option when=x" in str(
        found
    )
    assert not found.ok and {p.step for p in found.partings if p.file == TRAJECTORIES} == {1}


def test_secrets_are_not_kept_with_results(flats_suite: Suite, tmp_path: Path) -> None:
    settings = run_settings.build_settings(flats_suite, "odd", {"token": "hush", "pause": 0.5})
    kept = run_settings.describe_settings(settings)
    assert kept["options"] == {"token": "(not kept)", "pause": 0.5}
    assert settings.options["token"] == "hush"
    out = tmp_path / "run"
    run_suite(flats_suite, "random", out, max_episodes=1)
    about = json.loads((out / "run.json").read_text())
    about["settings"]["options"] = {"api_key": "hush"}
    (out / "run.json").write_text(json.dumps(about))
    with pytest.raises(BenchError, match=r"api_key=\(not kept\)"):
        rerun_policy(out, "straight")


def test_the_command_says_it_with_its_exit_code(
    copy: Path, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    assert main(["bench", "replay", str(copy)]) == 0
    assert "12 episodes agree to the byte" in capsys.readouterr().out
    edit_line(copy / RESULTS, 0, lambda r: r["metrics"].update(steps=1))
    assert main(["bench", "replay", str(copy)]) == 1
    assert "metrics.steps: recorded 1, now" in capsys.readouterr().out
    (copy / RESULTS).write_text("{")
    assert main(["bench", "replay", str(copy)]) == 2
    with pytest.raises(FormatError, match=r"results\.jsonl, line 1"):
        replay_run(copy)
    with pytest.raises(StorageError):
        replay_run(tmp_path / "nothing")


def test_differences_are_paths_with_both_values() -> None:
    a = {"m": {"x": 1, "gone": 2}, "poses": [[0.0, 1.0, 2.0]], "list": [1, 2]}
    b = {"m": {"x": 1.0, "new": 3}, "poses": [[0.0, 1.0, 2.5]], "list": [1]}
    assert list(differences(a, b)) == [
        ("list[1]", 2, "absent"),
        ("m.gone", 2, "absent"),
        ("m.new", "absent", 3),
        ("m.x", 1, 1.0),
        ("poses[0].yaw", 2.0, 2.5),
    ]
    assert list(differences(a, a)) == []
