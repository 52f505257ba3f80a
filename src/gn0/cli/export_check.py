"""Check an export for everything its reader assumes, file by file.

Reads every table, picture and video of it. With --format a folder that another program wrote is
checked too.
"""

from __future__ import annotations

from typing import Annotated

import tyro

from gn0.config import Config

EXAMPLES = """  gn0 export check out/vlnce
  gn0 export check downloads/trajectory_data --format streamvln"""


class Args(Config, frozen=True):
    """The folder.

    Attributes:
        folder: an export.
        format: its format; by default what its export.json says.
    """

    folder: Annotated[str, tyro.conf.Positional, tyro.conf.arg(metavar="EXPORT")]
    format: str = ""


def run(args: Args) -> int:
    """Say what is wrong; 1 when something is."""
    from gn0.cli.console import draw_progress
    from gn0.export.export_run import check_export, remark_export

    with draw_progress("checking the export"):
        faults = check_export(args.folder, args.format)
        remarks = remark_export(args.folder, args.format)
    for fault in faults:
        print(f"fault: {fault}")
    for remark in remarks:
        print(f"note: {remark}")
    if not faults:
        print(f"{args.folder}: no faults")
    return 1 if faults else 0
