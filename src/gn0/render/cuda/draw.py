"""Drawing on a device: lists of splats a tile for many views of many clouds, then one picture a view.

Three kernels and a scan: `count` and `emit` project each chunk of splats once for all views that
can see it and list what touches a tile; `paint` sorts each list by (float32 depth, index in the
cloud), projects the splats that are reached again and blends them. Entries are the sort keys
themselves, so the order in which atomics served them cannot show. See `docs/renderer_cuda.md`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gn0.device.device import Device, DeviceArray
from gn0.geometry import F32, F64
from gn0.render.camera import Camera
from gn0.render.cuda.tune import Tuning
from gn0.render.renderer import Output, RenderResult

CHUNK = 256  # splats a chunk
TILE = 16  # px


@dataclass(frozen=True, eq=False, kw_only=True)
class CloudDevice:
    """A packed cloud on a device, or a part of one.

    Attributes:
        splats: float32 [rows, 16], see `gn0.render.cuda.pack`.
        order: uint32 [rows], a packed splat's index in its cloud.
        places: uint32 [size], the inverse: where a splat of the cloud lies among the packed
            (anything for those left out). None when `ordered`, where both are the same.
        sh: halves as uint16 [rows, 16, 32 or 48]: coefficients 1, 2, ... of three colours,
            padded; None at degree 0.
        boxes: float32 [chunks, 7]: lowest and highest centre, largest reach [m], of each chunk.
        degree: SH degree.
        ordered: whether packed order is cloud order and every splat was kept: packed number and
            index are one.
        size: splats of the cloud before packing.
        alive: splats packed.
        slots: for a part, uint32 [chunks * 256]: packed numbers in packed order, then 0xffffffff;
            `boxes` are those of its own chunks. None for the whole.
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

    @property
    def chunks(self) -> int:
        """Number of chunks."""
        return len(self.boxes)

    @property
    def nbytes(self) -> int:
        """Bytes on the device."""
        arrays = (self.splats, self.order, self.places, self.sh, self.boxes, self.slots)
        return sum(array.nbytes for array in arrays if array is not None)


@dataclass(frozen=True, eq=False)
class PicturesDevice:
    """Pictures of V views on a device; a field is None when it was not asked for.

    Attributes:
        rgb: uint8 [V, H, W, 3], or float32 with `rgb_float`.
        depth: camera z of the expected surface [V, H, W] float32 m; +inf where alpha < 0.5.
        alpha: accumulated opacity [V, H, W] float32 in 0..1.
    """

    rgb: DeviceArray | None
    depth: DeviceArray | None
    alpha: DeviceArray | None

    def numpy(self) -> RenderResult:
        """Copies in host memory."""
        rgb, depth, alpha = (
            None if a is None else a.numpy() for a in (self.rgb, self.depth, self.alpha)
        )
        return RenderResult(rgb, depth, alpha)


class Drawer:
    """Draws on one device; buffers are kept between calls. One thread at a time.

    Args:
        device: draws.
        tuning: sizes that the kernels are compiled for.
        memory: bytes that the lists of one batch of views may take; a quarter of what is free
            when None.
    """

    def __init__(
        self, device: Device, tuning: Tuning | None = None, memory: int | None = None
    ) -> None:
        self.device = device
        self.tuning = tuning or Tuning()
        self.memory = memory

    def pictures(
        self, camera: Camera, count: int, outputs: Sequence[Output], rgb_float: bool = False
    ) -> PicturesDevice:
        """Room for pictures of `count` views.

        Raises:
            DeviceMemoryError: there is not so much.
        """
        shape = (count, camera.height, camera.width)
        kind = np.float32 if rgb_float else np.uint8
        return PicturesDevice(
            self.device.empty((*shape, 3), kind) if "rgb" in outputs else None,
            self.device.empty(shape, np.float32) if "depth" in outputs else None,
            self.device.empty(shape, np.float32) if "alpha" in outputs else None,
        )

    def draw(
        self,
        camera: Camera,
        matrices: F64,
        clouds: Sequence[CloudDevice],
        cloud_of: NDArray[np.int32],
        *,
        tails: Sequence[CloudDevice] = (),
        tail_of: NDArray[np.int32] | None = None,
        pictures: PicturesDevice,
        rows: NDArray[np.int64] | None = None,
        background: F32,
        antialiased: bool = False,
    ) -> None:
        """Draw views into `pictures`.

        Args:
            camera: of all views.
            matrices: world-to-camera [V, 4, 4].
            clouds: different clouds, once each.
            cloud_of: [V] which of them a view shows.
            tails: moving clouds, once each, drawn after all others at equal depth.
            tail_of: [V] which of them a view shows, -1 for none.
            pictures: what to fill; its type decides the type of rgb.
            rows: [V] rows of `pictures` that the views fill; their own numbers when None.
            background: float32 [3].
            antialiased: compensate opacity for the dilation.

        Raises:
            DeviceMemoryError: not even one view has room.
            DeviceError: the device is lost.
        """
        raise NotImplementedError

    def mark(
        self,
        camera: Camera,
        matrices: F64,
        clouds: Sequence[CloudDevice],
        cloud_of: NDArray[np.int32],
        *,
        threshold: float,
        marks: DeviceArray,
        rows: NDArray[np.int64] | None = None,
        antialiased: bool = False,
    ) -> None:
        """Set bits of splats that weigh more than `threshold` in some pixel of a view.

        Args:
            camera: of all views.
            matrices: world-to-camera [V, 4, 4].
            clouds: different clouds, once each.
            cloud_of: [V] which of them a view shows.
            threshold: of opacity there times what lets through before it.
            marks: uint32 [sets, words], one bit a splat of the cloud at the place that
                `np.packbits` gives it when the words' bytes are read in order. Only set, never
                cleared.
            rows: [V] set that a view marks in; its own number when None.
            antialiased: compensate opacity for the dilation.

        Raises:
            DeviceMemoryError: not even one view has room.
            DeviceError: the device is lost.
        """
        raise NotImplementedError
