"""Compare two runs of a suite: is A better than B, worse, or too close to tell?

Runs of suites that `gn0 missions generate` wrote can be paired by path as well: missions of one
path have the same start, goal and route, so goal and instruction missions can be compared with each
other, in two runs or in one.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated, Literal

import tyro

from gn0.config import Config

if TYPE_CHECKING:
    from gn0.bench.compare import Comparison

EXAMPLES = """  gn0 bench compare out/oracle out/random
  gn0 bench compare out/walls out/random --unit episode
  gn0 bench compare out/run --paired-by path --mission-a goal --mission-b instruction"""


class Args(Config, frozen=True):
    """Two runs of the same suite, or of the same paths.

    Attributes:
        a: first run folder.
        b: second run folder; the first once more, when two of its missions are compared.
        unit: what is resampled: scenes, episodes, or scenes where there are at least six.
        paired_by: the same episode, or the same path.
        mission_a: with --paired-by path, only these episodes of A: goal, instruction,
            instruction/detailed or instruction/benchmark.
        mission_b: the same of B.
    """

    a: Annotated[str, tyro.conf.Positional, tyro.conf.arg(metavar="RUN")]
    b: Annotated[
        str, tyro.conf.Positional, tyro.conf.arg(metavar="[RUN]", help_behavior_hint="(optional)")
    ] = ""
    unit: Literal["auto", "scene", "episode"] = "auto"
    paired_by: Literal["episode", "path"] = "episode"
    mission_a: str = ""
    mission_b: str = ""


def run(args: Args) -> int:
    """Print a line a metric."""
    from gn0.bench.compare import compare_paths, compare_runs, name_difference, name_pairing
    from gn0.bench.pairing import tell_paths
    from gn0.bench.results import load_summary
    from gn0.errors import ConfigError

    b = args.b or args.a
    missions = (args.mission_a, args.mission_b)
    if args.paired_by == "path":
        rows = compare_paths(
            args.a, b, mission_a=args.mission_a, mission_b=args.mission_b, unit=args.unit
        )
        notes = [name_difference(args.a, b), *tell_paths(args.a, b, *missions)]
        pairs = "paths"
    else:
        if any(missions) or not args.b:
            raise ConfigError(
                "one run, or missions, without --paired-by path",
                remedy="give two runs, or add --paired-by path",
            )
        rows = compare_runs(args.a, b, unit=args.unit)
        notes = [name_difference(args.a, b), name_pairing(args.a, b)]
        pairs = "episodes"
    for side, mission, folder in (("A", args.mission_a, args.a), ("B", args.mission_b, b)):
        label = load_summary(folder).label
        print(f"{side}: {label} ({folder})" + (f", {mission} missions" if mission else ""))
    for note in notes:
        if note:
            print(f"note: {note}")
    for following in (False, True):
        some = [row for row in rows if row.following is following]
        if some:
            _print_rows(some, f"{pairs} of following" if following else pairs)
    return 0


def _print_rows(rows: list[Comparison], pairs: str) -> None:
    about = "scenes like these" if rows[0].unit == "scene" else f"these scenes, other {pairs}"
    count = f"{rows[0].episodes} pair{'' if rows[0].episodes == 1 else 's'}"
    print(f"{count} of {pairs}; n : m counts the pairs that A and B lead;")
    print(f"intervals of 95 %; a verdict holds for {about}")
    for row in rows:
        few = row.episodes < rows[0].episodes
        print(f"{row}" + (f" (of {row.episodes} pairs that have it)" if few else ""))
