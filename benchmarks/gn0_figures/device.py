"""What figures on a device share: which one, its clock, and what it can do at most.

A time is that between two CUDA events on the device's one stream, around everything that the call
does there; on the host emulation it is the wall clock and shows only that the code runs.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import NamedTuple

import numpy as np

from gn0.device.device import Device, DeviceArray, KernelSource
from gn0.device.libcuda import say_driver, say_version
from gn0.device.open import find_device
from gn0.seeds import random_stream
from gn0_figures.board import FigureSkipped

WARM = 3  # calls before the first that counts
AWAKE = 0.3  # s of work after which a card that had nothing to do has its clocks up
_CEILINGS = KernelSource("ceilings", (Path(__file__).parent / "kernels" / "ceilings.cu",))
_THREADS = 256
_CHAINS = 8  # independent operations in flight a thread; ceilings.cu agrees

Contender = Callable[[int], object]


class CopyWords(NamedTuple):
    """`copy_words`."""

    source: DeviceArray
    target: DeviceArray
    words: np.int64


class MultiplyAdd(NamedTuple):
    """`multiply_add`."""

    out: DeviceArray
    rounds: np.int32


def open_figure_device() -> Device:
    """The device that `$GN0_DEVICE` names, else the card that is here.

    Raises:
        FigureSkipped: there is none.
    """
    device, reason = find_device()
    if device is None:
        raise FigureSkipped(f"needs a GPU: {reason}")
    return device


def describe_device(device: Device) -> str:
    """Card, driver and CUDA version, for the board."""
    driver = getattr(device, "driver", None)
    if driver is None:
        return device.name
    cuda = say_version(driver.version)
    return f"{device.name}, driver {say_driver().strip() or 'unknown'}, CUDA {cuda}"


def is_emulation(device: Device) -> bool:
    """Whether sizes should be tiny: kernels run thread by thread on the CPU."""
    return device.kind == "host"


def trim_memory(device: Device) -> None:
    """Give memory that the device keeps for later back, for others on the same card."""
    trim = getattr(device, "trim", None)
    if trim is not None:
        trim()


def memory_left(device: Device) -> int:
    """Bytes that nobody holds: what the device keeps for later counts as held.

    Since it keeps all that it was ever given until it is trimmed, the difference of two calls with
    no trim between them is a peak.
    """
    spare = getattr(device, "spare", None)
    return device.memory()[0] - (spare() if spare is not None else 0)


def time_call(device: Device, call: Contender, turn: int) -> tuple[float, float]:
    """Milliseconds of a call between two events, and by the wall clock until all is done."""
    device.synchronize()
    start = time.perf_counter()
    begin = device.event()
    held = call(turn)  # its memory is not given back before the clock stops
    end = device.event()
    taken = device.elapsed(begin, end)
    wall = (time.perf_counter() - start) * 1e3
    del held
    return taken, wall


def wake(device: Device, contenders: Mapping[str, Contender]) -> None:
    """Call them by turns until the card's clocks are up; nothing on the emulation."""
    start, turn = time.perf_counter(), 0
    while not is_emulation(device) and time.perf_counter() - start < AWAKE:
        for call in contenders.values():
            call(turn)
            device.synchronize()
        turn += 1


def interleave(
    device: Device,
    contenders: Mapping[str, Contender],
    rounds: int,
    *,
    warm: int = WARM,
    walls: dict[str, list[float]] | None = None,
) -> dict[str, list[float]]:
    """Milliseconds of each contender, by turns, so that a slow moment meets all.

    Each round has an order of its own: whoever always came behind itself would find its data in the
    caches, and whoever came behind another would not.

    Args:
        device: has the clock.
        contenders: called with 0, 1, 2 ... (new poses each time), the first `warm` untimed.
        rounds: timed calls each.
        warm: untimed calls each, after the card is awake.
        walls: takes the same calls' times by the wall clock.
    """
    wake(device, contenders)
    spent: dict[str, list[float]] = {name: [] for name in contenders}
    for turn in range(warm + rounds):
        for name in turn_order(contenders, turn):
            taken, wall = time_call(device, contenders[name], turn)
            if turn >= warm:
                spent[name].append(taken)
                if walls is not None:
                    walls.setdefault(name, []).append(wall)
    return spent


def turn_order(contenders: Iterable[str], turn: int) -> list[str]:
    """The order of contenders in a round."""
    names = list(contenders)
    order = random_stream(0, "figure rounds", str(turn)).permutation(len(names))
    return [names[k] for k in order]


def median(values: list[float]) -> float:
    """Median of some times."""
    return float(np.median(values))


def measure_ceilings(device: Device) -> tuple[float, float]:
    """Bytes a second of a copy (read and written) and operations a second of all lanes.

    A lane-operation is one fused multiply-add, or another instruction of the same rate, of one
    thread.
    """
    kernels = device.load(_CEILINGS)
    small = is_emulation(device)
    words = 2**10 if small else 2**26  # of 16 bytes: 1 GiB, far beyond the second-level cache
    source, target = device.zeros((words, 4), np.float32), device.empty((words, 4), np.float32)
    blocks = device.multiprocessors * (1 if small else 8)

    def copy() -> None:
        kernels["copy_words"].launch(blocks, _THREADS, CopyWords(source, target, np.int64(words)))

    rounds = np.int32(4 if small else 2**13)

    def multiply() -> None:
        kernels["multiply_add"].launch(blocks, _THREADS, MultiplyAdd(target, rounds))

    times = interleave(device, {"copy": lambda _: copy(), "add": lambda _: multiply()}, 5, warm=1)
    moved = 2 * words * 16
    operations = float(rounds) * _CHAINS * blocks * _THREADS
    return moved / median(times["copy"]) * 1e3, operations / median(times["add"]) * 1e3
