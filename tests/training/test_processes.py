"""Several processes that train one model: one's numbers, one's folder, and a clear end."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

pytest.importorskip("torch")
pytest.importorskip("transformers")

import torch

from gn0.errors import ConfigError, TrainingError
from gn0.training.processes import ALONE, Processes
from gn0.training.runs.training_state import load_state


def _together(folder: Path, samples: int, count: int = 2, dies_at: int = -1, what: str = ""):
    start = [sys.executable, "-m"]
    if count > 1:
        start += ["torch.distributed.run", "--standalone", f"--nproc-per-node={count}", "-m"]
    done = subprocess.run(
        [*start, "gn0_trials.training_together", str(folder), str(samples), str(dies_at), what],
        env=os.environ | {"OMP_NUM_THREADS": "1"}, capture_output=True, text=True, timeout=300,
    )  # fmt: skip
    return done.returncode, done.stdout + done.stderr


def _losses(folder: Path) -> list[float]:
    lines = (folder / "metrics.jsonl").read_text().splitlines()
    return [json.loads(line)["loss"] for line in lines]


def test_batches_are_shared_out_and_seeds_are_ones_own() -> None:
    assert Processes(1, 4).share(512) == 128
    with pytest.raises(ConfigError, match="a batch of 10 for 4 processes"):
        Processes(0, 4).share(10)
    assert ALONE.seed(7) == 7
    assert len({Processes(rank, 4).seed(7) for rank in range(4)} | {7}) == 5


def test_who_is_left_alone_is_told_where_to_go_on() -> None:
    def lost() -> None:
        raise RuntimeError("Connection closed by peer")

    with pytest.raises(TrainingError, match="another process of this run is gone") as caught:
        Processes(0, 2).ask(lost)
    assert "the last checkpoint" in str(caught.value)


@pytest.mark.slow
def test_two_processes_learn_what_one_does(tmp_path) -> None:
    assert _together(tmp_path / "one", 16, count=1)[0] == 0
    code, said = _together(tmp_path / "two", 16)
    assert code == 0, said
    assert _losses(tmp_path / "two") == pytest.approx(_losses(tmp_path / "one"), abs=1e-5)
    one, two = (load_state(tmp_path / name / "checkpoints") for name in ("one", "two"))
    assert two.counters.samples == one.counters.samples == 16
    named = dict(two.checkpoint.model.named_parameters())
    for name, weight in one.checkpoint.model.named_parameters():
        torch.testing.assert_close(named[name], weight, atol=1e-5, rtol=0)


@pytest.mark.slow
def test_two_processes_learn_several_inputs_as_one_does(tmp_path) -> None:
    """Also in steps without pictures, in which the vision tower has no gradient."""
    assert _together(tmp_path / "one", 24, count=1, what="inputs")[0] == 0
    code, said = _together(tmp_path / "two", 24, what="inputs")
    assert code == 0, said
    lines = (tmp_path / "two" / "metrics.jsonl").read_text().splitlines()
    inputs = ["loss_words" in json.loads(line) for line in lines]
    assert set(inputs) == {True, False}
    assert _losses(tmp_path / "two") == pytest.approx(_losses(tmp_path / "one"), abs=1e-5)
    one, two = (load_state(tmp_path / name / "checkpoints") for name in ("one", "two"))
    named = dict(two.checkpoint.model.named_parameters())
    for name, weight in one.checkpoint.model.named_parameters():
        torch.testing.assert_close(named[name], weight, atol=1e-5, rtol=0)


@pytest.mark.slow
def test_a_process_that_was_killed_is_named_and_the_run_goes_on(tmp_path) -> None:
    assert _together(tmp_path / "whole", 24)[0] == 0
    code, said = _together(tmp_path / "parts", 24, dies_at=12)
    assert code != 0
    assert "exitcode  : -9" in said or "another process of this run is gone" in said
    assert load_state(tmp_path / "parts" / "checkpoints").counters.step == 2
    code, said = _together(tmp_path / "parts", 24)
    assert code == 0, said
    assert _losses(tmp_path / "parts") == _losses(tmp_path / "whole")
