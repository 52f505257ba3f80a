"""Units of a measurement that is no timing, over the cores that there are."""

from __future__ import annotations

import multiprocessing
import os
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from typing import TypeVar

from gn0.jobs.process import count_cores
from gn0_figures.board import FigureContext

Unit = TypeVar("Unit")
Found = TypeVar("Found")
MOST = 12  # processes: each holds a scene


def cores_here() -> list[int]:
    """The cores that this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return sorted(os.sched_getaffinity(0))
    return list(range(os.cpu_count() or 1))


def keep_to_cores(cores: Sequence[int]) -> None:
    """Use no others from now on, where the system can be told so."""
    if hasattr(os, "sched_setaffinity"):
        os.sched_setaffinity(0, cores)


def spread(
    work: Callable[[Unit], Found], units: Sequence[Unit], ctx: FigureContext, name: str
) -> Iterator[Found]:
    """What `work` finds in each unit, in the order of the units.

    Args:
        work: a function of a module; it runs in processes of its own.
        units: what it is given, one at a time.
        ctx: gets the progress.
        name: of the units, for the bar.
    """
    spawn = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(min(count_cores(), MOST), mp_context=spawn) as pool:
        for number, found in enumerate(pool.map(work, units)):
            ctx.progress(name, number + 1, len(units))
            yield found
