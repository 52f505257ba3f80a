"""RL on whole episodes: returns and advantages by hand, who is done counts for nothing, resume."""

from __future__ import annotations

import json
import math
import os
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

torch = pytest.importorskip("torch")
pytest.importorskip("transformers")

import msgspec  # noqa: E402

from gn0.cli.main import main  # noqa: E402
from gn0.errors import CheckpointError, DeviceMemoryError, TrainingError  # noqa: E402
from gn0.scenes.folder import load_scene  # noqa: E402
from gn0.suites.suite import save_suite  # noqa: E402
from gn0.training.episode_rl import train_episode_rl  # noqa: E402
from gn0.training.exams.walks import Walk  # noqa: E402
from gn0.training.rl.decision_store import DecisionStore  # noqa: E402
from gn0.training.rl.episode_walks import list_decisions, pick_episodes  # noqa: E402
from gn0.training.rl.returns import ReturnWeights, score_walks, weigh_groups  # noqa: E402
from gn0.training.runs.loss_guard import LossGuard  # noqa: E402
from gn0.training.runs.training_state import load_state  # noqa: E402
from gn0_trials.episodes_small import build_walker, make_job, open_small  # noqa: E402


def walk(steps: int = 5, **values) -> Walk:
    """A walk that ends without STOP, half way."""
    plain = {
        "episode": "e", "scene": "s", "kind": "goal", "steps": steps, "stopped": False,
        "length": 4.0, "shortest": 8.0, "left": 4.0, "least": 4.0, "success": False,
        "success_near": False, "oracle": False, "spl": 0.0, "forwards": 4, "cut_short": 0,
        "path": "p", "tier": "", "left_straight": 4.0, "success_straight": False,
        "spl_straight": 0.0, "spl_near": 0.0, "decisions": 2,
    }  # fmt: skip
    return Walk(**(plain | values))


WALKS = [
    walk(success=True, stopped=True, spl=0.8, left=1.0),  # 1 + 0.8 − 1/8
    walk(cut_short=3),  # −4/8 − 3 · 0.05
    walk(left=12.0),  # walked away: −12/8
    walk(left=8.0, cut_short=10),  # −1 − 0.5
    walk(), walk(), walk(), walk(),
]  # fmt: skip


def test_returns_by_hand() -> None:
    returns = score_walks(WALKS)
    assert returns.total.tolist() == pytest.approx([1.675, -0.65, -1.5, -1.5] + [-0.5] * 4)
    dear = score_walks(WALKS, ReturnWeights(success=2, spl=0, left=0.5, cut_short=1))
    assert dear.total[:2].tolist() == pytest.approx([2 - 1 / 16, -0.25 - 3])
    assert score_walks([walk(shortest=0.0, left=0.0)]).total.tolist() == [0.0]


def test_one_advantage_an_episode_and_none_where_all_did_alike() -> None:
    returns = score_walks(WALKS)
    gains, kept, spread = weigh_groups(returns, 4)
    mine = np.array([1.675, -0.65, -1.5, -1.5])
    assert gains[:4] == pytest.approx((mine - mine.mean()) / (mine.std() + 1e-6))
    assert gains[4:].tolist() == [0.0] * 4
    assert kept.tolist() == [True, False]
    assert spread == pytest.approx([mine.std(), 0])
    # by the task alone: who never arrives is told nothing
    failed = score_walks([walk(left=float(k)) for k in range(4)])
    assert weigh_groups(failed, 2)[1].tolist() == [True, True]
    assert weigh_groups(failed, 2, "task")[1].tolist() == [False, False]
    assert not weigh_groups(failed, 2, "task")[0].any()


def test_each_lap_goes_through_all_episodes_in_an_order_of_its_own() -> None:
    updates = [pick_episodes(10, k, 4, seed=1) for k in range(5)]
    listed = [number for update in updates for number in update]
    laps = [listed[:10], listed[10:]]
    assert [sorted(lap) for lap in laps] == [list(range(10))] * 2
    assert laps[0] != laps[1]
    assert pick_episodes(10, 3, 4, seed=1) == updates[3]
    assert pick_episodes(10, 3, 4, seed=2) != updates[3]
    assert sorted(pick_episodes(2, 0, 4, seed=1)) == [0, 0, 1, 1]


