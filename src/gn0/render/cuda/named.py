"""Clouds of moving parts that a renderer on a device knows by name, and where they stand."""

from __future__ import annotations

import weakref
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gn0.device.device import Device
from gn0.errors import RenderError, brief
from gn0.gaussians.cloud import GaussianCloud
from gn0.geometry import F32, F64
from gn0.render.cuda.cloud import CloudDevice
from gn0.render.cuda.instances import NO_PART, Instances
from gn0.render.cuda.pack import prepare_cloud, upload_cloud
from gn0.render.cuda.part_table import PartTable
from gn0.render.cuda.posed import ReadyPoses, RestDevice, pose_ready, posed_bytes
from gn0.render.cuda.posed_places import Places, PosedPlaces
from gn0.render.instance import Instance, Parts, PartsDevice, check_named, check_parts, digest_part

_SLOT = "slot of the table "


@dataclass(frozen=True, eq=False)
class _NamedCloud:
    slot: int
    digest: str
    source: weakref.ref[GaussianCloud] | None


class NamedClouds:
    """Packed clouds by name, on a device; they stay there.

    Attributes:
        table: where they are, and others without names.
    """

    def __init__(self, device: Device) -> None:
        self._device = device
        self.table = PartTable(device)
        self._held: dict[str, _NamedCloud] = {}
        self._places = PosedPlaces(device)
        self._handles = np.zeros(0, np.int64)  # of the memory of clouds in poses, by slot

    def __contains__(self, name: object) -> bool:
        return isinstance(name, str) and self._find(name) is not None

    @property
    def used(self) -> int:
        """Bytes on the device."""
        named = (self.table.clouds[held.slot] for held in self._held.values())
        return self.table.posed_bytes + sum(cloud.nbytes for cloud in named if cloud is not None)

    def _find(self, name: str) -> int | None:
        """The slot of a name."""
        number = name.removeprefix(_SLOT)
        if number != name and number.isascii() and number.isdecimal():
            slot = int(number)
            posed = slot < len(self.table) and self.table.clouds.rests[slot] is not None
            if posed and name == self.name_of(slot):
                return slot
        held = self._held.get(name)
        return None if held is None else held.slot

    def hold(
        self,
        name: str,
        cloud: GaussianCloud,
        with_room: Callable[[Callable[[], CloudDevice]], CloudDevice],
    ) -> bool:
        """Bring a cloud to the device under a name, unless the very same is held there already.

        Args:
            name: of the cloud.
            cloud: its splats, in their own frame.
            with_room: calls what it is given, and makes room where there is too little.

        Returns:
            Whether it was brought there.

        Raises:
            RenderError: the name or the cloud cannot be a part's.
            DeviceMemoryError: the device has no room for it.
        """
        held = self._held.get(name) if isinstance(name, str) else None
        if held is not None and held.source is not None and held.source() is cloud:
            return False
        check_named(name, cloud)
        digest = digest_part(cloud)
        if held is not None and held.digest == digest:
            return False
        ready = prepare_cloud(cloud, part=True)
        packed = with_room(lambda: upload_cloud(self._device, ready))
        slot = self.table.take(1)[0] if held is None else held.slot
        self.table.put(slot, packed)
        self._held[name] = _NamedCloud(slot, digest, weakref.ref(cloud))
        return True

    def slot_of(self, name: str) -> int:
        """The slot of a name.

        Raises:
            RenderError: no cloud has it.
        """
        slot = self._find(name)
        if slot is None:
            raise RenderError(
                f"no cloud is named {brief(name)}",
                remedy="hand it to the renderer's name_cloud first",
            )
        return slot

    def pose(
        self, rests: Sequence[RestDevice], which: NDArray[np.integer], ready: ReadyPoses
    ) -> list[int]:
        """Slots of clouds in poses, with names (`name_of`), until `drop`; see `pose_ready`.

        Raises:
            DeviceMemoryError: the device has no room for them.
        """
        sizes = np.array([posed_bytes(rest.rows) for rest in rests])[which]
        places = self._places.take(sizes)
        try:
            clouds = pose_ready(self._device, rests, which, ready, places.pointers)
            slots = self.table.take(len(clouds))
        except BaseException:
            self._places.give(places)
            raise
        self.table.put_posed(slots, clouds)
        more = len(self.table) - len(self._handles)
        self._handles = np.append(self._handles, np.zeros(more, np.int64))
        self._handles[slots] = places.handles
        return slots

    def drop(self, slots: Sequence[int]) -> None:
        """Free slots that `pose` gave, and their memory."""
        at = np.asarray(slots, np.int64)
        places = Places(self.table.clouds.rows["splats"][at], self._handles[at])
        self.table.drop(slots)
        self._places.give(places)

    def let_go(self) -> None:
        """Free memory of clouds in poses that none has: it is short."""
        self._places.let_go()

    def name_of(self, slot: int) -> str:
        """The name of a slot that `add` gave."""
        return f"{_SLOT}{slot}"

    def place(self, parts: Parts | PartsDevice, views: int) -> Instances | None:
        """What to draw in so many views; None if nothing stands in any of them.

        Raises:
            RenderError: an instance of no known cloud, or of another fault that the host can see.
        """
        self.table.flush()
        if isinstance(parts, PartsDevice):
            clouds: Sequence[CloudDevice | None] = self.table.clouds
            for n, name in enumerate(parts.names or ()):
                if name not in self:
                    raise RenderError(
                        f"no cloud is named {brief(name)}",
                        where=f"names[{n}]",
                        remedy="hand it to the renderer's name_cloud first",
                    )
            if parts.names is not None:
                clouds = [self.table.clouds[self.slot_of(name)] for name in parts.names]
            found = Instances(
                *(clouds, parts.poses, parts.chosen, parts.firsts, parts.gains, parts.nearer),
                table=self.table if parts.names is None else None,
                settle=parts.settle,
                late=parts.late,
                meanwhile=parts.meanwhile,
            )
            found.check(views)
            return found if len(found) else None
        rows = check_parts(parts, views, self)
        if not any(rows):
            return None
        return _join_rows(rows, self.slot_of, self.table)


def _join_rows(
    rows: list[tuple[Instance, ...]], slot_of: Callable[[str], int], table: PartTable
) -> Instances:
    """Arrays of the instances of all views, as many of each; agents of one scene share theirs.

    How many that is, is a power of two: who comes into view seldom makes it another call.
    """
    each = 1 << (max(map(len, rows)) - 1).bit_length()
    begins: dict[int, int] = {}
    different: list[Instance] = []
    for row in rows:
        if id(row) not in begins:
            begins[id(row)] = len(different)
            different += row
    counts, begin = np.array([len(row) for row in rows]), np.array([begins[id(r)] for r in rows])
    place = np.arange(each)
    there = (place < counts[:, None]).ravel()
    at = np.where(there, (begin[:, None] + place).ravel(), 0)
    poses: F64 = np.stack([instance.pose for instance in different])[at]
    chosen = np.array([slot_of(instance.cloud) for instance in different], np.int32)[at]
    chosen[~there] = NO_PART
    gains: F32 | None = None
    if any(instance.gain is not None for instance in different):
        gains = np.stack([instance.whole_gain for instance in different])[at]
    nearer: F32 | None = None
    if any(instance.nearer > 0 for instance in different):
        nearer = np.array([instance.nearer for instance in different], np.float32)[at]
        nearer[~there] = different[-1].nearer  # so that who comes into view is no other call
    return Instances(table.clouds, poses, chosen, each, gains, nearer, table)
