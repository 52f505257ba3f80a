"""A trial of a card: whether it does what we rely on; for `gn0 doctor`."""

from __future__ import annotations

import threading
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from gn0.device.device import DeviceArray, KernelSource
from gn0.device.driver import DeviceCuda
from gn0.device.launch import KernelCuda
from gn0.errors import DeviceError

SOURCE = KernelSource("trial", (Path(__file__).parent / "kernels" / "trial.cu",))
TURNS = 50_000  # of a kernel that other work must wait for: some tenth of a millisecond
_SIZE = 1 << 14
_ODD = np.dtype(
    [("by", "f4"), ("first", "i4"), ("mask", "u8"), ("far", "f8"), ("last", "u1")], align=True
)
Kernels = Mapping[str, KernelCuda]


class TryParameters(NamedTuple):
    """`try_parameters`: one of each type."""

    x: DeviceArray
    y: DeviceArray
    small: np.uint8
    odd: np.void
    middle: np.uint16
    wide: np.int64
    yes: np.bool_
    n: np.uint32


class TryShared(NamedTuple):
    """`try_shared`."""

    values: DeviceArray
    n: np.uint32


class TryGrid(NamedTuple):
    """`try_grid`."""

    counts: DeviceArray


class TrySteps(NamedTuple):
    """`try_steps`."""

    values: DeviceArray
    turns: np.uint32


def try_card(device: DeviceCuda, turns: int = TURNS) -> list[str]:
    """What went wrong, in words, one line for each part of the trial; [] when all is well.

    Args:
        device: the card.
        turns: how long the kernels work that copies and later work must wait for.
    """
    wrong = []
    try:
        kernels = device.load(SOURCE)
    except DeviceError as error:
        return [f"kernels: {error}"]
    for name, part in _PARTS.items():
        try:
            part(device, kernels, turns)
        except DeviceError as error:
            wrong.append(f"{name}: {error}")
        if device.lost is not None:
            break
    return wrong


def _compare(what: str, found: NDArray[Any], wanted: NDArray[Any]) -> None:
    """Raises a `DeviceError` that says where the first difference is."""
    differs = np.flatnonzero(found != wanted)
    if differs.size:
        at = differs[0]
        raise DeviceError(
            f"{what}: {differs.size} of {found.size} values differ, the first at {at}: "
            f"{found.flat[at]} for {wanted.flat[at]}"
        )


def _steps(values: NDArray[np.uint32], turns: int) -> NDArray[np.uint32]:
    """What `try_steps` makes of values."""
    factor, add = 1, 0
    for _ in range(turns):
        factor, add = factor * 1664525 % 2**32, (add * 1664525 + 1013904223) % 2**32
    return values * np.uint32(factor) + np.uint32(add)


def _numbers(begin: int = 0) -> NDArray[np.uint32]:
    return np.arange(begin, begin + _SIZE, dtype=np.uint32)


def _try_copies(device: DeviceCuda, kernels: Kernels, turns: int) -> None:
    values = np.arange(700_003, dtype=np.uint32)  # several pinned slots
    there = device.upload(values)
    _compare("from pageable memory", there.numpy(), values)
    pinned = device.pinned(values.shape, values.dtype)
    pinned[:] = values[::-1]
    _compare("from pinned memory", device.upload(pinned, there).numpy(), pinned)
    device.fill(there, 7)
    _compare("fill", there.numpy(pinned), np.full_like(values, 0x07070707))


def _try_parameters(device: DeviceCuda, kernels: Kernels, turns: int) -> None:
    odd = np.zeros(1, _ODD)
    odd[0] = (0.5, -7, 9 << 40, 1e9, 3)
    x = np.arange(1000, dtype=np.float32)
    y = device.zeros(1000, np.float64)
    given = TryParameters(
        x=device.upload(x),
        y=y,
        small=np.uint8(200),
        odd=odd[0],
        middle=np.uint16(60_000),
        wide=np.int64(-(2**40)),
        yes=np.bool_(True),
        n=np.uint32(1000),
    )
    kernels["try_parameters"].launch(4, 256, given)
    _compare("sum", y.numpy(), 0.5 * x.astype(np.float64) + (1e9 + 9 + 3 + 60_200 - 2**40 - 7))


