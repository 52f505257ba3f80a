"""Which folders a run may write to, and how it says in what another run there differs."""

import json
from pathlib import Path
from typing import Any

import pytest

from gn0.bench import run_suite
from gn0.bench.run_folder import OTHERS, check_run_folder, tell_difference, tell_inputs
from gn0.cli.main import main
from gn0.errors import BenchError
from gn0.suites.suite import Suite


def straight(suite: Suite, out: Path, **settings: Any) -> None:
    run_suite(suite, settings.pop("policy", "straight"), out, max_episodes=2, **settings)


@pytest.mark.parametrize("name", OTHERS)
def test_a_folder_of_another_kind_is_left_as_it_is(
    flats_suite: Suite, tmp_path: Path, name: str
) -> None:
    (tmp_path / name).write_text("{}")
    (tmp_path / "journal.jsonl").write_text("theirs\n")
    before = {path.name: path.read_bytes() for path in tmp_path.iterdir()}
    for resume in (True, False):
        with pytest.raises(BenchError, match=r"is an? .*, not a run \(choose another --out"):
            straight(flats_suite, tmp_path, resume=resume)
    assert {path.name: path.read_bytes() for path in tmp_path.iterdir()} == before


def test_the_command_line_writes_no_suite_into_a_scene(
    flats_suite: Suite, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    scene = flats_suite.scene_folder(flats_suite.episodes[0].scene_id)
    (tmp_path / "bank.json").write_text("{}")
    assert main(["bench", "run", str(scene), "--policy", "random", "--out", str(tmp_path)]) == 2
    assert "is a bank of people, not a run" in capsys.readouterr().err
    assert [path.name for path in tmp_path.iterdir()] == ["bank.json"]


def test_a_first_attempt_that_fails_leaves_nothing_in_the_way(
    flats_suite: Suite, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    names = sorted({episode.scene_id for episode in flats_suite.episodes})
    one, other = (str(flats_suite.scene_folder(name)) for name in names[:2])
    out = str(tmp_path / "run")
    assert main(["bench", "run", one, "--policy", "randm", "--out", out]) == 2
    assert not Path(out).exists()
    few = ["--policy", "random", "--limit", "1", "--no-report", "--out", out]
    assert main(["bench", "run", one, *few]) == 0
    assert main(["bench", "run", other, *few]) == 2
    assert "another scene" in capsys.readouterr().err
    assert main(["bench", "run", other, *few, "--fresh"]) == 0
    assert main(["bench", "run", f"{out}/suite/scenes/{names[1]}", *few, "--fresh"]) == 0
    assert main(["bench", "run", f"{out}/suite", *few, "--fresh"]) == 0


def test_a_file_of_the_users_own_is_no_obstacle(flats_suite: Suite, tmp_path: Path) -> None:
    (tmp_path / "log.txt").write_text("what tee wrote")
    check_run_folder(tmp_path)
    straight(flats_suite, tmp_path)


@pytest.mark.parametrize(
    ("changed", "said"),
    [
        ({"control": "shuffled"}, "another config: control none, now shuffled"),
        ({"policy": "random"}, "another policy (straight, now random)"),
        (
            {"policy_options": {"stop_distance": 0.5}},
            "another config: policy option stop_distance not given, now 0.5",
        ),
        ({"max": 1}, "another config: episodes 2, now 1"),
    ],
)
def test_another_run_is_told_by_what_differs(
    flats_suite: Suite, tmp_path: Path, changed: dict[str, Any], said: str
) -> None:
    straight(flats_suite, tmp_path)
    with pytest.raises(BenchError) as error:
        if "max" in changed:
            run_suite(flats_suite, "straight", tmp_path, max_episodes=changed["max"])
        else:
            straight(flats_suite, tmp_path, **changed)
    assert said in str(error.value)
    assert "--fresh" in str(error.value)


def test_another_suite_is_told_by_name_and_size(
    flats_suite: Suite, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    straight(flats_suite, tmp_path)
    other = flats_suite.with_profile("paper")
    assert other.hash != flats_suite.hash
    with pytest.raises(BenchError, match=r"another suite \(\S+ of 2 episodes, \w+, now \S+ of 2 "):
        straight(other, tmp_path)


def test_a_run_of_an_earlier_version_is_told_by_its_digests(
    flats_suite: Suite, tmp_path: Path
) -> None:
    identity = {"suite": "s", "config": "c2", "code": "x", "policy": "p", "source": ""}
    told = tell_inputs(flats_suite, {}, "cpu", 2)
    head = {**identity, "config": "c1"}
    assert tell_difference(head, identity, told) == "another config (c1, now c2)"
    assert tell_difference({**head, "told": 3}, identity, told) == "another config (c1, now c2)"


def test_secrets_are_not_written_beside_results(flats_suite: Suite, tmp_path: Path) -> None:
    from gn0.bench.run_settings import HIDDEN, mask_secrets

    told = tell_inputs(flats_suite, mask_secrets({"api_key": "s3", "size": (1, 2)}), "cpu", 2)
    assert told["options"] == {"api_key": HIDDEN, "size": [1, 2]}
    straight(flats_suite, tmp_path)
    first = (tmp_path / "journal.jsonl").read_text().splitlines()[0].rpartition("\t")[0]
    assert json.loads(first)["told"]["episodes"] == 2
