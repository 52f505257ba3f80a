"""Room on a device for the pictures of a call."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from gn0.device.device import Device, DeviceArray
from gn0.render.camera import Camera
from gn0.render.cuda.replay import PicturesDevice
from gn0.render.renderer import LABELS, Output

_FLOAT = np.dtype(np.float32)
_ROW = 256  # bytes that pictures sharing memory are laid out by
_TOGETHER = 2**26  # bytes of pictures up to which they share memory


def lay_pictures(
    device: Device, camera: Camera, count: int, outputs: Sequence[Output], rgb_float: bool
) -> PicturesDevice:
    """Room for pictures of `count` views, in one piece where they are small.

    Raises:
        DeviceMemoryError: there is not so much.
    """
    shape = (count, camera.height, camera.width)
    pixels, kind = math.prod(shape), np.dtype(np.float32 if rgb_float else np.uint8)
    parts = [
        (name in outputs, pixels * size, dims, what)
        for name, size, dims, what in (
            ("rgb", 3 * kind.itemsize, (*shape, 3), kind),
            ("depth", 4, shape, _FLOAT),
            ("alpha", 4, shape, _FLOAT),
            *((name, 4, shape, np.dtype(np.uint32)) for name in LABELS),
        )
    ]
    size = sum(-(-size // _ROW) * _ROW for wanted, size, _, _ in parts if wanted)
    if size > _TOGETHER:  # whoever keeps one of them should not keep all
        return PicturesDevice(
            *(device.empty(dims, what) if wanted else None for wanted, _, dims, what in parts)
        )
    whole, at, arrays = device.empty(size, np.uint8), 0, []
    for wanted, size, dims, what in parts:
        place = whole.pointer + at
        arrays.append(DeviceArray(device, place, dims, what, whole.owner) if wanted else None)
        at += -(-size // _ROW) * _ROW if wanted else 0
    return PicturesDevice(*arrays)