def test_decisions_behind_the_end_are_not_learned_from() -> None:
    walks = [walk(steps) for steps in (3, 4, 1, 7)]
    rows, carried = list_decisions(walks, np.array([True, True]), 2, 3)
    # agents 0 and 2 decide once, 1 twice, 3 three times; a number is decision · 4 + agent
    assert rows.tolist() == [0, 1, 2, 3, 5, 7, 11]
    assert carried.tolist() == [3, 3, 1, 3, 1, 3, 1]
    rows, carried = list_decisions(walks, np.array([True, False]), 2, 3)
    assert rows.tolist() == [0, 1, 5]
    assert not len(list_decisions(walks, np.array([False, False]), 2, 3)[0])


def test_a_store_that_does_not_fit_says_what_would(pupil) -> None:
    layout, here = pupil.table.layout, torch.device("cpu")
    each = 2 * 32 * 32 * 3 + 4 * len(layout) + 8 * len(pupil.slots)
    assert DecisionStore(layout, len(pupil.slots), 3, 4, here).nbytes == 12 * each
    with pytest.raises(DeviceMemoryError, match=f"take {12 * each} bytes") as caught:
        DecisionStore(layout, len(pupil.slots), 3, 4, here, memory=7 * each)
    assert "7 decisions fit: 2 agents of as many, or 1 each" in str(caught.value)


