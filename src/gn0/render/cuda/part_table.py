"""Clouds of instances in one table on the device, by slots that stay.

A recorded call reads the table where it lies: which cloud stands where may change from call to
call, clouds may come and go, and the recording holds. Only a table that grows is another one.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from gn0.device.device import Device, DeviceArray
from gn0.render.cuda.cloud import CloudDevice, bound_all, build_clouds
from gn0.render.cuda.tables import CLOUD, NOWHERE

_SLOTS = 16  # at first


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
        self.clouds: list[CloudDevice | None] = []
        self._free: list[int] = []
        self._changed: tuple[int, int] | None = None
        self._rows: NDArray[np.void] = np.zeros(0, CLOUD)
        self._normals: NDArray[np.uint64] = np.zeros(0, np.uint64)
        self._grow(_SLOTS)

    def __len__(self) -> int:
        return len(self.clouds)

    @property
    def chunks(self) -> NDArray[np.int64]:
        """Of the cloud in each slot."""
        return np.where(self._rows["rows"] == np.uint32(NOWHERE), 0, self._rows["chunks"])

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

    def take(self) -> int:
        """A slot that is free, until `drop`."""
        if not self._free:
            self._grow(2 * len(self.clouds))
        return self._free.pop()

    def put(self, slot: int, cloud: CloudDevice) -> None:
        """Put a cloud into a slot that was taken."""
        self.put_all([slot], [cloud])

    def put_all(self, slots: Sequence[int], clouds: Sequence[CloudDevice]) -> None:
        """Put clouds, one at least, into slots that were taken."""
        self._write(slots, clouds)
        while self.most < max(cloud.chunks for cloud in clouds):
            self.most *= 2
            self.version += 1

    def drop(self, slots: Sequence[int]) -> None:
        """Free slots."""
        if slots:
            self._write(slots, [None] * len(slots))
            self._free += slots

    def flush(self) -> None:
        """Bring to the device what has changed; drawing calls read it in their turn."""
        if self._changed is None:
            return
        low, high = self._changed
        rows = self._rows[low:high].view(np.uint32).reshape(high - low, -1)
        self.device.upload(rows, self._there[low:high])
        self.device.upload(self._normals[low:high], self._normals_there[low:high])
        self.device.upload(self._bounds[low:high], self._bounds_there[low:high])
        self._changed = None

    def _write(self, slots: Sequence[int], clouds: Sequence[CloudDevice | None]) -> None:
        for slot, cloud in zip(slots, clouds, strict=True):
            self.clouds[slot] = cloud
        at = np.asarray(slots)
        self._rows[at] = build_clouds(clouds)
        normals = [0 if c is None or c.normals is None else c.normals.pointer for c in clouds]
        self._normals[at] = np.array(normals, np.uint64)
        self._bounds[at] = bound_all(clouds)
        low, high = self._changed or (slots[0], slots[0] + 1)
        self._changed = (min(low, min(slots)), max(high, 1 + max(slots)))

    def _grow(self, slots: int) -> None:
        had = len(self.clouds)
        self.clouds += [None] * (slots - had)
        self._free += range(slots - 1, had - 1, -1)  # the first goes first
        rows, normals = build_clouds(self.clouds).copy(), np.zeros(slots, np.uint64)
        normals[:had] = self._normals
        self._rows, self._normals, self._bounds = rows, normals, bound_all(self.clouds)
        self._there = self.device.empty((slots, CLOUD.itemsize // 4), np.uint32)
        self._bounds_there = self.device.empty((slots, 7), np.float32)
        self._normals_there = self.device.empty(slots, np.uint64)
        self._changed = (0, slots)
        self.version += 1
