"""`gn0 train sft`: from a suite to a policy that the benchmark runs, and on where it stopped."""

from __future__ import annotations

import json
import shutil
from dataclasses import replace
from pathlib import Path

import pytest

from gn0.cli.main import main
from gn0.data.build import build_dataset
from gn0.data.settings import BuildSettings, PictureSettings
from gn0.maps.navigation import NavigationMap
from gn0.missions.goal import sample_goal_episodes
from gn0.scenes.example import build_example_scene
from gn0.scenes.folder import load_scene, save_scene
from gn0.suites.suite import load_suite, save_suite

pytest.importorskip("torch")
pytest.importorskip("transformers")


def _make_suite(root: Path, name: str, seed: int) -> Path:
    save_scene(replace(build_example_scene(), id=name), root / name)
    scene = load_scene(root / name)
    episodes = sample_goal_episodes(scene, NavigationMap(scene.grid, 0.2), 6, seed)
    return save_suite(root / f"suite-{name}", [scene], episodes, name=name, max_steps=12).folder


@pytest.fixture(scope="module")
def suite(tmp_path_factory) -> Path:
    return _make_suite(tmp_path_factory.mktemp("suite"), "flat", 0)


def _train(suite: Path, out: Path, *more: str, also: tuple[Path, ...] = ()) -> int:
    return main(
        ["train", "sft", *map(str, (suite, *also)), "--split", "all", "--held-out", "",
         "--size", "nano", "--batch", "4", "--agents", "4", "--kept", "80", "--report", "1",
         "--save", "1", "--device", "host", "--out", str(out), *more]
    )  # fmt: skip


def test_a_split_of_the_examination_that_is_not_there_is_told_at_once(
    suite, tmp_path, own_cache, monkeypatch, capsys
) -> None:
    if not shutil.which("g++"):
        pytest.skip("the host emulation needs g++")
    monkeypatch.setenv("GN0_CACHE", str(own_cache))
    out = tmp_path / "out"
    assert _train(suite, out, "--held-out", "nowhere") == 2
    assert "no split 'nowhere'" in capsys.readouterr().err
    assert not out.exists()


@pytest.mark.slow
@pytest.mark.parametrize("source", ["walks", "uniform"])
def test_a_stopped_run_ends_in_the_same_policy(
    source, suite, tmp_path, own_cache, monkeypatch, capsys
) -> None:
    if not shutil.which("g++"):
        pytest.skip("the host emulation needs g++")
    monkeypatch.setenv("GN0_CACHE", str(own_cache))
    whole, parts = tmp_path / "whole", tmp_path / "parts"
    assert _train(suite, whole, "--source", source, "--samples", "12") == 0
    assert f"checkpoint={whole}/policy" in capsys.readouterr().out
    assert _train(suite, parts, "--source", source, "--samples", "12") == 0
    shutil.rmtree(parts / "checkpoints" / "step-000000003")
    shutil.rmtree(parts / "policy")
    assert _train(suite, parts, "--source", source, "--samples", "12") == 0
    for name in ("model.safetensors", "tokenizer.json", "policy.json"):
        assert (whole / "policy" / name).read_bytes() == (parts / "policy" / name).read_bytes()
    lines = (parts / "metrics.jsonl").read_text().splitlines()
    assert [json.loads(line)["step"] for line in lines] == [1, 2, 3]
    assert main(
        ["bench", "run", str(suite), "--policy", "bae", "--policy-option",
         f"checkpoint={whole / 'policy'}", "--episodes", "1",
         "--out", str(tmp_path / "bench")]
    ) == 0  # fmt: skip


INPUTS = ["--inputs", "maps:0.6,near_alone=near/7:0.4", "--held-out", "test", "--examined", "2",
          "--asked", "8"]  # fmt: skip


