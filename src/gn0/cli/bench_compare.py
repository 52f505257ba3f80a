"""Is run A better than run B, worse, or can nobody tell? Paired bootstrap over their episodes."""

from __future__ import annotations

from typing import Annotated

import tyro

from gn0.config import Config

EXAMPLES = "  gn0 bench compare out/walls out/random"


class Args(Config, frozen=True):
    """Two runs of the same suite.

    Attributes:
        a: first run folder.
        b: second run folder.
    """

    a: Annotated[str, tyro.conf.Positional]
    b: Annotated[str, tyro.conf.Positional]


def run(args: Args) -> int:
    """Print a line a metric."""
    from gn0.bench.compare import compare_runs, name_difference

    rows = compare_runs(args.a, args.b)
    if difference := name_difference(args.a, args.b):
        print(f"note: {difference}")
    for row in rows:
        print(row)
    return 0
