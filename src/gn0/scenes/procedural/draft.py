"""What the planner hands to the light bake: geometry, materials, lamps, objects, rooms."""

from __future__ import annotations

from dataclasses import dataclass

from gn0.config import Config
from gn0.scenes.mesh import SceneMesh
from gn0.scenes.scene import SceneObject, SceneOpening, SceneRoom, SceneWall

Colour = tuple[float, float, float]  # linear RGB, 0..1


class Material(Config, frozen=True):
    """A surface material: a procedural pattern with colours, evaluated at uv [m].

    Patterns that show one whole image (picture_landscape, picture_abstract, picture_portrait,
    screen, sky, rug_border, rug_persian) read uv as 0..1 across the panel, u right, v up; for
    these `scale` is the panel's width / height. Faces of the pattern "sky" are window panes: they
    let light from outside through; faces of "lampshade" glow by `emission`.

    Attributes:
        name: e.g. "oak planks".
        pattern: name of a pattern in `materials.py`, e.g. "paint", "planks", "fabric".
        colour, colour2: linear albedo of the pattern's main and second colour.
        scale: length of one pattern unit [m].
        contrast: strength of the pattern, 0 flat to 1 full.
        emission: linear radiance; lamps and screens glow without being lit.
        seed: makes two uses of one pattern differ.
        detail: how finely the surface must be sampled: 1 full texture, 0 plain paint.
    """

    name: str
    pattern: str
    colour: Colour
    colour2: Colour = (0.5, 0.5, 0.5)
    scale: float = 0.1
    contrast: float = 0.5
    emission: Colour = (0.0, 0.0, 0.0)
    seed: int = 0
    detail: float = 1.0


class Lamp(Config, frozen=True):
    """A light source: a small rectangle or sphere that shines on surfaces.

    Attributes:
        centre: (x, y, z) [m].
        size: (width, depth) [m] of a downward rectangle, or (d, d) of a sphere.
        shape: "rectangle" (shines down), "sphere" (shines all round) or "window" (sky light
            entering through an opening, along `direction`).
        colour: linear radiance.
        direction: unit vector along which it shines.
    """

    centre: tuple[float, float, float]
    size: tuple[float, float]
    shape: str
    colour: Colour
    direction: tuple[float, float, float] = (0.0, 0.0, -1.0)


class Sun(Config, frozen=True):
    """Parallel light through the windows: unit direction of travel, linear irradiance."""

    direction: tuple[float, float, float]
    colour: Colour


class Sky(Config, frozen=True):
    """Light of the open sky on whatever sees it: linear radiance overhead and at the horizon.

    `shown` is how much brighter the painted vault is seen than it lights the ground: film and eye
    keep the blue of a sky that is four times darker than a sunlit wall.
    """

    zenith: Colour
    horizon: Colour
    shown: float = 1.0


@dataclass(frozen=True, eq=False)
class SceneDraft:
    """A furnished building before light: world frame, metres, floor at z = 0.

    `mesh.material` indexes `materials`; `mesh.instance` indexes `objects` (−1: building shell).
    """

    mesh: SceneMesh
    materials: tuple[Material, ...]
    objects: tuple[SceneObject, ...]
    rooms: tuple[SceneRoom, ...]
    walls: tuple[SceneWall, ...]
    openings: tuple[SceneOpening, ...]
    lamps: tuple[Lamp, ...]
    sun: Sun | None
    ceiling: float  # height of the ceiling [m]; of the vault of heaven outdoors
    sky: Sky | None = None  # outdoors: faces of the pattern "open_sky" are its vault
