"""Figures of the device renderer beside its speed: agreement, bytes, memory, start, sets."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import time
from collections.abc import Iterator

import numpy as np

from gn0.errors import DeviceError
from gn0.render.cpu import RendererCpu
from gn0.render.cuda.renderer import RendererCuda, RendererVisibleCuda
from gn0.render.gsplat import memory_peak, release_memory
from gn0.render.renderer import RenderOptions
from gn0.testing.renderer_check import psnr
from gn0_figures.agreement import (
    DEPTH,
    OPTIONS,
    Setting,
    capture_settings,
    compare_pictures,
    scene_settings,
)
from gn0_figures.board import (
    Figure,
    FigureContext,
    FigureRow,
    FigureSkipped,
    row_at_least,
    row_at_most,
)
from gn0_figures.device import interleave, is_emulation, median, memory_left, trim_memory
from gn0_figures.device_scenes import FigureScene, apartment_scene, flat_scene, house_scene
from gn0_figures.device_table import OUTPUTS, Bench
from gn0_figures.flat import flat_camera
from gn0_figures.rival import rival_version

MEMORY = 6.0  # GB, at most, for 256 views of 224x224 over a million splats of SH 3
COMPILE = 20.0  # s, at most
BUILD = 10.0  # s, at most, for the visible sets of 150 m²
QUALITY = 60.0  # dB, at least in the mean, of visible sets against the full set
HELD_OUT = 64  # views that no set has looked from


def _settings(ctx: FigureContext) -> Iterator[Setting]:
    """What is drawn to compare; what is not here is left out and said."""
    tiny = is_emulation(ctx.device)
    size = {"views": 1, "pixels": 24, "bev": 32} if tiny else {"views": 4, "pixels": 224}
    count = 1500 if tiny else 1_000_000
    yield from scene_settings(flat_scene(count, 0), **size)
    yield from scene_settings(flat_scene(count, 3), **size)
    if tiny:
        return
    yield from scene_settings(apartment_scene(ctx), **size)
    try:
        yield from scene_settings(house_scene(ctx), **size)
    except FigureSkipped as reason:
        ctx.progress(f"left out: {reason}", 0, 1)
    try:
        yield from capture_settings(ctx.need_data("splats/statues/angel.sog"))
    except FileNotFoundError as error:
        ctx.progress(f"left out: {error}", 0, 1)


def measure_accuracy(ctx: FigureContext) -> list[FigureRow]:
    """Agreement with the CPU backend and with gsplat, and with itself to the byte."""
    bench = Bench(ctx)
    different = pictures = 0
    for setting in _settings(ctx):
        ctx.progress(setting.name, 0, 1)
        renderer = RendererCuda(setting.cloud, OPTIONS, ctx.device)
        got = setting.draw(renderer)
        want = setting.draw(RendererCpu(setting.cloud, OPTIONS))
        near = compare_pictures(got, want)
        detail = f"{len(setting.views)} views; largest difference of alpha {near.alpha:.3g}"
        label = f"{setting.name}, cuda to cpu"
        bench.add(row_at_least(f"RGB PSNR, {label}", near.rgb, setting.least, "dB", detail))
        bench.add(row_at_most(f"depth p99, {label}", near.depth, DEPTH, "mm", "alpha > 0.5"))
        rival = bench.rival(setting.cloud)
        if rival is not None:
            rival.options = OPTIONS
            far = compare_pictures(got, setting.draw(rival))
            label = f"{setting.name}, cuda to gsplat"
            detail = f"{rival_version()}, whose alpha ends at 0.999, not 0.99"
            bench.add(row_at_least(f"RGB PSNR, {label}", far.rgb, setting.least, "dB", detail))
            bench.add(row_at_most(f"depth p99, {label}", far.depth, DEPTH, "mm", detail))
        again = setting.draw(RendererCuda(setting.cloud, OPTIONS, ctx.device))
        for name in ("rgb", "depth", "alpha"):
            first, second = getattr(got, name), getattr(again, name)
            different += sum(a.tobytes() != b.tobytes() for a, b in zip(first, second, strict=True))
            pictures += len(first)
    detail = f"{pictures} pictures of the settings above, two renderers each"
    bench.add(row_at_most("pictures that differ on repeat", different, 0, "pictures", detail))
    return bench.rows


def measure_memory(ctx: FigureContext) -> list[FigureRow]:
    """Memory of many views of SH 3, and a scene of ten million splats."""
    bench = Bench(ctx)
    scene = bench.flat(1_000_000, 3)
    views, pixels = (2, 32) if bench.tiny else (256, 224)
    camera, poses = flat_camera(pixels, pixels), scene.views(views, 1)
    trim_memory(ctx.device)
    before = memory_left(ctx.device)
    renderer = RendererCuda(scene.cloud, device=ctx.device)
    held = renderer.render_device(camera, poses, outputs=OUTPUTS)
    ctx.device.synchronize()
    used = (before - memory_left(ctx.device)) / 1e9
    del held
    detail = f"{scene.name}; peak of splats, lists and pictures (RGB and depth)"
    rival = bench.rival(scene.cloud)
    if rival is not None:
        placed = rival.place(camera, poses)
        memory_peak(reset=True)
        base = memory_peak()
        try:
            rival.rasterize(camera, placed, packed=True)
            detail += f"; gsplat packed {(memory_peak() - base) / 1e9:.1f} GB above its splats"
        except DeviceError as error:
            detail += f"; gsplat packed: {error}"
        release_memory()
    bench.add(
        row_at_most(f"memory, {views} views of {pixels}x{pixels}, SH 3", used, MEMORY, "GB", detail)
    )
    del renderer, rival
    large = flat_scene(3000 if bench.tiny else 10_000_000)
    trim_memory(ctx.device)
    before = memory_left(ctx.device)
    renderer = RendererCuda(large.cloud, device=ctx.device)
    poses = large.views(views, 2)
    times = interleave(
        *(ctx.device, {"": lambda _: renderer.render_device(camera, poses, outputs=OUTPUTS)}, 3),
        warm=1,
    )
    used = (before - memory_left(ctx.device)) / 1e9
    detail = f"{large.name}; {views} views of {pixels}x{pixels} a call, memory {used:.1f} GB"
    rate = views / median(times[""]) * 1e3
    bench.add(FigureRow(name="ten million splats", value=rate, unit="frames/s", detail=detail))
    one = poses[:1]
    got = RendererCuda(large.cloud, OPTIONS, ctx.device).render(camera, one)
    near = compare_pictures(got, RendererCpu(large.cloud, OPTIONS).render(camera, one))
    bench.add(row_at_least("ten million splats, RGB PSNR to cpu", near.rgb, 55.0, "dB"))
    return bench.rows


def measure_start(ctx: FigureContext) -> list[FigureRow]:
    """The first picture of a process: from an empty cache, and from a full one."""
    environment = {**os.environ, "GN0_CACHE": str(ctx.work / "cache")}
    environment["CUDA_CACHE_PATH"] = str(ctx.work / "driver-cache")  # the driver has its own
    if is_emulation(ctx.device):
        environment["GN0_DEVICE"] = "host"
    rows: list[FigureRow] = []
    for title in ("from an empty cache", "from the cache"):
        done = subprocess.run(
            [sys.executable, "-m", "gn0_figures.first_picture"],
            env=environment,
            capture_output=True,
            text=True,
            timeout=170,
            check=False,
        )
        if done.returncode:
            raise RuntimeError(f"no first picture: {done.stderr[-2000:]}")
        found = json.loads(done.stdout.splitlines()[-1])
        split = ", ".join(f"{k} {found[k]:.2f} s" for k in ("imports", "device", "first", "second"))
        detail = f"a process of its own: {split}; imports {', '.join(found['modules'])}"
        name, value = f"kernels and first picture, {title}", float(found["first"])
        if rows or is_emulation(ctx.device):
            rows.append(FigureRow(name=name, value=value, unit="s", detail=detail))
        else:
            rows.append(row_at_most(name, value, COMPILE, "s", detail))
        ctx.report(rows[-1])
    return rows


def measure_visible(ctx: FigureContext) -> list[FigureRow]:
    """Visible sets: how long all of a scene take, and how near their pictures are."""
    bench = Bench(ctx)
    scenes = [bench.flat(1_000_000, 0)]
    if not bench.tiny:
        try:
            scenes.append(house_scene(ctx))
        except FigureSkipped as reason:
            ctx.progress(f"left out: {reason}", 0, 1)
    for scene in scenes:
        _measure_sets(bench, scene)
    return bench.rows


def _measure_sets(bench: Bench, scene: FigureScene) -> None:
    renderer = RendererCuda(scene.cloud, RenderOptions(), bench.device)
    key = f"figure {scene.cloud.content_hash} {time.time_ns()}"  # never from an earlier run
    sets = RendererVisibleCuda(renderer, key, scene.floor, scene.eye, bench.set_options)
    sets.render(flat_camera(16, 16), scene.views(1, 8))  # compiles, and finds one set
    start = time.perf_counter()
    for _ in sets.build(bench.ctx.progress):
        pass
    seconds = time.perf_counter() - start
    camera = flat_camera(224, 224) if not bench.tiny else flat_camera(32, 32)
    views = scene.views(4 if bench.tiny else HELD_OUT, 9)
    want, got = renderer.render(camera, views), sets.render(camera, views)
    assert want.rgb is not None and got.rgb is not None
    quality = [min(psnr(a, b, 255), 99.0) for a, b in zip(got.rgb, want.rgb, strict=True)]
    cells = [cell for cell in sets.sets.locate(camera, views) if cell is not None]
    share = np.mean([sets.size_of(cell) for cell in dict.fromkeys(cells)] or [0]) / len(scene.cloud)
    detail = (
        f"{scene.name}, {scene.area:.0f} m², {len(sets.cells)} cells of "
        f"{sets.options.cell:g} m, written to the cache; sets keep {100 * share:.0f} %"
    )
    bench.add(row_at_most(f"building all visible sets, {scene.name}", seconds, BUILD, "s", detail))
    detail = f"{len(views)} held-out views; worst {min(quality):.1f} dB"
    name = f"visible sets to full set, mean, {scene.name}"
    if bench.tiny:
        bench.add(FigureRow(name=name, value=float(np.mean(quality)), unit="dB", detail=detail))
    else:
        bench.add(row_at_least(name, float(np.mean(quality)), QUALITY, "dB", detail))
    assert sets.files is not None
    sets.files.clear()


FIGURES = [
    Figure("render.cuda.start", "CUDA renderer: start", measure_start, 0.7, backend="cuda"),
    Figure(
        "render.cuda.accuracy", "CUDA renderer: agreement", measure_accuracy, 2.5, backend="cuda"
    ),
    Figure("render.cuda.memory", "CUDA renderer: memory", measure_memory, 2.0, backend="cuda"),
    Figure(
        "render.cuda.visible", "CUDA renderer: visible sets", measure_visible, 1.0, backend="cuda"
    ),
]
