"""Figures of people in pictures on the CPU: what each adds to a picture, bank included."""

from __future__ import annotations

import time
from collections.abc import Hashable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from gn0.avatars.motion.gait import PHASES
from gn0.avatars.posed_bank import PosedBank
from gn0.geometry import F64
from gn0.people.poser import name_posed, open_posed
from gn0.people.shown import PoseShown
from gn0.render.camera import Camera
from gn0.render.cpu import RendererCpu
from gn0.render.instance import Instance
from gn0.render.renderer import RenderOptions
from gn0_figures.board import Figure, FigureContext, FigureRow, row_at_least, row_at_most
from gn0_figures.device_scenes import flat_scene
from gn0_figures.flat import flat_camera
from gn0_figures.people_among import measure_among
from gn0_figures.people_walking import LIGHT, PIXELS, Walkers, find_views, open_actors

CASES = (
    ("one at 2 m", 1, 2.0, 2.0),
    ("one beyond 4 m", 1, 4.2, 0.6),
    ("eight from 2 m", 8, 2.0, 8.0),
)
_SPEEDS = (1.0, 0.6)  # of walks whose poses are new: one after the other, no joints are known yet
_CYCLES, _THREADS, _WARM = 2, 2, 8  # of the walk; cores; first pictures that do not count


@dataclass(frozen=True)
class _Stage:
    """What draws people, and from where."""

    cpu: RendererCpu
    camera: Camera
    view: F64

    def bare(self) -> float:
        """Seconds of a picture without people."""
        begin = time.perf_counter()
        self.cpu.render(self.camera, self.view, outputs=("rgb", "depth"))
        return time.perf_counter() - begin

    def peopled(
        self, bank: PosedBank, wanted: Sequence[tuple[Hashable, PoseShown]], poses: F64
    ) -> float:
        """Seconds of one with people, bank included."""
        begin = time.perf_counter()
        names = name_posed(bank, self.cpu, wanted)
        parts = [Instance(name, pose, LIGHT) for name, pose in zip(names, poses, strict=True)]
        self.cpu.render(self.camera, self.view, outputs=("rgb", "depth"), parts=parts)
        return time.perf_counter() - begin


def measure_people(ctx: FigureContext) -> list[FigureRow]:
    """Milliseconds that people add to RGB-D of 224×224 of 300,000 splats."""
    scene, camera = flat_scene(300_000), flat_camera(PIXELS, PIXELS)
    cpu = RendererCpu(scene.cloud, RenderOptions(threads=_THREADS))
    rows = []
    for title, count, away, most in CASES:
        stage = _Stage(cpu, camera, find_views(scene, 1, away + 0.9, False)[0])
        walkers = Walkers(open_actors(8, False)[:count], away, camera.fx)
        where = f"{scene.name}, {PIXELS}x{PIXELS} RGB-D, {_THREADS} cores, level of detail by "
        where += "distance, bank and light included; "
        rows += _time_poses(ctx, stage, walkers, title, most, where)
        rows += _time_walk(ctx, stage, walkers, title, most, where)
        for row in rows[-5:]:
            ctx.report(row)
    for row in (among := measure_among(ctx)):
        ctx.report(row)
    return [*rows, *among]


def _time_poses(
    ctx: FigureContext, stage: _Stage, walkers: Walkers, title: str, most: float, where: str
) -> list[FigureRow]:
    """Rows of poses that are there, and of new ones; that they are is proven for each picture."""
    bank, poses, count = _open_bank(stage), walkers.poses(stage.view), len(walkers.actors)
    bare, there, new = [], [], []
    for turn in range(len(_SPEEDS) * PHASES):
        ctx.progress(f"{title}, poses", turn, len(_SPEEDS) * PHASES)
        wanted = replace(walkers, speed=_SPEEDS[turn // PHASES]).wanted(turn)
        bare.append(stage.bare())
        known = bank.hits, bank.misses
        new.append(stage.peopled(bank, wanted, poses))
        if (bank.hits, bank.misses) != (known[0], known[1] + count):
            raise RuntimeError(f"{title}: a pose of picture {turn} was there")
        bare.append(stage.bare())
        there.append(stage.peopled(bank, wanted, poses))
        if (bank.hits, bank.misses) != (known[0] + count, known[1] + count):
            raise RuntimeError(f"{title}: a pose of picture {turn} was not there")
    without = float(np.median(bare[2 * _WARM :]))
    adds, fresh = (1e3 * (float(np.median(t[_WARM:])) - without) for t in (there, new))
    size = bank.bytes / sum(len(pose.avatar) for _, pose in wanted) / len(new)
    detail = f"{where}{1e3 * without:.2f} ms without; medians of {len(new) - _WARM} pictures by "
    detail += "turns, all poses in the bank or none"
    return [
        row_at_most(f"{title}, poses in the bank", adds, most, "ms", detail),
        row_at_most(f"{title}, poses new", fresh, most, "ms", detail),
        row_at_most(
            f"{title}, bytes of a posed splat", size, 60, "B",
            f"{len(new) * count} clouds of {count} people, of all that the bank and the renderer "
            "keep of each, padding and shadows included; "
            f"{bank.bytes / 2**20:.0f} MB in the bank",
        ),
    ]  # fmt: skip


def _time_walk(
    ctx: FigureContext, stage: _Stage, walkers: Walkers, title: str, most: float, where: str
) -> list[FigureRow]:
    """Rows of a walk on the spot, a phase further each picture, in a bank that is empty first."""
    bank, poses = _open_bank(stage), walkers.poses(stage.view)
    bare, spent, total = [], [], _CYCLES * PHASES
    for turn in range(total):
        ctx.progress(f"{title}, walk", turn, total)
        wanted = walkers.wanted(turn)
        bare.append(stage.bare())
        spent.append(stage.peopled(bank, wanted, poses))
    without = float(np.median(bare[_WARM:]))
    mean = 1e3 * (float(np.mean(spent[_WARM:])) - without)
    detail = f"{where}{_CYCLES} cycles of {PHASES} pictures, walking on the spot, the bank empty "
    detail += f"first; {1e3 * without:.2f} ms without; "
    detail += f"{bank.bytes / 2**20:.0f} of {bank.budget / 2**20:.0f} MB in the bank"
    return [
        row_at_most(f"{title}, a walk, mean", mean, most, "ms", detail),
        row_at_least(f"{title}, a walk, hit rate", bank.hit_rate, 0.5, "", detail),
    ]


def _open_bank(stage: _Stage) -> PosedBank:
    bank = open_posed(stage.cpu)
    assert isinstance(bank, PosedBank)
    return bank


FIGURES = [Figure("people.render", "People in pictures", measure_people, 2.0)]
