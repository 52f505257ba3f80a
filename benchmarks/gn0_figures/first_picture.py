"""A first picture in a process of its own: what it waits for and what it imports.

`python -m gn0_figures.first_picture` prints one line of JSON. It imports what drawing needs.
"""

from __future__ import annotations

import json
import sys
import time

_START = time.perf_counter()

import numpy as np  # noqa: E402

from gn0.gaussians.cloud import GaussianCloud  # noqa: E402
from gn0.geometry import view_from_pose  # noqa: E402
from gn0.render.camera import Camera  # noqa: E402
from gn0.render.cuda.renderer import RendererCuda  # noqa: E402
from gn0_figures.device import open_figure_device  # noqa: E402


def third_party_modules() -> list[str]:
    """Names of imported packages that are neither Python's nor ours."""
    names = {name.split(".")[0] for name in sys.modules}
    known = {*sys.stdlib_module_names, "gn0"}
    return sorted(n for n in names - known if not n.startswith("_") and _is_installed(n))


def _is_installed(name: str) -> bool:
    place = getattr(sys.modules.get(name), "__file__", None) or ""
    return "site-packages" in place or "dist-packages" in place


def main() -> None:
    """Draw one picture of a few splats and say how long each step took [s]."""
    imported = time.perf_counter()
    device = open_figure_device()
    opened = time.perf_counter()
    count = 300
    at = np.linspace(-1, 1, count, dtype=np.float32)
    cloud = GaussianCloud(
        means=np.stack([2 + at, np.sin(9 * at), np.cos(7 * at)], 1).astype(np.float32),
        quats=np.tile(np.array([1, 0, 0, 0], np.float32), (count, 1)),
        scales=np.full((count, 3), 0.05, np.float32),
        opacities=np.full(count, 0.8, np.float32),
        sh=np.ones((count, 16, 3), np.float32) * 0.1,
    )
    renderer = RendererCuda(cloud, device=device)
    camera = Camera.from_hfov(32, 32, 90)
    renderer.render(camera, view_from_pose(0, 0, 0, 0))
    drawn = time.perf_counter()
    renderer.render(camera, view_from_pose(0, 0, 0, 0.1))
    found = {
        "imports": imported - _START,
        "device": opened - imported,
        "first": drawn - opened,
        "second": time.perf_counter() - drawn,
        "modules": third_party_modules(),
    }
    print(json.dumps(found))


if __name__ == "__main__":
    main()
