"""Memory for maps and fields on a device: blocks of any size, cut from a few large slabs."""

from __future__ import annotations

from bisect import insort
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gn0.device.device import Device, DeviceArray
from gn0.errors import DeviceMemoryError

ALIGNMENT = 256  # bytes
SLAB = 2**26  # bytes


@dataclass(frozen=True, eq=False)
class Block:
    """A piece of a slab.

    Attributes:
        memory: uint8 [size], the piece itself.
        slab: number of the slab.
        offset: where the piece begins in it.
    """

    memory: DeviceArray
    slab: int
    offset: int

    @property
    def pointer(self) -> int:
        """Its address on the device."""
        return self.memory.pointer


class PoolDevice:
    """Blocks of device memory up to a limit; the first gap that is large enough is taken.

    A block that was given back may be cut again at once: all work on a device runs in order, so
    who read it is done before the new bytes arrive.

    Args:
        device: where the memory is.
        limit: bytes of all slabs together; `take` goes beyond it only when told to.
        slab: bytes of a slab; larger blocks have one of their own.
    """

    def __init__(self, device: Device, limit: int, slab: int = SLAB) -> None:
        self._device = device
        self.limit = limit
        self._slab = max(min(slab, limit), ALIGNMENT)
        self._slabs: dict[int, DeviceArray] = {}
        self._gaps: dict[int, list[tuple[int, int]]] = {}  # (offset, size), sorted
        self._count = 0
        self.used = 0

    @property
    def held(self) -> int:
        """Bytes of all slabs."""
        return sum(slab.nbytes for slab in self._slabs.values())

    def take(self, size: int, *, beyond: bool = False) -> Block | None:
        """A block of so many bytes; None when that would take slabs beyond the limit.

        Args:
            size: bytes.
            beyond: take them all the same.

        Raises:
            DeviceMemoryError: the device itself has no more.
        """
        room = max(-(-size // ALIGNMENT), 1) * ALIGNMENT
        place = self._find(room)
        if place is None:
            fresh = max(room, self._slab)
            if self.held + fresh > self.limit:
                if not beyond and self.held + room > self.limit:
                    return None
                fresh = room
            try:
                slab_memory = self._device.empty(fresh, np.uint8)
            except DeviceMemoryError:
                if fresh == room:
                    raise
                fresh = room  # the device is nearly full: no room for others
                slab_memory = self._device.empty(fresh, np.uint8)
            self._slabs[self._count] = slab_memory
            self._gaps[self._count] = [(0, fresh)]
            self._count += 1
            place = self._find(room)
            assert place is not None
        slab, index = place
        offset, length = self._gaps[slab].pop(index)
        if length > room:
            insort(self._gaps[slab], (offset + room, length - room))
        self.used += room
        return Block(self._slabs[slab][offset : offset + size], slab, offset)

    def _find(self, room: int) -> tuple[int, int] | None:
        for slab, gaps in self._gaps.items():
            for index, (_, length) in enumerate(gaps):
                if length >= room:
                    return slab, index
        return None

    def give(self, block: Block) -> None:
        """Give a block back; a slab that is empty then goes too, if there is more than one."""
        room = max(-(-block.memory.nbytes // ALIGNMENT), 1) * ALIGNMENT
        gaps = self._gaps[block.slab]
        begin, end = block.offset, block.offset + room
        for gap in [g for g in gaps if g[0] + g[1] == begin or g[0] == end]:
            gaps.remove(gap)
            begin, end = min(begin, gap[0]), max(end, gap[0] + gap[1])
        insort(gaps, (begin, end - begin))
        self.used -= room
        whole = self._slabs[block.slab].nbytes
        if gaps == [(0, whole)] and (self.held > self.limit or whole < self._slab):
            del self._slabs[block.slab], self._gaps[block.slab]

    def store(self, block: Block, *arrays: NDArray[Any]) -> list[int]:
        """Copy arrays into a block, one behind another at steps of 16 bytes; their addresses."""
        staged = np.zeros(block.memory.nbytes, np.uint8)
        pointers, at = [], 0
        for array in arrays:
            raw = np.ascontiguousarray(array).view(np.uint8).ravel()
            staged[at : at + len(raw)] = raw
            pointers.append(block.pointer + at)
            at += -(-len(raw) // 16) * 16
        self._device.upload(staged, block.memory)
        return pointers


def store_size(*arrays: NDArray[Any]) -> int:
    """Bytes of a block that `PoolDevice.store` can copy these arrays into."""
    return sum(-(-array.nbytes // 16) * 16 for array in arrays)
