"""Read every byte of a dataset again and name what is damaged: the file, and the rows where known.

With --pixels every picture is drawn again as well and compared with the hash in its row. The exit
code is 0 if everything is intact and 1 if something is damaged.
"""

from __future__ import annotations

from typing import Annotated

import msgspec
import tyro

from gn0.config import Config
from gn0.counted import counted

EXAMPLES = """  gn0 data verify out/data
  gn0 data verify out/data --pixels --workers 2"""

SHOWN = 20  # damages that are listed


class Args(Config, frozen=True):
    """What to read.

    Attributes:
        dataset: the dataset folder.
        pixels: also draw every picture again.
        workers: readers, and processes that draw; 0 means one per core.
    """

    dataset: Annotated[str, tyro.conf.Positional, tyro.conf.arg(metavar="DATASET")]
    pixels: bool = False
    workers: Annotated[int, msgspec.Meta(ge=0, le=1024)] = 0


def run(args: Args) -> int:
    """Read, and say what is damaged."""
    from gn0.cli.console import draw_progress, say_aside
    from gn0.data.verify import count_damages, verify_dataset

    with draw_progress() as progress:
        report = verify_dataset(
            args.dataset,
            pixels=args.pixels,
            workers=args.workers,
            progress=progress,
            note=say_aside,
        )
    for damage in report.damages[:SHOWN]:
        print(damage)
    if len(report.damages) > SHOWN:
        print(f"… and {len(report.damages) - SHOWN} more")
    files, samples = counted(report.files, "file"), counted(report.samples, "sample")
    size = f"{files}, {report.size / 1e6:.1f} MB, {samples}"
    if not report.ok:
        print(f"damaged: {count_damages(report.damages)}, out of {size}")
        source = " --suite SUITE" if any(d.kind == "source" for d in report.damages) else ""
        print(f"make them again: gn0 data repair {args.dataset}{source}")
        return 1
    caches = ", ".join(report.layouts) or "none: `gn0 data render` makes one"
    print(f"whole: {size}; caches of pictures: {caches}")
    if report.pixels:
        compared = counted(report.pixels, "sample")
        print(f"the pictures of {compared}, drawn again, have the pixels they had")
    elif args.pixels:
        print("no picture was compared: the rows have no hashes yet (`gn0 data render`)")
    return 0
