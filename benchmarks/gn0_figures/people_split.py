"""Where a step of agents on a device goes who see people: told by events between its kernels."""

from __future__ import annotations

from itertools import pairwise
from typing import Any

import numpy as np

from gn0.device.device import DeviceArray, Event
from gn0.sim.device_env import VectorEnvDevice
from gn0_figures.board import FigureRow

# what is told before each stage of a drawing call, and what the time until the next is called
_CALLED = {
    "step": "simulator, and who is seen how", "upload": "views", "count": "entries counted",
    "emit": "listed", "scan": "lists in order", "blend": "painted",
    "settle": "who lacks heard of and posed", "end": "all else, people posed ahead",
}  # fmt: skip


def split_steps(env: VectorEnvDevice, actions: DeviceArray, turns: int) -> dict[str, float]:
    """Median milliseconds of the device in each part of a step, in order; "all" of them at last.

    Args:
        env: whose agents walk.
        actions: of each step.
        turns: steps.
    """
    device = env.simulator.device
    eyes: Any = env._eyes
    drawer = eyes._renderer.drawer
    before, marks = drawer.on_stage, list[tuple[str, Event]]()

    def note(stage: str) -> None:
        marks.append((stage, device.event()))

    spent: dict[str, list[float]] = {stage: [] for stage in _CALLED}
    try:
        drawer.on_stage = note
        for turn in range(turns):
            note("step")
            env.step(actions[turn])
        note("step")
        device.synchronize()
    finally:
        drawer.on_stage = before
    steps = [n for n, (stage, _) in enumerate(marks) if stage == "step"]
    for first, last in pairwise(steps):
        taken = dict.fromkeys(_CALLED, 0.0)
        for (stage, begin), (_, end) in pairwise(marks[first : last + 1]):
            taken[stage if stage in taken else "upload"] += device.elapsed(begin, end)
        for stage, value in taken.items():
            spent[stage].append(value)
    found = {_CALLED[stage]: float(np.median(values)) for stage, values in spent.items()}
    return {**found, "all": sum(found.values())}


def split_row(people: int, split: dict[str, float], settings: str) -> FigureRow:
    """A split as a row of the board."""
    told = "; ".join(f"{name} {value:.2f}" for name, value in split.items() if name != "all")
    return FigureRow(
        name=f"device time of a step among {people} who walk", value=split["all"], unit="ms",
        detail=f"{settings}; ms: {told}",
    )  # fmt: skip
