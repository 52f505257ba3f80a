"""Surfels against a ray-traced reference of the same baked scene."""

from __future__ import annotations

import math
import time

import numpy as np

from gn0.geometry import F64, view_from_pose
from gn0.render.camera import Camera
from gn0.render.cpu import RendererCpu
from gn0.render.renderer import RenderOptions
from gn0.scenes.procedural.apartment import draft_apartment
from gn0.scenes.procedural.draft import SceneDraft
from gn0.scenes.procedural.finish import cover_outlined, light_draft
from gn0.scenes.procedural.generate import floor_area
from gn0.scenes.procedural.refine_views import refine_draft
from gn0.scenes.rays import RayCaster
from gn0.scenes.truth import render_truth
from gn0.seeds import random_stream
from gn0_figures.board import Figure, FigureContext, FigureRow, row_at_least, row_at_most

SEEDS = (1, 7)
VIEWS = 8  # of each apartment
EYE = 1.25  # m
CLEARANCE = 0.6  # of a camera to everything at eye height [m]


def choose_views(draft: SceneDraft, caster: RayCaster, count: int, seed: int) -> list[F64]:
    """Level views from random free places, each towards the longest sight of sixteen."""
    rng = random_stream(seed, "psnr views")
    angle = np.arange(16) * math.pi / 8
    ring = np.stack([np.cos(angle), np.sin(angle), 0 * angle], 1)
    views: list[F64] = []
    boxes = [(np.min(r.polygon, axis=0), np.max(r.polygon, axis=0)) for r in draft.rooms]
    share = np.array([np.prod(high - low) for low, high in boxes])
    while len(views) < count:
        low, high = boxes[int(rng.choice(len(boxes), p=share / share.sum()))]
        x, y = rng.uniform(low, high)
        eye = np.repeat([[x, y, EYE]], 16, axis=0)
        _, far, _ = caster.cast(eye, ring)
        if far.min() < CLEARANCE:
            continue
        sight = np.minimum(far, 6.0)
        sight = sight + 0.5 * (np.roll(sight, 1) + np.roll(sight, -1))
        views.append(view_from_pose(x, y, EYE, float(angle[int(sight.argmax())]), -0.1))
    return views


def measure_psnr(ctx: FigureContext) -> list[FigureRow]:
    """PSNR of surfels as placed and as refined, over all views of all apartments."""
    camera = Camera.from_hfov(640, 480, 79.0)
    f = camera.fx
    K = np.array([[f, 0, camera.cx], [0, f, camera.cy], [0, 0, 1]])
    psnr: dict[tuple[int, bool], list[float]] = {}
    holes: dict[tuple[int, bool], list[float]] = {}
    density: dict[int, list[float]] = {20_000: [], 10_000: []}
    seconds: list[float] = []
    for seed in SEEDS:
        draft = draft_apartment(seed)
        shader = light_draft(draft, seed=seed, progress=ctx.progress)
        caster = RayCaster(draft.mesh)
        views = choose_views(draft, caster, VIEWS, seed)
        truth = [
            render_truth(draft.mesh, shader, K, view, (640, 480), samples=3, caster=caster)[0]
            for view in views
        ]
        area = floor_area(draft)
        for target in density:
            cloud, outlines = cover_outlined(draft, shader, int(target * area), seed=seed)
            density[target].append(len(cloud) / area)
            for refined in (False, True) if target == 20_000 else (False,):
                if refined:
                    start = time.perf_counter()
                    cloud = refine_draft(
                        draft, shader, cloud, outlines, area=area, seed=seed, progress=ctx.progress
                    )
                    seconds.append(time.perf_counter() - start)
                picture = RendererCpu(cloud, RenderOptions(rgb_float=True)).render(
                    camera, np.stack(views), outputs=("rgb", "alpha")
                )
                assert picture.rgb is not None and picture.alpha is not None
                key = (target, refined)
                for shown, alpha, right in zip(picture.rgb, picture.alpha, truth, strict=True):
                    error = np.clip(shown, 0, 1).astype(np.float64) - right
                    psnr.setdefault(key, []).append(float(-10 * np.log10(np.mean(error**2))))
                    holes.setdefault(key, []).append(float((alpha < 0.95).mean()))
    rows = []
    for target, refined in ((20_000, True), (20_000, False), (10_000, False)):
        detail = (
            f"apartments {', '.join(map(str, SEEDS))}, {VIEWS} views each that no fit has seen, "
            f"640x480, hfov 79, eye {EYE} m, at most {max(density[target]):.0f} Gaussians/m², "
            "truth 9 rays a pixel"
        )
        values, share = psnr[target, refined], 100 * float(np.mean(holes[target, refined]))
        mean, worst = float(np.mean(values)), float(np.min(values))
        name = f"surfels at {target // 1000} k/m², {'--refine' if refined else 'as placed'}"
        if (target, refined) == (20_000, True):
            rows.append(row_at_least(f"{name}, PSNR mean", mean, 33.0, "dB", detail))
            rows.append(row_at_least(f"{name}, PSNR worst", worst, 29.0, "dB", detail))
            rows.append(row_at_most(f"{name}, pixels with T > 5 %", share, 0.1, "%", detail))
            rows.append(
                FigureRow(
                    name="time to refine an apartment",
                    value=float(np.mean(seconds)),
                    unit="s",
                    detail=detail,
                )
            )
            continue
        rows.append(FigureRow(name=f"{name}, PSNR mean", value=mean, unit="dB", detail=detail))
        rows.append(FigureRow(name=f"{name}, PSNR worst", value=worst, unit="dB", detail=detail))
    return rows


FIGURES = [
    Figure(
        id="procedural.psnr",
        title="Surfels against ray tracing",
        measure=measure_psnr,
        minutes=60.0,
    )
]
