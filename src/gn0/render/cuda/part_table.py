"""Clouds of instances in one table on the device, by slots that stay.

A recorded call reads the table where it lies: which cloud stands where may change from call to
call, clouds may come and go, and the recording holds. Only a table that grows is another one.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import overload

import numpy as np
from numpy.typing import NDArray

from gn0.device.device import Device, DeviceArray
from gn0.render.cuda.cloud import CloudDevice, bound_all, build_clouds
from gn0.render.cuda.posed import PosedClouds, RestDevice, posed_bytes, posed_cloud
from gn0.render.cuda.tables import CLOUD, NOWHERE

_SLOTS = 16  # at first


class PartClouds(Sequence[CloudDevice | None]):
    """The clouds of a table by slot; one of people in poses is made when it is asked for."""

    def __init__(self, slots: int = 0) -> None:
        # of objects, so that thousands change at once: clouds, those in arrays once they were asked
        # for, and those at rest of which clouds in arrays are
        self.others: NDArray[np.object_] = np.full(slots, None, object)
        self.rests: NDArray[np.object_] = np.full(slots, None, object)
        self.rows = build_clouds([None] * slots).copy()
        self.bounds = bound_all([None] * slots) if slots else np.zeros((0, 7), np.float32)

    def __len__(self) -> int:
        return len(self.others)

    @overload
    def __getitem__(self, slot: int) -> CloudDevice | None: ...

    @overload
    def __getitem__(self, slot: slice) -> list[CloudDevice | None]: ...

    def __getitem__(self, slot: int | slice) -> CloudDevice | list[CloudDevice | None] | None:
        if isinstance(slot, slice):
            return [self[n] for n in range(*slot.indices(len(self)))]
        rest: RestDevice | None = self.rests[slot]
        if self.others[slot] is None and rest is not None:
            row = self.rows[slot]
            step = float(row["sh_row"].view(np.float32))
            box = self.bounds[slot].copy()
            self.others[slot] = posed_cloud(rest, int(row["splats"]), box, step)
        found: CloudDevice | None = self.others[slot]
        return found

    @property
    def known(self) -> NDArray[np.bool_]:
        """Which slots have one."""
        return self.rows["rows"] != np.uint32(NOWHERE)

    def grow(self, slots: int) -> None:
        """Have so many slots."""
        more = PartClouds(slots - len(self))
        self.others = np.concatenate([self.others, more.others])
        self.rests = np.concatenate([self.rests, more.rests])
        self.rows = np.concatenate([self.rows, more.rows])
        self.bounds = np.concatenate([self.bounds, more.bounds])


class PartTable:
    """Clouds by slot, those that no slot has apart.

    Args:
        device: where they are.

    Attributes:
        clouds: of each slot; None where it is free.
        version: of the table: another one for every size of it, or of its largest cloud.
        most: chunks that no cloud has ever had more of, a power of two.
    """

    def __init__(self, device: Device) -> None:
        self.device = device
        self.version = 0
        self.most = 1
        self.clouds = PartClouds()
        self._free: list[int] = []
        self._changed: tuple[int, int] | None = None
        self._normals: NDArray[np.uint64] = np.zeros(0, np.uint64)
        self._grow(_SLOTS)

    def __len__(self) -> int:
        return len(self.clouds)

    @property
    def chunks(self) -> NDArray[np.int64]:
        """Of the cloud in each slot."""
        return np.where(self.clouds.known, self.clouds.rows["chunks"], 0).astype(np.int64)

    @property
    def posed_bytes(self) -> int:
        """Bytes of all clouds that `put_posed` put here."""
        return sum(posed_bytes(rest.rows) for rest in self.clouds.rests if rest is not None)

    @property
    def rows(self) -> DeviceArray:
        """The table, `tables.CLOUD` as words, as of `flush`."""
        return self._there

    @property
    def bounds(self) -> DeviceArray:
        """Bounds of each, float32 [slots, 7], as of `flush`."""
        return self._bounds_there

    @property
    def normals(self) -> DeviceArray:
        """Where the normals of each are, uint64, as of `flush`."""
        return self._normals_there

    @property
    def normals_here(self) -> NDArray[np.uint64]:
        """The same on the host."""
        return self._normals

    def take(self, count: int) -> list[int]:
        """So many slots that are free, until `drop`."""
        while len(self._free) < count:
            self._grow(2 * len(self))
        found = self._free[len(self._free) - count :]
        del self._free[len(self._free) - count :]
        return found[::-1]

    def put(self, slot: int, cloud: CloudDevice) -> None:
        """Put a cloud into a slot that was taken."""
        self._write([slot], [cloud])
        self._see(cloud.chunks)

    def put_posed(self, slots: Sequence[int], clouds: PosedClouds) -> None:
        """Put clouds in poses, one at least, into slots that were taken."""
        at, entries = np.asarray(slots), clouds.entries
        kinds = np.empty(len(clouds.rests), object)
        kinds[:] = clouds.rests
        self.clouds.rests[at] = kinds[clouds.which]
        self.clouds.rows[at], self.clouds.bounds[at] = entries, clouds.boxes
        self._normals[at] = entries["splats"]
        self._mark(at)
        self._see(int(entries["chunks"].max()))

    def drop(self, slots: Sequence[int]) -> None:
        """Free slots."""
        if not slots:
            return
        at = np.asarray(slots)
        self.clouds.others[at] = self.clouds.rests[at] = None
        self.clouds.rows[at], self.clouds.bounds[at] = _NONE.rows[0], _NONE.bounds[0]
        self._normals[at] = 0
        self._mark(at)
        self._free += slots

    def flush(self) -> None:
        """Bring to the device what has changed; drawing calls read it in their turn."""
        if self._changed is None:
            return
        low, high = self._changed
        rows = self.clouds.rows[low:high].view(np.uint32).reshape(high - low, -1)
        self.device.upload(rows, self._there[low:high])
        self.device.upload(self._normals[low:high], self._normals_there[low:high])
        self.device.upload(self.clouds.bounds[low:high], self._bounds_there[low:high])
        self._changed = None

    def _write(self, slots: Sequence[int], clouds: Sequence[CloudDevice]) -> None:
        at = np.asarray(slots)
        for slot, cloud in zip(slots, clouds, strict=True):
            self.clouds.others[slot] = cloud
        self.clouds.rows[at] = build_clouds(clouds)
        self.clouds.bounds[at] = bound_all(clouds)
        normals = [0 if c.normals is None else c.normals.pointer for c in clouds]
        self._normals[at] = np.array(normals, np.uint64)
        self._mark(at)

    def _mark(self, slots: NDArray[np.integer]) -> None:
        low, high = self._changed or (int(slots[0]), int(slots[0]) + 1)
        self._changed = min(low, int(slots.min())), max(high, 1 + int(slots.max()))

    def _see(self, chunks: int) -> None:
        while self.most < chunks:
            self.most *= 2
            self.version += 1

    def _grow(self, slots: int) -> None:
        had = len(self)
        self.clouds.grow(slots)
        self._free[:0] = range(slots - 1, had - 1, -1)  # the first goes first
        self._normals = np.append(self._normals, np.zeros(slots - had, np.uint64))
        self._there = self.device.empty((slots, CLOUD.itemsize // 4), np.uint32)
        self._bounds_there = self.device.empty((slots, 7), np.float32)
        self._normals_there = self.device.empty(slots, np.uint64)
        self._changed = (0, slots)
        self.version += 1


_NONE = PartClouds(1)
