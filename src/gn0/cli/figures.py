"""Measure the figures of merit and write the board (figures.md and figures.json).

A figure whose data or GPU is absent is skipped and says so; the board keeps its last measured rows.
One that breaks off keeps the rows that it had measured, and the next one runs. Run it on a quiet
machine: timings are only as good as the machine is idle.
"""

from __future__ import annotations

import os
import sys
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from typing import Annotated

import tyro

from gn0.config import Config
from gn0.errors import ConfigError

EXAMPLES = """  gn0 figures --list
  gn0 figures maps render.fps
  gn0 figures render --backend cuda
  gn0 figures --all --out docs"""

BOARD = ("benchmarks", "tests/trials")  # of a checkout: its code, and the judges


class Args(Config, frozen=True):
    """Which figures, and where the board is.

    Attributes:
        ids: figure ids, or their first part for a whole room.
        all: measure every figure.
        list: name the figures and measure nothing.
        out: folder of the board.
        data: folder of third-party test data; default $GN0_DATA, else ../shared/data.
        backend: only figures of this backend ("cuda"), of those chosen.
        scenes: folder of scenes made beforehand (see benchmarks/gpu_figures.md).
        merge: measure nothing; take the rows of this figures.json, measured on another machine.
    """

    ids: Annotated[
        tuple[str, ...],
        tyro.conf.Positional,
        tyro.conf.arg(metavar="[ID ...]", help_behavior_hint="(optional)"),
    ] = ()
    all: bool = False
    list: bool = False
    out: str = "docs"
    data: str = ""
    backend: str = ""
    scenes: str = ""
    merge: str = ""


def run(args: Args) -> int:
    """Measure and write; 1 when a measured target is missed or a figure broke off.

    Raises:
        ConfigError: GN0 does not run from a checkout; the board is no part of the package.
    """
    _find_board(Path(__file__).resolve().parents[3])
    return int(import_module("gn0_figures.measure").measure_board(args))


def _find_board(checkout: Path) -> None:
    """Make the board's code importable, here and in the processes that it starts."""
    folders = [str(checkout / name) for name in BOARD]
    if (checkout / "benchmarks" / "gn0_figures").is_dir():
        sys.path[:0] = [folder for folder in folders if folder not in sys.path]
        known = os.environ.get("PYTHONPATH", "").split(os.pathsep)
        new = [folder for folder in folders if folder not in known]
        os.environ["PYTHONPATH"] = os.pathsep.join([*new, *filter(None, known)])
    elif find_spec("gn0_figures") is None:
        raise ConfigError(
            "the code that measures the board is not part of the installed package",
            remedy="it lies in benchmarks/gn0_figures of GN0's repository: in a checkout, run "
            "`pip install -e '.[dev]'` and `gn0 figures` again",
        )
