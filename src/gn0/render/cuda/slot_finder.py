"""Slots of codes by a hash table on the device, which learns what comes and goes by a launch.

A code that is in no slot any more keeps its place in the table, so that no way to another breaks;
when half of the places are taken the table is laid anew.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from gn0.device.device import Device, DeviceArray, Download
from gn0.jit import njit
from gn0.render.cuda.posed import SOURCE
from gn0.render.cuda.records import FindLate, FindSlots, HoldSlots

_MIX = 0x9E3779B97F4A7C15  # of codes, as in `kernels/posed.cu`
_THREADS = 128
_LEAST = 2**18  # places: a thousand codes may come and go a step, and each time laid anew it waits


class LackingCodes:
    """Codes that were looked for and are in no slot, on their way to the host.

    Attributes:
        late: as of `PartsDevice`, if it was asked for.
    """

    def __init__(self, download: Download, late: DeviceArray | None = None) -> None:
        self._download, self.late = download, late

    def numpy(self) -> NDArray[np.uint64]:
        """Those codes, once each, in ascending order; waits for the device."""
        words = self._download.numpy()
        return np.unique(words[2 : 2 + int(words[0])])

    @property
    def late_views(self) -> int:
        """How many views are late; waits for the device."""
        return int(self._download.numpy()[1])


class SlotFinder:
    """Slots of codes by a hash table on the device.

    Args:
        device: where.
        least: places of the table, a power of two.
    """

    def __init__(self, device: Device, least: int = _LEAST) -> None:
        self._device, self._least = device, least
        self._places = self._keys = 0
        self._held: tuple[DeviceArray, DeviceArray, DeviceArray] | None = None
        self._spare: dict[int, tuple[DeviceArray, NDArray[np.uint64]]] = {}
        self._late: DeviceArray | None = None
        self._uses: Download | None = None  # on their way
        self._room: NDArray[np.uint32] = np.zeros((2, 0), np.uint32)

    def set(self, codes: NDArray[np.uint64], slots: NDArray[np.int32], most: int) -> None:
        """Say which code, above 0, is in which slot below `most`; stamps of before are lost."""
        self._places = max(1 << (4 * len(slots)).bit_length(), self._least)
        self._keys = len(codes)
        keys, found = place_codes(codes, slots, self._places)
        upload = self._device.upload
        self._held = upload(keys), upload(found), self._device.zeros((2, most), np.uint32)

    def hold(self, codes: NDArray[np.uint64], slots: NDArray[np.int32]) -> bool:
        """Say that codes, once each, are in slots from now on; -1: in none, where they were in one.

        Returns:
            Whether it was done: a table that is full, or knows no such slots, is to be `set`.
        """
        if self._held is None:
            return False
        keys, found, uses = self._held
        more = int((slots >= 0).sum())  # at most: those that went keep their places
        if 2 * (self._keys + more) > self._places or slots.max(initial=0) >= uses.shape[1]:
            return False
        self._keys += more
        there = self._device.upload(np.concatenate([codes, slots.astype(np.int64).view(np.uint64)]))
        count = len(codes)
        record = HoldSlots(
            there[:count], there[count:], np.uint32(count), keys, found, np.uint32(self._places)
        )
        self._device.load(SOURCE)["hold_slots"].launch(-(-count // _THREADS), _THREADS, record)
        return True

    def find(
        self, codes: DeviceArray, chosen: DeviceArray, stamp: int, *, lane: int = 0, each: int = 0
    ) -> LackingCodes:
        """Write the slots of codes uint64 [I] to int32 [I]; 0 and those that are in none: -1.

        Args:
            codes: what is looked for.
            chosen: what is written to.
            stamp: by which what is found is stamped.
            lane: looks whose answers are awaited at the same time have different ones.
            each: so many codes are of one view, and it is asked which views are late; 0: not.

        Returns:
            The codes that are in none; until the next look of that lane. Which views are late,
            until that is asked again.
        """
        assert self._held is not None
        keys, slots, uses = self._held
        count = len(codes)
        if lane not in self._spare or len(self._spare[lane][1]) != count + 2:
            room = self._device.pinned(count + 2, np.uint64)
            self._spare[lane] = self._device.empty(count + 2, np.uint64), room
        missing, here = self._spare[lane]
        self._device.fill(missing[:2], 0)
        record = FindSlots(
            *(codes, np.uint32(count), keys, slots, np.uint32(self._places)),
            *(np.uint32(stamp), uses[0], uses[1], chosen, missing),
        )
        kernels = self._device.load(SOURCE)
        kernels["find_slots"].launch(-(-count // _THREADS), _THREADS, record)
        late: DeviceArray | None = None
        if each:
            views = count // each
            if self._late is None or len(self._late) != views:
                self._late = self._device.empty(views, np.int32)
            late = self._late
            finding = FindLate(
                *(codes, chosen, np.uint32(each), np.uint32(views), late, missing[1:2])
            )
            kernels["find_late"].launch(-(-views // _THREADS), _THREADS, finding)
        return LackingCodes(self._device.download_async(missing, here), late)

    @property
    def sends(self) -> bool:
        """Whether `send_uses` began what nobody has taken."""
        return self._uses is not None

    def send_uses(self) -> None:
        """Begin what `take_uses` waits for, before the device has much else to do."""
        if self._held is None or self._uses is not None:
            return
        uses = self._held[2]
        if self._room.shape != uses.shape:
            self._room = self._device.pinned(uses.shape, np.uint32)
        self._uses = self._device.download_async(uses, self._room)
        self._device.fill(uses[1], 0)

    def take_uses(self) -> NDArray[np.uint32]:
        """When each slot was last found, and by how many stamps since this was asked last."""
        self.send_uses()
        if self._uses is None:
            return np.zeros((2, 0), np.uint32)
        download, self._uses = self._uses, None
        found: NDArray[np.uint32] = download.numpy()
        return found


def place_codes(
    codes: NDArray[np.uint64], which: NDArray[np.int32], places: int
) -> tuple[NDArray[np.uint64], NDArray[np.int32]]:
    """A hash table of codes and their slots as `find_slots` reads it, of a power of two of places.

    Each code lies in the first free place from its own on, and no place between is free.
    """
    keys, found = np.zeros(places, np.uint64), np.full(places, -1, np.int32)
    _place_codes(codes, which, keys, found)
    return keys, found


@njit
def _place_codes(codes, which, keys, found):  # type: ignore[no-untyped-def]
    last = keys.shape[0] - 1
    for n in range(codes.shape[0]):
        at = np.int64((codes[n] * np.uint64(_MIX)) >> np.uint64(32)) & last
        while keys[at] != np.uint64(0):
            at = (at + 1) & last
        keys[at], found[at] = codes[n], which[n]
