"""SFT: samples a second with pictures made beside the learner, and where the time goes."""

from __future__ import annotations

import os
import subprocess
import sys
import time
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import torch

from gn0.data.answer_form import AnswerForm
from gn0.errors import DeviceMemoryError
from gn0.maps.navigation import NavigationMap
from gn0.missions.goal import sample_goal_episodes
from gn0.policies.bae.policy_settings import PolicySettings
from gn0.scenes.example import build_example_scene
from gn0.scenes.folder import load_scene, save_scene
from gn0.sim.ego_map import EgoSquare, MapView
from gn0.suites.suite import save_suite
from gn0.training.learner import Learner, open_learner
from gn0.training.pupil import Pupil, build_pupil
from gn0.training.recipe import Recipe, parse_speed
from gn0.training.streams.samples import Stream
from gn0.training.streams.step_ring import StepRing
from gn0.training.streams.stream_live import StreamLive
from gn0.training.streams.stream_uniform import StreamUniform
from gn0.training.worlds import Lessons, list_squares, load_lessons, open_world
from gn0_figures.board import Figure, FigureContext, FigureRow, row_at_least
from gn0_figures.device import is_emulation

AIMS = {1: 10_000.0, 2: 7_000.0, 4: 4_000.0}  # samples a second, by pictures
INPUTS = (("near", "far"), ("rgb", "history", "near", "far"), ("near",), ("rgb", "history"))
HOMES = 4
ENOUGH = 215.0  # s after which no further thing is compiled
QUICKEST = "whole,joined,narrow"  # on an H100, says train.speed
PARTS = ("draw", "assemble", "forward", "backward", "optimiser")
SMALL = MapView(squares=(EgoSquare(32, 0.24), EgoSquare(32, 0.6)))


