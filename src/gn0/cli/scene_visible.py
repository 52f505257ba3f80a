"""Find the visible sets of a whole scene now, so that later runs need not.

A visible set holds the splats that show from one floor cell. Runs that use them (`--visible-sets`,
`VectorEnv(visible_sets=True)`) find each set when an agent first comes there; this verb walks all
cells. Sets are kept in the cache folder. Stopped, it goes on where it was.
"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import msgspec
import tyro

from gn0.config import Config

EXAMPLES = """  gn0 scene visible out/house
  gn0 scene visible out/house --camera vlnce --cells 20"""


class Args(Config, frozen=True):
    """The scene, and whose eyes.

    Attributes:
        folder: a scene folder.
        camera: the camera preset whose body and eye height count.
        cells: find only the first so many; 0 means all.
    """

    folder: Annotated[str, tyro.conf.Positional]
    camera: str = "gn_bench"
    cells: Annotated[int, msgspec.Meta(ge=0)] = 0


def run(args: Args) -> int:
    """Find the sets and say how large they are."""
    from itertools import islice

    from gn0.cli.console import draw_progress
    from gn0.maps.navigation import NavigationMap
    from gn0.render.renderer import build_renderer, limit_to_visible
    from gn0.render.visible import RendererVisible
    from gn0.scenes.folder import load_scene
    from gn0.sim.presets import find_preset

    body = find_preset(args.camera).agent
    with draw_progress() as progress:
        progress("reading the scene", 0, 0)
        scene = load_scene(Path(args.folder))
        renderer = limit_to_visible(
            build_renderer(scene.gaussians, "cpu"),
            scene.cloud_hash or scene.gaussians.content_hash,
            NavigationMap(scene.grid, body.radius).inflated,
            body.camera_height,
        )
        assert isinstance(renderer, RendererVisible)
        done = list(islice(renderer.build(progress), args.cells or None))
    sizes = [renderer.open(cell).size for cell in done[:: max(len(done) // 16, 1)]]
    print(f"{len(done)} of {len(renderer.cells)} cells, {renderer.built} found now, others kept")
    if sizes:
        share = sum(sizes) / len(sizes) / max(len(scene.gaussians), 1)
        print(f"a set holds {share:.0%} of the scene's {len(scene.gaussians)} splats, on average")
    if renderer.files is not None:
        print(f"cache: {renderer.files.nbytes / 1e6:.1f} MB in {renderer.files.folder}")
    print("next: gn0 bench run SUITE --visible-sets --out out/run")
    return 0
