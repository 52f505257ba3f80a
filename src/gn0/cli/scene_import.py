"""Turn an InteriorGS folder, or a Gazebo/SDF world of COLLADA meshes, into a scene folder.

The source is told by its content. Occupancy comes from the geometry within the agent's body:
`--height-band LO HI`, metres above the floor.
"""

from __future__ import annotations

from typing import Annotated, Literal

import msgspec
import tyro

from gn0.config import Config

EXAMPLES = """  gn0 scene import path/to/small_house --out out/house
  gn0 scene import path/to/small_house --height-band 0.15 0.30 --out out/house-lidar
  gn0 scene import path/to/InteriorGS/0001_839920 --out out/flat"""


class Args(Config, frozen=True):
    """Source and settings.

    Attributes:
        path: a scene or world folder, or a .world file.
        out: the scene folder to write.
        height_band: the body band [m above the floor] whose obstacles block the agent.
        resolution: cell size of the occupancy grid [m].
        density: Gaussians per square metre of floor, for meshes.
        light: home bakes lamps and daylight, flat shows textures as they are; for meshes.
        packed: write 3dgs_compressed.ply (smaller, rounded) instead of point_cloud.ply.
        overwrite: replace an existing output folder.
    """

    path: Annotated[str, tyro.conf.Positional]
    out: str
    height_band: tuple[float, float] = (0.10, 1.50)
    resolution: float = 0.05
    density: Annotated[float, msgspec.Meta(ge=1000, le=40000)] = 10_000.0
    light: Literal["home", "flat"] = "home"
    packed: bool = False
    overwrite: bool = False


def run(args: Args) -> int:
    """Import and say what came out."""
    from gn0.cli.console import draw_progress
    from gn0.scenes.sources import import_scene

    with draw_progress() as progress:
        scene = import_scene(
            args.path,
            args.out,
            height_band=args.height_band,
            resolution=args.resolution,
            density=args.density,
            light=args.light,
            cloud_form="packed" if args.packed else "exact",
            overwrite=args.overwrite,
            progress=progress,
        )
    print_scene(scene, args.out)
    return 0


def print_scene(scene: object, out: str) -> None:
    """One paragraph on a scene: size, content, where it lies, what to do next."""
    from gn0.scenes.scene import Scene

    assert isinstance(scene, Scene)
    categories = {thing.category for thing in scene.objects}
    print(
        f"{scene.id}: {len(scene.gaussians):,} Gaussians, {scene.grid.free_area:.1f} m² walkable, "
        f"{len(scene.rooms)} rooms, {len(scene.objects)} objects of {len(categories)} categories"
    )
    print(f"written to {out}; next: gn0 scene check {out} && gn0 scene show {out}")
