"""Clouds that the CPU renderer knows by name, packed once, and where instances of them stand."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple
from weakref import WeakValueDictionary, ref

import numpy as np
from numpy.typing import NDArray

from gn0.gaussians.cloud import GaussianCloud
from gn0.gaussians.morton import morton_order
from gn0.geometry import F32, F64
from gn0.render.cpu_pack import CHUNK, PackedCloud, pack_cloud, read_only
from gn0.render.cpu_posed import PosedPacked
from gn0.render.instance import Instance, check_name, check_named, find_normals
from gn0.render.labels import U32, encode_labels

NO_GAIN = read_only(np.empty((0, 3), np.float32))  # colours stay as they are
NO_NORMALS = read_only(np.empty((0, 3 * CHUNK), np.float32))


class PlacedPart(NamedTuple):
    """A packed cloud and where it stands.

    Attributes:
        cloud: its splats, in its own frame.
        first: added to a splat's index in its cloud, for ties in depth.
        pose: part-to-world [4, 4] m.
        gain: [0, 3] none, [1, 3] constant, or [4, 3] with the linear terms in the part's frame.
        normals: [C, 3 * CHUNK] packed as the cloud is, in the part's frame; read for a gain of
            [4, 3] alone. A posed cloud has its own.
        codes: what its splats belong to, by cloud index [N]; see `gn0.render.labels`.
        nearer: see `Instance`.
    """

    cloud: PackedCloud
    first: int
    pose: F64
    gain: F32
    normals: F32
    codes: U32
    nearer: float


@dataclass(frozen=True, eq=False)
class _NamedCloud:
    cloud: PackedCloud
    normals: F32
    codes: U32
    source: ref[GaussianCloud]


def _are_equal(held: GaussianCloud | None, cloud: GaussianCloud) -> bool:
    """Whether a cloud has all that a part's picture depends on from one that is still there."""
    if held is None or held is cloud:
        return held is cloud
    for field in ("means", "quats", "scales", "opacities", "sh", "normal", "label", "categories"):
        one, two = getattr(held, field), getattr(cloud, field)
        if one is not two and (one is None or two is None or not np.array_equal(one, two)):
            return False
    return True


class _Order(NamedTuple):
    order: NDArray[np.int64]
    scales: ref[F32]


class NamedClouds:
    """Packed clouds by name; posed ones belong to whoever posed them, and go with them."""

    def __init__(self) -> None:
        self._held: dict[str, _NamedCloud] = {}
        self._posed: WeakValueDictionary[str, PosedPacked] = WeakValueDictionary()
        self._orders: dict[int, _Order] = {}

    def __contains__(self, name: object) -> bool:
        return name in self._held or name in self._posed

    def hold_packed(self, name: str, posed: PosedPacked) -> None:
        """Know a posed cloud under a name, as long as somebody holds it.

        Raises:
            RenderError: no name.
        """
        check_name(name)
        self._held.pop(name, None)
        self._posed[name] = posed

    def hold(self, name: str, cloud: GaussianCloud) -> None:
        """Pack a cloud under a name, unless the very same is held there already.

        Raises:
            RenderError: the name or the cloud cannot be a part's.
        """
        held = self._held.get(name) if isinstance(name, str) else None
        if held is not None and _are_equal(held.source(), cloud):
            return
        check_named(name, cloud)
        packed = pack_cloud(cloud, order=self._find_order(cloud))
        lanes = find_normals(cloud)[packed.order].reshape(-1, CHUNK, 3).transpose(0, 2, 1)
        normals = np.ascontiguousarray(lanes).reshape(-1, 3 * CHUNK)
        self._held[name] = _NamedCloud(
            packed,
            read_only(normals),
            encode_labels(cloud.label, cloud.categories, len(cloud)),
            ref(cloud),
        )
        self._posed.pop(name, None)

    def _find_order(self, cloud: GaussianCloud) -> NDArray[np.int64]:
        """Neighbours together [N]: as in the first pose of clouds that share their scales.

        Splats that are near each other on a body are so in every pose, and sorting them is most
        of what packing takes.
        """
        scales = cloud.scales if cloud.scales.base is None else cloud.scales.base
        known = self._orders.get(id(scales))
        if known is not None and known.scales() is scales and len(known.order) == len(cloud):
            return known.order
        self._orders = {
            key: each for key, each in self._orders.items() if each.scales() is not None
        }
        order = morton_order(cloud.means)
        if isinstance(scales, np.ndarray):
            self._orders[id(scales)] = _Order(order, ref(scales))
        return order

    def place(self, instances: Sequence[Instance], first: int) -> list[PlacedPart]:
        """What to draw for checked instances; indices run on from `first`, in their order."""
        placed = []
        for instance in instances:
            posed = self._posed.get(instance.cloud)
            gain = instance.part_gain
            if gain is None:
                gain = NO_GAIN
            elif not gain[1:].any():
                gain = gain[:1]
            if posed is not None:
                cloud, normals, codes = posed.cloud, NO_NORMALS, posed.rest.codes
            else:
                held = self._held[instance.cloud]
                cloud, normals, codes = held.cloud, held.normals, held.codes
            placed.append(
                PlacedPart(cloud, first, instance.pose, gain, normals, codes, instance.nearer)
            )
            first += len(codes)
        return placed
