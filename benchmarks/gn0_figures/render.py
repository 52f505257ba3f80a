"""Figures of the CPU renderer: frames a second, where the time goes, and distance to the judge."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import replace

import numpy as np

from gn0.gaussians.cloud import GaussianCloud
from gn0.geometry import F64
from gn0.render.camera import Camera
from gn0.render.cpu import STAGES, RendererCpu
from gn0.render.instance import Instance, move_instance
from gn0.render.renderer import Output, RenderOptions, RenderResult
from gn0.testing.reference import RendererReference
from gn0.testing.renderer_check import psnr
from gn0_figures.board import (
    Figure,
    FigureContext,
    FigureRow,
    row_at_least,
    row_at_most,
)
from gn0_figures.flat import build_flat, flat_bev, flat_camera, flat_views
from gn0_figures.moving import GAIN, build_body, pose_upright

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


def measure_parts(ctx: FigureContext) -> list[FigureRow]:
    """What a moving part adds to a picture, as an instance and as moved splats, by turns."""
    size = 40_000
    cloud, body, camera = build_flat(300_000), build_body(size, 1), flat_camera(224, 224)
    views = flat_views(_VIEWS)
    renderer = RendererCpu(cloud, RenderOptions(threads=2))
    renderer.name_cloud("body", body)
    parts = [
        [Instance("body", pose_upright(view, 2.0 + k % 3, 0.4 * k), GAIN)]
        for k, view in enumerate(views)
    ]
    ready = [move_instance(body, row[0]) for row in parts]
    away = Instance("body", pose_upright(views[0], -500.0, 0.0))
    contenders: dict[str, Callable[[int], RenderResult]] = {
        "static": lambda v: renderer.render(camera, views[v]),
        "an instance": lambda v: renderer.render(camera, views[v], parts=parts[v]),
        "an instance out of sight": lambda v: renderer.render(camera, views[v], parts=[away]),
        "extra splats, moved before": lambda v: renderer.render(camera, views[v], extra=ready[v]),
        "splats moved, and extra": lambda v: renderer.render(
            camera, views[v], extra=move_instance(body, parts[v][0])
        ),
    }
    spent = {name: np.empty((_ROUNDS + 1, _VIEWS)) for name in contenders}
    for turn in range(_ROUNDS + 1):  # the first one warms up
        ctx.progress("render.parts", turn, _ROUNDS + 1)
        for v in range(_VIEWS):
            for name, draw in contenders.items():
                draw(v)  # caches as the contender before leaves them would be another's
                start = time.perf_counter()
                draw(v)
                spent[name][turn, v] = time.perf_counter() - start
    each = {name: float(np.median(taken[1:], axis=0).mean()) for name, taken in spent.items()}
    told = ", ".join(f"{name} {seconds * 1e3:.2f}" for name, seconds in each.items())
    detail = "standard flat, 224x224, 0.3 M Gaussians, two cores, RGB + depth + alpha; a body of "
    detail += f"{size:,} discs 2 to 4 m before each of {_VIEWS} views, with a gain; ms: {told}"
    rows = []
    for name, limit in ((name, {"an instance": 35.0}.get(name)) for name in list(each)[1:]):
        adds = 100 * (each[name] / each["static"] - 1)
        title = f"{name} adds to a static picture"
        if limit is None:
            rows.append(FigureRow(name=title, value=adds, unit="%", detail=detail))
        else:
            rows.append(row_at_most(title, adds, limit, "%", detail))
    return rows + _parts_agreement(body)


def measure_labels(ctx: FigureContext) -> list[FigureRow]:
    """What labels add to a picture, and labels alone, by turns."""
    plain, camera, views = build_flat(300_000), flat_camera(224, 224), flat_views(_VIEWS)
    numbers = np.arange(len(plain)) // 3000  # a hundred objects, each in one place
    cloud = replace(
        plain, label=numbers.astype(np.int32), categories=np.arange(1, 101, dtype=np.int32)
    )
    bare, renderer = (RendererCpu(c, RenderOptions(threads=2)) for c in (plain, cloud))
    seen: tuple[Output, ...] = ("rgb", "depth")
    contenders: dict[str, Callable[[int], RenderResult]] = {
        "splats without labels": lambda v: bare.render(camera, views[v], outputs=seen),
        "splats with labels": lambda v: renderer.render(camera, views[v], outputs=seen),
        "colour, depth and object": lambda v: renderer.render(
            camera, views[v], outputs=(*seen, "instance")
        ),
        "the object alone": lambda v: renderer.render(camera, views[v], outputs=("instance",)),
    }
    spent = {name: np.empty((_ROUNDS + 1, _VIEWS)) for name in contenders}
    for turn in range(_ROUNDS + 1):  # the first one warms up
        ctx.progress("render.labels", turn, _ROUNDS + 1)
        for v in range(_VIEWS):
            for name, draw in contenders.items():
                draw(v)
                start = time.perf_counter()
                draw(v)
                spent[name][turn, v] = time.perf_counter() - start
    each = {name: float(np.median(taken[1:], axis=0).mean()) for name, taken in spent.items()}
    told = ", ".join(f"{name} {seconds * 1e3:.2f}" for name, seconds in each.items())
    detail = "standard flat, 224x224, 0.3 M Gaussians of 100 objects, two cores, RGB + depth; ms: "
    detail += told
    base = each["splats without labels"]
    ratios = spent["splats with labels"][1:] / spent["splats without labels"][1:]
    paired = float(np.median(ratios))  # a mean of medians scatters by 3 % from run to run
    rows = [
        row_at_most(
            "labels that nobody asks for add", 100 * (paired - 1), 1.0, "%",
            f"{detail}; the median of {ratios.size} ratios of two pictures drawn one after another",
        ),
    ]  # fmt: skip
    for name in ("colour, depth and object", "the object alone"):
        ratio = each[name] / base
        rows.append(FigureRow(name=f"{name}, over RGB + depth", value=ratio, unit="times"))
    return rows


def _parts_agreement(body: GaussianCloud) -> list[FigureRow]:
    """Instances against moved splats, picture by picture: the worst of them."""
    camera, views, rows = flat_camera(224, 224), flat_views(8), []
    for degree in (0, 3):
        cloud = body if degree == 0 else build_body(len(body), 1, sh_degree=degree)
        renderer = RendererCpu(build_flat(300_000), RenderOptions(rgb_float=True))
        renderer.name_cloud("body", cloud)
        near, off = [], []
        for k, view in enumerate(views):
            instance = Instance("body", pose_upright(view, 1.0 + k % 4, 0.7 * k), GAIN)
            got = renderer.render(camera, view, parts=[instance])
            want = renderer.render(camera, view, extra=move_instance(cloud, instance))
            assert got.rgb is not None and got.depth is not None
            assert want.rgb is not None and want.depth is not None
            solid = np.isfinite(got.depth) & np.isfinite(want.depth)
            near.append(psnr(got.rgb, want.rgb))
            off.append(float(np.percentile(np.abs(got.depth[solid] - want.depth[solid]), 99.9)))
        detail = (
            f"standard flat, 224x224, {len(views)} views, a body of {len(body):,} discs 1 to 4 m"
        )
        detail += " before each, with a gain; the worst picture"
        name = f"instances to moved splats, SH {degree}"
        rows.append(row_at_least(f"RGB PSNR, {name}", min(near), 75.0, "dB", detail))
        rows.append(row_at_most(f"depth error p99.9, {name}", max(off) * 1e3, 0.1, "mm", detail))
    return rows


FIGURES = [
    Figure(id="render.speed", title="CPU renderer: speed", measure=measure_speed, minutes=1.5),
    Figure(
        id="render.accuracy",
        title="CPU renderer: agreement with the float64 judge",
        measure=measure_accuracy,
        minutes=2.0,
    ),
    Figure(id="render.parts", title="CPU renderer: moving parts", measure=measure_parts),
    Figure(id="render.labels", title="CPU renderer: labels of pictures", measure=measure_labels),
]
