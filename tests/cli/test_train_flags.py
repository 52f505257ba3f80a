"""What the verbs of training say of numbers and folders that they cannot take, before any work."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from gn0.cli.main import main
from gn0.cli.train_flags import resolve_start, train_stage
from gn0.cli.train_rl import Args as ArgsRl
from gn0.errors import CheckpointError

VERBS = ("sft", "dagger", "dapo", "rl", "baseline")


@pytest.mark.parametrize("verb", VERBS)
@pytest.mark.parametrize(
    ("flag", "value"),
    [
        ("--rate", "inf"),
        ("--rate", "nan"),
        ("--rate", "2"),
        ("--seed", "9" * 23),
        ("--minutes", "nan"),
    ],
)
def test_numbers_that_no_run_can_have_are_told_by_their_flag_at_once(
    verb: str, flag: str, value: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    start = ["--start", str(tmp_path)] if verb in ("dapo", "rl") else []
    out = tmp_path / "out"
    assert main(["train", verb, str(tmp_path), *start, flag, value, "--out", str(out)]) == 2
    said = capsys.readouterr().err
    assert f"error [CONFIG] {flag}: " in said and f"see `gn0 train {verb} --help`" in said
    assert not out.exists()


@pytest.mark.parametrize("verb", ["sft", "dagger", "rl"])
def test_a_batch_that_nothing_could_hold_is_refused(
    verb: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """It was gathered, without a word, until somebody stopped it."""
    words = ["train", verb, str(tmp_path), "--start", str(tmp_path), "--batch", "100000000"]
    assert main([*words, "--out", str(tmp_path / "out")]) == 2
    assert "[CONFIG] --batch" in capsys.readouterr().err


def test_what_lies_in_place_of_a_suite_is_told(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "data").mkdir()
    (tmp_path / "data" / "dataset.json").write_text("{}")
    (tmp_path / "file").write_text("x")
    words = ["--out", str(tmp_path / "out")]
    assert main(["train", "sft", str(tmp_path / "data"), *words]) == 2
    assert "this is a dataset" in (said := capsys.readouterr().err) and "--source dataset" in said
    assert main(["train", "sft", str(tmp_path / "file"), *words]) == 2
    assert "a file: give the folder" in capsys.readouterr().err
    assert main(["train", "sft", str(tmp_path / "none"), *words]) == 2
    assert "check that the path exists" in capsys.readouterr().err


def test_the_folder_of_a_run_stands_for_its_policy(tmp_path: Path) -> None:
    run = tmp_path / "run"
    run.mkdir()
    (run / "run.json").write_text(json.dumps({}))
    (run / "policy.json").write_text("{}")  # what it was asked, beside the checkpoints
    flags = ArgsRl(suite=("suite",), out="out", start=str(run))
    with pytest.raises(CheckpointError, match="no policy yet"):
        resolve_start(flags)
    (run / "policy").mkdir()
    (run / "policy" / "policy.json").write_text("{}")
    assert resolve_start(flags).start == str(run / "policy")
    (tmp_path / "cma" / "policy").mkdir(parents=True)
    (tmp_path / "cma" / "run.json").write_text("{}")
    (tmp_path / "cma" / "policy" / "cma.json").write_text("{}")
    for folder in (tmp_path / "cma", tmp_path / "cma" / "policy"):
        with pytest.raises(CheckpointError, match="a baseline of `gn0 train baseline`"):
            resolve_start(ArgsRl(suite=("suite",), out="out", start=str(folder)))
    whole = ArgsRl(suite=("suite",), out="out", start=str(run / "policy"))
    assert resolve_start(whole) == whole


def test_who_stops_a_run_is_told_where_it_goes_on(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    def train(*_: object, **__: object) -> Path:
        raise KeyboardInterrupt

    flags = ArgsRl(suite=("suite",), out=str(tmp_path), start="policy")
    with pytest.raises(KeyboardInterrupt):
        train_stage(flags, train, flags)
    assert "no checkpoint yet (--save)" in capsys.readouterr().out
    (state := tmp_path / "checkpoints" / "step-000001200").mkdir(parents=True)
    (state / "state.json").write_text("{}")
    with pytest.raises(KeyboardInterrupt):
        train_stage(flags, train, flags)
    assert "the same command goes on from step 1,200" in capsys.readouterr().out
