"""`gn0 train dapo`: from a policy to a policy, on where it stopped, by one process or two."""

from __future__ import annotations

import json
import os
import shutil
import socket
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import pytest

pytest.importorskip("torch")
pytest.importorskip("transformers")

import torch

from gn0.cli.main import main
from gn0.data.answer_form import AnswerForm
from gn0.errors import ConfigError, TrainingError
from gn0.maps.navigation import NavigationMap
from gn0.missions.goal import sample_goal_episodes
from gn0.policies.bae.policy_settings import PolicySettings
from gn0.scenes.example import build_example_scene
from gn0.scenes.folder import load_scene, save_scene
from gn0.sim.ego_map import EgoSquare, MapView
from gn0.suites.suite import load_suite, save_suite
from gn0.training.dapo import RECIPES_DAPO, DapoJob, train_dapo
from gn0.training.learner import Learner, freeze_tower
from gn0.training.pupil import build_pupil, load_pupil
from gn0.training.rl.dapo_stage import DapoPlan, DapoStage
from gn0.training.rl.policy_gradient import PolicyLoss
from gn0.training.rl.rollouts import RolloutSettings

SQUARES = MapView(squares=(EgoSquare(32, 0.24), EgoSquare(32, 0.6)))


@pytest.fixture(scope="module")
def suite(tmp_path_factory) -> Path:
    root = tmp_path_factory.mktemp("suite")
    save_scene(replace(build_example_scene(), id="flat"), root / "flat")
    scene = load_scene(root / "flat")
    episodes = sample_goal_episodes(scene, NavigationMap(scene.grid, 0.2), 6, 0)
    return save_suite(root / "suite", [scene], episodes, name="flat", max_steps=12).folder


@pytest.fixture(scope="module")
def start(suite, tmp_path_factory) -> Path:
    """A policy of random weights, small enough for many rollouts."""
    texts = [episode.instruction for episode in load_suite(suite).episodes]
    form = AnswerForm(points=2, layout="compact")
    settings = PolicySettings(prompt="short", pictures=("near", "far"), form=form, view=SQUARES)
    pupil = build_pupil("nano", settings, texts, merges=300)
    folder = tmp_path_factory.mktemp("start") / "policy"
    pupil.save(folder)
    return folder


@pytest.fixture(autouse=True)
def _cached(own_cache, monkeypatch) -> None:
    if not shutil.which("g++"):
        pytest.skip("the host emulation needs g++")
    monkeypatch.setenv("GN0_CACHE", str(own_cache))


def _job(suite: Path, start: Path, **more) -> DapoJob:
    own = {
        "splits": (), "held_out": (), "states": 8, "agents": 2, "epochs": 2, "prompts": 4,
        "minibatches": 2, "rollout": RolloutSettings(answers=3),
        "plan": DapoPlan(report=1, save=1),
    }  # fmt: skip
    return DapoJob(suites=(str(suite),), start=str(start), **(own | more))


def _train(job: DapoJob, out: Path, said: list[str] | None = None) -> Path:
    say = (said if said is not None else []).append
    return train_dapo(job, out, device="host", say=say)


def _read(out: Path) -> list[dict]:
    return [json.loads(line) for line in (out / "metrics.jsonl").read_text().splitlines()]


def test_a_stopped_run_ends_in_the_same_bytes(suite, start, tmp_path, monkeypatch) -> None:
    """States, their order, answers and weights: all go on as if the run had never stopped."""
    whole, parts = tmp_path / "whole", tmp_path / "parts"
    job = _job(suite, start)
    policy = _train(job, whole)

    class StoppedError(Exception):
        pass

    learn = DapoStage.learn

    def stop(self, *args) -> None:
        if self.counters.step == 2:
            raise StoppedError
        learn(self, *args)

    with monkeypatch.context() as patched:
        patched.setattr(DapoStage, "learn", stop)
        with pytest.raises(StoppedError):
            _train(job, parts)
    said: list[str] = []
    other = _train(job, parts, said)
    for name in ("model.safetensors", "policy.json"):
        assert (policy / name).read_bytes() == (other / name).read_bytes()
    timed = ("seconds", "samples_per_second")
    one, two = ([{k: v for k, v in line.items() if k not in timed} for line in _read(out)]
                for out in (whole, parts))  # fmt: skip
    assert one == two and [line["step"] for line in one] == [1, 2, 3, 4]
    assert one[-1]["samples"] == 4 * 12
    assert one[0]["kl"] == 0 < one[-1]["kl"]
    assert "step 4/4" in said[-1] and "reward" in said[-1]
    assert _train(job, parts, said) == other and said[-1] == "done before, at step 4"
    with pytest.raises(TrainingError, match="another run"):
        _train(_job(suite, start, low=0.1), parts)


