"""Memory of a card, and the pinned slots through which copies to and from it go."""

from __future__ import annotations

import ctypes
import threading
from collections import deque
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass
from typing import Any, Protocol

from gn0.device.libcuda import NOT_READY, OUT_OF_MEMORY
from gn0.errors import DeviceError

GRAIN = 512  # bytes that sizes are rounded up to
_KEEP_ALL = ctypes.c_uint64(2**64 - 1)
_RELEASE_THRESHOLD, _RESERVED, _USED = 4, 5, 7  # CUmemPool_attribute


class Calls(Protocol):
    """Calls of the driver in the context of one card; `DeviceCuda` is it."""

    ordinal: int

    def call(self, name: str, *args: Any, about: str = "") -> None:
        """Call; any code but 0 is an error."""
        ...

    def attempt(self, name: str, *args: Any) -> int:
        """Call and return the code; only a lost card is an error."""
        ...

    def quietly(self, name: str, *args: Any) -> None:
        """Call and forget the code; does nothing on a lost card. For finalizers."""
        ...


class Pool(Protocol):
    """Where memory comes from and goes to, in the order of the one stream."""

    def take(self, size: int) -> int | None:
        """Address of so many bytes, or None when there are not so many."""
        ...

    def give(self, pointer: int, size: int) -> None:
        """Take memory back; called by finalizers, so it never raises and takes no lock."""
        ...

    def spare(self) -> int:
        """Bytes that are kept and not used."""
        ...

    def trim(self) -> None:
        """Give what is spare back to the card."""
        ...


class PoolDriver:
    """A memory pool of the driver's, which keeps what it was given until `trim`."""

    def __init__(self, device: Calls) -> None:
        self._device = device
        self._pool = ctypes.c_void_p()
        properties = _PoolProperties(allocation=1, place=1, ordinal=device.ordinal)
        device.call("cuMemPoolCreate", ctypes.byref(self._pool), ctypes.byref(properties))
        threshold = ctypes.byref(_KEEP_ALL)
        device.call("cuMemPoolSetAttribute", self._pool, _RELEASE_THRESHOLD, threshold)

    def take(self, size: int) -> int | None:
        """Address of so many bytes, or None when there are not so many."""
        pointer = ctypes.c_uint64()
        at = ctypes.byref(pointer)
        code = self._device.attempt("cuMemAllocFromPoolAsync", at, size, self._pool, None)
        if code not in (0, OUT_OF_MEMORY):
            self._device.call("cuMemAllocFromPoolAsync", at, size, self._pool, None)
        return pointer.value if code != OUT_OF_MEMORY else None

    def give(self, pointer: int, size: int) -> None:
        """Take memory back, when the work launched so far is done."""
        self._device.quietly("cuMemFreeAsync", pointer, None)

    def spare(self) -> int:
        """Bytes that are kept and not used."""
        reserved, used = ctypes.c_uint64(), ctypes.c_uint64()
        for attribute, value in ((_RESERVED, reserved), (_USED, used)):
            self._device.call("cuMemPoolGetAttribute", self._pool, attribute, ctypes.byref(value))
        return reserved.value - used.value

    def trim(self) -> None:
        """Give what is spare back to the card."""
        self._device.call("cuMemPoolTrimTo", self._pool, 0)


class _PoolProperties(ctypes.Structure):
    _fields_ = [
        ("allocation", ctypes.c_int),
        ("handles", ctypes.c_int),
        ("place", ctypes.c_int),
        ("ordinal", ctypes.c_int),
        ("security", ctypes.c_void_p),
        ("most", ctypes.c_size_t),
        ("usage", ctypes.c_ushort),
        ("reserved", ctypes.c_ubyte * 54),
    ]


