"""Generate a furnished building from a seed: plan, furniture, materials, baked light, splats.

The same seed and settings give the same bytes.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated, Literal

import msgspec

from gn0.config import Config
from gn0.errors import ConfigError
from gn0.scenes.procedural.kinds import KINDS, KindName, SizeName, StyleName

if TYPE_CHECKING:
    from gn0.scenes.procedural.generate import GenerateSettings

KIND_TABLE = "\n".join(
    f"  {name:<12}{', '.join(f'{low}–{high}' for low, high in kind.areas):<28}{kind.about}"
    for name, kind in KINDS.items()
)
EXAMPLES = f"""  gn0 scene generate --kind apartment --seed 7 --out out/flat
  gn0 scene generate --seed 11 --size large --density 20000 --out out/sharp
  gn0 scene generate --seed 3 --size small --density 5000 --light draft --out out/quick
  gn0 scene generate --seed 7 --density 20000 --refine --out out/photo
  gn0 scene generate --kind residence --seed 5 --open-plan --light draft --out out/open
  gn0 scene generate --kind office --seed 1 --light draft --out out/office
  gn0 scene generate --kind corridor --seed 4 --size large --packed --out out/school
  gn0 scene generate --seed 3 --light draft --as-capture --capture-scale 0.4 --out scan.splat

kinds, with the m² of floor of small, medium and large:
{KIND_TABLE}"""


class Args(Config, frozen=True):
    """What to generate, and where.

    Attributes:
        out: the scene folder to write.
        kind: kind of building; listed above.
        seed: seed of everything random.
        size: size of the building; the m² of each kind are listed above.
        style: style of the furnishing; drawn from the seed by default.
        density: Gaussians per square metre of floor, 5000 fast to 20000 sharp; by default
            10000 for homes, fewer for halls.
        light: normal, or draft for a quicker bake.
        refine: fit the Gaussians to ray-traced pictures: 34 dB instead of 26 at density 20000, but
            a quarter of an hour or more.
        open_plan: an apartment or a residence with next to no walls between its day rooms.
        packed: write 3dgs_compressed.ply (smaller, rounded) instead of point_cloud.ply.
        overwrite: replace an existing output folder.
        as_capture: write a bare splat file instead of a scene folder, like a scan: no map,
            no labels, tilted; OUT ends with .ply, .compressed.ply, .splat, .ksplat, .spz, .sog
            or .glb.
        capture_up: the axis of that file nearest to up, or a direction x,y,z.
        capture_tilt: by how many degrees up differs from it; the seed draws the direction.
        capture_scale: metres that one unit of that file stands for.
    """

    out: str
    kind: KindName = "apartment"
    seed: Annotated[int, msgspec.Meta(ge=0, le=2**62)] = 0
    size: SizeName = "medium"
    style: StyleName | None = None
    density: Annotated[float, msgspec.Meta(ge=5000, le=20000)] | None = None
    light: Literal["normal", "draft"] = "normal"
    refine: bool = False
    open_plan: bool = False
    packed: bool = False
    overwrite: bool = False
    as_capture: bool = False
    capture_up: str = "-y"
    capture_tilt: Annotated[float, msgspec.Meta(ge=0, le=45)] = 8.0
    capture_scale: Annotated[float, msgspec.Meta(gt=0, le=1e6)] = 1.0


def run(args: Args) -> int:
    """Generate and say what came out."""
    from gn0.cli.console import draw_progress
    from gn0.cli.scene_import import print_scene
    from gn0.scenes.procedural.generate import GenerateSettings, generate_scene

    given = (args.capture_up, args.capture_tilt, args.capture_scale)
    if given != ("-y", 8.0, 1.0) and not args.as_capture:
        raise ConfigError(
            "--capture-up, --capture-tilt and --capture-scale belong to a bare splat file",
            remedy="add --as-capture, or leave them out",
        )

    settings = GenerateSettings(
        kind=args.kind,
        seed=args.seed,
        size=args.size,
        style=args.style,
        density=args.density,
        light=args.light,
        cloud_form="packed" if args.packed else "exact",
        refine=args.refine,
        open_plan=args.open_plan,
    )
    if args.as_capture:
        _write_capture(args, settings)
        return 0
    with draw_progress() as progress:
        scene = generate_scene(settings, args.out, overwrite=args.overwrite, progress=progress)
    print_scene(scene, args.out)
    return 0


def _write_capture(args: Args, settings: GenerateSettings) -> None:
    """Write the splats alone, and say how they lie: what an import should find."""
    from pathlib import Path

    from gn0.cli.console import draw_progress
    from gn0.scenes.capture.gravity import name_direction
    from gn0.scenes.procedural.generate import build_generated
    from gn0.testing.bare_capture import (
        BareSettings,
        check_bare_settings,
        check_capture_file,
        save_bare_capture,
    )

    out = Path(args.out)
    check_capture_file(out, overwrite=args.overwrite)
    lies = check_bare_settings(
        BareSettings(
            up=args.capture_up, tilt=args.capture_tilt, scale=args.capture_scale, seed=args.seed
        )
    )
    with draw_progress() as progress:
        scene = build_generated(settings, "capture", progress)
        frame = save_bare_capture(scene.gaussians, out, lies, overwrite=args.overwrite)
    print(
        f"{out}: {len(scene.gaussians):,} Gaussians and nothing else; "
        f"in truth up is {name_direction(frame.rotation[:, 2])} and a unit {frame.scale:g} m"
    )
    print(f"next: gn0 scene inspect {out} && gn0 scene import {out} --out DIR")
