"""Figures of labels on the device: what they cost beside colours, and whether the CPU shows them.

Views lie on the device; each call draws poses that the call before has not drawn. Ratios are
medians over rounds in which all took turns.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from gn0.gaussians.cloud import GaussianCloud
from gn0.render.cpu import RendererCpu
from gn0.render.cuda.renderer import RendererCuda
from gn0.render.renderer import Output
from gn0_figures.board import Figure, FigureContext, FigureRow, row_at_least, row_at_most
from gn0_figures.device import Contender, interleave, median
from gn0_figures.device_table import BATCHES, OUTPUTS, Bench
from gn0_figures.flat import flat_camera

EQUAL = 99.9  # % of pixels, at least, that show the object that the CPU shows
UNASKED = 1.0  # % of the time, at most, that labels add which nobody asks for
_OBJECTS, _ROUNDS = 100, 24
_BOTH: tuple[Output, ...] = ("semantic", "instance")


def with_labels(cloud: GaussianCloud, objects: int = _OBJECTS) -> GaussianCloud:
    """The same splats, in so many objects, each in one place: the flat's are in Morton order."""
    label = np.arange(len(cloud)) * objects // max(len(cloud), 1)
    categories = np.arange(objects) % 17 + 1
    return replace(cloud, label=label.astype(np.int32), categories=categories.astype(np.int32))


def measure_labels(ctx: FigureContext) -> list[FigureRow]:
    """Views a second with labels over those of colour and depth, and agreement with the CPU."""
    bench = Bench(ctx)
    for views, pixels, splats in ((256, 224, 300_000), (16, 640, 1_000_000)):
        _measure_cost(bench, *((3, 32, splats) if bench.tiny else (views, pixels, splats)))
    _measure_agreement(bench)
    return bench.rows


def _measure_cost(bench: Bench, views: int, pixels: int, splats: int) -> None:
    scene, device = bench.flat(splats, 0), bench.device
    bare = RendererCuda(scene.cloud, device=device)
    renderer = RendererCuda(with_labels(scene.cloud), device=device)
    camera = flat_camera(pixels, pixels)
    turns = 1 if bench.tiny else BATCHES
    poses = [device.upload(some) for some in np.split(scene.views(turns * views, 1), turns)]

    def draw(of: RendererCuda, outputs: tuple[Output, ...]) -> Contender:
        return lambda turn: of.batch.draw(camera, poses[turn % turns], "scene", outputs=outputs)

    rounds = 1 if bench.tiny else _ROUNDS
    plain = {
        "splats without labels": draw(bare, OUTPUTS),
        "splats with labels": draw(renderer, OUTPUTS),
    }
    asked = {
        "colour and depth": draw(renderer, OUTPUTS),
        "colour, depth and both labels": draw(renderer, (*OUTPUTS, *_BOTH)),
        "both labels alone": draw(renderer, _BOTH),
    }
    # apart: a renderer that also draws labels in between finds its splats in the caches
    times = interleave(device, plain, rounds, warm=bench.warm)
    times |= interleave(device, asked, rounds, warm=bench.warm)
    size = f"{splats / 1e6:g} M, {views} views of {pixels}x{pixels}"
    spent = ", ".join(f"{name} {median(taken):.3g} ms" for name, taken in times.items())
    detail = f"{scene.name} of {_OBJECTS} objects, {size}, poses on the device; medians: {spent}"

    def ratio(name: str, base: str) -> float:
        return float(np.median(np.array(times[name]) / np.array(times[base])))

    title = f"labels that nobody asks for add, {size}"
    added = 100 * (ratio("splats with labels", "splats without labels") - 1)
    if bench.tiny:
        bench.add(FigureRow(name=title, value=added, unit="%", detail=detail))
    else:
        bench.add(row_at_most(title, added, UNASKED, "%", detail))
    for name in list(asked)[1:]:
        times_over = ratio(name, "colour and depth")
        title = f"{name}, over RGB + depth, {size}"
        bench.add(FigureRow(name=title, value=times_over, unit="times", detail=detail))


def _measure_agreement(bench: Bench) -> None:
    views, pixels = (4, 32) if bench.tiny else (16, 224)
    scene = bench.flat(300_000, 0)
    camera, looks, cloud = flat_camera(pixels, pixels), scene.views(views, 6), None
    for objects in (_OBJECTS, 10_000):
        cloud = with_labels(scene.cloud, min(objects, len(scene.cloud)))
        want = RendererCpu(cloud).render(camera, looks, outputs=_BOTH)
        got = RendererCuda(cloud, device=bench.device).render(camera, looks, outputs=_BOTH)
        assert want.instance is not None and got.instance is not None
        equal = 100 * float((got.instance == want.instance).mean())
        detail = f"{scene.name}, {views} views of {pixels}x{pixels}; "
        detail += f"{len(np.unique(want.instance)):,} objects in sight"
        name = f"pixels that show the object that the CPU shows, of {objects:,}"
        bench.add(row_at_least(name, equal, EQUAL, "%", detail))


FIGURES = [
    Figure("render.cuda.labels", "CUDA renderer: labels", measure_labels, 1.5, backend="cuda")
]
