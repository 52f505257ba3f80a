"""Deciding and walking: decisions a second of many agents on a card, and of one on CPU cores."""

from __future__ import annotations

import os
import subprocess
import sys
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor

from gn0.data.answer_form import AnswerForm
from gn0.maps.navigation import NavigationMap
from gn0.policies.bae.actor import Actor
from gn0.policies.bae.engines import open_engine
from gn0.policies.bae.policy_settings import PolicySettings
from gn0.policies.bae.questions import Questions
from gn0.seeds import random_stream
from gn0.sim.device_env import VectorEnvDevice
from gn0.sim.ego_map import EgoSquare, MapView
from gn0.testing.scenes import build_map_scene, build_point_episodes
from gn0.training.exams.evaluation import ClosedLoop
from gn0.training.pupil import Pupil, build_pupil
from gn0_figures.board import Figure, FigureContext, FigureRow, row_at_least
from gn0_figures.device import is_emulation
from gn0_figures.flat import build_flat, flat_floor

DECISIONS = 2000.0  # a second, at least
ON_CPU = 2.0  # a second on two cores, at least
PICTURES = ("rgb", "history", "near", "far")
SETTINGS = PolicySettings(prompt="short", pictures=PICTURES, form=AnswerForm(layout="compact"))
SMALL = MapView(squares=(EgoSquare(32, 0.24), EgoSquare(32, 0.6)))
TEXT = "walk past the sofa, turn left at the door and stop beside the bed by the window"


def _seconds(call: Callable[[], object], warm: int, times: int) -> float:
    """Seconds of a call, the mean of some after the warm ones."""

    def wait() -> None:
        if torch.cuda.is_available():
            torch.cuda.synchronize()

    for _ in range(warm):
        call()
    wait()
    begin = time.perf_counter()
    for _ in range(times):
        call()
    wait()
    return (time.perf_counter() - begin) / times


def measure_closed_loop(ctx: FigureContext) -> list[FigureRow]:
    """Decisions a second of agents that walk, and what a decision alone takes."""
    tiny = is_emulation(ctx.device)
    rows: list[FigureRow] = []

    def add(row: FigureRow) -> None:
        rows.append(row)
        ctx.report(row)

    cloud = build_flat(1500 if tiny else 1_000_000)
    flat = replace(
        build_map_scene(flat_floor(0.0), "flat"),
        load_cloud=lambda: cloud,
        cloud_hash=cloud.content_hash,
    )
    episodes = build_point_episodes(flat, NavigationMap(flat.grid, 0.2), 4 if tiny else 200)
    settings = SETTINGS
    if tiny:
        settings = PolicySettings(
            prompt="short", pictures=("near", "far"), form=AnswerForm(layout="compact"), view=SMALL
        )
    pupil = build_pupil("nano" if tiny else "tiny", settings, [TEXT, *{
        episode.instruction for episode in episodes
    }])  # fmt: skip
    device = "cpu" if tiny else "cuda"
    pupil.model.to(device)
    dtype = None if tiny else torch.bfloat16
    for count in (2,) if tiny else (512, 1024):
        sensors = [name for name in settings.sensors(pupil.template) if name != "pose"]
        env = VectorEnvDevice(
            count, flat, episodes=episodes, device=ctx.device, sensors=sensors,
            preset=settings.preset, map_view=settings.view,
        )  # fmt: skip
        loop = ClosedLoop(env, pupil, dtype=dtype, compiled=not tiny)
        walk, decide = _prepare(loop)
        rate = count / _seconds(walk, 1 if tiny else 4, 1 if tiny else 20)
        alone = _seconds(decide, 1, 1 if tiny else 20)
        tokens = len(loop.maker.table.layout)
        detail = f"{count} agents in the standard flat of {len(cloud) / 1e6:g} M splats, "
        detail += f"{len(settings.pictures)} pictures, {tokens} + {len(pupil.slots)} tokens; "
        detail += f"{settings.executed} actions a decision, all pictures after each; bfloat16, "
        detail += f"one graph a decision; the decision alone takes {alone * 1e3:.3g} ms"
        name = f"decisions a second, closed loop, {count} agents"
        add(
            FigureRow(name=name, value=rate, unit="1/s", detail=detail)
            if tiny
            else row_at_least(name, rate, DECISIONS, "1/s", detail)
        )
        if count in (2, 512):
            add(_compare(loop, pupil))
        del env, loop, walk, decide
        if not tiny:
            torch.cuda.empty_cache()
    return rows


