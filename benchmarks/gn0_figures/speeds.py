"""Ways to compute a step of training on a card: samples a second of each `--speed`."""

from __future__ import annotations

import time
from functools import partial

import torch

from gn0.training.learner import open_learner
from gn0.training.recipe import Recipe, parse_speed
from gn0_figures.board import Figure, FigureContext, FigureRow
from gn0_figures.sft import INPUTS, free_memory, open_bench

SPEEDS = {
    "layer by layer": "blocks",
    "joined products": "joined",
    "narrow": "narrow",
    "joined and narrow": "joined,narrow",
    "as a whole": "whole",
    "as a whole, joined and narrow": "whole,joined,narrow",
    "tuned, joined and narrow": "tuned,joined,narrow",
}


def measure_speeds(ctx: FigureContext) -> list[FigureRow]:
    """A step on samples that lie there, computed in each of these ways: samples a second."""
    bench, pictures = open_bench(ctx), INPUTS[0]
    batch = 4 if bench.tiny else 512
    pupil = bench.build(pictures)
    maker = pupil.maker(bench.lessons.texts, pupil.model.device)
    stream = bench.open_stream(pupil, "uniform")
    made = maker.make(stream.draw(batch))
    del stream
    free_memory()
    kept = {name: weight.clone() for name, weight in pupil.model.state_dict().items()}
    for name in SPEEDS:  # by worth: what there is no time for is left out
        if bench.late:
            break
        torch.compiler.reset()
        pupil.model.load_state_dict(kept)
        speed = parse_speed(SPEEDS[name].split(","))
        learner = open_learner(pupil, maker.table, Recipe(), speed)
        begin = time.perf_counter()
        loss = float(learner.judge(made).loss.detach())
        step = partial(learner.step, made, 0.01)
        step()
        bench.wait()
        compiled = time.perf_counter() - begin
        rate = batch / bench.time(step)
        detail = (
            f"{batch} samples that lie there, {', '.join(pictures)}; ready after {compiled:.3g} "
        )
        detail += f"s; loss {loss:.6g}; --speed {SPEEDS[name]}"
        bench.add(
            FigureRow(name=f"samples a second, {name}", value=rate, unit="1/s", detail=detail)
        )
    return bench.rows


FIGURES = [
    Figure("train.speed", "Ways to compute a step of training", measure_speeds, 4.0, backend="cuda")
]
