"""Memory of posed clouds on a device, in slabs of places of one size.

A call may make a thousand clouds and let go of as many; an allocation each, or an object each,
would cost more than to pose them. All is asked for and given back in arrays.
"""

from __future__ import annotations

from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from gn0.device.device import Device, DeviceArray
from gn0.jit import njit

SLAB = 2 * 2**20  # bytes of a slab at least
SLAB_MOST = 64 * 2**20  # and at most, unless one place is larger
SPARE = 2**28  # bytes of slabs that nobody needs and that are kept: asking for them anew is dear
_GRAIN = 512  # bytes
_SHELF = 32  # bits of a handle below the number of its shelf


class Places(NamedTuple):
    """Memory that was taken.

    Attributes:
        pointers: where each place begins, uint64 [n].
        handles: by which it is given back, int64 [n].
    """

    pointers: NDArray[np.uint64]
    handles: NDArray[np.int64]


class _Shelf:
    """Slabs of places of one size.

    Attributes:
        room: bytes of a place.
        slabs: by number; None where one went.
        free: of each slab its places that are free, those given back last at the end; as many as
            it has places, one slab behind the other.
        firsts: where each slab begins there.
        left, whole: how many of each are free, and all of its places.
    """

    def __init__(self, room: int) -> None:
        self.room = room
        self.slabs: list[DeviceArray | None] = []
        self.free = np.zeros(0, np.uint64)
        self.firsts = np.zeros(0, np.int64)
        self.left = np.zeros(0, np.int64)
        self.whole = np.zeros(0, np.int64)

    def add(self, memory: DeviceArray) -> None:
        """Take a new slab in, all of it free."""
        starts = np.arange(0, memory.nbytes - self.room + 1, self.room, dtype=np.uint64)
        self.firsts = np.append(self.firsts, len(self.free))
        self.free = np.append(self.free, np.uint64(memory.pointer) + starts)
        self.left, self.whole = (np.append(old, len(starts)) for old in (self.left, self.whole))
        self.slabs.append(memory)

    def take(self, count: int) -> tuple[NDArray[np.uint64], NDArray[np.int64]]:
        """Pointers and slabs of so many free places, of the fullest slabs: others empty.

        Of a slab those that were given back last.
        """
        pointers, numbers = np.empty(count, np.uint64), np.empty(count, np.int64)
        _take_places(self.free, self.firsts, self.left, pointers, numbers)
        return pointers, numbers

    def give(self, pointers: NDArray[np.uint64], numbers: NDArray[np.int64]) -> None:
        """Have places free again."""
        _give_places(self.free, self.firsts, self.left, pointers, numbers)

    def empties(self) -> NDArray[np.int64]:
        """Slabs none of whose places is held."""
        return np.flatnonzero((self.left == self.whole) & (self.whole > 0))

    def spare(self) -> int:
        """Bytes of those."""
        return self.room * int(self.whole[self.empties()].sum())

    def release(self, over: int) -> int:
        """Let go of such slabs until so many bytes are; how many were."""
        freed = 0
        for number in self.empties().tolist():
            if freed >= over:
                break
            freed += self.room * int(self.whole[number])
            self.slabs[number] = None
            self.left[number] = self.whole[number] = 0
        return freed


class PosedPlaces:
    """Gives memory for posed clouds, until it is given back.

    Args:
        device: where it is.
        spare: bytes that are kept although nobody holds them, until `let_go`.
    """

    def __init__(self, device: Device, spare: int = SPARE) -> None:
        self._device, self._most = device, spare
        self._shelves: list[_Shelf] = []
        self._by_room: dict[int, int] = {}

    def let_go(self) -> None:
        """Free what nobody holds: memory is short."""
        self._trim(0)

    def _trim(self, most: int) -> None:
        over = sum(shelf.spare() for shelf in self._shelves) - most
        for shelf in self._shelves:
            if over <= 0:
                break
            over -= shelf.release(over)

    def take(self, sizes: NDArray[np.integer]) -> Places:
        """Memory of at least so many bytes each [n].

        Raises:
            DeviceMemoryError: the device has no room for it.
        """
        found = Places(np.zeros(len(sizes), np.uint64), np.full(len(sizes), -1, np.int64))
        different, which = np.unique(sizes, return_inverse=True)
        rooms = np.array([_room(size) for size in different.tolist()], np.int64)[which]
        try:
            for room in np.unique(rooms).tolist():
                mine = np.flatnonzero(rooms == room)
                number = self._by_room.setdefault(room, len(self._shelves))
                if number == len(self._shelves):
                    self._shelves.append(_Shelf(room))
                shelf = self._shelves[number]
                while (lack := len(mine) - int(shelf.left.sum())) > 0:
                    self._add(shelf, lack)
                pointers, slabs = shelf.take(len(mine))
                found.pointers[mine], found.handles[mine] = pointers, number << _SHELF | slabs
        except BaseException:
            taken = found.handles >= 0
            self.give(Places(found.pointers[taken], found.handles[taken]))
            raise
        return found

    def give(self, places: Places) -> None:
        """Have places free again; work on the one stream goes in order."""
        shelves = places.handles >> _SHELF
        for number in np.unique(shelves).tolist():
            mine = shelves == number
            slabs = places.handles[mine] & ((1 << _SHELF) - 1)
            self._shelves[number].give(places.pointers[mine], slabs)
        self._trim(self._most)

    def _add(self, shelf: _Shelf, lack: int) -> None:
        """Another slab for a shelf that lacks so many places: as few allocations as can be."""
        room = shelf.room
        count = min(max(lack, SLAB // room), max(SLAB_MOST // room, 1))
        shelf.add(self._device.empty(count * room // 4, np.uint32))


@lru_cache(1024)
def _room(size: int) -> int:
    """A size rounded up by at most an eighth, so that people of about a size share slabs."""
    grain = max(_GRAIN, 1 << max((size - 1).bit_length() - 4, 0))
    return -(-size // grain) * grain


@njit
def _take_places(free, firsts, left, pointers, numbers):  # type: ignore[no-untyped-def]
    at = 0
    while at < pointers.shape[0]:
        best = -1
        for slab in range(left.shape[0]):
            if left[slab] > 0 and (best < 0 or left[slab] < left[best]):
                best = slab
        while at < pointers.shape[0] and left[best] > 0:
            left[best] -= 1
            pointers[at], numbers[at] = free[firsts[best] + left[best]], best
            at += 1


@njit
def _give_places(free, firsts, left, pointers, numbers):  # type: ignore[no-untyped-def]
    for n in range(pointers.shape[0]):
        slab = numbers[n]
        free[firsts[slab] + left[slab]] = pointers[n]
        left[slab] += 1