@pytest.fixture(scope="module")
def start(flats_suite, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A policy to begin from."""
    if not shutil.which("g++"):
        pytest.skip("the host emulation needs g++")
    folder = tmp_path_factory.mktemp("start") / "policy"
    build_walker([episode.instruction for episode in flats_suite.episodes]).save(folder)
    return folder


@pytest.fixture
def stage(flats_suite, start):
    """Two episodes, three agents in each, twelve actions, before the first update."""
    return open_small(make_job(flats_suite.folder, start))


def _weights(stage) -> list[torch.Tensor]:
    return [weight.detach().clone() for weight in stage.learner.weights.values()]


def _learn(stage, rollout) -> list[torch.Tensor]:
    """What an update makes of the weights, which are put back."""
    before = _weights(stage)
    stage.learn(0, rollout, stage.score(rollout), LossGuard())
    after = _weights(stage)
    with torch.no_grad():
        for weight, old in zip(stage.learner.weights.values(), before, strict=True):
            weight.copy_(old)
    stage.learner.optimiser.state.clear()
    assert any(not torch.equal(a, b) for a, b in zip(before, after, strict=True))
    return after


def test_scripted_answers_have_the_returns_that_one_counts(stage) -> None:
    """One agent stops at once, one turns until its time is up, one walks till it meets a wall."""
    plans = torch.tensor([[0] * 6, [2] * 6, [1] * 6])
    decide = stage.loop.actor.decide

    def say(pictures, prompts, draws):
        said = decide(pictures, prompts, draws)
        return type(said)(
            said.ids, plans.repeat(2, 1), said.tokens, said.logprobs, said.entropy
        )  # fmt: skip

    stage.loop.actor.decide = say
    rollout = stage.walk(0)
    assert [one.steps for one in rollout.walks] == [1, 12, 12] * 2
    listed = stage.loop.env.tasks.episodes
    numbers = pick_episodes(len(listed), 0, 2, 0)
    assert [one.episode for one in rollout.walks[::3]] == [listed[k].id for k in numbers]
    for group in (rollout.walks[:3], rollout.walks[3:]):
        stops, turns, walks = group
        assert stops.shortest > 3 and not stops.success  # too far to stop at once
        assert turns.left == stops.left == stops.shortest
        assert walks.forwards == 12
    found = rollout.returns.total
    assert found[[0, 1, 3, 4]].tolist() == [-1.0] * 4
    for k in (2, 5):
        one = rollout.walks[k]
        assert found[k] == pytest.approx(-one.left / one.shortest - 0.05 * one.cut_short)
    # who stopped decides once, the others four times
    assert np.bincount(rollout.rows % 6).tolist() == [1, 4, 4] * 2
    assert rollout.gains[0] == rollout.gains[1]


def test_what_was_said_after_the_end_changes_nothing(stage) -> None:
    rollout = stage.walk(0)
    live = np.zeros(stage.store.count * stage.store.agents, bool)
    live[rollout.rows] = True
    assert 0 < live.sum() < len(live)
    plain = _learn(stage, rollout)
    for kept in stage.store._kept:
        flat = kept[: stage.store.count].flatten(0, 1)
        flat[torch.from_numpy(~live)] = 1
    for one, other in zip(plain, _learn(stage, rollout), strict=True):
        assert torch.equal(one, other)


def test_the_batch_is_filled_up_with_what_does_not_count(stage, flats_suite, start) -> None:
    """In float64: Adam goes by signs, so what is rounding in a gradient is none in a weight."""
    other = open_small(make_job(flats_suite.folder, start, batch=3))
    for one in (stage, other):
        one.pupil.model.double()
    plain = _learn(stage, stage.walk(0))
    for one, two in zip(plain, _learn(other, other.walk(0)), strict=True):
        assert torch.allclose(one, two, atol=2e-5)
    assert any(
        weight.requires_grad for weight in stage.pupil.model.model.visual.merger.parameters()
    )
    assert not stage.pupil.model.model.visual.patch_embed.proj.weight.requires_grad


def test_tokens_of_actions_that_were_not_carried_out_can_be_left_out(
    stage, flats_suite, start
) -> None:
    whole = stage._take(stage.walk(0), np.arange(3))
    slots = stage.pupil.slots
    assert (whole.mask[:3].sum(1) == 24 + 6).all()  # twelve waypoints and all actions
    assert not whole.mask[3:].any()
    other = open_small(make_job(flats_suite.folder, start, tokens="executed"))
    rollout = other.walk(0)
    batch = other._take(rollout, np.arange(len(rollout.rows))[:8])
    mask = batch.mask[: min(8, len(rollout.rows))]
    said = torch.from_numpy((slots.kinds == 3) & slots.chosen)
    assert mask[:, said].sum(1).tolist() == rollout.carried[: len(mask)].tolist()
    assert (mask[:, ~said].sum(1) == 24).all()


def test_the_kl_to_the_start_is_nought_before_the_first_step(stage) -> None:
    rollout = stage.walk(0)
    scores = stage.score(rollout)
    assert stage.compare(rollout, scores) == pytest.approx(0, abs=1e-6)
    assert scores.gap < 1e-5 and scores.entropy > 0
    stage.learn(0, rollout, scores, LossGuard())
    assert stage.compare(rollout, stage.score(rollout)) > 1e-6


def _run(suite, start: Path, out: Path, *more: str) -> int:
    return main(
        ["train", "rl", str(suite.folder), "--start", str(start), "--split", "all",
         "--held-out", "", "--episodes", "2", "--group", "3", "--max-steps", "12", "--batch", "8",
         "--rate", "1e-3", "--save", "1", "--device", "host", "--out", str(out), *more]
    )  # fmt: skip


@pytest.mark.slow
def test_a_stopped_run_ends_in_the_same_policy(flats_suite, start, tmp_path, capsys) -> None:
    whole, parts = tmp_path / "whole", tmp_path / "parts"
    assert _run(flats_suite, start, whole, "--updates", "3") == 0
    told = capsys.readouterr().out
    assert "update 3/3 · return" in told and f"checkpoint={whole}/policy" in told
    assert _run(flats_suite, start, parts, "--updates", "2") == 0
    assert _run(flats_suite, start, parts, "--updates", "3") == 0
    for name in ("model.safetensors", "tokenizer.json", "policy.json"):
        assert (whole / "policy" / name).read_bytes() == (parts / "policy" / name).read_bytes()
    lines = [json.loads(t) for t in (parts / "metrics.jsonl").read_text().splitlines()]
    assert [line["step"] for line in lines] == [1, 2, 3]
    for name in (
        "return", "return_success", "return_spl", "return_left", "return_cut_short", "group_std",
        "dropped", "clipped", "answer_entropy", "kl", "seconds_walk", "seconds_score",
        "seconds_learn",
    ):  # fmt: skip
        assert name in lines[0]
    capsys.readouterr()
    assert _run(flats_suite, start, parts, "--updates", "3") == 0
    assert "done before, at update 3" in capsys.readouterr().out
    assert _run(flats_suite, start, parts, "--updates", "3", "--seed", "1") == 2
    assert "the folder holds another run" in capsys.readouterr().err


def test_a_loss_that_is_not_finite_stops_and_leaves_the_last_checkpoint(
    flats_suite, start, tmp_path, monkeypatch
) -> None:
    from gn0.training.rl.episode_stage import EpisodeStage

    learned = EpisodeStage.learn

    def spoil(self, update, rollout, scores, guard):
        if update == 1:
            scores.old.fill_(math.nan)
        return learned(self, update, rollout, scores, guard)

    monkeypatch.setattr(EpisodeStage, "learn", spoil)
    job = make_job(flats_suite.folder, start, updates=3)
    with pytest.raises(TrainingError, match="loss is nan at step 2") as caught:
        train_episode_rl(job, tmp_path / "run", device="host", say=lambda _: None)
    assert "minibatch 1 of 2" in str(caught.value) and "step-000000001" in str(caught.value)
    state = load_state(tmp_path / "run" / "checkpoints")
    assert state.counters.step == 1
    assert all(torch.isfinite(weight).all() for weight in state.checkpoint.model.parameters())


def test_what_is_no_policy_is_told_before_anything_is_made(
    flats_suite, start, tmp_path, capsys
) -> None:
    out = tmp_path / "out"
    assert _run(flats_suite, tmp_path, out) == 2
    assert "no policy.json" in capsys.readouterr().err
    assert _run(flats_suite, start, out, "--held-out", "nowhere") == 2
    assert "no split 'nowhere'" in capsys.readouterr().err
    assert _run(flats_suite, start, out, "--executed", "7") == 2
    assert "7 of 6 actions" in capsys.readouterr().err
    bare = tmp_path / "bare"
    shutil.copytree(start, bare)
    for name in ("shards.json", "model.safetensors"):
        (bare / name).unlink()
    job = make_job(flats_suite.folder, bare)
    with pytest.raises(CheckpointError, match="shards are missing"):
        train_episode_rl(job, out, device="host")
    assert not out.exists()


@pytest.mark.slow
def test_two_processes_share_the_episodes(flats_suite, start, tmp_path) -> None:
    done = subprocess.run(
        [sys.executable, "-m", "torch.distributed.run", "--standalone", "--nproc-per-node=2", "-m",
         "gn0_trials.episodes_small", str(flats_suite.folder), str(start), str(tmp_path / "two"),
         "2"],
        env=os.environ | {"OMP_NUM_THREADS": "1"}, capture_output=True, text=True, timeout=600,
    )  # fmt: skip
    assert done.returncode == 0, done.stdout + done.stderr
    lines = (tmp_path / "two" / "metrics.jsonl").read_text().splitlines()
    assert [json.loads(line)["step"] for line in lines] == [1, 2]
    assert (tmp_path / "two" / "policy" / "model.safetensors").is_file()


@pytest.mark.slow
def test_the_return_of_a_two_armed_problem_rises(flats_suite, tmp_path) -> None:
    """Goals are 1.5 m away, and three actions are all there are: stop among them, or fail."""
    if not shutil.which("g++"):
        pytest.skip("the host emulation needs g++")
    near = []
    for episode in flats_suite.episodes:
        path = np.array(episode.path)
        begin = int(np.flatnonzero(np.linalg.norm(path - path[-1], axis=1) > 1.5)[-1])
        pose = (*episode.path[begin], episode.start[2])
        near.append(msgspec.structs.replace(episode, start=pose, path=episode.path[begin:]))
    scenes = [load_scene(flats_suite.scene_folder(s.id)) for s in flats_suite.about.scenes]
    suite = save_suite(tmp_path / "near", scenes, near, name="near", max_steps=3)
    build_walker([episode.instruction for episode in near], points=0).save(tmp_path / "start")
    told: list[dict[str, float]] = []
    job = make_job(
        suite.folder, tmp_path / "start", updates=12, episodes=4, group=16, max_steps=3, batch=64,
        minibatches=1, rate=1e-4,
    )  # fmt: skip
    train_episode_rl(job, tmp_path / "run", device="host", say=lambda _: None)
    for line in (tmp_path / "run" / "metrics.jsonl").read_text().splitlines():
        told.append(json.loads(line))
    assert told[0]["return_success"] < 0.8
    assert told[-1]["return_success"] > 0.95
    assert told[-1]["return"] > told[0]["return"] + 0.5