def _prepare(loop: ClosedLoop) -> tuple[Callable[[], None], Callable[[], object]]:
    """A decision with its steps, and a decision of pictures that lie there."""
    env, executed = loop.env, loop.executed
    state: dict[str, Any] = {}
    state["seen"], state["infos"] = env.reset(seed=0)
    last = torch.zeros(env.num_envs, dtype=torch.int64, device=loop.device)

    def ask() -> Tensor:
        infos, seen = state["infos"], state["seen"]
        number, pose = (torch.from_dlpack(infos[name]) for name in ("episode", "pose"))
        hit = torch.from_dlpack(seen["collided"])
        ids = loop.maker.prompts(number, pose, last, hit)
        return loop.actor.decide(loop._show(seen, number, pose, False), ids).actions

    def walk() -> None:
        actions = ask()
        for k in range(executed):
            state["seen"], *_, state["infos"] = env.step(actions[:, k].to(torch.uint8))
            last.copy_(actions[:, k])

    return walk, ask


def _compare(loop: ClosedLoop, pupil: Pupil) -> FigureRow:
    """Answers of the recorded decision that are not those of one that is not recorded, float32."""
    layout, count = loop.maker.table.layout, loop.actor.count
    stream = random_stream(0, "figure closed loop")
    pictures = [
        torch.from_numpy(
            stream.integers(0, 256, (count, s.height, s.width, 3), dtype=np.uint8)
        ).to(loop.device)
        for s in layout.sizes
    ]  # fmt: skip
    pose = torch.from_numpy(stream.uniform(-3, 3, (count, 3))).to(loop.device)
    zeros = torch.zeros(count, dtype=torch.int64, device=loop.device)
    ids = loop.maker.prompts(zeros, pose, zeros - 1, zeros)
    said = [
        Actor(
            pupil.model, layout, pupil.slots, pupil.settings.frame, count, recorded=recorded
        ).decide(pictures, ids).ids
        for recorded in (None, False)
    ]  # fmt: skip
    unlike = float((said[0] != said[1]).any(1).sum())
    return FigureRow(
        name="answers unlike those without a graph", value=unlike, unit="",
        detail=f"of {count}, float32, greedy",
    )  # fmt: skip


def measure_cpu(ctx: FigureContext) -> list[FigureRow]:
    """Seconds a decision of `tiny` on one and two cores, by NumPy and by torch."""
    folder = ctx.work / "tiny"
    pupil = build_pupil("tiny", SETTINGS, [TEXT])
    pupil.save(folder, overwrite=True)
    rows = []
    for backend in ("numpy", "torch"):
        for cores in (1, 2):
            found = _run_apart(folder, backend, cores)
            name = f"decisions a second by {backend}, {cores} core{'s' * (cores > 1)}"
            detail = "tiny, four pictures of 128 px, one at a time, float32; "
            detail += f"{1 / found:.3g} s each"
            row = (
                row_at_least(name, found, ON_CPU, "1/s", detail)
                if cores == 2
                else FigureRow(name=name, value=found, unit="1/s", detail=detail)
            )
            rows.append(row)
            ctx.report(row)
    return rows


def _run_apart(folder: Path, backend: str, cores: int) -> float:
    """Decisions a second of another process, whose libraries have so many threads."""
    names = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS")
    threads = dict.fromkeys(names, str(cores))
    command = [sys.executable, "-m", "gn0_figures.closed_loop", str(folder), backend]
    done = subprocess.run(
        command, env=os.environ | threads, capture_output=True, text=True, check=True
    )
    return float(done.stdout.split()[-1])


def time_decisions(folder: Path, backend: str, times: int = 5) -> float:
    """Decisions a second of a checkpoint's engine, one at a time."""
    questions = Questions(folder)
    engine = open_engine(questions, backend, "cpu", "float32", 1)
    stream = random_stream(0, "figure cpu")
    pictures = [
        stream.integers(0, 256, (1, s.height, s.width, 3), dtype=np.uint8)
        for s in questions.layout.sizes
    ]
    ids = questions.fill(TEXT, 1, False, 0.3)[None]
    return 1 / _seconds(lambda: engine.answer(pictures, ids), 1, times)


FIGURES = [
    Figure("train.closed_loop", "Deciding and walking", measure_closed_loop, 2.0, backend="cuda"),
    Figure("train.cpu", "Deciding on a CPU", measure_cpu, 2.0),
]

if __name__ == "__main__":
    print(time_decisions(Path(sys.argv[1]), sys.argv[2]))
