"""Figures of people in pictures on the CPU: what each adds to a picture, bank included."""

from __future__ import annotations

import time

import numpy as np

from gn0.avatars.posed_bank import PosedBank
from gn0.render.cpu import RendererCpu
from gn0.render.instance import Instance
from gn0.render.renderer import RenderOptions
from gn0_figures.board import Figure, FigureContext, FigureRow, row_at_least, row_at_most
from gn0_figures.device_scenes import flat_scene
from gn0_figures.flat import flat_camera
from gn0_figures.people_walking import LIGHT, PIXELS, Walkers, find_views, open_actors

CASES = (
    ("one at 2 m", 1, 2.0, 2.0),
    ("one beyond 4 m", 1, 4.2, 0.6),
    ("eight from 2 m", 8, 2.0, 8.0),
)
_ROUNDS, _THREADS = 128, 2  # two cycles of a walk; cores


def measure_people(ctx: FigureContext) -> list[FigureRow]:
    """Milliseconds that people add to RGB-D of 224×224 of 300,000 splats."""
    scene, camera = flat_scene(300_000), flat_camera(PIXELS, PIXELS)
    cpu = RendererCpu(scene.cloud, RenderOptions(threads=_THREADS))
    rows = []
    for title, count, away, most in CASES:
        view = find_views(scene, 1, away + 0.9, False)[0]
        walkers = Walkers(open_actors(8, False)[:count], away, camera.fx)
        bank, poses = PosedBank(prefix=title), walkers.poses(view)
        spent: dict[str, list[float]] = {"bare": [], "filling": [], "filled": []}
        for turn in range(_ROUNDS + 8):
            ctx.progress(title, turn, _ROUNDS + 8)
            begin = time.perf_counter()
            cpu.render(camera, view, outputs=("rgb", "depth"))
            middle = time.perf_counter()
            posed = bank.fetch(walkers.wanted(turn))
            bank.tell(cpu, posed)
            parts = [Instance(p.name, pose, LIGHT) for p, pose in zip(posed, poses, strict=True)]
            cpu.render(camera, view, outputs=("rgb", "depth"), parts=parts)
            end = time.perf_counter()
            if turn >= 8:
                spent["bare"].append(middle - begin)
                spent["filling" if turn < _ROUNDS // 2 else "filled"].append(end - middle)
        bare = float(np.median(spent["bare"]))
        fills, filled = (float(np.median(spent[k])) - bare for k in ("filling", "filled"))
        detail = f"{scene.name}, {PIXELS}x{PIXELS} RGB-D, {_THREADS} cores, walking on the spot, "
        detail += f"level of detail by distance; {1e3 * bare:.2f} ms without; medians of "
        detail += f"{_ROUNDS} pictures, half of them while the bank was filled"
        rows.append(row_at_most(f"{title}, posed before", 1e3 * filled, most, "ms", detail))
        rows.append(row_at_most(f"{title}, posed anew", 1e3 * fills, most, "ms", detail))
        rows.append(row_at_least(f"{title}, hit rate", bank.hit_rate, 0.5, "", detail))
        for row in rows[-3:]:
            ctx.report(row)
    return rows


FIGURES = [Figure("people.render", "People in pictures", measure_people, 2.0)]
