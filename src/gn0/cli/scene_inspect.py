"""What a splat file holds: format, count, SH degree, bounds, dropped splats, oddities."""

from __future__ import annotations

from typing import Annotated

import tyro

from gn0.config import Config

EXAMPLES = """  gn0 scene inspect point_cloud.ply
  gn0 scene inspect 3dgs_compressed.ply"""


class Args(Config, frozen=True):
    """The file.

    Attributes:
        file: a splat file of any format, or the folder of an unbundled SOG.
        level: level of detail of a streamed SOG, 0 the finest.
    """

    file: Annotated[str, tyro.conf.Positional]
    level: int | None = None


def run(args: Args) -> int:
    """Print what the file holds."""
    from gn0.gaussians.files import describe_cloud_file

    facts = describe_cloud_file(args.file, level=args.level)
    width = max(map(len, facts)) + 2
    for name, value in facts.items():
        shown = f"{value:,}" if isinstance(value, int) and not isinstance(value, bool) else value
        print(f"{name.replace('_', ' '):<{width}}{'–' if value in ([], {}, ()) else shown}")
    return 0