class PoolList:
    """Freed blocks by size, for cards whose driver has no pools (some virtual ones)."""

    def __init__(self, device: Calls) -> None:
        self._device = device
        self._free: dict[int, list[int]] = {}

    def take(self, size: int) -> int | None:
        """Address of so many bytes, or None when there are not so many."""
        room = _step(size)
        with suppress(KeyError, IndexError):  # another thread may take the last one
            return self._free[room].pop()
        pointer = ctypes.c_uint64()
        code = self._device.attempt("cuMemAlloc_v2", ctypes.byref(pointer), room)
        if code not in (0, OUT_OF_MEMORY):
            self._device.call("cuMemAlloc_v2", ctypes.byref(pointer), room)
        return pointer.value if code != OUT_OF_MEMORY else None

    def give(self, pointer: int, size: int) -> None:
        """Keep a block for the next of its size; later work on the stream may use it."""
        self._free.setdefault(_step(size), []).append(pointer)

    def spare(self) -> int:
        """Bytes that are kept and not used."""
        return sum(room * len(blocks) for room, blocks in list(self._free.items()))

    def trim(self) -> None:
        """Give what is spare back to the card."""
        for blocks in list(self._free.values()):
            with suppress(IndexError):
                while True:
                    self._device.call("cuMemFree_v2", blocks.pop())


def _step(size: int) -> int:
    """A size rounded up by at most an eighth, so that blocks are found again."""
    grain = max(GRAIN, 1 << max((size - 1).bit_length() - 3, 0))
    return -(-size // grain) * grain


@dataclass(frozen=True)
class _Slot:
    address: int
    event: int


class Staging:
    """Pinned slots: a copy from pageable memory would make the driver wait for the stream.

    Slots are taken in turn; more are made while all are in use, up to a number, and beyond it
    only while other threads hold them all.
    """

    SIZE, MOST, AHEAD = 1 << 20, 64, 8

    def __init__(self, device: Calls) -> None:
        self._device = device
        self._slots: deque[_Slot] = deque()
        self._made = 0
        self._lock = threading.Lock()

    def upload(self, address: int, pointer: int, size: int, stream: int | None) -> None:
        """Copy to the card; returns when the host's bytes were read."""
        for at, count in _pieces(size, self.SIZE):
            slot = self._take()
            ctypes.memmove(slot.address, address + at, count)
            self._device.call("cuMemcpyHtoDAsync_v2", pointer + at, slot.address, count, stream)
            self._device.call("cuEventRecord", slot.event, stream)
            self._slots.append(slot)

    def download(self, pointer: int, address: int, size: int, stream: int | None) -> None:
        """Copy from the card; returns when the host's bytes are written."""
        ahead: deque[tuple[_Slot, int, int]] = deque()
        for at, count in _pieces(size, self.SIZE):
            if len(ahead) == self.AHEAD:
                self._land(*ahead.popleft(), address)
            slot = self._take()
            self._device.call("cuMemcpyDtoHAsync_v2", slot.address, pointer + at, count, stream)
            self._device.call("cuEventRecord", slot.event, stream)
            ahead.append((slot, at, count))
        while ahead:
            self._land(*ahead.popleft(), address)

    def _land(self, slot: _Slot, at: int, count: int, address: int) -> None:
        self._device.call("cuEventSynchronize", slot.event)
        ctypes.memmove(address + at, slot.address, count)
        self._slots.appendleft(slot)

    def _take(self) -> _Slot:
        """A slot whose last copy is done."""
        with self._lock:
            if self._slots:
                code = self._device.attempt("cuEventQuery", self._slots[0].event)
                if code == 0:
                    return self._slots.popleft()
                if code != NOT_READY:
                    self._device.call("cuEventQuery", self._slots[0].event)
            if self._made < self.MOST or not self._slots:
                try:
                    return self._make()
                except DeviceError:
                    if not self._slots:
                        raise
            slot = self._slots.popleft()
        self._device.call("cuEventSynchronize", slot.event)
        return slot

    def _make(self) -> _Slot:
        address, event = ctypes.c_void_p(), ctypes.c_void_p()
        self._device.call(
            "cuMemHostAlloc", ctypes.byref(address), self.SIZE, 1, about="pinned host memory"
        )
        self._device.call("cuEventCreate", ctypes.byref(event), 2)  # no timing
        self._made += 1
        return _Slot(address.value or 0, event.value or 0)


def _pieces(size: int, most: int) -> Iterator[tuple[int, int]]:
    for at in range(0, size, most):
        yield at, min(most, size - at)
