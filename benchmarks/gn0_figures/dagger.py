"""DAgger: labelled states that a policy visits, and samples learned beside them, a second."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from itertools import pairwise

import torch

from gn0.policies.bae.actor import Actor
from gn0.training.learner import Learner, open_learner
from gn0.training.policy_driver import PolicyDriver, open_driver
from gn0.training.pupil import Pupil
from gn0.training.recipe import Recipe
from gn0.training.streams.samples import SampleMaker
from gn0.training.streams.step_ring import StepRing
from gn0.training.streams.stream_live import StreamLive
from gn0.training.worlds import list_squares, load_lessons, open_world
from gn0_figures.board import Figure, FigureContext, FigureRow, row_at_least
from gn0_figures.device import is_emulation
from gn0_figures.sft import Bench, count_waits, free_memory, make_suite, mark_time

STATES, MINUTES = 2_000_000.0, 10.0  # labelled states that the policy visits, in so many
DECISIONS = 2000.0  # a second, with four pictures
INPUTS = (("near", "far"), ("rgb", "history", "near", "far"))
RATIOS = (0.5, 1.0)  # new states a sample
PARTS = ("acting", "stepping", "labelling", "assembling", "learning")


@dataclass
class _Loop:
    """A policy that drives, and learns.

    Attributes:
        pupil, driver: the policy, in training and acting.
        learner, maker: how it learns.
        stream: of the agents that it drives.
        batch: samples of a step.
    """

    pupil: Pupil
    driver: PolicyDriver
    learner: Learner
    maker: SampleMaker
    stream: StreamLive
    batch: int

    def step(self) -> None:
        """Walk as far as is due, and learn from a batch."""
        self.learner.step(self.maker.make(self.stream.draw(self.batch)), 0.01)


def measure_dagger(ctx: FigureContext) -> list[FigureRow]:
    """States and samples a second with two and four pictures, and where the time goes."""
    began = time.perf_counter()
    lessons = load_lessons(make_suite(ctx.work, is_emulation(ctx.device)))
    bench = Bench(ctx, lessons)
    made = f"{len(lessons.scene_ids)} flats, {len(lessons.episodes)} episodes"
    bench.add(FigureRow(
        name="suite made in", value=time.perf_counter() - began, unit="s", detail=made
    ))  # fmt: skip
    for pictures in INPUTS[:1] if bench.tiny else INPUTS:
        torch.compiler.reset()
        loop = _open_loop(bench, pictures)
        _measure_walks(bench, loop)
        _split(bench, loop)
        for ratio in RATIOS:
            _measure_live(bench, loop, ratio)
        del loop
        free_memory()
    return bench.rows


def _open_loop(bench: Bench, pictures: tuple[str, ...]) -> _Loop:
    pupil = bench.build(pictures)
    device, squares = pupil.model.device, list_squares(pupil.settings)
    world = open_world(bench.lessons, pupil.settings, bench.agents, device=bench.ctx.device)
    ring = StepRing(world, max(17, bench.kept // bench.agents), names=squares)
    stream = StreamLive(world, ring, seed=0)
    maker = pupil.maker(stream.texts, device)
    learner = open_learner(pupil, maker.table, Recipe())
    driver = open_driver(pupil, bench.agents, dtype=learner.autocast).enter(maker)
    stream.driver = driver
    return _Loop(pupil, driver, learner, maker, stream, 4 if bench.tiny else 512)


def _add(bench: Bench, name: str, value: float, floor: float, detail: str) -> None:
    """A row; on a card it must reach the floor."""
    row = FigureRow(name=name, value=value, unit="1/s", detail=detail)
    bench.add(row if bench.tiny else row_at_least(name, value, floor, "1/s", detail))


def _tell(loop: _Loop) -> str:
    actor, pictures = loop.driver.actor, loop.pupil.settings.pictures
    text = f"{', '.join(pictures)}; {actor.count} agents, {loop.driver.executed} actions a decision"
    return f"{text}, {len(loop.maker.table.layout)} + {len(loop.pupil.slots)} tokens"


def _measure_walks(bench: Bench, loop: _Loop) -> None:
    """Collecting alone: the policy drives, every step is labelled and kept."""
    executed, agents = loop.driver.executed, bench.agents

    def decide() -> None:
        for _ in range(executed):
            loop.stream.step()

    count = len(loop.pupil.settings.pictures)
    seconds = bench.time(decide)
    rate = executed * agents / seconds
    detail = f"{_tell(loop)}; {rate * 60 * MINUTES / 1e6:.3g} M in {MINUTES:g} minutes"
    _add(bench, f"labelled states a second, collecting, {count} pictures", rate,
         STATES / (60 * MINUTES), detail)  # fmt: skip
    _add(bench, f"decisions a second, collecting, {count} pictures", agents / seconds,
         DECISIONS, _tell(loop))  # fmt: skip
    unlike = _compare(loop)
    detail = f"of {agents} agents where they stand; else captured as one graph"
    bench.add(FigureRow(
        name=f"actions unlike those without a graph, {count} pictures", value=unlike, unit="",
        detail=detail,
    ))  # fmt: skip


def _compare(loop: _Loop) -> float:
    """Agents that the driver tells something else than an actor that is not recorded."""
    stream, actor = loop.stream, loop.driver.actor
    plain = Actor(
        loop.pupil.model, loop.maker.table.layout, loop.pupil.slots, loop.pupil.settings.frame,
        actor.count, dtype=loop.learner.autocast, recorded=False,
    )  # fmt: skip
    other = PolicyDriver(plain, loop.maker, loop.driver.executed)
    states = stream.ring.latest()
    return float((loop.driver(states) != other(states)).any(1).sum())


def _measure_live(bench: Bench, loop: _Loop, ratio: float) -> None:
    """The whole loop, beta 0: walk and learn in turns."""
    stream, count = loop.stream, len(loop.pupil.settings.pictures)
    stream.ratio = ratio
    # as many steps are behind it as are due
    stream.drawn = int((stream.ring.count - stream.fill) * bench.agents / ratio)
    steps = stream.ring.count
    begun = time.perf_counter()
    with count_waits() as waits:
        seconds = bench.time(loop.step)
    passed = time.perf_counter() - begun
    rate = loop.batch / seconds
    visited = (stream.ring.count - steps) * bench.agents / passed
    detail = f"{_tell(loop)}, batch {loop.batch}, {ratio:g} new states a sample; {visited:,.0f} "
    detail += f"states/s or {visited * 60 * MINUTES / 1e6:.3g} M in {MINUTES:g} minutes; torch "
    detail += f"waited {waits[0]:g} times for the card"
    name = f"samples a second, live, {count} pictures, {ratio:g} states each"
    bench.add(FigureRow(name=name, value=rate, unit="1/s", detail=detail))


def _split(bench: Bench, loop: _Loop) -> None:
    """Milliseconds of a decision's parts and of the batches that go with it, in line."""
    stream, count = loop.stream, len(loop.pupil.settings.pictures)
    executed, ratio = loop.driver.executed, RATIOS[0]
    batches = max(1, round(executed * bench.agents / ratio / loop.batch))
    clocks: list[tuple[str, Callable[[], float]]] = []

    def walk() -> Iterator[str]:
        for _ in range(executed):
            labels = stream._look()
            yield "labelling"
            actions = stream._choose(torch.from_dlpack(labels.actions)[:, 0])
            yield "acting"
            stream._move(actions)
            yield "stepping"
        for _ in range(batches):
            made = loop.maker.make(stream.draw(loop.batch))
            yield "assembling"
            loop.learner.step(made, 0.01)
            yield "learning"

    # no step is due while batches are drawn
    stream.ratio, stream.fill = 1e-9, 1
    loop.step()
    bench.wait()
    with count_waits() as waits:
        for _ in range(bench.rounds):
            clocks.append(("", mark_time()))
            clocks.extend((part, mark_time()) for part in walk())
    bench.wait()
    spent = dict.fromkeys(PARTS, 0.0)
    marks = [(part, mark()) for part, mark in clocks]
    for (_, before), (part, after) in pairwise(marks):
        if part:
            spent[part] += (after - before) / bench.rounds
    stream.fill = min(64, stream.ring.steps)
    told = f"of {bench.agents} agents' decision with {executed} steps, and {batches} batches of "
    told += f"{loop.batch}, in line; torch waited {waits[0]:g} times in {bench.rounds} rounds"
    for part in PARTS:
        name = f"{part}, {count} pictures"
        bench.add(FigureRow(name=name, value=spent[part], unit="ms", detail=told))


FIGURES = [Figure("train.dagger", "DAgger", measure_dagger, 4.0, backend="cuda")]
