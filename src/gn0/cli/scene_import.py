"""Turn a splat file, an InteriorGS folder, a Gazebo/SDF world or a ROS map into a scene folder.

The source is recognised by its content. Occupancy comes from what lies within the agent's body:
`--height-band LO HI`, metres above the floor.

A bare splat file (.ply, .splat, .spz, .sog, .glb, a SOG folder) says neither which way is up nor
how large it is: both are proposed, with the evidence in words and in capture.png, or given.
"""

from __future__ import annotations

from typing import Annotated, Literal

import msgspec
import tyro

from gn0.config import Config

EXAMPLES = """  gn0 scene import path/to/small_house --out out/house
  gn0 scene import my.ply --out out/room
  gn0 scene import my.splat --up=-y --scale-from ceiling:2.6 --out out/room
  gn0 scene import statue.sog --up=y --floor bottom --out out/statue
  gn0 scene import path/to/small_house --height-band 0.15 0.30 --out out/house-lidar
  gn0 scene import path/to/map.yaml --out out/map
  gn0 scene import path/to/InteriorGS/0001_839920 --out out/flat"""


class Args(Config, frozen=True):
    """Source and settings.

    Attributes:
        path: a splat file, a scene or world folder, a .world file, or a ROS map's .yaml.
        out: the scene folder to write.
        height_band: the body band [m above the floor] whose obstacles block the agent.
        resolution: cell size of the occupancy grid [m].
        density: Gaussians per square metre of floor, for meshes.
        light: home bakes lamps and daylight, flat shows textures as they are; for meshes.
        strict: refuse a world of meshes that has any defect, instead of repairing what can be
            repaired and leaving the rest out; either way defects are listed before light is baked.
        packed: write 3dgs_compressed.ply (smaller, rounded) instead of point_cloud.ply.
        overwrite: replace an existing output folder.
        up: bare captures: auto, an axis of the file (z, -y, ...) or a direction x,y,z.
        scale: bare captures: metres per unit of the file; 0 proposes one.
        scale_from: bare captures: a known length, e.g. ceiling:2.6, door-height:2.0@x,y,z,
            camera-height:1.5@x,y,z or two-points:1.2@x,y,z@x,y,z (points in the file's units).
        floor: bare captures: auto, bottom, or a height along up in the file's units; the last two
            put a flat ground there, for objects scanned without their floor.
        yaw: bare captures: walls aligns them with x and y, keep leaves the heading.
        seed_point: bare captures: X Y [m] on the open floor to map from.
        least_area: bare captures: with less walkable ground [m²] it asks, and writes nothing.
        open_doors: bare captures: take the leaves of doors found closed out of splats and map.
        level: bare captures: level of detail of a streamed SOG, 0 the finest.
    """

    path: Annotated[str, tyro.conf.Positional, tyro.conf.arg(metavar="SOURCE")]
    out: str
    height_band: tuple[float, float] = (0.10, 1.50)
    resolution: float = 0.05
    density: Annotated[float, msgspec.Meta(ge=1000, le=40000)] = 10_000.0
    light: Literal["home", "flat"] = "home"
    strict: bool = False
    packed: bool = False
    overwrite: bool = False
    up: str = "auto"
    scale: float = 0.0
    scale_from: str = ""
    floor: str = "auto"
    yaw: Literal["walls", "keep"] = "walls"
    seed_point: tuple[float, float] | None = None
    least_area: float = 1.0
    open_doors: bool = False
    level: int | None = None


def run(args: Args) -> int:
    """Import and say what came out."""
    from gn0.cli.console import draw_progress, say_aside
    from gn0.scenes.capture.settings import CaptureSettings
    from gn0.scenes.scene_sources import import_scene

    capture = CaptureSettings(
        up=args.up,
        scale=args.scale,
        scale_from=args.scale_from,
        floor=args.floor,
        yaw=args.yaw,
        seed_point=args.seed_point,
        least_area=args.least_area,
        open_doors=args.open_doors,
        level=args.level,
    )
    with draw_progress() as progress:
        scene = import_scene(
            args.path,
            args.out,
            height_band=args.height_band,
            resolution=args.resolution,
            density=args.density,
            light=args.light,
            strict=args.strict,
            capture=capture,
            cloud_form="packed" if args.packed else "exact",
            overwrite=args.overwrite,
            progress=progress,
            tell=say_aside,
        )
    if scene.source.kind == "capture":
        print_capture(scene, args.out)
    print_scene(scene, args.out)
    return 0


def print_capture(scene: object, out: str) -> None:
    """The evidence behind a capture's frame, in words, and as capture.png in its folder."""
    from pathlib import Path

    from gn0.scenes.capture.capture_source import evidence_lines
    from gn0.scenes.scene import Scene
    from gn0.storage import write_atomic
    from gn0.viewer.capture_sheet import render_capture

    assert isinstance(scene, Scene)
    picture = render_capture(scene)
    path = Path(out) / "capture.png"
    write_atomic(path, lambda stream: picture.save(stream, "PNG"))
    print(f"evidence for the frame (picture: {path}):")
    print("\n".join(evidence_lines(scene.source)))


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
