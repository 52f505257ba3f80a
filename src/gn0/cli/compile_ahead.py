"""Compile the kernels that a first run will need next, beside it, on an idle core.

A fresh machine compiles every kernel once. While one process makes a scene, another can already
draw a picture and plan an episode of the built-in flat: what it compiles is in the cache when the
first gets there.
"""

from __future__ import annotations

import contextlib
import os
import subprocess
import sys
from collections.abc import Iterator

_CODE = "from gn0.cli.compile_ahead import use_kernels; use_kernels()"


@contextlib.contextmanager
def compile_ahead() -> Iterator[None]:
    """Compile in a process beside this one, if anything is left to compile and a core is free."""
    if (os.cpu_count() or 1) < 2 or _is_compiled():
        yield
        return
    quiet = subprocess.DEVNULL
    process = subprocess.Popen(
        [sys.executable, "-c", _CODE], stdin=quiet, stdout=quiet, stderr=quiet
    )
    try:
        yield
    finally:
        process.kill()
        process.wait()


def _is_compiled() -> bool:
    from gn0.jit import is_compiled
    from gn0.render.cpu_raster import blend

    return is_compiled(blend)


def use_kernels() -> None:
    """Plan, walk and draw in the built-in flat: each kernel is compiled by its first call."""
    import numpy as np

    from gn0.maps.navigation import NavigationMap
    from gn0.missions.goal import sample_goal_episodes
    from gn0.render.bev import render_bev
    from gn0.render.camera import Camera
    from gn0.render.open import build_renderer
    from gn0.scenes.example import build_example_scene

    scene = build_example_scene()
    renderer = build_renderer(scene.gaussians, "cpu")
    renderer.render(Camera.from_hfov(64, 48, 90.0), np.eye(4))
    navigation = NavigationMap(scene.grid, 0.2)
    sample_goal_episodes(scene, navigation, 2, 0)
    bounds = np.array(scene.grid.bounds).reshape(2, 2)
    render_bev("", renderer, bounds, 0.1, 2.0, cache=False)
