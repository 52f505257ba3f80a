"""From a furnished draft to the light in it and the Gaussians that show it."""

from __future__ import annotations

import numpy as np

from gn0.errors import ConfigError
from gn0.gaussians.cloud import GaussianCloud
from gn0.progress import Progress, no_progress
from gn0.scenes.bake import DRAFT, BakeSettings, bake_light
from gn0.scenes.exposure import LEAST, weigh_views
from gn0.scenes.procedural.draft import SceneDraft
from gn0.scenes.procedural.surface import ProceduralSurface
from gn0.scenes.surfels import build_surfels
from gn0.scenes.tone import BakedShader, choose_exposure

DARK = 0.01  # of the median irradiance: less is not seen
QUALITIES = {"normal": BakeSettings(), "draft": DRAFT}


def light_draft(
    draft: SceneDraft, *, quality: str = "normal", seed: int = 0, progress: Progress = no_progress
) -> BakedShader:
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
    surface = ProceduralSurface(draft.mesh, draft.materials)
    light = bake_light(
        draft.mesh,
        surface,
        draft.lamps,
        draft.sun,
        settings=QUALITIES[quality],
        opaque=surface.opaque(),
        seed=seed,
        progress=progress,
    )
    return BakedShader(draft.mesh, surface, light, choose_exposure(light))


def cover_draft(
    draft: SceneDraft,
    shader: BakedShader,
    count: int,
    *,
    seed: int = 0,
    progress: Progress = no_progress,
) -> GaussianCloud:
    """At most `count` Gaussians that show a lit draft, labelled by object index."""
    weight = weigh_views(draft.mesh, seed=seed)
    cloud = build_surfels(
        draft.mesh,
        shader,
        count=count,
        detail=weight,
        seed=seed,
        oriented=True,
        unseen=weight <= LEAST,
        label_of_instance=np.arange(len(draft.objects)),
        progress=progress,
    )
    return _drop_unlit(cloud)


def _drop_unlit(cloud: GaussianCloud) -> GaussianCloud:
    """Without the discs that no light reaches.

    They lie between surfaces that touch or nearly touch; nobody can see them, but where two
    layers are closer than a disc is wide they would show through the upper one as dark stripes.
    """
    assert cloud.irradiance is not None
    level = cloud.irradiance.max(axis=1)
    return cloud.select(np.flatnonzero(level > DARK * float(np.median(level))))
