"""Compute the visible sets of a whole scene now, so that later runs need not.

A visible set holds the splats that can be seen from one floor cell. Runs that use them
(`--visible-sets`, `VectorEnv(visible_sets=True)`) compute each set when an agent first comes there;
this verb does so for all cells. Sets are kept in the cache folder. It can be stopped and resumed.
"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

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
        cells: compute only the first so many; 0 means all.
        backend: what draws; each backend has sets of its own. auto: the best available.
    """

    folder: Annotated[str, tyro.conf.Positional, tyro.conf.arg(metavar="SCENE")]
    camera: str = "gn_bench"
    cells: Annotated[int, msgspec.Meta(ge=0)] = 0
    backend: Literal["auto", "cpu", "cuda"] = "auto"


def run(args: Args) -> int:
    """Find the sets and say how large they are."""
    import time

    from gn0.cli.console import draw_progress
    from gn0.maps.navigation import NavigationMap
    from gn0.render.open import build_renderer, choose_backend
    from gn0.render.renderer import DrawnScene
    from gn0.scenes.folder import load_scene
    from gn0.sim.presets import find_preset

    body = find_preset(args.camera).agent
    with draw_progress() as progress:
        progress("reading the scene", 0, 0)
        scene = load_scene(Path(args.folder))
        name, _ = choose_backend(args.backend)
        drawn = DrawnScene(build_renderer(scene.gaussians, name)).limit_to_visible(
            scene.cloud_hash or scene.gaussians.content_hash,
            NavigationMap(scene.grid, body.radius).inflated,
            body.camera_height,
        )
        sets = drawn.renderer.open_sets(drawn.key)
        start = time.perf_counter()
        done = list(sets.build(progress, most=args.cells or None))
        took = time.perf_counter() - start
    built = sets.built
    sizes = [sets.size_of(cell) for cell in done[:: max(len(done) // 16, 1)]]
    print(
        f"{len(done)} of {len(sets.cells)} cells, {built} found now by {drawn.name} "
        f"in {took:.1f} s, others kept"
    )
    if sizes:
        share = sum(sizes) / len(sizes) / max(len(scene.gaussians), 1)
        print(f"a set holds {share:.0%} of the scene's {len(scene.gaussians)} splats, on average")
    if sets.files is not None:
        print(f"cache: {sets.files.nbytes / 1e6:.1f} MB in {sets.files.folder}")
    print("next: gn0 bench run SUITE --visible-sets --out out/run")
    return 0
