"""Where the time of a drawing call goes, stage by stage."""

from __future__ import annotations

import time
from collections import defaultdict
from collections.abc import Callable
from itertools import pairwise

import numpy as np

from gn0.device.device import Event
from gn0.render.cuda.draw import STAGES, Drawer


def time_stages(drawer: Drawer, draw: Callable[[int], object], repeat: int = 7) -> dict[str, float]:
    """Median milliseconds of each stage of a call, of all of them, and of the call on the host.

    Args:
        drawer: whose stages are timed.
        draw: a call that draws with it; told which turn it is, from 0.
        repeat: turns that count; two more come before them.

    Returns:
        Milliseconds by stage (`gn0.render.cuda.draw.STAGES`), "all", and "host": wall time until
        the device is done, after the call has returned.
    """
    taken: dict[str, list[float]] = defaultdict(list)
    before = drawer.on_stage
    try:
        for turn in range(repeat + 2):
            marks: list[tuple[str, Event]] = []

            def note(stage: str, marks: list[tuple[str, Event]] = marks) -> None:
                marks.append((stage, drawer.device.event()))

            drawer.on_stage = note
            drawer.device.synchronize()
            start = time.perf_counter()
            draw(turn)
            drawer.device.synchronize()
            wall = (time.perf_counter() - start) * 1e3
            if turn < 2:
                continue
            spent = dict.fromkeys(STAGES, 0.0)
            for (stage, begin), (_, end) in pairwise(marks):
                if stage in spent:
                    spent[stage] += drawer.device.elapsed(begin, end)
            for stage, value in spent.items():
                taken[stage].append(value)
            taken["all"].append(drawer.device.elapsed(marks[0][1], marks[-1][1]) if marks else 0.0)
            taken["host"].append(wall)
    finally:
        drawer.on_stage = before
    return {stage: float(np.median(values)) for stage, values in taken.items()}
