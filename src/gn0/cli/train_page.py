"""Write the page of a training run: curves, examinations, recipe and hashes, as one HTML file.

A stage writes it itself when it is done; this shows a run that goes on, or was stopped. The file
opens from disk, without network or scripts.
"""

from __future__ import annotations

from typing import Annotated

import tyro

from gn0.config import Config

EXAMPLES = """  gn0 train page out/sft
  gn0 train page out/sft out/dagger"""


class Args(Config, frozen=True):
    """Which runs.

    Attributes:
        run: folders of training runs.
    """

    run: Annotated[
        tuple[str, ...],
        tyro.conf.Positional,
        tyro.conf.arg(metavar="RUN [RUN ...]", help_behavior_hint="(required)"),
    ]


def run(args: Args) -> int:
    """Write page.html into each folder, and say where."""
    from gn0.errors import ConfigError
    from gn0.storage import check_contained
    from gn0.training.runs.run_folder import write_run_page

    if not args.run:
        raise ConfigError("no run folder given", remedy="gn0 train page RUN [RUN ...]")
    for folder in args.run:
        check_contained(folder)
        print(write_run_page(folder))
    return 0
