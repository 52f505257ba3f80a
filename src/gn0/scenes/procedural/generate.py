"""`gn0 scene generate`: from a seed to a scene folder."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

import msgspec
import numpy as np

from gn0.config import Config, check_config
from gn0.errors import ConfigError
from gn0.progress import Progress, no_progress
from gn0.scenes.folder import CloudForm, save_scene
from gn0.scenes.occupancy import BAND, RESOLUTION, build_occupancy
from gn0.scenes.procedural.building import choose_palette
from gn0.scenes.procedural.finish import cover_outlined, floor_area, light_draft
from gn0.scenes.procedural.kinds import KINDS, OPEN_KINDS, KindName, SizeName, StyleName
from gn0.scenes.procedural.palette import Palette
from gn0.scenes.procedural.refine_views import refine_draft
from gn0.scenes.scene import Scene, SceneSourceInfo, name_categories
from gn0.storage import check_replaceable, plain_path


class GenerateSettings(Config, frozen=True):
    """What to generate.

    Attributes:
        kind: of building, one of `kinds.KINDS`.
        seed: seed of everything random.
        size: of the kind's three; `KINDS[kind].areas` says how many m² of floor.
        style: style of the furnishing; drawn from the seed when None.
        density: Gaussians per square metre of floor; the kind's own when None.
        light: "normal", or "draft" for coarser light and up to a tenth fewer Gaussians, in less
            than half of the time.
        cloud_form: "exact" (`point_cloud.ply`) or "packed" (`3dgs_compressed.ply`).
        refine: fit the Gaussians to ray-traced pictures: sharper outlines, minutes of work.
        without: forms of furniture that it goes without, as "seats/chair/2"; see `forms.FORMS`.
        open_plan: an apartment or a residence with next to no walls between its day rooms.
    """

    kind: KindName = "apartment"
    seed: Annotated[int, msgspec.Meta(ge=0, le=2**62)] = 0
    size: SizeName = "medium"
    style: StyleName | None = None
    density: Annotated[float, msgspec.Meta(ge=1000, le=40000)] | None = None
    light: Literal["normal", "draft"] = "normal"
    cloud_form: CloudForm = "exact"
    refine: bool = False
    without: tuple[str, ...] = ()
    open_plan: bool = False

    def __post_init__(self) -> None:
        if self.open_plan and self.kind not in OPEN_KINDS:
            raise ConfigError(
                f"no {self.kind} is of another plan than its own",
                where="open_plan",
                remedy=f"leave it out, or choose one of {', '.join(OPEN_KINDS)}",
            )


def build_generated(
    settings: GenerateSettings, scene_id: str, progress: Progress = no_progress
) -> Scene:
    """A generated scene in memory.

    Raises:
        ConfigError: a setting is out of range.
        SceneError: no walkable building was found.
    """
    settings = check_config(settings)
    kind = KINDS[settings.kind]
    density = kind.density if settings.density is None else settings.density
    progress("furnishing", 0, 1)
    style: str | Palette | None = settings.style
    if settings.without:
        style = choose_palette(settings.kind, settings.seed, style, settings.without)
    opened = {"open_plan": True} if settings.open_plan else {}
    draft = kind.draft(settings.seed, size=settings.size, style=style, **opened)
    progress("furnishing", 1, 1)
    progress("mapping", 0, 1)
    grid = build_occupancy(draft.mesh)
    progress("mapping", 1, 1)
    shader = light_draft(draft, quality=settings.light, seed=settings.seed, progress=progress)
    area = floor_area(draft)
    count = int(density * area)
    cloud, outlines = cover_outlined(
        draft, shader, count, quality=settings.light, seed=settings.seed, progress=progress
    )
    if settings.refine:
        cloud = refine_draft(
            draft, shader, cloud, outlines, area=area, seed=settings.seed, progress=progress
        )
    cloud = name_categories(cloud, draft.objects)
    corners = draft.mesh.vertices[np.unique(draft.mesh.faces)]
    return Scene(
        id=scene_id,
        source=SceneSourceInfo(
            kind="procedural",
            detail=f"{settings.kind} {kind.version}",
            seed=settings.seed,
            settings={
                "kind": settings.kind,
                "size": settings.size,
                "style": settings.style,
                "density": float(density),
                "light": settings.light,
                "refine": settings.refine,
                "height_band_low": BAND[0],
                "height_band_high": BAND[1],
                "resolution": RESOLUTION,
                **({"without": ", ".join(settings.without)} if settings.without else {}),
                **opened,
            },
            label_source="generated",
        ),
        grid=grid,
        objects=draft.objects,
        rooms=draft.rooms,
        bounds=np.stack([corners.min(axis=0), corners.max(axis=0)]),
        load_cloud=lambda: cloud,
        walls=draft.walls,
        openings=draft.openings,
        licence="CC0-1.0",
    )


def generate_scene(
    settings: GenerateSettings,
    out: Path | str,
    *,
    overwrite: bool = False,
    progress: Progress = no_progress,
) -> Scene:
    """Generate a scene into the folder `out`; the scene's id is the folder's name.

    Args:
        settings: what to generate.
        out: the scene folder to write.
        overwrite: replace an existing folder.
        progress: progress sink.

    Raises:
        StorageError: `out` exists and is not empty, or cannot be written.
        ConfigError: a setting is out of range.
        SceneError: no walkable building was found, or the folder's name cannot be a scene's id.
    """
    out = plain_path(out)
    # said now, not after half a minute of work
    check_replaceable(out, overwrite=overwrite, marker="scene.json")
    scene = build_generated(settings, out.resolve().name, progress)
    return save_scene(
        scene, out, cloud_form=settings.cloud_form, overwrite=overwrite, progress=progress
    )
