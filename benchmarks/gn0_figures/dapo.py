"""DAPO: seconds of a step of 64 prompts with 8 answers each, and where they go."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from typing import Any

import torch
from torch import Tensor

from gn0.seeds import derive_seed
from gn0.training.dapo import DapoJob, open_policy_learner
from gn0.training.learner import freeze_tower
from gn0.training.pupil import Pupil
from gn0.training.rl.dapo_stage import DapoStage
from gn0.training.rl.rollouts import RolloutMaker, RolloutSettings
from gn0.training.rl.visited_states import collect_states
from gn0.training.worlds import load_lessons, open_world
from gn0_figures.board import Figure, FigureContext, FigureRow, row_at_most
from gn0_figures.device import is_emulation
from gn0_figures.sft import Bench, count_waits, make_suite, mark_time

SECONDS = 0.5  # of a step, at most
PARTS = ("sampling", "rollout", "reward", "log-probabilities", "update")
INPUTS = (("near", "far"), ("rgb", "history", "near", "far"))
STATES = 8192


def measure_dapo(ctx: FigureContext) -> list[FigureRow]:
    """A step by pictures: as a whole, by part, and how often it waits for the card."""
    began = time.perf_counter()
    tiny = is_emulation(ctx.device)
    bench = Bench(ctx, load_lessons(make_suite(ctx.work, tiny)))
    bench.began = began
    for pictures in INPUTS[:1] if tiny else INPUTS:
        if not bench.late:
            _measure_input(bench, pictures)
    return bench.rows


def _measure_input(bench: Bench, pictures: tuple[str, ...]) -> None:
    torch.compiler.reset()
    pupil = bench.build(pictures)
    stage, seconds = _open_stage(bench, pupil)
    shown = ", ".join(pictures)
    count = len(stage.maker.visited)
    bench.add(FigureRow(
        name=f"{count:,} states of the policy's walks, {len(pictures)} pictures", value=seconds,
        unit="s", detail=f"{shown}; {stage.maker.visited.ring.agents} agents, labels, kept views",
    ))  # fmt: skip

    def step() -> None:
        for _ in _walk(stage):
            pass

    whole = bench.time(step)
    answers = stage.maker.settings.answers
    layout = stage.maker.visited.maker.table.layout
    name = f"a step of {stage.prompts} × {answers}, {len(pictures)} pictures"
    detail = f"{shown}; {len(layout)} + {len(stage.maker.slots)} tokens, {stage.minibatches} "
    detail += f"minibatches; {stage.prompts * answers / whole:,.0f} answers a second"
    bench.add(
        FigureRow(name=name, value=whole, unit="s", detail=detail)
        if bench.tiny
        else row_at_most(name, whole, SECONDS, "s", detail)
    )
    _split_step(bench, stage, pictures)


def _open_stage(bench: Bench, pupil: Pupil) -> tuple[DapoStage, float]:
    """A stage whose states are collected, and the seconds that this took."""
    tiny = bench.tiny
    job = DapoJob(
        suites=("suite",), start="policy", states=16 if tiny else STATES, prompts=4 if tiny else 64,
        agents=4 if tiny else 128, rollout=RolloutSettings(answers=2 if tiny else 8),
        epochs=1_000_000,
    )  # fmt: skip
    freeze_tower(pupil)
    world = open_world(bench.lessons, pupil.settings, job.agents, device=bench.ctx.device)
    dtype = None if tiny else torch.bfloat16
    begin = time.perf_counter()
    visited = collect_states(world, pupil, job.states, seed=0, dtype=dtype)
    bench.wait()
    seconds = time.perf_counter() - begin
    maker = RolloutMaker(pupil, visited, job.rollout, job.prompts, dtype=dtype)
    learner = open_policy_learner(job, pupil, maker)
    start = {name: weight.detach().clone() for name, weight in learner.weights.items()}
    stage = DapoStage(
        pupil=pupil, learner=learner, maker=maker, plan=job.plan, recipe={}, corpus="",
        start=start, epochs=job.epochs, prompts=job.prompts, minibatches=job.minibatches,
    )  # fmt: skip
    return stage, seconds


def _walk(stage: DapoStage) -> Iterator[None]:
    """A step, part by part."""
    maker = stage.maker
    asked = maker.ask(stage.pick_states(stage.prompts), derive_seed(0, "figure", stage.at))
    yield
    walks = maker.walk(asked)
    yield
    rollout = maker.score(asked, walks)
    told = maker.measure(rollout)
    yield
    old = stage.recall(rollout)
    yield

    def tell(number: int, losses: Any, norm: Tensor) -> None:
        told[f"loss_{number}"] = losses.loss

    stage.learn(maker.batch(rollout, old), 1.0, tell)
    yield


def _split_step(bench: Bench, stage: DapoStage, pictures: tuple[str, ...]) -> None:
    """Milliseconds of the parts of a step, and how often it waits for the card."""
    spent, clocks = [0.0] * len(PARTS), []
    begin = time.perf_counter()
    with count_waits() as waits:
        for _ in range(bench.rounds):
            marks: list[Callable[[], float]] = [mark_time()]
            marks += [mark_time() for _ in _walk(stage)]
            clocks.append(marks)
    issued = time.perf_counter() - begin
    bench.wait()
    for marks in clocks:
        times = [mark() for mark in marks]
        for k in range(len(PARTS)):
            spent[k] += (times[k + 1] - times[k]) / bench.rounds
    end = f", {len(pictures)} pictures"
    for name, milliseconds in zip(PARTS, spent, strict=True):
        bench.add(FigureRow(name=name + end, value=milliseconds, unit="ms"))
    detail = f"by torch in {bench.rounds} steps; issued in {issued / bench.rounds * 1e3:.3g} ms "
    bench.add(FigureRow(
        name=f"waits for the card{end}", value=waits[0], unit="", detail=detail + "each"
    ))  # fmt: skip


FIGURES = [Figure("train.dapo", "DAPO", measure_dapo, 4.0, backend="cuda")]
