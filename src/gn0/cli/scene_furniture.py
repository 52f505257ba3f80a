"""Draw what generated scenes are furnished with: a sheet of the catalogue, a tile a thing.

Names are kinds (seats), things (seats/sofa) or patterns (*/lamp*); without any, all are drawn.
"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import msgspec
import tyro

from gn0.config import Config
from gn0.counted import counted

EXAMPLES = """  gn0 scene furniture --out out/furniture.png
  gn0 scene furniture seats kitchen/fridge "*/*lamp*" --seed 3 --out out/some.png
  gn0 scene furniture --list"""


class Args(Config, frozen=True):
    """Which things, and the picture.

    Attributes:
        names: kinds, things or patterns; all without any.
        out: the PNG or JPEG to write.
        seed: which of the many of each thing is drawn.
        list: print the names of things instead.
    """

    names: Annotated[
        tuple[str, ...],
        tyro.conf.Positional,
        tyro.conf.arg(metavar="[NAME ...]", help_behavior_hint="(optional)"),
    ] = ()
    out: str = "furniture.png"
    seed: Annotated[int, msgspec.Meta(ge=0, le=2**62)] = 0
    list: bool = False


def run(args: Args) -> int:
    """Draw and write, or list."""
    from gn0.cli.console import draw_progress
    from gn0.cli.picture_file import check_picture, write_picture
    from gn0.scenes.procedural.catalogue.table import find_things
    from gn0.storage import check_writable

    things = find_things(args.names)
    if args.list:
        print("\n".join(thing.name for thing in things))
        return 0
    from gn0.viewer.furniture_sheet import draw_catalogue

    check_picture(args.out)
    out = Path(args.out)
    check_writable(out)
    with draw_progress() as progress:
        sheet = draw_catalogue(things, seed=args.seed, progress=progress)
    write_picture(args.out, sheet)
    print(f"{counted(len(things), 'thing')}, written to {out}")
    return 0
