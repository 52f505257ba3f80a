"""Measure the figures of merit and write the board (figures.md and figures.json).

A figure whose data is absent is skipped and says so; the board keeps its last measured rows.
Run it on a quiet machine: timings are only as good as the machine is idle.
"""

from __future__ import annotations

import datetime
import os
import tempfile
from pathlib import Path
from typing import Annotated

import tyro

from gn0.config import Config

EXAMPLES = """  gn0 figures --list
  gn0 figures maps render.fps
  gn0 figures --all --out docs"""


class Args(Config, frozen=True):
    """Which figures, and where the board is.

    Attributes:
        ids: figure ids, or their first part for a whole room.
        all: measure every figure.
        list: name the figures and measure nothing.
        out: folder of the board.
        data: folder of third-party test data; default $GN0_DATA, else ../shared/data.
    """

    ids: Annotated[tuple[str, ...], tyro.conf.Positional] = ()
    all: bool = False
    list: bool = False
    out: str = "docs"
    data: str = ""


def run(args: Args) -> int:
    """Measure and write; 1 when a measured target is missed."""
    from gn0 import __version__
    from gn0.cli.console import draw_progress
    from gn0.figures.board import (
        BoardEntry,
        FigureContext,
        hardware_name,
        load_board,
        write_board,
    )
    from gn0.figures.catalogue import all_figures, find_figures

    if args.list or not (args.all or args.ids):
        for figure in all_figures().values():
            print(f"{figure.id:<28}{figure.title}  (about {figure.minutes:g} min)")
        return 0
    figures = list(all_figures().values()) if args.all else find_figures(list(args.ids))
    board_file = Path(args.out) / "figures.json"
    data = Path(args.data or os.environ.get("GN0_DATA", "../shared/data"))
    missed = 0
    with tempfile.TemporaryDirectory(prefix="gn0-figures-") as work, draw_progress() as progress:
        for figure in figures:
            scratch = Path(work) / figure.id
            scratch.mkdir()
            context = FigureContext(
                data=data.resolve() if data.is_dir() else None, work=scratch, progress=progress
            )
            try:
                rows = figure.measure(context)
            except FileNotFoundError as error:
                print(f"{figure.id}: skipped, needs {error} under --data or $GN0_DATA")
                continue
            entry = BoardEntry(
                id=figure.id,
                title=figure.title,
                rows=rows,
                hardware=hardware_name(),
                date=datetime.date.today().isoformat(),
                version=__version__,
            )
            known = all_figures()  # what is no longer measured leaves the board
            board = {k: v for k, v in load_board(board_file).items() if k in known}
            board[figure.id] = entry
            write_board(Path(args.out), board.values())
            for row in rows:
                mark = {True: "met", False: "MISSED", None: ""}[row.passed]
                print(f"{figure.id}: {row.name}: {row.value:.4g} {row.unit} {row.target} {mark}")
                missed += row.passed is False
    print(f"board: {Path(args.out) / 'figures.md'}; {missed} targets missed")
    return 1 if missed else 0
