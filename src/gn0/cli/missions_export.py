"""Write the episodes of a suite in another format: GN-Matrix or VLN-CE.

A suite that was imported gives back the rows it came from, value for value, when it is exported in
their own format.
"""

from __future__ import annotations

from typing import Annotated

import tyro

from gn0.config import Config

EXAMPLES = """  gn0 missions export out/suite --format gn-matrix --out episodes.parquet
  gn0 missions export out/suite --format gn-matrix-json --out tasks
  gn0 missions export out/suite --format vlnce --out val/val.json.gz"""


class Args(Config, frozen=True):
    """The suite, the format and the place.

    Attributes:
        suite: a suite folder, or a scene folder for the fifty goal episodes sampled in it.
        format: gn-matrix (a Parquet file), gn-matrix-json (a folder), vlnce (a .json.gz file), or
            a plug-in's.
        out: what to write; must not exist.
    """

    suite: Annotated[str, tyro.conf.Positional, tyro.conf.arg(metavar="SUITE")]
    format: str
    out: str


def run(args: Args) -> int:
    """Write, and say how much."""
    from gn0.bench.imports import export_set
    from gn0.bench.suite import open_suite

    written = export_set(open_suite(args.suite), args.format, args.out)
    print(f"{len(written.tasks)} episodes of {len(written.scenes)} scenes: {args.out}")
    return 0