@pytest.mark.slow
def test_one_policy_learns_several_inputs_and_is_asked_in_any(
    suite, tmp_path, own_cache, monkeypatch, capsys
) -> None:
    if not shutil.which("g++"):
        pytest.skip("the host emulation needs g++")
    monkeypatch.setenv("GN0_CACHE", str(own_cache))
    whole, parts = tmp_path / "whole", tmp_path / "parts"
    assert _train(suite, whole, *INPUTS, "--samples", "24") == 0
    shutil.copytree(whole, parts)
    shutil.rmtree(parts / "checkpoints" / "step-000000006")
    shutil.rmtree(parts / "policy")
    assert _train(suite, parts, *INPUTS, "--samples", "24") == 0
    for name in ("model.safetensors", "tokenizer.json", "policy.json"):
        assert (whole / "policy" / name).read_bytes() == (parts / "policy" / name).read_bytes()
    lines = [json.loads(line) for line in (parts / "metrics.jsonl").read_text().splitlines()]
    asked = {"loss_maps" in line for line in lines}
    assert asked == {True, False} and all(
        ("loss_maps" in line) != ("loss_near_alone" in line) for line in lines
    )
    assert {"SR", "SR_near_alone", "first_action", "first_action_near_alone"} <= lines[-1].keys()
    capsys.readouterr()
    bench = ["bench", "run", str(suite), "--policy", "bae", "--policy-option",
             f"checkpoint={whole / 'policy'}", "--episodes", "1", "--no-report"]  # fmt: skip
    for name, backend in (("near_alone", "torch"), ("near_alone", "numpy"), ("maps", "numpy")):
        out = tmp_path / f"bench-{name}-{backend}"
        more = ["--policy-option", f"inputs={name}", "--policy-option", f"backend={backend}"]
        assert main([*bench, *more, "--out", str(out)]) == 0
        assert f'"{name}"' in (out / "run.json").read_text()
    assert main([*bench, "--policy-option", "inputs=views", "--out", str(tmp_path / "none")]) != 0
    assert "known: maps, near_alone" in capsys.readouterr().err


@pytest.mark.slow
def test_the_papers_prompt_on_whole_maps_is_trained_and_acts(
    suite, tmp_path, own_cache, monkeypatch
) -> None:
    if not shutil.which("g++"):
        pytest.skip("the host emulation needs g++")
    monkeypatch.setenv("GN0_CACHE", str(own_cache))
    out = tmp_path / "out"
    options = ["--prompt", "paper_planning_maps", "--map-size", "32,32", "--samples", "8"]
    assert _train(suite, out, *options, "--source", "uniform", "--jitter") == 0
    settings = json.loads((out / "policy" / "policy.json").read_text())
    assert settings["pictures"] == ["bev", "occupancy"] and settings["coordinates"] == "map"
    assert main(
        ["bench", "run", str(suite), "--policy", "bae", "--policy-option",
         f"checkpoint={out / 'policy'}", "--episodes", "1", "--no-report",
         "--out", str(tmp_path / "bench")]
    ) == 0  # fmt: skip


@pytest.mark.slow
def test_several_datasets_are_one_source(suite, tmp_path) -> None:
    plain = BuildSettings(pictures=PictureSettings(layout="none"))
    one, two = tmp_path / "first", tmp_path / "second"
    build_dataset(load_suite(suite), one, plain)
    build_dataset(load_suite(_make_suite(tmp_path, "other-flat", 1)), two, plain)
    options = ["--source", "dataset", "--shares", "0.7,0.3", "--samples", "16"]
    whole, parts = tmp_path / "whole", tmp_path / "parts"
    assert _train(one, whole, *options, also=(two,)) == 0
    shutil.copytree(whole, parts)
    shutil.rmtree(parts / "checkpoints" / "step-000000004")
    shutil.rmtree(parts / "policy")
    assert _train(one, parts, *options, also=(two,)) == 0
    name = Path("policy") / "model.safetensors"
    assert (whole / name).read_bytes() == (parts / name).read_bytes()
    assert _train(one, tmp_path / "odd", *options[:2], "--shares", "1", also=(two,)) == 2


@pytest.mark.slow
def test_scenes_join_at_their_number_of_samples(
    suite, tmp_path, own_cache, monkeypatch, capsys
) -> None:
    if not shutil.which("g++"):
        pytest.skip("the host emulation needs g++")
    monkeypatch.setenv("GN0_CACHE", str(own_cache))
    second = _make_suite(tmp_path, "other-flat", 1)
    growing = ["--joins", "0,8", "--samples", "16", "--text-length", "40"]
    whole, parts = tmp_path / "whole", tmp_path / "parts"
    assert _train(suite, whole, *growing, also=(second,)) == 0
    shutil.copytree(whole, parts)
    shutil.rmtree(parts / "checkpoints" / "step-000000004")
    shutil.rmtree(parts / "policy")
    assert _train(suite, parts, *growing, also=(second,)) == 0
    one, two = (run / "policy" / "model.safetensors" for run in (whole, parts))
    assert one.read_bytes() == two.read_bytes()
    capsys.readouterr()
    assert _train(suite, parts, *growing, also=(second,)) == 0
    assert "done before, at step 4" in capsys.readouterr().out
    assert _train(suite, tmp_path / "twice", "--joins", "0,8", also=(suite,)) == 2
    assert "is in two suites" in capsys.readouterr().err


def test_another_run_in_the_folder_is_refused(suite, tmp_path, capsys) -> None:
    out = tmp_path / "run"
    out.mkdir()
    (out / "notes.txt").write_text("mine")
    assert _train(suite, out, "--samples", "4") == 2
    assert "TRAINING" in capsys.readouterr().err
    assert (out / "notes.txt").read_text() == "mine"
