"""Times every kernel of a drawing call without people, with one unseen, and with some in sight.

`python -m gn0_figures.tune --people` prints milliseconds a kernel: what people cost, and where;
with `--sweep` also whole calls for other kernel sizes, and whether their pictures are the same.
"""

from __future__ import annotations

import hashlib
from collections import defaultdict
from collections.abc import Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

from gn0.device.device import Device, Event, Kernel
from gn0.errors import Gn0Error
from gn0.render.cuda.draw import Drawer
from gn0.render.cuda.replay import PicturesDevice
from gn0.render.cuda.tune import MANY, Tuning
from gn0_figures.board import FigureContext
from gn0_figures.device import Contender, interleave, is_emulation, median
from gn0_figures.device_table import Bench
from gn0_figures.people_batch import UNSEEN_AWAY, PeopleBatch, open_batch

SEEN = (1, 4, 8)  # people before each view
_REPEAT = 15
# sizes that lists of people, longer than those of scenes, may want otherwise
_SIZES: tuple[dict[str, int], ...] = (
    *({"capacity": 1024}, {"capacity": 1024, "buckets": 1024, "blocks": 5}, {"blocks": 6}),
    *({"stage": 128}, {"chunks": 4}, {"chunks": 2}, {"large": 4}, {"puts": 1}),
    *({"cover_blocks": 3}, {"cover_blocks": 5}, {"spread": 32768}),
)


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


def print_people(device: Device, *, sweep: bool = False) -> None:
    """A table of kernels, with nobody, one unseen, one, four and eight before each view.

    With `sweep` another of whole calls, for other sizes of the kernels.
    """
    bench = Bench(FigureContext(None, Path(), device=device))
    crowd = open_batch(bench)
    drawer = crowd.batch.drawer = TimedDrawer(device)
    calls = {"none": crowd.draw(None), "unseen": crowd.draw(crowd.send(1, UNSEEN_AWAY))}
    calls |= {str(count): crowd.draw(crowd.send(count)) for count in SEEN}
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
    if sweep:
        for line in sweep_sizes(crowd, calls, repeat):
            print(line, flush=True)


def sweep_sizes(crowd: PeopleBatch, calls: Mapping[str, Contender], repeat: int) -> Iterator[str]:
    """Milliseconds of whole calls by sizes of kernels, times over the default's, a digest.

    The default is timed anew beside each: a card's clocks wander.
    """
    device = crowd.bench.device
    drawers = {"default": Drawer(device)}

    def drawn_by(which: str, call: Contender) -> Contender:
        def draw(turn: int) -> object:
            crowd.batch.drawer = drawers[which]
            return call(turn)

        return draw

    yield f"{'sizes':36}" + "".join(f"{name:>16}" for name in calls) + "  bytes"
    for change in _SIZES[:1] if is_emulation(device) else _SIZES:
        title = " ".join(f"{name}={value}" for name, value in change.items())
        try:
            drawers[title] = Drawer(device, _change(MANY, change))
            both = {
                (name, which): drawn_by(which, call)
                for name, call in calls.items()
                for which in ("default", title)
            }
            named = {f"{name} {which}": call for (name, which), call in both.items()}
            spent = interleave(device, named, repeat, warm=2)
            cells = []
            for name in calls:
                usual, now = (median(spent[f"{name} {which}"]) for which in ("default", title))
                cells.append(f"{now:9.3f} {now / usual:6.3f}")
            digests = {which: _digest(drawn_by(which, calls["4"])) for which in ("default", title)}
            same = "same" if len(set(digests.values())) == 1 else "OTHER"
            yield f"{title:36}" + "".join(cells) + f"  {same}"
        except Gn0Error as error:
            yield f"{title:36} failed: {error}"
        drawers.pop(title, None)


def _change(tuning: Tuning, change: Mapping[str, int]) -> Tuning:
    return replace(tuning, **change)  # type: ignore[arg-type]


def _digest(draw: Contender) -> str:
    pictures = draw(0)
    assert isinstance(pictures, PicturesDevice)
    told = hashlib.sha256()
    for array in (pictures.rgb, pictures.depth):
        assert array is not None
        told.update(array.numpy().tobytes())
    return told.hexdigest()
