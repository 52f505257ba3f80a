"""Generate a furnished building from a seed: plan, furniture, materials, baked light, splats.

The same seed and settings give the same bytes.
"""

from __future__ import annotations

from typing import Annotated, Literal

import msgspec

from gn0.config import Config
from gn0.scenes.procedural.kinds import KINDS, KindName, SizeName, StyleName

KIND_TABLE = "\n".join(
    f"  {name:<12}{', '.join(f'{low}–{high}' for low, high in kind.areas):<28}{kind.about}"
    for name, kind in KINDS.items()
)
EXAMPLES = f"""  gn0 scene generate --kind apartment --seed 7 --out out/flat
  gn0 scene generate --seed 11 --size large --density 20000 --out out/sharp
  gn0 scene generate --seed 3 --size small --density 5000 --light draft --out out/quick
  gn0 scene generate --seed 7 --density 20000 --refine --out out/photo
  gn0 scene generate --kind office --seed 1 --light draft --out out/office
  gn0 scene generate --kind corridor --seed 4 --size large --packed --out out/school

kinds, with the m² of floor of small, medium and large:
{KIND_TABLE}"""


class Args(Config, frozen=True):
    """What to generate, and where.

    Attributes:
        out: the scene folder to write.
        kind: of building; listed above.
        seed: of everything drawn by chance.
        size: of the building; the m² of each kind are listed above.
        style: taste of the furnishing; drawn from the seed by default.
        density: Gaussians per square metre of floor, 5000 fast to 20000 sharp; by default
            10000 for homes, fewer for halls.
        light: normal, or draft for a quicker bake.
        refine: fit the Gaussians to ray-traced pictures: 34 dB instead of 26 at density 20000, for
            a quarter of an hour and more.
        packed: write 3dgs_compressed.ply (smaller, rounded) instead of point_cloud.ply.
        overwrite: replace an existing output folder.
    """

    out: str
    kind: KindName = "apartment"
    seed: Annotated[int, msgspec.Meta(ge=0, le=2**62)] = 0
    size: SizeName = "medium"
    style: StyleName | None = None
    density: Annotated[float, msgspec.Meta(ge=5000, le=20000)] | None = None
    light: Literal["normal", "draft"] = "normal"
    refine: bool = False
    packed: bool = False
    overwrite: bool = False


def run(args: Args) -> int:
    """Generate and say what came out."""
    from gn0.cli.console import draw_progress
    from gn0.cli.scene_import import print_scene
    from gn0.scenes.procedural.generate import GenerateSettings, generate_scene

    settings = GenerateSettings(
        kind=args.kind,
        seed=args.seed,
        size=args.size,
        style=args.style,
        density=args.density,
        light=args.light,
        cloud_form="packed" if args.packed else "exact",
        refine=args.refine,
    )
    with draw_progress() as progress:
        scene = generate_scene(settings, args.out, overwrite=args.overwrite, progress=progress)
    print_scene(scene, args.out)
    return 0
