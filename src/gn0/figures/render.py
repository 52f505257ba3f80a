"""Figures of the CPU renderer: frames a second, where the time goes, and distance to the judge."""

from __future__ import annotations

import time

import numpy as np

from gn0.figures.board import (
    Figure,
    FigureContext,
    FigureRow,
    row_at_least,
    row_at_most,
)
from gn0.figures.flat import build_flat, flat_bev, flat_camera, flat_views
from gn0.gaussians.cloud import GaussianCloud
from gn0.geometry import F64
from gn0.render.camera import Camera
from gn0.render.cpu import STAGES, RendererCpu
from gn0.render.renderer import RenderOptions
from gn0.testing.check_renderer import psnr
from gn0.testing.reference import RendererReference

_VIEWS = 32
_ROUNDS = 5


def _frames(cloud: GaussianCloud, camera: Camera, views: F64, threads: int) -> dict[str, float]:
    """Milliseconds a frame, whole and a stage: the median of several rounds over all views."""
    renderer = RendererCpu(cloud, RenderOptions(threads=threads))
    renderer.render(camera, views[:2])
    rounds = []
    for _ in range(_ROUNDS):
        before = dict(renderer.stage_seconds)
        start = time.perf_counter()
        for view in views:  # one frame a call, as a simulator asks for them
            renderer.render(camera, view)
        spent = {"frame": time.perf_counter() - start}
        spent |= {stage: renderer.stage_seconds[stage] - before[stage] for stage in STAGES}
        rounds.append(spent)
    middle = sorted(rounds, key=lambda r: r["frame"])[_ROUNDS // 2]
    return {name: seconds / len(views) * 1e3 for name, seconds in middle.items()}


def measure_speed(ctx: FigureContext) -> list[FigureRow]:
    """Frames a second of RGB + depth + alpha on the standard flat."""
    rows = []
    views = flat_views(_VIEWS)
    cases = [
        (300_000, 0, 224, 224, 50.0),
        (1_000_000, 0, 640, 480, 12.0),
        (300_000, 0, 640, 480, None),
        (1_000_000, 0, 224, 224, None),
        (300_000, 3, 224, 224, None),
    ]
    for done, (count, degree, width, height, least) in enumerate(cases):
        ctx.progress("render.speed", done, len(cases))
        cloud = build_flat(count, sh_degree=degree)
        camera = flat_camera(width, height)
        for threads in (2, 1):
            spent = _frames(cloud, camera, views, threads)
            cores = "two cores" if threads == 2 else "one core"
            name = f"{width}x{height}, {count / 1e6:g} M Gaussians, SH {degree}, {cores}"
            split = ", ".join(f"{stage} {spent[stage]:.1f}" for stage in STAGES)
            detail = f"standard flat, HFOV 90°, RGB + depth + alpha, {_VIEWS} views; ms: {split}"
            rate = 1e3 / spent["frame"]
            if threads == 2 and least is not None:
                rows.append(row_at_least(name, rate, least, "frames/s", detail))
            else:
                rows.append(FigureRow(name=name, value=rate, unit="frames/s", detail=detail))
    rows.append(_map_row())
    return rows


def _map_row() -> FigureRow:
    renderer = RendererCpu(build_flat(1_000_000), RenderOptions(threads=2))
    camera, view = flat_bev(1024)
    renderer.render(camera, view)
    times = []
    for _ in range(_ROUNDS):
        start = time.perf_counter()
        renderer.render(camera, view)
        times.append(time.perf_counter() - start)
    return FigureRow(
        name="map picture 1024x1024, 1 M Gaussians, two cores",
        value=float(np.median(times)) * 1e3,
        unit="ms",
        detail="standard flat, 13.5 m across, cut at 2.3 m, no cache",
    )


def measure_accuracy(ctx: FigureContext) -> list[FigureRow]:
    """Agreement with the float64 judge on the standard flat."""
    rows: list[FigureRow] = []
    views = flat_views(4)
    cases = [
        ("perspective", 300_000, 0, flat_camera(224, 224), views[:2], 55.0),
        ("perspective", 1_000_000, 0, flat_camera(160, 120), views, 55.0),
        ("perspective", 300_000, 3, flat_camera(160, 120), views, 55.0),
        ("BEV", 300_000, 0, *flat_bev(256), 60.0),
    ]
    for done, (kind, count, degree, camera, poses, least) in enumerate(cases):
        ctx.progress("render.accuracy", done, len(cases))
        cloud = build_flat(count, sh_degree=degree)
        options = RenderOptions(rgb_float=True)
        got = RendererCpu(cloud, options).render(camera, poses)
        want = RendererReference(cloud, options).render(camera, poses)
        assert got.rgb is not None and want.rgb is not None
        assert got.depth is not None and want.depth is not None and want.alpha is not None
        solid = (want.alpha > 0.5) & np.isfinite(got.depth)
        error = np.abs(got.depth[solid] - want.depth[solid])
        name = f"{kind} {camera.width}x{camera.height}, {count / 1e6:g} M, SH {degree}"
        detail = f"standard flat, {len(got.rgb)} views, against the float64 per-pixel loop"
        rows.append(row_at_least(f"RGB PSNR, {name}", psnr(got.rgb, want.rgb), least, "dB", detail))
        rows.append(
            row_at_most(
                *(f"depth error p99, {name}", float(np.percentile(error, 99)) * 1e3, 1.0, "mm"),
                detail=f"{detail}; where alpha > 0.5",
            )
        )
    return rows


FIGURES = [
    Figure(id="render.speed", title="CPU renderer: speed", measure=measure_speed, minutes=1.5),
    Figure(
        id="render.accuracy",
        title="CPU renderer: agreement with the float64 judge",
        measure=measure_accuracy,
        minutes=2.0,
    ),
]
