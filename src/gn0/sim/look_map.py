"""What a scene looks like from above in its light."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from gn0.geometry import F64
from gn0.render.bev import BevPicture, bev_file, render_bev
from gn0.render.renderer import DrawnScene, Renderer
from gn0.scenes.scene import Scene
from gn0.sim.open import look_hash, split_look

Colour = tuple[float, float, float]


def draw_map(
    renderer: Renderer,
    look: str,
    scene: Scene,
    cut_height: float,
    background: Colour,
) -> BevPicture:
    """A look from above, from the cache when it is there; the renderer knows it by its name."""
    what, place = _plan(look, scene)
    return render_bev(what, DrawnScene(renderer, look), *place, cut_height, background=background)


def find_map(
    renderer: Renderer, look: str, scene: Scene, cut_height: float, background: Colour
) -> Path:
    """The file in the cache of what `draw_map` draws, whether it is there or not."""
    what, place = _plan(look, scene)
    return bev_file(what, renderer.traits, *place, cut_height, background=background)


def _plan(look: str, scene: Scene) -> tuple[str, tuple[F64, float]]:
    """What is seen, and of which place."""
    _, light = split_look(look)
    return look_hash(scene, light), (
        np.array(scene.grid.bounds).reshape(2, 2), scene.grid.resolution
    )  # fmt: skip
