"""`gn0 policy show` and `ask`, the benchmark and the demo run a checkpoint on the core install."""

from __future__ import annotations

import json
import sys
from dataclasses import replace
from pathlib import Path

import pytest
from PIL import Image

from gn0.bench.results import load_results
from gn0.cli import train_packages
from gn0.cli.demo import choose_camera, find_trained
from gn0.cli.main import main
from gn0.errors import CheckpointError
from gn0.maps.navigation import NavigationMap
from gn0.missions.goal import sample_goal_episodes
from gn0.policies.bae import engines
from gn0.scenes.example import build_example_scene
from gn0.scenes.folder import load_scene, save_scene
from gn0.suites.suite import save_suite
from gn0_trials.random_policy import write_random_policy

STEPS = 7


@pytest.fixture(scope="module")
def policy(tmp_path_factory: pytest.TempPathFactory) -> str:
    return str(write_random_policy(tmp_path_factory.mktemp("nano") / "policy"))


@pytest.fixture(scope="module")
def scene(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("scene") / "flat"
    save_scene(replace(build_example_scene(), id="flat"), folder)
    return folder


@pytest.fixture(scope="module")
def suite(scene: Path) -> Path:
    flat = load_scene(scene)
    episodes = sample_goal_episodes(flat, NavigationMap(flat.grid, 0.2), 4, 0)
    out = scene.parent / "suite"
    return save_suite(out, [flat], episodes, name="flat", max_steps=STEPS).folder


@pytest.fixture(autouse=True)
def core_install(monkeypatch: pytest.MonkeyPatch) -> None:
    """Nothing of the extra `train` is found, and but for torch nothing can be imported."""
    for name in ("transformers", "tokenizers", "safetensors"):
        monkeypatch.setitem(sys.modules, name, None)
    for module in (engines, train_packages):
        monkeypatch.setattr(module, "find_spec", lambda name: None)
    monkeypatch.delenv("GN0_POLICY", raising=False)


def show(policy: str, suite: Path, out: Path, *more: str) -> int:
    return main(["policy", "show", policy, str(suite), "--out", str(out), *more])


def test_the_benchmark_runs_it_and_its_cases_are_drawn(
    policy: str, suite: Path, tmp_path: Path, worker_here: None, capsys
) -> None:
    run = tmp_path / "run"
    assert main(
        ["bench", "run", str(suite), "--policy", "bae", "--policy-option", f"checkpoint={policy}",
         "--no-report", "--out", str(run)]
    ) == 0  # fmt: skip
    results = load_results(run)
    assert [r.status for r in results] == ["valid"] * 4
    for seed in ("0", "0"):
        assert show(policy, suite, tmp_path / "cases.png", "--from", str(run), "--pick", "1",
                    "--seed", seed) == 0  # fmt: skip
    with Image.open(tmp_path / "cases.png") as picture:
        assert picture.width == 1800
    capsys.readouterr()
    (tmp_path / "walks.jsonl").write_text('{"episode": "elsewhere", "success": true}\n')
    assert show(policy, suite, tmp_path / "x.png", "--from", str(tmp_path / "walks.jsonl")) == 2
    assert "no episode 'elsewhere'" in capsys.readouterr().err


def test_a_decision_and_a_whole_walk_are_drawn(
    policy: str, suite: Path, tmp_path: Path, capsys
) -> None:
    assert show(policy, suite, tmp_path / "one.png", "--step", "4") == 0
    assert show(policy, suite, tmp_path / "all.jpg", "--steps", "all") == 0
    with Image.open(tmp_path / "one.png") as picture:
        assert picture.width == 1800 and picture.height > 1000
    with Image.open(tmp_path / "all.jpg") as picture:
        assert picture.format == "JPEG"
    assert not list(tmp_path.glob("*.tmp*"))
    capsys.readouterr()
    for more, said in (
        (("--episode", "flat_9"), "did you mean"),
        (("--step", "99"), "the walk ends after step"),
        (("--pose", "1,2"), "is not a pose"),
        (("--pose", "1e3,0,0"), "cannot stand at"),
        (("--pose", "1,2,3", "--steps", "all"), "--pose and --steps"),
        (("--pick", "9"), "--pick and --seed draw episodes of a run"),
    ):
        assert show(policy, suite, tmp_path / "bad.png", *more) == 2
        assert said in capsys.readouterr().err
    assert show(policy, suite, tmp_path / "bad.gif") == 2
    assert show(str(tmp_path / "nowhere"), suite, tmp_path / "bad.png") == 2
    assert "no such checkpoint" in capsys.readouterr().err
    assert not list(tmp_path.glob("bad*"))


def ask(policy: str, scene: str, text: str, out: Path, *more: str) -> int:
    return main(["policy", "ask", policy, scene, text, "--out", str(out), "--steps", "3", *more])


def test_an_errand_leaves_a_video_a_page_and_the_walk(
    policy: str, scene: Path, tmp_path: Path, capsys
) -> None:
    out = tmp_path / "ask"
    assert ask(policy, str(scene), "go to <FWD> the sofa", out) == 0
    said = capsys.readouterr().out
    assert "it stands at" in said and str(out / "walk.mp4") in said
    walk = json.loads((out / "walk.json").read_text())
    assert walk["instruction"] == "go to the sofa"
    assert len(walk["steps"]) == walk["end"]["steps"] <= 3
    assert (out / "walk.mp4").read_bytes()[4:8] == b"ftyp"
    page = (out / "index.html").read_text("utf-8")
    assert "“go to the sofa”" in page and "default-src " in page and "<script" not in page
    assert ask(policy, str(scene), "go", out) == 2
    assert "--overwrite" in capsys.readouterr().err
    assert ask(policy, str(scene), "go on", out, "--overwrite") == 0
    again = json.loads((out / "walk.json").read_text())
    assert again["instruction"] == "go on" and again["start"] == walk["start"]


def test_what_makes_no_sense_is_told_before_anything_is_written(
    policy: str, scene: Path, suite: Path, tmp_path: Path, capsys
) -> None:
    out = tmp_path / "ask"
    for place, text, said in (
        (str(scene), "", "says nothing"),
        (str(scene), "x" * 10_000, "10000 characters"),
        (str(scene), "<action><STOP>", "says nothing"),
        (str(tmp_path / "gone"), "go", "no such scene"),
        (str(suite), "go", "is a suite"),
        ("apartment", "go", "has no seed"),
        ("apartment:x", "go", "has no seed"),
    ):
        assert ask(policy, place, text, out) == 2
        assert said in capsys.readouterr().err
        assert not out.exists()
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "notes.txt").write_text("mine")
    assert ask(policy, str(scene), "go", tmp_path / "mine", "--overwrite") == 2
    assert (tmp_path / "mine" / "notes.txt").read_text() == "mine"


def test_the_demo_takes_the_policy_that_is_named(
    policy: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("GN0_POLICY", policy)
    found = find_trained()
    assert found is not None and str(found.folder) == policy
    assert choose_camera(found) == choose_camera(None) == "gn_bench"  # it sees maps alone
    monkeypatch.setenv("GN0_POLICY", str(tmp_path))
    with pytest.raises(CheckpointError, match="names no checkpoint"):
        find_trained()


def test_packing_asks_for_what_it_needs(policy: str, tmp_path: Path, capsys) -> None:
    assert main(["policy", "pack", policy, "--out", str(tmp_path / "out")]) == 2
    assert "torch" in capsys.readouterr().err
    (tmp_path / "run.json").write_text("{}")
    assert main(["policy", "pack", str(tmp_path), "--out", str(tmp_path / "out")]) == 2
    assert "has no policy yet" in capsys.readouterr().err
