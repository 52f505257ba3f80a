"""RL on whole episodes: seconds of an update of 64 × 8 agents, and where they go."""

from __future__ import annotations

import numpy as np

from gn0.data.answer_slots import ACTION
from gn0.training.episode_rl import EpisodeJob, open_stage
from gn0.training.exams.evaluation import ClosedLoop
from gn0.training.processes import ALONE
from gn0.training.rl.episode_recipe import EpisodePlan, EpisodeRecipe
from gn0.training.rl.episode_stage import EpisodeStage
from gn0.training.rl.episode_walks import PARTS
from gn0.training.runs.loss_guard import LossGuard
from gn0.training.worlds import load_lessons
from gn0_figures.board import Figure, FigureContext, FigureRow, row_at_most
from gn0_figures.device import is_emulation
from gn0_figures.sft import Bench, make_suite

SECONDS = 30.0  # of an update, at most
PICTURES = ("near", "far")
SMALL = EpisodeRecipe(episodes=2, group=2, max_steps=6, batch=4, minibatches=2)


def measure_episode_rl(ctx: FigureContext) -> list[FigureRow]:
    """An update of a policy that never stops, the longest there is, and of one that does."""
    tiny = is_emulation(ctx.device)
    bench = Bench(ctx, load_lessons(make_suite(ctx.work, tiny)))
    pupil = bench.build(PICTURES)
    start = ctx.work / "start"
    pupil.save(start, overwrite=True)
    recipe = SMALL if tiny else EpisodeRecipe()
    job = EpisodeJob(suites=("suite",), start=str(start), recipe=recipe, plan=EpisodePlan())
    stage = open_stage(
        job, pupil, bench.lessons, ctx.device, processes=ALONE, recipe={}, say=lambda _: None
    )
    agents = f"{recipe.episodes} × {recipe.group} agents"
    bench.add(FigureRow(
        name="what is kept of decisions", value=stage.store.nbytes / 1e9, unit="GB",
        detail=f"{agents}, {stage.store.decisions} decisions each, {' and '.join(PICTURES)}",
    ))  # fmt: skip
    actor, allowed = stage.loop.actor, list(stage.loop.actor._allowed)
    slots, stop = pupil.slots, pupil.slots.vocabulary.actions[0]
    for slot in np.flatnonzero(slots.kinds == ACTION).tolist():
        own = allowed[slot]
        assert not isinstance(own, int)
        actor._allowed[slot] = own[own != stop]
    _measure_update(bench, stage, "nobody stops")
    stage.loop = ClosedLoop(
        stage.loop.env, pupil, dtype=stage.learner.autocast, compiled=not tiny, temperature=1.0
    )
    _measure_update(bench, stage, "a quarter of all actions is STOP")
    return bench.rows


def _measure_update(bench: Bench, stage: EpisodeStage, who: str) -> None:
    """An update's seconds and their split; the first one builds graphs, and is not counted."""
    how, guard = stage.how, LossGuard()
    rounds = 1 if bench.tiny else 2
    told = [stage.update(number, guard) for number in range(rounds + 1)][1:]
    mean = {name: sum(one[name] for one in told) / rounds for name in told[0]}
    parts = {name: mean[f"seconds_{name}"] for name in PARTS}
    detail = f"tiny, {', '.join(PICTURES)}, {how.episodes} × {how.group} agents, {who}; "
    detail += f"{how.max_steps} actions at most, {stage.loop.executed} a decision; "
    detail += f"{mean['decisions']:,.0f} decisions, {mean['learned']:,.0f} learned from; "
    detail += f"{mean['decisions'] / parts['walk']:,.0f} decisions a second, "
    detail += f"{mean['learned'] / parts['learn']:,.0f} learned a second"
    seconds = sum(parts.values())
    name = f"an update, {who}"
    bench.add(
        FigureRow(name=name, value=seconds, unit="s", detail=detail)
        if bench.tiny
        else row_at_most(name, seconds, SECONDS, "s", detail)
    )
    for part, value in parts.items():
        bench.add(FigureRow(name=f"{part}, {who}", value=value, unit="s"))


FIGURES = [Figure("train.rl", "RL on whole episodes", measure_episode_rl, 4.0, backend="cuda")]
