"""One HTML page from one or more runs of a suite: policies side by side, failures first."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import msgspec
import tyro

from gn0.config import Config

EXAMPLES = """  gn0 bench report out/walls
  gn0 bench report out/walls out/house-oracle --out out/both.html
  gn0 bench report elsewhere/walls --suite out/suite"""


class Args(Config, frozen=True):
    """Runs and output.

    Attributes:
        runs: run folders, as written by `gn0 bench run`.
        out: the page to write; default: report.html in the first run's folder.
        suite: their suite, if it was not run from here.
        videos: how many episodes are shown as video per policy.
        bank: folder of the bank of people whom episodes name.
    """

    runs: Annotated[
        tuple[str, ...],
        tyro.conf.Positional,
        tyro.conf.arg(metavar="RUN [RUN ...]", help_behavior_hint="(required)"),
    ]
    out: str = ""
    suite: str = ""
    videos: Annotated[int, msgspec.Meta(ge=0, le=64)] = 4
    bank: str = ""


def run(args: Args) -> int:
    """Write the page and say where it is."""
    from gn0.bench.report import write_report
    from gn0.cli.console import draw_progress
    from gn0.errors import ConfigError

    if not args.runs:
        raise ConfigError("no run folder given", remedy="gn0 bench report RUN [RUN ...]")
    folders = [Path(folder) for folder in args.runs]
    out = Path(args.out) if args.out else folders[0] / "report.html"
    with draw_progress() as progress:
        page = write_report(
            folders, out, suite=args.suite or None, videos=args.videos, bank=args.bank or None,
            progress=progress,
        )  # fmt: skip
        print(page)
    return 0
