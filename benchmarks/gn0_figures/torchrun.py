"""Measurements on several cards: how many there are, and commands of a process for each."""

from __future__ import annotations

import os
import subprocess
import sys
import time
from collections.abc import Iterable, Iterator
from typing import TypeVar

import torch

from gn0_figures.board import FigureContext, FigureSkipped
from gn0_figures.device import is_emulation

T = TypeVar("T")
COUNTS = (2, 4, 8)  # of cards that are tried
PATIENCE = 420.0  # s of a run at most


def count_cards(ctx: FigureContext) -> int:
    """Cards that torch sees; two on the emulation.

    Raises:
        FigureSkipped: fewer than two.
    """
    cards = 2 if is_emulation(ctx.device) else torch.cuda.device_count()
    if cards < 2:
        raise FigureSkipped(f"needs two cards or more: torch sees {cards}")
    return cards


def begin_within(seconds: float, trials: Iterable[T]) -> Iterator[T]:
    """The trials, the first one in any case, none once so many seconds are over."""
    began = time.perf_counter()
    for number, trial in enumerate(trials):
        if number and time.perf_counter() - began > seconds:
            return
        yield trial


def write_words(cards: int, *words: str) -> list[str]:
    """A module and its words as a user types them behind `python`: by torchrun for several cards.

    Behind `--` torchrun takes no flag for its own.
    """
    if cards == 1:
        return ["-m", *words]
    start = ["-m", "torch.distributed.run", "--standalone", f"--nproc-per-node={cards}"]
    return [*start, "-m", "--", *words]


def run_python(words: list[str]) -> str:
    """Run Python with these words; gives what it said.

    Raises:
        RuntimeError: it failed, or took longer than `PATIENCE`; with what it said last.
    """
    env = os.environ | {"OMP_NUM_THREADS": "1"}  # as torchrun sets it, also for one
    with subprocess.Popen(
        [sys.executable, *words], env=env, text=True,
        stdout=subprocess.PIPE, stderr=subprocess.STDOUT,
    ) as process:  # fmt: skip
        try:
            said, _ = process.communicate(timeout=PATIENCE)
        except BaseException:
            process.terminate()  # torchrun ends its processes then; killed, it would leave them
            raise
    if process.returncode:
        raise RuntimeError(f"{' '.join(words)}: {said[-2000:]}")
    return said
