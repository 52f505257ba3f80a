"""Memory of posed clouds on a device, in slabs of places of one size.

A call may make a thousand clouds and let go of as many; an allocation each would cost more than to
pose them.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache
from weakref import WeakSet

import numpy as np

from gn0.device.device import Device, DeviceArray

SLAB = 2 * 2**20  # bytes of a slab, unless one place is larger
_GRAIN = 512  # bytes


class _Slab:
    """Places of one size in one allocation, which goes when none of them is held."""

    def __init__(self, memory: DeviceArray, size: int) -> None:
        self.memory = memory
        self.free = list(range(0, memory.nbytes, size))


class _Place:
    """What holds a place: it is free again when nothing refers to it."""

    __slots__ = ("at", "slab")

    def __init__(self, slab: _Slab, at: int) -> None:
        self.slab, self.at = slab, at

    def __del__(self) -> None:
        self.slab.free.append(self.at)  # work on the one stream goes in order


class PosedPlaces:
    """Gives memory for posed clouds.

    Args:
        device: where it is.
    """

    def __init__(self, device: Device) -> None:
        self._device = device
        self._slabs: dict[int, WeakSet[_Slab]] = {}

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
            at = slab.free.pop()
            if not slab.free:
                slabs.pop()
            pointer = slab.memory.pointer + at
            found.append(DeviceArray(self._device, pointer, (room // 4,), word, _Place(slab, at)))
        return found

    def _add(self, room: int) -> _Slab:
        count = max(SLAB // room, 1)
        slab = _Slab(self._device.empty(count * room // 4, np.uint32), room)
        self._slabs.setdefault(room, WeakSet()).add(slab)
        return slab


@lru_cache(1024)
def _room(size: int) -> int:
    """A size rounded up by at most an eighth, so that people of about a size share slabs."""
    grain = max(_GRAIN, 1 << max((size - 1).bit_length() - 4, 0))
    return -(-size // grain) * grain
