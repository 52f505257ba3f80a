"""Clouds of moving parts that a renderer on a device knows by name, and where they stand."""

from __future__ import annotations

import weakref
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from gn0.device.device import Device
from gn0.errors import RenderError, brief
from gn0.gaussians.cloud import GaussianCloud
from gn0.geometry import F32, F64
from gn0.render.cuda.cloud import CloudDevice
from gn0.render.cuda.instances import Instances
from gn0.render.cuda.pack import prepare_cloud, upload_cloud
from gn0.render.instance import Instance, Parts, PartsDevice, check_named, check_parts, digest_part


@dataclass(frozen=True, eq=False)
class _NamedCloud:
    cloud: CloudDevice
    digest: str
    source: weakref.ref[GaussianCloud]


class NamedClouds:
    """Packed clouds by name, on a device; they stay there."""

    def __init__(self, device: Device) -> None:
        self._device = device
        self._held: dict[str, _NamedCloud] = {}

    def __contains__(self, name: object) -> bool:
        return name in self._held

    @property
    def used(self) -> int:
        """Bytes on the device."""
        return sum(held.cloud.nbytes for held in self._held.values())

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
        if held is not None and held.source() is cloud:
            return False
        check_named(name, cloud)
        digest = digest_part(cloud)
        if held is not None and held.digest == digest:
            return False
        ready = prepare_cloud(cloud, part=True)
        packed = with_room(lambda: upload_cloud(self._device, ready))
        self._held[name] = _NamedCloud(packed, digest, weakref.ref(cloud))
        return True

    def place(self, parts: Parts | PartsDevice, views: int) -> Instances | None:
        """What to draw in so many views; None if nothing stands in any of them.

        Raises:
            RenderError: an instance of no known cloud, or of another fault that the host can see.
        """
        if isinstance(parts, PartsDevice):
            for n, name in enumerate(parts.names):
                if name not in self._held:
                    raise RenderError(
                        f"no cloud is named {brief(name)}",
                        where=f"names[{n}]",
                        remedy="hand it to the renderer's name_cloud first",
                    )
            clouds = [self._held[name].cloud for name in parts.names]
            found = Instances(clouds, parts.poses, parts.chosen, parts.firsts, parts.gains)
            found.check(views)
            return found if len(found) else None
        rows = check_parts(parts, views, self._held)
        if not any(rows):
            return None
        number = {name: n for n, name in enumerate(dict.fromkeys(_names(rows)))}
        clouds = [self._held[name].cloud for name in number]
        return _join_rows(rows, number, clouds)


def _names(rows: list[tuple[Instance, ...]]) -> list[str]:
    distinct = {id(row): row for row in rows}
    return [instance.cloud for row in distinct.values() for instance in row]


def _join_rows(
    rows: list[tuple[Instance, ...]], number: dict[str, int], clouds: list[CloudDevice]
) -> Instances:
    """Arrays of the instances of all views; agents of one scene share theirs."""
    begins: dict[int, int] = {}
    different: list[Instance] = []
    for row in rows:
        if id(row) not in begins:
            begins[id(row)] = len(different)
            different += row
    poses: F64 = np.stack([instance.pose for instance in different])
    chosen = np.array([number[instance.cloud] for instance in different], np.int32)
    counts = np.array([len(row) for row in rows])
    firsts = np.concatenate([[0], np.cumsum(counts)])
    begin = np.array([begins[id(row)] for row in rows])
    at = np.arange(firsts[-1]) + np.repeat(begin - firsts[:-1], counts)
    gains: F32 | None = None
    if any(instance.gain is not None for instance in different):
        gains = np.stack([instance.whole_gain for instance in different])[at]
    return Instances(clouds, poses[at], chosen[at], firsts.astype(np.int32), gains)