def test_the_tower_stands_still_and_the_rest_learns(suite, start, tmp_path) -> None:
    policy = _train(_job(suite, start, states=8, epochs=1), tmp_path / "run")
    before = load_pupil(start).model.state_dict()
    after = load_pupil(policy).model.state_dict()
    moved = {name for name, weight in after.items() if not torch.equal(weight, before[name])}
    assert any("visual.merger" in name for name in moved)
    assert any("visual.deepstack_merger_list" in name for name in moved)
    assert any("language_model" in name for name in moved)
    parts = ("visual.merger", "visual.deepstack_merger_list")
    assert not {n for n in moved if "visual." in n and not any(part in n for part in parts)}
    record = json.loads((tmp_path / "run" / "run.json").read_text())
    weights = {"first": 0.5, "collision": 0.5, "length": 0.2, "format": 2.0,
               "position_scale": 0.5, "waypoint_scale": 0.3}  # fmt: skip
    assert record["recipe"]["rollout"]["reward"] == weights
    card = (policy / "README.md").read_text()
    assert "stage `dapo`" in card and '"format": 2.0' in card
    assert f"| began from | …/{start.name} |" in card


def test_answers_are_judged_by_the_weights_that_gave_them(
    suite, start, tmp_path, monkeypatch
) -> None:
    """At a rollout's first minibatch no ratio is clipped; the last ones learn from old answers."""
    ratios: list[float] = []
    forward = PolicyLoss.forward

    def watch(self, batch):
        with torch.no_grad():
            found = self.score(batch.pictures, batch.ids, batch.answers)
        ratios.append(float((found.logprobs - batch.old).abs().max()))
        return forward(self, batch)

    monkeypatch.setattr(PolicyLoss, "forward", watch)
    recipe = replace_rate(1e-3)
    _train(_job(suite, start, states=8, epochs=1, recipe=recipe), tmp_path / "run")
    assert len(ratios) == 4
    assert ratios[0] == ratios[2] == 0
    assert min(ratios[1], ratios[3]) > 1e-4


def replace_rate(rate: float):
    import msgspec

    return msgspec.structs.replace(RECIPES_DAPO["scratch"], rate=rate, warm_steps=0)


def test_a_loss_that_is_not_finite_stops_and_names_step_and_batch(
    suite, start, tmp_path, monkeypatch
) -> None:
    step = Learner.step

    def spoil(self, batch, share):
        if spoiled.append(0) or len(spoiled) == 6:
            batch.advantages.fill_(torch.nan)
        return step(self, batch, share)

    spoiled: list[int] = []
    monkeypatch.setattr(Learner, "step", spoil)
    with pytest.raises(TrainingError, match="loss is nan at step 3") as caught:
        _train(_job(suite, start), tmp_path / "run")
    assert "batch 2 of 2, of states 8 and on" in str(caught.value)
    assert sorted(p.name for p in (tmp_path / "run" / "checkpoints").iterdir()) == [
        "step-000000001", "step-000000002",
    ]  # fmt: skip


def test_jobs_that_make_no_sense_are_refused(suite, start, tmp_path) -> None:
    for more, told in (
        ({"states": 1, "epochs": 2}, "give 2 states or more"),
        ({"minibatches": 5}, "at most one a prompt"),
        ({"resample": 2}, "drop groups"),
    ):
        with pytest.raises(ConfigError) as caught:
            _job(suite, start, **more)
        assert told in caught.value.remedy
    assert _job(suite, start).recipe.batch == 12
    long = _job(suite, start, rollout=RolloutSettings(answers=3, overlong=4))
    with pytest.raises(ConfigError, match="too long"):  # before anybody walks
        _train(long, tmp_path / "run")
    assert not (tmp_path / "run").exists()


