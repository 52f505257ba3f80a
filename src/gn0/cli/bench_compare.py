"""Is run A better than run B, worse, or can nobody tell? Paired bootstrap over their episodes."""

from __future__ import annotations

from typing import Annotated, Literal

import tyro

from gn0.config import Config

EXAMPLES = """  gn0 bench compare out/walls out/random
  gn0 bench compare out/walls out/random --unit episode"""


class Args(Config, frozen=True):
    """Two runs of the same suite.

    Attributes:
        a: first run folder.
        b: second run folder.
        unit: what is resampled: scenes, episodes, or scenes where there are at least six.
    """

    a: Annotated[str, tyro.conf.Positional]
    b: Annotated[str, tyro.conf.Positional]
    unit: Literal["auto", "scene", "episode"] = "auto"


def run(args: Args) -> int:
    """Print a line a metric."""
    from gn0.bench.compare import compare_runs, name_difference, name_pairing

    rows = compare_runs(args.a, args.b, unit=args.unit)
    for note in (name_difference(args.a, args.b), name_pairing(args.a, args.b)):
        if note:
            print(f"note: {note}")
    about = "scenes like these" if rows[0].unit == "scene" else "these scenes, other episodes"
    print(f"{rows[0].episodes} pairs of episodes; n : m counts the pairs that A and B lead;")
    print(f"intervals of 95 %; a verdict holds for {about}")
    for row in rows:
        print(row)
    return 0
