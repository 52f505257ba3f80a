"""From a furnished draft to the light in it and the Gaussians that show it."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from gn0.errors import ConfigError
from gn0.gaussians.cloud import GaussianCloud
from gn0.progress import Progress, no_progress
from gn0.scenes.bake import DRAFT, BakeSettings, bake_light
from gn0.scenes.exposure import LEAST, weigh_views
from gn0.scenes.procedural.draft import SceneDraft
from gn0.scenes.procedural.surface import ProceduralSurface
from gn0.scenes.reach import Outlines
from gn0.scenes.shading import Shader
from gn0.scenes.sky import OpenAirShader, find_vault
from gn0.scenes.surfels import Placement, outlines_of, place_surfels, shade_surfels
from gn0.scenes.tone import BakedShader, choose_exposure

DARK = 0.01  # of the median irradiance: less is not seen
CAMERAS = 160  # that judge what is seen closely, up to 140 m² of floor
CAMERAS_PER_M2 = 1.15  # in larger halls: each sees `SIGHT` far
SIGHT = 8.0  # m
SIGHT_OUTDOORS = 45.0  # m: walls all round a yard are in the pictures
QUALITIES = {"normal": BakeSettings(), "draft": DRAFT}


def floor_area(draft: SceneDraft) -> float:
    """Clear floor area of all rooms [m²]."""
    total = 0.0
    for room in draft.rooms:
        x, y = np.array(room.polygon).T
        total += float(abs(x @ np.roll(y, -1) - y @ np.roll(x, -1)) / 2)
    return total


def light_draft(
    draft: SceneDraft, *, quality: str = "normal", seed: int = 0, progress: Progress = no_progress
) -> BakedShader | OpenAirShader:
    """Bake a draft's light and expose it: the look of the finished scene.

    Args:
        draft: the furnished building.
        quality: "normal", or "draft" for a faster bake with softer shadows.
        seed: root of the sampling patterns.
        progress: progress sink.

    Raises:
        ConfigError: no such quality.
    """
    if quality not in QUALITIES:
        raise ConfigError(f"no bake quality {quality!r}", remedy="known: " + ", ".join(QUALITIES))
    vault = find_vault(draft.mesh, draft.materials)
    mesh = draft.mesh.select(~vault) if draft.sky is not None else draft.mesh
    surface = ProceduralSurface(mesh, draft.materials)
    light = bake_light(
        mesh,
        surface,
        draft.lamps,
        draft.sun,
        sky=draft.sky,
        settings=QUALITIES[quality],
        opaque=surface.opaque(),
        seed=seed,
        progress=progress,
    )
    baked = BakedShader(
        draft.mesh,
        ProceduralSurface(draft.mesh, draft.materials),
        light,
        choose_exposure(light),
    )
    if draft.sky is None:
        return baked
    return OpenAirShader(baked, vault, max(draft.sky.horizon) * draft.sky.shown)


def place_draft(
    draft: SceneDraft,
    shader: Shader,
    count: int,
    *,
    seed: int = 0,
    progress: Progress = no_progress,
) -> Placement:
    """At most `count` discs on the surfaces of a draft, finer where one looks closely."""
    cameras, sight = max(CAMERAS, int(CAMERAS_PER_M2 * floor_area(draft))), SIGHT
    if draft.sky is not None:
        cameras, sight = CAMERAS, SIGHT_OUTDOORS
    weight = weigh_views(draft.mesh, cameras=cameras, sight=sight, seed=seed, progress=progress)
    return place_surfels(
        draft.mesh,
        shader,
        count=count,
        detail=weight,
        seed=seed,
        oriented=True,
        unseen=weight <= LEAST,
        progress=progress,
    )


def cover_draft(
    draft: SceneDraft,
    shader: Shader,
    count: int,
    *,
    seed: int = 0,
    progress: Progress = no_progress,
) -> GaussianCloud:
    """At most `count` Gaussians that show a lit draft, labelled by object index."""
    return cover_outlined(draft, shader, count, seed=seed, progress=progress)[0]


def cover_outlined(
    draft: SceneDraft,
    shader: Shader,
    count: int,
    *,
    seed: int = 0,
    progress: Progress = no_progress,
) -> tuple[GaussianCloud, Outlines]:
    """`cover_draft`, and how far each of its splats may reach."""
    placement = place_draft(draft, shader, count, seed=seed, progress=progress)
    progress("surfels", 5, 6)
    cloud = shade_surfels(placement, shader, np.arange(max(len(draft.objects), 1)), progress)
    progress("surfels", 6, 6)
    lit = _find_lit(cloud)
    return cloud.select(lit), outlines_of(placement).select(lit)


def _find_lit(cloud: GaussianCloud) -> NDArray[np.int64]:
    """All but the discs that no light reaches.

    They lie between surfaces that touch or nearly touch; nobody can see them, but where two
    layers are closer than a disc is wide they would show through the upper one as dark stripes.
    """
    assert cloud.irradiance is not None
    level = cloud.irradiance.max(axis=1)
    return np.flatnonzero(level > DARK * float(np.median(level)))
