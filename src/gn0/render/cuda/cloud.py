"""Clouds on a device, and the table by which the drawing kernels find them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from struct import Struct

import numpy as np
from numpy.typing import NDArray

from gn0.device.device import Device, DeviceArray
from gn0.geometry import F32
from gn0.render.cuda.tables import CLOUD, NOWHERE
from gn0.render.labels import encode_labels

PACKED = 8  # instead of a degree: a posed cloud, see `kernels/posed.cuh`
_NO_CLOUD = np.array([(0,) * 9 + (NOWHERE,)], CLOUD).tobytes()


class CloudLabels:
    """What the splats of a cloud belong to; on the device from when somebody wants labels.

    Args:
        label: int32 [N] of each splat, as in `GaussianCloud`.
        categories: of each object, likewise.
    """

    def __init__(
        self, label: NDArray[np.int32], categories: NDArray[np.int32] | None = None
    ) -> None:
        self.label, self.categories = label, categories
        self._codes: DeviceArray | None = None

    @property
    def nbytes(self) -> int:
        """Bytes on the device."""
        return 0 if self._codes is None else self._codes.nbytes

    def bring(self, device: Device, order: DeviceArray, alive: int) -> DeviceArray:
        """Codes uint32 [rows] of the packed splats, the `alive` first of which are some.

        Raises:
            RenderError: numbers that a code cannot hold.
            DeviceMemoryError: the device has no room for them.
        """
        if self._codes is None:
            codes = np.zeros(len(order), np.uint32)
            index = order.numpy()[:alive]
            codes[:alive] = encode_labels(self.label, self.categories)[index]
            self._codes = device.upload(codes)
        return self._codes


@dataclass(frozen=True, eq=False, kw_only=True)
class CloudDevice:
    """A packed cloud on a device, or a part of one.

    Attributes:
        splats: float32 [rows, 16], see `gn0.render.cuda.pack`.
        order: uint32 [rows], a packed splat's index in its cloud.
        places: uint32 [size], the inverse: where a splat of the cloud lies among the packed
            (anything for those left out). None when `ordered`, and of posed clouds: keys then hold
            packed numbers.
        sh: halves as uint16 [rows, 16, 32 or 48]: coefficients 1, 2, ... of three colours,
            padded; None at degree 0.
        boxes: float32 [chunks, 7]: lowest and highest centre, largest reach [m], of each chunk.
        degree: SH degree.
        ordered: whether packed order is cloud order.
        size: splats of the cloud before packing.
        alive: splats packed.
        slots: for a part, uint32 [chunks * 256]: packed numbers in packed order, then 0xffffffff;
            `boxes` are those of its own chunks. None for the whole.
        normals: of one that may be an instance, uint32 [rows] as `instances.pack_normals` has them.
        labels: what its splats belong to; None if nobody said.
        rest: of a posed cloud, what no pose changes, see `gn0.render.cuda.posed`; its splats are
            16 bytes each, its normals among them.
        step: of a posed cloud's places [m].
        bounds: of one that may be an instance, float32 [7]: a box that holds all centres, and the
            largest reach, as of a chunk; None if nobody knows.
    """

    splats: DeviceArray
    order: DeviceArray
    places: DeviceArray | None
    sh: DeviceArray | None
    boxes: DeviceArray
    degree: int
    ordered: bool
    size: int
    alive: int
    slots: DeviceArray | None = None
    normals: DeviceArray | None = None
    labels: CloudLabels | None = None
    rest: DeviceArray | None = None
    step: float = 0.0
    bounds: F32 | None = None

    @property
    def chunks(self) -> int:
        """Number of chunks."""
        return len(self.boxes)

    @cached_property
    def entry(self) -> bytes:
        """What kernels see of it."""
        return build_cloud(self)

    @property
    def nbytes(self) -> int:
        """Bytes on the device."""
        arrays = (
            self.splats,
            self.order,
            self.places,
            self.sh,
            self.boxes,
            self.slots,
            self.normals,
        )
        codes = 0 if self.labels is None else self.labels.nbytes
        return codes + sum(array.nbytes for array in arrays if array is not None)


def bound_all(clouds: Sequence[CloudDevice | None]) -> F32:
    """Bounds of clouds [n, 7]; where nobody knows them, a reach without end."""
    endless = np.array([0, 0, 0, 0, 0, 0, np.inf], np.float32)
    bounds = [endless if c is None or c.bounds is None else c.bounds for c in clouds]
    return np.concatenate(bounds).reshape(-1, 7)


def build_clouds(clouds: Sequence[CloudDevice | None]) -> NDArray[np.void]:
    """Clouds [n] as kernels see them; None is one that no view may show."""
    return np.frombuffer(b"".join([_NO_CLOUD if c is None else c.entry for c in clouds]), CLOUD)


def build_cloud(cloud: CloudDevice) -> bytes:
    """A cloud as kernels see it."""
    at = [
        0 if array is None else array.pointer
        for array in (cloud.splats, cloud.order, cloud.places, cloud.sh, cloud.boxes, cloud.slots)
    ]
    degree, last = cloud.degree, _NUMBER.pack(0 if cloud.sh is None else cloud.sh.shape[1])
    if cloud.ordered:
        at[2] = 0
    if cloud.rest is not None:
        degree, at[5], last = PACKED, cloud.rest.pointer, _STEP.pack(cloud.step)
    return _ENTRY.pack(*at, cloud.chunks, degree, last, len(cloud.splats))


# records of structured arrays are filled too slowly for a thousand posed clouds a step
_ENTRY, _NUMBER, _STEP = Struct("<6Q2I4sI"), Struct("<I"), Struct("<f")
assert _ENTRY.size == CLOUD.itemsize
