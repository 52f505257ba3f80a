"""Draw a sheet of a scene: plan with rooms and objects, bird's-eye view, four views."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

import tyro

from gn0.config import Config

EXAMPLES = """  gn0 scene show out/flat
  gn0 scene show out/flat --out flat.png
  gn0 scene show out/flat --labels semantic --out kinds.png"""


class Args(Config, frozen=True):
    """The scene and the picture.

    Attributes:
        folder: a scene folder.
        out: the PNG or JPEG to write; default: NAME.png beside the scene folder.
        labels: what the views show instead of colours: the category of what is seen (semantic), or
            which object it is (instance), each in a colour of its own.
    """

    folder: Annotated[str, tyro.conf.Positional, tyro.conf.arg(metavar="SCENE")]
    out: str = ""
    labels: Literal["", "semantic", "instance"] = ""


def run(args: Args) -> int:
    """Draw and write."""
    from gn0.cli.console import draw_progress
    from gn0.cli.picture_file import check_picture, write_picture
    from gn0.render.open import build_renderer
    from gn0.scenes.folder import load_scene
    from gn0.storage import check_writable
    from gn0.viewer.scene_sheet import render_sheet

    if args.out:
        check_picture(args.out)
    folder = Path(args.folder)
    scene = load_scene(folder)
    out = Path(args.out) if args.out else folder.resolve().parent / f"{folder.resolve().name}.png"
    check_writable(out)
    with draw_progress() as progress:
        progress("drawing", 0, 1)
        sheet = render_sheet(
            scene,
            build_renderer(scene.gaussians),
            labels=args.labels,
        )
        progress("drawing", 1, 1)
    write_picture(str(out), sheet)
    print(f"written to {out}")
    return 0
