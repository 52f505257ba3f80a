"""Memory of posed clouds on a device, in slabs of places of one size.

A call may make a thousand clouds and let go of as many; an allocation each would cost more than to
pose them.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache
from weakref import WeakSet, ref

import numpy as np

from gn0.device.device import Device, DeviceArray

SLAB = 2 * 2**20  # bytes of a slab, unless one place is larger
SPARE = 2**28  # bytes of slabs that nobody needs and that are kept: asking for them anew is dear
_GRAIN = 512  # bytes


class _Slab:
    """Places of one size in one allocation, which goes when none of them is held."""

    __slots__ = ("__weakref__", "count", "free", "memory", "spare")

    def __init__(self, memory: DeviceArray, size: int, spare: _Spare) -> None:
        self.memory = memory
        self.free = list(range(0, memory.nbytes, size))
        self.count, self.spare = len(self.free), ref(spare)

    def give(self, at: int) -> None:
        """A place is free again; work on the one stream goes in order."""
        self.free.append(at)
        if len(self.free) == self.count and (spare := self.spare()) is not None:
            spare.keep(self)


class _Spare:
    """Slabs none of whose places is held, of so many bytes."""

    def __init__(self, most: int) -> None:
        self._most = most
        self._bytes = 0
        self._held: set[_Slab] = set()

    def keep(self, slab: _Slab) -> None:
        if self._bytes + slab.memory.nbytes <= self._most:
            self._bytes += slab.memory.nbytes
            self._held.add(slab)

    def use(self, slab: _Slab) -> None:
        if slab in self._held:
            self._bytes -= slab.memory.nbytes
            self._held.discard(slab)

    def clear(self) -> None:
        self._bytes = 0
        self._held.clear()


class _Place:
    """What holds a place: it is free again when nothing refers to it."""

    __slots__ = ("at", "slab")

    def __init__(self, slab: _Slab, at: int) -> None:
        self.slab, self.at = slab, at

    def __del__(self) -> None:
        self.slab.give(self.at)


class PosedPlaces:
    """Gives memory for posed clouds.

    Args:
        device: where it is.
        spare: bytes that are kept although nobody holds them, until `let_go`.
    """

    def __init__(self, device: Device, spare: int = SPARE) -> None:
        self._device = device
        self._slabs: dict[int, WeakSet[_Slab]] = {}
        self._spare = _Spare(spare)

    def let_go(self) -> None:
        """Free what nobody holds: memory is short."""
        self._spare.clear()

    def take(self, sizes: Sequence[int]) -> list[DeviceArray]:
        """Memory uint32 [words] of at least so many bytes each, free again when let go of.

        Raises:
            DeviceMemoryError: the device has no room for it.
        """
        open_slabs: dict[int, list[_Slab]] = {}
        word = np.dtype(np.uint32)
        found = []
        for size in sizes:
            room = _room(size)
            slabs = open_slabs.get(room)
            if slabs is None:  # the fullest last, which is taken from: others empty
                slabs = [slab for slab in self._slabs.get(room, ()) if slab.free]
                slabs.sort(key=lambda slab: -len(slab.free))
                open_slabs[room] = slabs
            if not slabs:
                slabs.append(self._add(room))
            slab = slabs[-1]
            if len(slab.free) == slab.count:
                self._spare.use(slab)
            at = slab.free.pop()
            if not slab.free:
                slabs.pop()
            pointer = slab.memory.pointer + at
            found.append(DeviceArray(self._device, pointer, (room // 4,), word, _Place(slab, at)))
        return found

    def _add(self, room: int) -> _Slab:
        count = max(SLAB // room, 1)
        slab = _Slab(self._device.empty(count * room // 4, np.uint32), room, self._spare)
        self._slabs.setdefault(room, WeakSet()).add(slab)
        return slab


@lru_cache(1024)
def _room(size: int) -> int:
    """A size rounded up by at most an eighth, so that people of about a size share slabs."""
    grain = max(_GRAIN, 1 << max((size - 1).bit_length() - 4, 0))
    return -(-size // grain) * grain