def _try_shared(device: DeviceCuda, kernels: Kernels, turns: int) -> None:
    for size in (47 * 1024, 48 * 1024, min(100 * 1024, device.shared_max - 1024)):
        values = np.arange(size // 4, dtype=np.uint32)
        there = device.upload(values)
        kernels["try_shared"].launch(1, 512, TryShared(there, np.uint32(len(values))), shared=size)
        _compare(f"{size} bytes", there.numpy(), values[::-1] + values[-1])


def _try_grid(device: DeviceCuda, kernels: Kernels, turns: int) -> None:
    counts = device.zeros((4, 3, 5), np.uint32)
    kernels["try_grid"].launch((5, 3, 4), (8, 2, 4), TryGrid(counts))
    _compare("blocks", counts.numpy(), np.full((4, 3, 5), 4, np.uint32))


def _try_order(device: DeviceCuda, kernels: Kernels, turns: int) -> None:
    """Memory is used again, and copied beside later work, when the work before is done."""
    wanted = _steps(_numbers(), turns)
    for beside in (False, True):
        there = device.upload(_numbers())
        begin = device.event()
        kernels["try_steps"].launch(_SIZE // 256, 256, TrySteps(there, np.uint32(turns)))
        end = device.event()
        copy = device.download_async(there, beside=beside)
        del there
        later = device.zeros(_SIZE, np.uint32)
        kernels["try_steps"].launch(_SIZE // 256, 256, TrySteps(later, np.uint32(1)))
        _compare("a copy beside work" if beside else "a copy", copy.numpy(), wanted)
        _compare("memory that was used before", later.numpy(), _steps(0 * _numbers(), 1))
        if device.elapsed(begin, end) <= 0:
            raise DeviceError("a kernel took no time")


def _try_recording(device: DeviceCuda, kernels: Kernels, turns: int) -> None:
    given = device.pinned(_SIZE, np.uint32)
    result = device.pinned(_SIZE, np.uint32)
    kernels["try_steps"].launch(1, 1, TrySteps(device.zeros(1, np.uint32), np.uint32(1)))
    with device.capture() as graph:
        inner = device.upload(given)
        scratch = device.zeros(_SIZE, np.uint32)
        kernels["try_steps"].launch(_SIZE // 256, 256, TrySteps(inner, np.uint32(turns)))
        device.download_async(inner, result)
    del inner, scratch
    filler = [device.zeros(_SIZE, np.uint32) for _ in range(4)]
    for begin in (1, 2):
        given[:] = _numbers(begin)
        graph.launch()
        device.synchronize()
        _compare(f"run {begin}", result, _steps(_numbers(begin), turns))
    for other in filler:
        _compare("memory of others", other.numpy(), 0 * _numbers())


def _try_threads(device: DeviceCuda, kernels: Kernels, turns: int) -> None:
    """A thread in which no card is current yet, as every new one."""
    wrong: list[DeviceError] = []

    def work(begin: int) -> None:
        try:
            there = device.upload(_numbers(begin))
            kernels["try_steps"].launch(_SIZE // 256, 256, TrySteps(there, np.uint32(3)))
            _compare("a thread's own", there.numpy(), _steps(_numbers(begin), 3))
        except DeviceError as error:
            wrong.append(error)

    threads = [threading.Thread(target=work, args=(k,)) for k in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    if wrong:
        raise wrong[0]


_PARTS = {
    "copies": _try_copies,
    "parameters": _try_parameters,
    "shared memory": _try_shared,
    "grids": _try_grid,
    "order": _try_order,
    "recordings": _try_recording,
    "threads": _try_threads,
}
