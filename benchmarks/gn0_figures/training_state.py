"""Figures of a training run's checkpoints: seconds, bytes, and what kill −9 leaves."""

from __future__ import annotations

import shutil
import time

from gn0.training.runs.training_state import load_state, measure_state, save_state
from gn0_figures.board import Figure, FigureContext, FigureRow, row_at_least, row_at_most
from gn0_trials.training_kills import LearnerOfWords, WordsRecipe, kill_training

TIMES, KILLS = 5, 100


def measure_checkpoints(ctx: FigureContext) -> list[FigureRow]:
    """Seconds and bytes of a checkpoint of size tiny, and 100 kills of a run of size nano."""
    learner = LearnerOfWords(recipe=WordsRecipe(size="tiny"))
    learner.learn(1)
    for _, weight in learner.named:  # the vision tower is in what is saved, though words alone came
        weight.grad = weight.detach() * 0 if weight.grad is None else weight.grad
    learner.optimiser.step()
    folder = ctx.work / "tiny"
    saving: list[float] = []
    loading: list[float] = []
    for step in range(1, TIMES + 1):
        learner.step = step
        begin = time.perf_counter()
        path = save_state(folder, learner.state())
        saving.append(time.perf_counter() - begin)
        begin = time.perf_counter()
        load_state(folder)
        loading.append(time.perf_counter() - begin)
    millions = sum(weight.numel() for _, weight in learner.named) / 1e6
    detail = f"tiny, {millions:.1f} M weights of float32, averaged weights, both moments of AdamW; "
    worst = f"the slowest of {TIMES}"
    rows = [
        row_at_most("save", max(saving), 2.0, "s", f"{detail}synced and hashed; {worst}"),
        FigureRow(
            name="load", value=max(loading), unit="s",
            detail=f"{detail}every byte checked, model built; {worst}",
        ),
        FigureRow(name="size", value=measure_state(path) / 1e6, unit="MB", detail=detail + "all"),
    ]  # fmt: skip
    save_state(folder, learner.state(), without_optimiser=True)
    light = "without the optimiser; weights and averaged weights"
    rows.append(
        FigureRow(
            name="size without optimiser", value=measure_state(path) / 1e6, unit="MB", detail=light
        )
    )
    for row in rows:
        ctx.report(row)
    shutil.rmtree(folder)
    tally = kill_training(ctx.work / "kills", KILLS)
    detail = (
        f"nano, a state every 2 steps, kill −9 at {tally.kills} random moments, {tally.saving} of "
        f"them with a half-written state on the disk; {tally.step} steps in all"
    )
    found = row_at_least(
        "kills that leave the last or the one before", tally.last, KILLS, "", detail
    )
    detail = "weights, averaged weights and every loss, against the same run without kills"
    same = row_at_least("same bits after all kills", float(tally.equal), 1, "", detail)
    for row in (found, same):
        ctx.report(row)
    return [*rows, found, same]


FIGURES = [
    Figure(
        "train.checkpoint", "Checkpoints of a training run, and kill −9", measure_checkpoints, 4.0
    )
]