@pytest.mark.slow
def test_a_random_policy_comes_to_do_what_pays(suite, start, tmp_path) -> None:
    """Rewards alone, of its own states: half as much again after two dozen rollouts."""
    job = _job(
        suite, start, states=32, agents=4, epochs=6, prompts=8, minibatches=2,
        rollout=RolloutSettings(), recipe=replace_rate(5e-4), plan=DapoPlan(report=4, save=0),
    )  # fmt: skip
    _train(job, tmp_path / "run")
    lines = _read(tmp_path / "run")
    assert lines[-1]["reward"] > 1.5 * lines[0]["reward"] > 0.3
    assert lines[-1]["reward_first"] > lines[0]["reward_first"] + 0.2
    assert lines[-1]["entropy"] < lines[0]["entropy"]


@pytest.mark.slow
def test_further_prompts_take_the_place_of_groups_without_variance(suite, start, tmp_path) -> None:
    settings = RolloutSettings(answers=2, drop_uniform=True, temperature=0.01)
    job = _job(suite, start, rollout=settings, resample=2, states=24, epochs=1)
    _train(job, tmp_path / "run")
    lines = _read(tmp_path / "run")
    assert len(lines) < 6  # some steps took several rounds of prompts
    assert all(line["samples"] == 8 * (k + 1) for k, line in enumerate(lines))


@pytest.mark.slow
def test_the_verb_examines_before_and_after(suite, start, tmp_path, capsys) -> None:
    out = tmp_path / "run"
    words = ["train", "dapo", str(suite), "--start", str(start), "--split", "all", "--held-out",
             load_suite(suite).episodes[0].split, "--states", "8", "--epochs", "1", "--agents", "4",
             "--prompts", "4", "--answers", "2", "--minibatches", "2", "--examined", "2", "--asked",
             "8", "--report", "1", "--device", "host", "--reward-length", "0.4",
             "--out", str(out)]  # fmt: skip
    assert main(words) == 0
    told = capsys.readouterr().out
    assert "before: SR" in told and f"checkpoint={out}/policy" in told
    lines = _read(out)
    assert [line["step"] for line in lines] == [0, 1, 2]
    assert "SR" in lines[0] and "SR" in lines[2] and "entropy" in lines[0]
    card = (out / "policy" / "README.md").read_text()
    assert '"length": 0.4' in card and "| before_SR |" in card and "| SR % |" in card
    assert json.loads((out / "run.json").read_text())["results"]["episodes"] == 2
    assert main([*words[:-1], str(tmp_path / "none"), "--start", str(tmp_path)]) == 2
    assert "no policy.json" in capsys.readouterr().err


@pytest.mark.slow
def test_two_processes_train_one_policy(suite, start, tmp_path) -> None:
    with socket.socket() as found:
        found.bind(("127.0.0.1", 0))
        port = str(found.getsockname()[1])
    words = ["train", "dapo", str(suite), "--start", str(start), "--split", "all", "--held-out",
             "", "--states", "8", "--epochs", "1", "--agents", "2", "--prompts", "4", "--answers",
             "2", "--minibatches", "2", "--report", "1", "--device", "host",
             "--out", str(tmp_path / "run")]  # fmt: skip
    own = {"WORLD_SIZE": "2", "MASTER_ADDR": "127.0.0.1", "MASTER_PORT": port}
    both = [
        subprocess.Popen(
            [sys.executable, "-m", "gn0", *words],
            env=os.environ | own | {"RANK": str(rank), "LOCAL_RANK": str(rank)},
            stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True,
        )
        for rank in range(2)
    ]  # fmt: skip
    told = [one.communicate(timeout=300)[0] for one in both]
    assert [one.returncode for one in both] == [0, 0], told
    assert "written to" in told[0]
    assert [line["samples"] for line in _read(tmp_path / "run")] == [8, 16]
    assert load_pupil(tmp_path / "run" / "policy").model is not None


def test_what_is_frozen(make_pupil) -> None:
    pupil = make_pupil()
    freeze_tower(pupil)
    still = {n for n, w in pupil.model.named_parameters() if not w.requires_grad}
    assert still and all("visual." in name and "merger" not in name for name in still)