class Bench:
    """What is measured with, on a card or in miniature on the emulation.

    Args:
        ctx: of the figure.
        lessons: to learn from.
    """

    def __init__(self, ctx: FigureContext, lessons: Lessons) -> None:
        self.ctx, self.lessons, self.began = ctx, lessons, time.perf_counter()
        self.tiny = is_emulation(ctx.device)
        self.agents = 4 if self.tiny else 1024
        self.kept = 80 if self.tiny else 102_400
        self.rounds = 1 if self.tiny else 32
        self.rows: list[FigureRow] = []

    @property
    def late(self) -> bool:
        """Whether there is no time left to compile anything further."""
        return time.perf_counter() - self.began > ENOUGH

    def add(self, row: FigureRow) -> None:
        """Say and keep a row."""
        self.rows.append(row)
        self.ctx.report(row)

    def build(self, pictures: tuple[str, ...]) -> Pupil:
        """A policy that is shown these pictures."""
        form = AnswerForm(layout="compact")
        settings = PolicySettings(prompt="short", pictures=pictures, form=form)
        if self.tiny:
            settings = PolicySettings(prompt="short", pictures=pictures, form=form, view=SMALL)
        pupil = build_pupil("nano" if self.tiny else "tiny", settings, self.lessons.texts)
        pupil.model.to("cpu" if self.tiny else "cuda").train()
        return pupil

    def open_stream(self, pupil: Pupil, source: str) -> Stream:
        """Samples of a source for a policy."""
        squares = list_squares(pupil.settings)
        world = open_world(self.lessons, pupil.settings, self.agents, device=self.ctx.device)
        if source == "uniform":
            return StreamUniform(world, seed=0, names=squares)
        ring = StepRing(world, max(17, self.kept // self.agents), names=squares)
        return StreamLive(world, ring, seed=0)

    def wait(self) -> None:
        """Until the card has done all."""
        if torch.cuda.is_available():
            torch.cuda.synchronize()

    def time(self, call: Callable[[], object], warm: int = 3) -> float:
        """Seconds of a call, the mean of some after the warm ones."""
        for _ in range(1 if self.tiny else warm):
            call()
        self.wait()
        begin = time.perf_counter()
        for _ in range(self.rounds):
            call()
        self.wait()
        return (time.perf_counter() - begin) / self.rounds


def make_suite(folder: Path, tiny: bool) -> Path:
    """A suite of draft flats with their missions; one small flat in miniature."""
    if tiny:
        save_scene(replace(build_example_scene(), id="flat"), folder / "flat")
        scene = load_scene(folder / "flat")
        episodes = sample_goal_episodes(scene, NavigationMap(scene.grid, 0.2), 4, 0)
        return save_suite(folder / "suite", [scene], episodes, name="flat", max_steps=12).folder
    homes, missions = folder / "homes.yaml", folder / "missions.yaml"
    homes.write_text(
        f"name: sft\nseed: 21\nval_seen: 1.0\nparts:\n  - {{kind: apartment, size: small, count: "
        f"{HOMES}, density: 2500, light: draft, split: train, name: flat}}\n"
    )
    missions.write_text(  # as in runs/ablation
        "per_scene: 12\nmissions: [goal, instruction]\nstyles: [detailed, benchmark]\n"
        "minimum_length: 5\nlights: 3\n"
    )
    flats, suite = folder / "homes", folder / "suite"
    for words in (
        ("scene", "corpus", "--spec", str(homes), "--out", str(flats), "--no-sheet"),
        ("missions", "generate", str(flats), "--spec", str(missions), "--camera", "tiny_128",
         "--seed", "21", "--out", str(suite)),
    ):  # fmt: skip
        workers = ("--workers", str(min(HOMES, os.cpu_count() or 1)))
        done = subprocess.run(
            [sys.executable, "-m", "gn0", *words, *workers],
            env=os.environ | {"NUMBA_NUM_THREADS": "1"}, capture_output=True, text=True,
        )  # fmt: skip
        if done.returncode:
            raise RuntimeError(f"gn0 {words[0]} {words[1]}: {done.stderr[-1000:]}")
    return suite


def open_bench(ctx: FigureContext) -> Bench:
    """A suite is made, and says how long it took."""
    began = time.perf_counter()
    lessons = load_lessons(make_suite(ctx.work, is_emulation(ctx.device)))
    bench = Bench(ctx, lessons)
    made = f"{len(lessons.scene_ids)} flats, {len(lessons.episodes)} episodes"
    bench.add(FigureRow(
        name="suite made in", value=time.perf_counter() - began, unit="s", detail=made
    ))  # fmt: skip
    bench.began = began
    return bench


def measure_sft(ctx: FigureContext) -> list[FigureRow]:
    """Samples a second by source and pictures, and the split of a step."""
    bench = open_bench(ctx)
    for pictures in INPUTS[:1] if bench.tiny else INPUTS:  # by worth
        if pictures == INPUTS[0] or not bench.late:
            _measure_input(bench, pictures, QUICKEST)
    if not bench.late:
        _measure_batch(bench, 8 if bench.tiny else 2048, QUICKEST)
    return bench.rows


def _measure_input(bench: Bench, pictures: tuple[str, ...], speed: str) -> None:
    """Rates of both sources with these pictures, batch 512, and the split of a step."""
    torch.compiler.reset()
    pupil = bench.build(pictures)
    maker = pupil.maker(bench.lessons.texts, pupil.model.device)
    learner = open_learner(pupil, maker.table, Recipe(), parse_speed(speed.split(",")))
    beside, batch = _beside(learner), 4 if bench.tiny else 512
    for source in ("walks", "uniform"):
        stream = bench.open_stream(pupil, source)

        def step(own: Learner = learner, stream: Stream = stream) -> None:
            made = maker.make(stream.draw(batch))
            with own.queue():
                own.step(made, 0.01)

        rate = batch / bench.time(step)
        over = batch / bench.time(partial(step, beside), 1)
        name = f"samples a second, {len(pictures)} of {source}: {', '.join(pictures)}"
        detail = f"in line {rate:,.0f}/s; {len(maker.table.layout)} + {len(pupil.slots)} tokens, "
        detail += f"batch {batch}, {bench.agents} agents, pictures made beside it; steps on a "
        detail += f"stream of their own: {over:,.0f}/s; --speed {speed}"
        rate = max(rate, over)
        bench.add(
            FigureRow(name=name, value=rate, unit="1/s", detail=detail)
            if bench.tiny
            else row_at_least(name, rate, AIMS[len(pictures)], "1/s", detail)
        )
        if pictures == INPUTS[0]:
            _split_step(bench, learner, maker, stream, source)
        del stream
        free_memory()


def _measure_batch(bench: Bench, batch: int, speed: str) -> None:
    """The rate of a larger batch; the last of all, as a card that was full stays so."""
    torch.compiler.reset()
    pupil = bench.build(INPUTS[0])
    maker = pupil.maker(bench.lessons.texts, pupil.model.device)
    learner = open_learner(pupil, maker.table, Recipe(), parse_speed(speed.split(",")))
    stream = bench.open_stream(pupil, "walks")
    detail = f"{', '.join(INPUTS[0])}; {bench.agents} agents; --speed {speed}"
    name, value, unit = "batch that does not fit", float(batch), ""
    try:
        rate = batch / bench.time(lambda: learner.step(maker.make(stream.draw(batch)), 0.01))
    except (DeviceMemoryError, torch.OutOfMemoryError) as error:
        detail = f"{detail}: {error}"
    else:
        name, value, unit = f"samples a second, batch {batch}", rate, "1/s"
    bench.add(FigureRow(name=name, value=value, unit=unit, detail=detail))


def _beside(learner: Learner) -> Learner:
    """The same learner with a stream of its own."""
    return Learner(learner.loss, learner.recipe, autocast=learner.autocast, beside=True)


def _split_step(bench: Bench, learner: Learner, maker: Any, stream: Stream, source: str) -> None:
    """Milliseconds of the parts of a step in line, and how often it waits for the card."""
    batch, count = (4 if bench.tiny else 512), len(PARTS)
    spent = [0.0] * count

    def walk() -> Iterator[None]:
        states = stream.draw(batch)
        yield
        made = maker.make(states)
        yield
        losses = learner.judge(made)
        yield
        learner.descend(losses)
        yield
        learner.update(0.01)
        yield

    clocks: list[list[Callable[[], float]]] = []
    begin = time.perf_counter()
    with count_waits() as waits:
        for _ in range(bench.rounds):
            clocks.append([mark_time()])
            for _ in walk():
                clocks[-1].append(mark_time())
    issued = time.perf_counter() - begin
    bench.wait()
    for marks in clocks:
        times = [mark() for mark in marks]
        for k in range(count):
            spent[k] += (times[k + 1] - times[k]) / bench.rounds
    for name, milliseconds in zip(PARTS, spent, strict=True):
        detail = f"{source}, {batch} samples, near and far, in line"
        bench.add(FigureRow(
            name=f"{name}, {source}", value=milliseconds, unit="ms", detail=detail
        ))  # fmt: skip
    detail = (
        f"by torch in {bench.rounds} steps; issued in {issued / bench.rounds * 1e3:.3g} ms each"
    )
    bench.add(
        FigureRow(name=f"waits for the card, {source}", value=waits[0], unit="", detail=detail)
    )


def mark_time() -> Callable[[], float]:
    """Milliseconds of this moment on the card, or by the clock; ask once all is done."""
    if not torch.cuda.is_available():
        now = time.perf_counter() * 1e3
        return lambda: now
    event = torch.cuda.Event(enable_timing=True)
    event.record()
    return lambda: _ORIGIN[0].elapsed_time(event)


_ORIGIN: list[Any] = []


@contextmanager
def count_waits() -> Iterator[list[float]]:
    """How often torch waits for the card within; nought on a CPU."""
    found = [0.0]
    if not torch.cuda.is_available():
        yield found
        return
    _ORIGIN[:] = [torch.cuda.Event(enable_timing=True)]
    _ORIGIN[0].record()
    torch.cuda.synchronize()
    with warnings.catch_warnings(record=True) as said:
        warnings.simplefilter("always")
        torch.cuda.set_sync_debug_mode("warn")
        try:
            yield found
        finally:
            torch.cuda.set_sync_debug_mode("default")
    found[0] = float(sum("synchroniz" in str(one.message) for one in said))


def free_memory() -> None:
    """Give the card back what torch keeps for later."""
    if torch.cuda.is_available():
        torch.cuda.synchronize()
        torch.cuda.empty_cache()


FIGURES = [Figure("train.sft", "Supervised fine-tuning", measure_sft, 4.0, backend="cuda")]
