"""From a furnished draft to the light in it and the Gaussians that show it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gn0.errors import ConfigError
from gn0.gaussians.cloud import GaussianCloud
from gn0.progress import Progress, no_progress
from gn0.scenes.bake import DRAFT, BakeSettings, bake_light
from gn0.scenes.charts import charts_of
from gn0.scenes.exposure import LEAST, weigh_views
from gn0.scenes.procedural.draft import SceneDraft
from gn0.scenes.procedural.surface import ProceduralSurface
from gn0.scenes.reach import Outlines
from gn0.scenes.shading import Shader, ShaderGrouped, ShaderOfGroups
from gn0.scenes.sky import OpenAirShader, find_vault
from gn0.scenes.surfels import Placement, outlines_of, place_surfels, shade_surfels
from gn0.scenes.tiles import PICKS
from gn0.scenes.tone import BakedShader, choose_exposure

DARK = 0.01  # of the median irradiance: less is not seen
CAMERAS = 160  # that judge what is seen closely, up to 140 m² of floor
CAMERAS_PER_M2 = 1.15  # in larger halls: each sees `SIGHT` far
SIGHT = 8.0  # m
SIGHT_OUTDOORS = 45.0  # m: walls all round a yard are in the pictures


@dataclass(frozen=True)
class Quality:
    """The care taken over a scene's looks.

    Attributes:
        bake: of the light.
        cameras: share of the cameras that judge what is seen closely.
        charts: judge whole pieces of surface instead of faces.
        first: see `place_surfels`.
        together: light the points of a cell together.
        merged: look up direct and bounced light at once; indoors, for the dark feet of house
            fronts would widen.
    """

    bake: BakeSettings
    cameras: float = 1.0
    charts: bool = False
    first: float = 1.0
    together: bool = False
    merged: bool = False


QUALITIES = {
    "normal": Quality(BakeSettings()),
    "draft": Quality(DRAFT, cameras=0.6, charts=True, first=0.66, together=True, merged=True),
}


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
    care = _quality(quality)
    vault = find_vault(draft.mesh, draft.materials)
    mesh = draft.mesh.select(~vault) if draft.sky is not None else draft.mesh
    surface = ProceduralSurface(mesh, draft.materials)
    light = bake_light(
        mesh,
        surface,
        draft.lamps,
        draft.sun,
        sky=draft.sky,
        settings=care.bake,
        opaque=surface.opaque(),
        seed=seed,
        progress=progress,
    )
    baked = BakedShader(
        draft.mesh,
        ProceduralSurface(draft.mesh, draft.materials),
        light.merged() if care.merged and draft.sky is None else light,
        choose_exposure(light),
    )
    if draft.sky is None:
        return baked
    return OpenAirShader(baked, vault, max(draft.sky.horizon) * draft.sky.shown)


def _quality(name: str) -> Quality:
    if name not in QUALITIES:
        raise ConfigError(f"no bake quality {name!r}", remedy="known: " + ", ".join(QUALITIES))
    return QUALITIES[name]


def place_draft(
    draft: SceneDraft,
    shader: Shader,
    count: int,
    *,
    quality: str = "normal",
    seed: int = 0,
    progress: Progress = no_progress,
) -> Placement:
    """At most `count` discs on the surfaces of a draft, finer where one looks closely.

    Raises:
        ConfigError: no such quality.
    """
    care = _quality(quality)
    cameras, sight = max(CAMERAS, int(CAMERAS_PER_M2 * floor_area(draft))), SIGHT
    if draft.sky is not None:
        cameras, sight = CAMERAS, SIGHT_OUTDOORS
    weight = weigh_views(
        draft.mesh,
        cameras=int(care.cameras * cameras),
        sight=sight,
        seed=seed,
        charts=charts_of(draft.mesh) if care.charts else None,
        progress=progress,
    )
    return place_surfels(
        draft.mesh,
        shader,
        count=count,
        detail=weight,
        seed=seed,
        oriented=True,
        unseen=weight <= LEAST,
        first=care.first,
        progress=progress,
    )


def cover_draft(
    draft: SceneDraft,
    shader: ShaderGrouped,
    count: int,
    *,
    quality: str = "normal",
    seed: int = 0,
    progress: Progress = no_progress,
) -> GaussianCloud:
    """At most `count` Gaussians that show a lit draft, labelled by object index."""
    options: dict[str, Any] = {"quality": quality, "seed": seed, "progress": progress}
    return cover_outlined(draft, shader, count, **options)[0]


def cover_outlined(
    draft: SceneDraft,
    shader: ShaderGrouped,
    count: int,
    *,
    quality: str = "normal",
    seed: int = 0,
    progress: Progress = no_progress,
) -> tuple[GaussianCloud, Outlines]:
    """`cover_draft`, and how far each of its splats may reach."""
    sight: Shader = ShaderOfGroups(shader, PICKS) if _quality(quality).together else shader
    placement = place_draft(draft, sight, count, quality=quality, seed=seed, progress=progress)
    progress("surfels", 5, 6)
    cloud = shade_surfels(placement, sight, np.arange(max(len(draft.objects), 1)), progress)
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
