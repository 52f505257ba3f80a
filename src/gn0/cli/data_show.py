"""Draw a sample sheet: a few steps with view, history, BEV and occupancy, and the path ahead."""

from __future__ import annotations

from typing import Annotated

import msgspec
import tyro

from gn0.config import Config

EXAMPLES = """  gn0 data show out/data --out out/samples.png
  gn0 data show out/data --episode flat-0003 --steps 6 --out out/samples.png"""


class Args(Config, frozen=True):
    """What to draw.

    Attributes:
        dataset: the dataset folder.
        out: the PNG or JPEG file to write.
        episode: id of an episode; by default the first one.
        steps: how many of its steps.
    """

    dataset: Annotated[str, tyro.conf.Positional, tyro.conf.arg(metavar="DATASET")]
    out: str
    episode: str = ""
    steps: Annotated[int, msgspec.Meta(ge=1, le=50)] = 4


def run(args: Args) -> int:
    """Draw and write."""
    import io
    from pathlib import Path

    from gn0.cli.console import draw_progress
    from gn0.data.dataset import open_dataset
    from gn0.data.sample_sheet import draw_sheet
    from gn0.errors import ConfigError
    from gn0.storage import write_bytes

    kinds = {".png": "PNG", ".jpg": "JPEG", ".jpeg": "JPEG"}
    kind = kinds.get(Path(args.out).suffix.lower())
    if kind is None:
        raise ConfigError(
            f"cannot write {args.out!r}", where="--out", remedy="end it with .png or .jpg"
        )
    with draw_progress("drawing the sheet"):
        sheet = draw_sheet(open_dataset(args.dataset), args.episode, args.steps)
    stream = io.BytesIO()
    sheet.save(stream, kind, **({"quality": 88} if kind == "JPEG" else {}))
    write_bytes(args.out, stream.getvalue())
    print(f"{args.out}: {sheet.width}x{sheet.height} px")
    return 0
