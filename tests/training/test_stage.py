"""A stage that was stopped goes on to the same bytes; one that fails leaves what was good."""

from __future__ import annotations

import itertools
import json
import math
from types import SimpleNamespace

import pytest

pytest.importorskip("torch")
pytest.importorskip("transformers")

import torch

from gn0.errors import TrainingError
from gn0.policies.bae.checkpoint import Checkpoint
from gn0.training.learner import Learner, LossForward
from gn0.training.recipe import Recipe
from gn0.training.runs.run_folder import open_run
from gn0.training.runs.training_state import load_state
from gn0.training.stage import Stage, StagePlan

RECIPE = Recipe(batch=4, warm_steps=2, mean=0.9)


class Counted:
    """States that hang on how many were drawn."""

    texts = ("", "", "")

    def __init__(self, draw) -> None:
        self._draw, self.drawn = draw, 0

    def draw(self, count: int):
        states = self._draw(count, seed=self.drawn)
        self.drawn += count
        return states

    def state(self):
        return {"drawn": self.drawn}

    def restore(self, state) -> None:
        self.drawn = state["drawn"]


class Kept:
    """What a stage needs of a pupil."""

    def __init__(self, pupil, model) -> None:
        self.checkpoint = Checkpoint(model, pupil.tokenizer, pupil.ids)


def _open(folder, **options):
    return open_run(
        folder, stage="sft", recipe={}, hashes={"corpus": "c"}, command=["gn0"], device="cpu",
        versions={}, **options,
    )  # fmt: skip


def _run(
    pupil, stream, folder, samples: int, save: int = 2, *, said=None, examine=None, minutes=None
) -> Stage:
    with _open(folder) as run:
        state = load_state(run.resumed) if run.resumed else None
        model = state.checkpoint.model.train() if state else pupil.model
        forward = pupil.forward_of(model)
        learner = Learner(LossForward(forward, pupil.slots, RECIPE), RECIPE)
        plan = StagePlan(samples=samples, report=2, save=save, minutes=minutes)
        stage = Stage(Kept(pupil, model), learner, stream, pupil.maker, plan, {}, "c")
        if state is not None:
            stage.restore(state)
        stage.run(run, (said if said is not None else []).append, examine)
    return stage


def test_a_run_with_a_limit_says_what_is_left_of_it(make_pupil, draw_states, tmp_path, monkeypatch):
    """By a clock that goes on by a second each time that it is looked at."""
    clock = SimpleNamespace(monotonic=map(float, itertools.count()).__next__)
    monkeypatch.setattr("gn0.training.stage.time", clock)
    said: list[str] = []
    stage = _run(
        make_pupil(), Counted(draw_states), tmp_path / "run", 10**9, 0, said=said, minutes=0.5
    )
    first, last = said[0], said[-1]
    assert first.startswith("step 2 · 8 samples") and 0 < float(first[-7:-5]) < 30, first
    assert first.endswith(" left") and last.startswith(f"step {stage.counters.step}/")


def _weights(stage: Stage) -> list[torch.Tensor]:
    learner = stage.learner
    return [*learner.weights.values(), *learner.averaged.values()]


def test_a_run_that_was_stopped_ends_in_the_same_bytes(words, make_pupil, draw_states, tmp_path):
    whole = _run(make_pupil(), Counted(draw_states), tmp_path / "whole", 24)

    class StoppedError(Exception):
        pass

    def stop() -> dict[str, float]:
        raise StoppedError

    half = Counted(draw_states)
    original = half.draw

    def draw(count: int):
        if half.drawn == 16:
            stop()
        return original(count)

    half.draw = draw
    with pytest.raises(StoppedError):
        _run(make_pupil(), half, tmp_path / "parts", 24)
    said: list[str] = []
    again = _run(make_pupil(), Counted(draw_states), tmp_path / "parts", 24, said=said)
    assert again.counters.step == 6 and again.counters.samples == 24
    for one, other in zip(_weights(whole), _weights(again), strict=True):
        assert torch.equal(one, other)
    steps = [
        json.loads(line)["step"]
        for line in (tmp_path / "parts" / "metrics.jsonl").read_text().splitlines()
    ]
    assert steps == [2, 4, 6]
    assert "step 6/6" in said[-1] and "first action" in said[-1]


def test_more_samples_lengthen_a_run_that_was_done(words, make_pupil, draw_states, tmp_path):
    _run(make_pupil(), Counted(draw_states), tmp_path, 8)
    longer = _run(make_pupil(), Counted(draw_states), tmp_path, 16)
    assert longer.counters.step == 4 and longer.schedule.end == 4


def test_a_loss_that_is_not_finite_stops_and_leaves_the_last_checkpoint(
    words, make_pupil, draw_states, tmp_path, monkeypatch
):
    pupil = make_pupil()
    stream = Counted(draw_states)
    original = stream.draw

    def draw(count: int):
        states = original(count)
        if stream.drawn > 12:
            with torch.no_grad():  # a weight that went bad
                next(iter(current[0].weights.values())).fill_(math.nan)
        return states

    stream.draw = draw
    current: list[Learner] = []
    made = Learner.__init__

    def remember(self, *args, **options) -> None:
        made(self, *args, **options)
        current[:] = [self]

    monkeypatch.setattr(Learner, "__init__", remember)
    with pytest.raises(TrainingError, match="loss is nan at step 4"):
        _run(pupil, stream, tmp_path, 24, save=1)
    state = load_state(tmp_path / "checkpoints")
    assert state.counters.step == 3
    assert all(torch.isfinite(w).all() for w in state.checkpoint.model.parameters())


def test_what_is_examined_stands_in_the_curves(words, make_pupil, draw_states, tmp_path):
    _run(
        make_pupil(), Counted(draw_states), tmp_path, 8, examine=lambda: {"waypoint_12_median": 0.5}
    )
    last = json.loads((tmp_path / "metrics.jsonl").read_text().splitlines()[-1])
    assert last["waypoint_12_median"] == 0.5 and last["samples"] == 8
