"""Photographs of a draft for the refinement of its splats: where from, and what is on them."""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import partial

import numpy as np
from numpy.typing import NDArray

from gn0.gaussians.cloud import GaussianCloud
from gn0.gaussians.morton import morton_order
from gn0.geometry import F64, view_from_pose
from gn0.plugins import get_plugin
from gn0.progress import Progress, no_progress
from gn0.scenes.procedural.draft import SceneDraft
from gn0.scenes.rays import RayCaster
from gn0.scenes.reach import Outlines
from gn0.scenes.shading import Shader
from gn0.scenes.truth import trace_picture
from gn0.seeds import random_stream

VIEWS_PER_M2 = 10.0
STEPS_PER_M2 = 70.0
CLEARANCE = 0.35  # of a camera to everything at its height [m]
LENSES = ((640, 480, 79.0), (480, 360, 86.07))  # width, height, hfov: what policies look through
_SECOND_LENS = 0.25  # share of views through it
_EYES = (0.9, 1.6)  # heights of most cameras [m]
_HIGH = (1.6, 2.3)  # and of some that look down on tables and beds
_HIGH_SHARE = 0.12
_SIGHT = 6.0  # farther views count no more [m]


def place_views(
    draft: SceneDraft, caster: RayCaster, count: int, seed: int
) -> tuple[list[F64], list[int]]:
    """Seeded free places in all rooms, each view towards the farther of a few directions.

    Returns:
        world-to-camera [4, 4] of each view, and the index of its lens in `LENSES`.
    """
    rng = random_stream(seed, "refine views")
    angle = np.arange(16) * math.pi / 8
    ring = np.stack([np.cos(angle), np.sin(angle), 0 * angle], 1)
    boxes = [(np.min(r.polygon, axis=0), np.max(r.polygon, axis=0)) for r in draft.rooms]
    share = np.array([np.prod(high - low) for low, high in boxes])
    views: list[F64] = []
    lenses: list[int] = []
    for _ in range(200 * count):
        if len(views) == count:
            break
        low, high = boxes[int(rng.choice(len(boxes), p=share / share.sum()))]
        x, y = rng.uniform(low, high)
        above = rng.random() < _HIGH_SHARE
        z = rng.uniform(*(_HIGH if above else _EYES))
        _, far, _ = caster.cast(np.repeat([[x, y, z]], 16, axis=0), ring)
        yaws = rng.uniform(0, 2 * math.pi, 3)
        pitch = rng.uniform(-0.9, -0.4) if above else rng.uniform(-0.35, 0.1)
        lens = int(rng.random() < _SECOND_LENS)
        if far.min() < CLEARANCE:
            continue
        sight = np.minimum(far, _SIGHT)[np.round(yaws * 8 / math.pi).astype(int) % 16]
        views.append(view_from_pose(x, y, z, float(yaws[int(sight.argmax())]), float(pitch)))
        lenses.append(lens)
    return views, lenses


def refine_draft(
    draft: SceneDraft,
    shader: Shader,
    cloud: GaussianCloud,
    outlines: Outlines,
    *,
    area: float,
    seed: int = 0,
    refiner: str = "cpu",
    progress: Progress = no_progress,
) -> GaussianCloud:
    """Splats of a draft, fitted to ray-traced pictures of it; none reaches farther than before.

    Args:
        draft: the furnished building.
        shader: its look.
        cloud: its splats, see `cover_outlined`.
        outlines: how far each of them may reach.
        area: of floor [m²]; views and steps grow with it.
        seed: root of views, rays and order.
        refiner: plug-in that fits; the scenes know no renderer.
        progress: progress sink.

    Raises:
        ConfigError: no such refiner.
    """
    refine: Callable[..., GaussianCloud] = get_plugin("refiner", refiner)
    caster = RayCaster(draft.mesh)
    views, lenses = place_views(draft, caster, math.ceil(VIEWS_PER_M2 * area), seed)
    if not views:
        return cloud
    pictures: list[NDArray[np.uint8]] = []
    for v, (view, lens) in enumerate(zip(views, lenses, strict=True)):
        progress("photographs", v, len(views))
        rng = random_stream(seed, "refine rays", v)
        pictures.append(trace_picture(draft.mesh, shader, *_lens(lens), view, rng, caster=caster))
    progress("photographs", len(views), len(views))
    order = morton_order(cloud.means)  # in which refiners give splats back
    cloud = cloud.select(order)
    refined = refine(
        cloud,
        lenses=[LENSES[k] for k in lenses],
        views=np.stack(views),
        picture=partial(_pick, pictures),
        steps=math.ceil(STEPS_PER_M2 * area),
        closed=True,
        seed=seed,
        progress=progress,
    )
    return outlines.select(order).hold_cloud(refined, cloud)


def _pick(pictures: list[NDArray[np.uint8]], v: int) -> NDArray[np.uint8]:
    return pictures[v]


def _lens(index: int) -> tuple[F64, tuple[int, int]]:
    """Intrinsics and picture size of a lens."""
    width, height, hfov = LENSES[index]
    f = width / (2 * math.tan(math.radians(hfov) / 2))
    return np.array([[f, 0, width / 2], [0, f, height / 2], [0, 0, 1]]), (width, height)
