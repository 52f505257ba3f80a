"""Times every kernel of a drawing call without people, with one unseen, and with some in sight.

`python -m gn0_figures.tune --people` prints milliseconds a kernel: what people cost, and where.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from gn0.device.device import Device, Event, Kernel
from gn0.render.cuda.draw import Drawer
from gn0_figures.board import FigureContext
from gn0_figures.device import Contender, is_emulation, median
from gn0_figures.device_table import Bench
from gn0_figures.people_batch import UNSEEN_AWAY, open_batch

_REPEAT = 15


class _TimedKernel:
    def __init__(self, kernel: Kernel, name: str, drawer: TimedDrawer) -> None:
        self.name = name
        self._kernel, self._drawer = kernel, drawer

    def launch(
        self,
        grid: int | tuple[int, ...],
        block: int | tuple[int, ...],
        record: Any,
        *,
        shared: int = 0,
    ) -> None:
        """Between two events."""
        begin = self._drawer.device.event()
        self._kernel.launch(grid, block, record, shared=shared)
        self._drawer.marks.append((self.name, begin, self._drawer.device.event()))


class TimedDrawer(Drawer):
    """A drawer that notes when each kernel begins and ends on the device.

    Attributes:
        marks: name of a kernel, and the events around it, in the order of the launches.
    """

    def __init__(self, device: Device) -> None:
        super().__init__(device)
        self.marks: list[tuple[str, Event, Event]] = []

    def _load(self, parts: bool) -> Mapping[str, Kernel]:
        kernels = super()._load(parts)
        return {name: _TimedKernel(kernel, name, self) for name, kernel in kernels.items()}


def time_kernels(drawer: TimedDrawer, draw: Contender, repeat: int) -> dict[str, float]:
    """Median milliseconds of each kernel of a call, and of the call ("all"), in order.

    "all" is from the first event before a kernel to the last behind one: between kernels the
    device may wait for the host.
    """
    taken: dict[str, list[float]] = defaultdict(list)
    for turn in range(repeat + 2):
        drawer.device.synchronize()
        drawer.marks.clear()
        held = draw(turn)
        drawer.device.synchronize()
        del held
        if turn < 2:
            continue
        spent: dict[str, float] = defaultdict(float)
        for name, begin, end in drawer.marks:
            spent[name] += drawer.device.elapsed(begin, end)
        spent["all"] = drawer.device.elapsed(drawer.marks[0][1], drawer.marks[-1][2])
        for name, value in spent.items():
            taken[name].append(value)
    return {name: median(values) for name, values in taken.items()}


def print_people(device: Device) -> None:
    """A table of kernels, with nobody, one unseen, one and eight before each view."""
    bench = Bench(FigureContext(None, Path(), device=device))
    crowd = open_batch(bench)
    drawer = crowd.batch.drawer = TimedDrawer(device)
    calls = {"none": crowd.draw(None), "unseen": crowd.draw(crowd.send(1, UNSEEN_AWAY))}
    calls |= {str(count): crowd.draw(crowd.send(count)) for count in (1, 8)}
    repeat = 1 if is_emulation(device) else _REPEAT
    found, entries = {}, {}
    for name, call in calls.items():
        found[name] = time_kernels(drawer, call, repeat)
        entries[name] = drawer.entries / len(crowd.looks)
    views = f"{crowd.name}, visible sets, {len(crowd.looks)} views of {crowd.camera.width} px"
    print(f"{views}; milliseconds, medians of {repeat}")
    print(f"{'people a view':16}" + "".join(f"{name:>10}" for name in calls))
    kernels = list(dict.fromkeys(kernel for times in found.values() for kernel in times))
    for kernel in sorted(kernels, key="all".__eq__):
        values = "".join(f"{found[name].get(kernel, 0.0):10.3f}" for name in calls)
        print(f"{kernel:16}{values}")
    print(
        f"{'entries a view':16}" + "".join(f"{entries[name]:10.0f}" for name in calls), flush=True
    )
