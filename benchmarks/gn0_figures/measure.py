"""The verb `gn0 figures`: measure what was asked for, say it line by line, write the board."""

from __future__ import annotations

import datetime
import faulthandler
import os
import signal
import sys
import tempfile
import traceback
from dataclasses import replace
from pathlib import Path
from typing import Any

from gn0 import __version__
from gn0.cli.compile_ahead import compile_all, is_compiled
from gn0.cli.console import draw_progress
from gn0.cli.figures import Args
from gn0.errors import ConfigError
from gn0_figures import catalogue
from gn0_figures.board import (
    BoardEntry,
    Figure,
    FigureContext,
    FigureRow,
    FigureSkipped,
    hardware_name,
    load_board,
    write_board,
)
from gn0_figures.device import describe_device, open_figure_device

EMULATION = "host emulation"


def measure_board(args: Args) -> int:
    """Measure and write; 1 when a measured target is missed or a figure broke off."""
    if args.merge:
        return _merge(args)
    chosen = bool(args.all or args.ids)
    known = catalogue.all_figures().values()
    figures = catalogue.find_figures([*args.ids]) if args.ids and not args.all else [*known]
    if args.backend:
        figures = [figure for figure in figures if figure.backend == args.backend]
        if not figures:
            raise ConfigError(
                f"no figure of those chosen has backend {args.backend!r}", remedy="give cuda"
            )
    if args.list or not (chosen or args.backend):
        for figure in figures:
            print(f"{figure.id:<28}{figure.title}  (about {figure.minutes:g} min)")
        for room, package in catalogue.left_out().items():
            print(f"{room:<28}left out: needs the package {package}")
        return 0
    data = Path(args.data or os.environ.get("GN0_DATA", "../shared/data"))
    scenes = Path(args.scenes) if args.scenes else None
    if scenes is not None and not scenes.is_dir():
        raise ConfigError("no such folder", where=f"--scenes {scenes}")
    if hasattr(signal, "SIGUSR1") and sys.__stderr__ is not None:
        faulthandler.register(signal.SIGUSR1, file=sys.__stderr__)  # says where a figure hangs
    failed = 0
    with tempfile.TemporaryDirectory(prefix="gn0-figures-") as work, draw_progress() as progress:
        for figure in figures:
            scratch = Path(work) / figure.id
            scratch.mkdir()
            context = FigureContext(
                data=data.resolve() if data.is_dir() else None,
                work=scratch,
                progress=progress,
                scenes=scenes,
            )
            failed += _Run(figure, Path(args.out)).measure(context)
    print(f"board: {Path(args.out) / 'figures.md'}; {failed} targets missed or figures broken off")
    return 1 if failed else 0


def _merge(args: Args) -> int:
    """Put the measured rows of another board on ours."""
    other = load_board(Path(args.merge))
    if not other:
        raise ConfigError("no board there", where=args.merge, remedy="give a figures.json")
    board = load_board(Path(args.out) / "figures.json")
    for name, entry in other.items():
        wanted = not args.ids or any(name == i or name.startswith(i + ".") for i in args.ids)
        if wanted and entry.hardware.startswith(EMULATION):
            print(f"{name}: left where it is: times of the host emulation mean nothing")
        elif wanted and entry.rows:
            board[name] = entry
            print(f"{name}: {len(entry.rows)} rows of {entry.date}, {entry.hardware}")
    write_board(Path(args.out), board.values())
    return 0


class _Run:
    """One figure's way to the board."""

    def __init__(self, figure: Figure, out: Path) -> None:
        self.figure, self.out = figure, out
        self.rows: list[FigureRow] = []
        self.hardware = ""

    def measure(self, context: FigureContext) -> int:
        """Run it; returns how many targets it missed, counting a failure as one."""
        figure = self.figure
        self.hardware = hardware_name()
        note = ""
        try:
            if figure.backend == "cuda":
                device = open_figure_device()
                if device.kind == "cuda" and not is_compiled("device"):
                    compile_all(
                        "device", progress=context.progress
                    )  # beside it they would be timed
                self.hardware = f"{describe_device(device)} · {self.hardware}"
                context = replace(context, device=device)
            rows = figure.measure(replace(context, report=self._report))
            for row in rows[len(self.rows) :]:
                self._print(row)
            self.rows = rows
        except FileNotFoundError as error:
            print(f"{figure.id}: skipped, needs {error} under --data or $GN0_DATA")
            return 0
        except FigureSkipped as reason:
            print(f"{figure.id}: skipped, {reason}")
            self._skip(str(reason))
            return 0
        except Exception as error:  # the next figure runs, and what was measured is kept
            traceback.print_exc()
            note = f"broke off: {type(error).__name__}: {error}"
            print(f"{figure.id}: {note}")
            if not self.rows:
                self._skip(note)
                return 1
        self._write(self.rows, note)
        return sum(row.passed is False for row in self.rows) + bool(note)

    def _report(self, row: FigureRow) -> None:
        self.rows.append(row)
        self._print(row)
        self._write(self.rows, "broke off before its end")

    def _print(self, row: FigureRow) -> None:
        mark = {True: "met", False: "MISSED", None: ""}[row.passed]
        text = f"{row.name}: {row.value:.4g} {row.unit} {row.target} {mark}"
        print(f"{self.figure.id}: {text}", flush=True)

    def _board(self) -> dict[str, BoardEntry]:
        board = load_board(self.out / "figures.json")
        if catalogue.left_out():
            return board
        known = catalogue.all_figures()  # what is no longer measured leaves the board
        return {k: v for k, v in board.items() if k in known}

    def _write(self, rows: list[Any], note: str) -> None:
        board = self._board()
        board[self.figure.id] = BoardEntry(
            id=self.figure.id,
            title=self.figure.title,
            rows=rows,
            hardware=self.hardware,
            date=datetime.date.today().isoformat(),
            version=__version__,
            note=note,
        )
        write_board(self.out, board.values())

    def _skip(self, reason: str) -> None:
        """What was never measured stands on the board with the reason."""
        if not self._board().get(self.figure.id):
            self._write([], reason)
