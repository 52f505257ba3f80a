"""`gn0 train baseline`: from a suite to a policy of the benchmark, and on where it stopped."""

from __future__ import annotations

import itertools
import json
import shutil
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import pytest

from gn0.cli.main import main
from gn0.maps.navigation import NavigationMap
from gn0.missions.goal import sample_goal_episodes
from gn0.scenes.example import build_example_scene
from gn0.scenes.folder import load_scene, save_scene
from gn0.suites.suite import save_suite

pytest.importorskip("torch")
pytest.importorskip("transformers")


@pytest.fixture(scope="module")
def suite(tmp_path_factory) -> Path:
    root = tmp_path_factory.mktemp("suite")
    save_scene(replace(build_example_scene(), id="flat"), root / "flat")
    scene = load_scene(root / "flat")
    episodes = sample_goal_episodes(scene, NavigationMap(scene.grid, 0.2), 6, 0)
    return save_suite(root / "suite", [scene], episodes, name="flat", max_steps=12).folder


def train(suite: Path, out: Path, *more: str) -> int:
    return main(
        ["train", "baseline", str(suite), "--split", "all", "--held-out", "", "--size", "nano",
         "--pictures", "near", "--agents", "3", "--steps", "4", "--samples", "48", "--rounds", "2",
         "--report", "1", "--save", "1", "--device", "host", "--out", str(out), *more]
    )  # fmt: skip


@pytest.fixture
def emulation(own_cache, monkeypatch) -> None:
    if not shutil.which("g++"):
        pytest.skip("the host emulation needs g++")
    monkeypatch.setenv("GN0_CACHE", str(own_cache))


def test_what_makes_no_sense_is_told_before_anything_is_written(
    suite, tmp_path, emulation, capsys
) -> None:
    out = tmp_path / "out"
    for more, said in (
        (("--held-out", "nowhere"), "no split 'nowhere'"),
        (("--without", "depth"), "'depth' is not there to be left out"),
        (("--without", "near,words"), "neither pictures nor words"),
        (("--pictures", "history"), "no picture 'history'"),
        (("--preset", "none"), "none"),
    ):
        assert train(suite, out, *more) == 2
        assert said in capsys.readouterr().err
        assert not out.exists()


@pytest.mark.slow
def test_a_stopped_run_ends_in_the_same_policy(suite, tmp_path, emulation, capsys) -> None:
    whole, parts = tmp_path / "whole", tmp_path / "parts"
    assert train(suite, whole) == 0
    said = capsys.readouterr().out
    assert f"checkpoint={whole}/policy" in said
    assert "retrained, small" in said
    shutil.copytree(whole, parts)
    shutil.rmtree(parts / "checkpoints" / "step-000000004")
    shutil.rmtree(parts / "policy")
    assert train(suite, parts, "--examined", "2", "--held-out", "") == 0
    for name in ("model.safetensors", "tokenizer.json", "cma.json"):
        assert (whole / "policy" / name).read_bytes() == (parts / "policy" / name).read_bytes()
    lines = [json.loads(line) for line in (parts / "metrics.jsonl").read_text().splitlines()]
    assert [(line["step"], line["round"]) for line in lines] == [(1, 0), (2, 0), (3, 1), (4, 2)]
    assert lines[-1]["gpu_minutes"] == 0  # of a CPU
    capsys.readouterr()
    assert train(suite, whole) == 0
    assert "done before, at step 4" in capsys.readouterr().out
    assert train(suite, whole, "--model", "seq2seq") == 2
    assert "another run: settings.graph was 'cma', is 'seq2seq'" in capsys.readouterr().err
    assert main(
        ["bench", "run", str(suite), "--policy", "cma", "--policy-option",
         f"checkpoint={whole / 'policy'}", "--episodes", "1", "--no-report",
         "--out", str(tmp_path / "bench")]
    ) == 0  # fmt: skip


@pytest.mark.slow
def test_it_keeps_to_its_minutes(suite, tmp_path, emulation, monkeypatch) -> None:
    """By a clock that goes on by a second each time that it is looked at."""
    ticks = itertools.count()
    clock = SimpleNamespace(monotonic=lambda: float(next(ticks)))
    monkeypatch.setattr("gn0.training.recurrent_stage.time", clock)
    out = tmp_path / "out"
    assert train(suite, out, "--samples", "12000000", "--minutes", "1", "--save", "0") == 0
    lines = [json.loads(line) for line in (out / "metrics.jsonl").read_text().splitlines()]
    begun = {k: next(one["seconds"] for one in lines if one["round"] == k) for k in range(3)}
    step = 3  # it looks three times: a round begins with the next one, and is told at its end
    assert 24 <= begun[1] <= 24 + 2 * step  # --forced is 0.4, and rounds share the rest
    assert 42 <= begun[2] <= 42 + 2 * step
    assert 60 - step <= lines[-1]["seconds"] <= 63 + step
    shares = [line["share_of_rate"] for line in lines if line["seconds"] > 48 + step]
    assert shares == sorted(shares, reverse=True) and 0 < shares[-1] < 0.2
    assert (out / "policy" / "cma.json").is_file()


@pytest.mark.slow
def test_it_is_examined_in_closed_loop(suite, tmp_path, emulation) -> None:
    out = tmp_path / "out"
    assert train(suite, out, "--samples", "12", "--rounds", "0", "--held-out", "test",
                 "--examined", "2") == 0  # fmt: skip
    results = json.loads((out / "run.json").read_text())["results"]
    assert results["episodes"] == 2
    assert 0 <= results["SPL"] <= results["SR"] <= 1
    assert results["gpu_minutes"] == 0
