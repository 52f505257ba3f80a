"""Who is who on a device: numbers of instances in pictures, and how much of each is seen there."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from gn0.device.device import Device, DeviceArray, KernelSource
from gn0.geometry import F64
from gn0.render.camera import Camera
from gn0.render.cuda.draw import Drawer
from gn0.render.cuda.instances import NO_PART, Instances, find_whose
from gn0.render.cuda.records import CountSeen
from gn0.render.who import SHOWN, SeenInstance, WhoPictures

SOURCE = KernelSource("who", (Path(__file__).parent / "kernels" / "who.cu",))
ALONE_BYTES = 2**28  # of pictures of instances alone that are there at once
_SEEN = 7  # words a row; `who.cu` has the same
_THREADS = 256


class WhoDevice(NamedTuple):
    """Who is who in V views, on the device; see `gn0.render.who`.

    Attributes:
        numbers: uint32 [V, H, W], the place among its view's instances of the one that each pixel
            shows, from 1; 0 none.
        seen: uint32 [I, 7] of each instance: the pixels that show it, those that it has alone,
            those of both, and the box of the first: left, top, right, bottom [px], or zeros.
    """

    numbers: DeviceArray
    seen: DeviceArray

    def fetch(self, counts: Sequence[int]) -> WhoPictures:
        """The same in host memory, of views with as many instances of the same room each."""
        table = self.seen.numpy().astype(int)
        room = len(table) // max(len(counts), 1)
        seen = []
        for view, count in enumerate(counts):
            rows = table[view * room : view * room + count].tolist()
            seen.append([_read(number, row) for number, row in enumerate(rows, start=1)])
        return WhoPictures(self.numbers.numpy(), seen)


def count_all(
    device: Device,
    who: WhoDevice,
    instances: Instances,
    views: int,
    draw_alone: Callable[[NDArray[np.int64], Instances], DeviceArray],
) -> None:
    """Write the rows of `who.seen`.

    Args:
        device: of all arrays.
        who: its numbers are there.
        instances: of so many `views`, on the host.
        views: of the picture.
        draw_alone: opacities [K, H, W] of instances, one in each of the views with these numbers,
            with nothing around them.
    """
    height, width = who.numbers.shape[1:]
    whose, before = find_whose(instances, views)
    shown = np.flatnonzero(np.asarray(instances.chosen) != NO_PART)
    step = max(ALONE_BYTES // (4 * height * width), 1)
    for begin in range(0, len(shown), step):
        rows = shown[begin : begin + step]
        alone = draw_alone(whose[rows], instances.take(rows))
        views_of, places, at = (
            device.upload(of.astype(np.int32)) for of in (whose[rows], before[rows], rows)
        )
        counting = CountSeen(
            numbers=who.numbers,
            alone=alone,
            views=views_of,
            places=places,
            rows=at,
            pixels=np.uint64(height * width),
            width=np.uint32(width),
            shown=np.float32(SHOWN),
            out=who.seen,
        )
        device.load(SOURCE)["count_seen"].launch(len(alone), _THREADS, counting)


def draw_alone(
    drawer: Drawer, camera: Camera, matrices: F64, one_each: Instances, antialiased: bool
) -> DeviceArray:
    """Opacities [V, H, W] of one instance a view, with nothing around it.

    Raises:
        DeviceMemoryError, DeviceError: see `Drawer.draw`.
    """
    pictures = drawer.pictures(camera, len(matrices), ("alpha",))
    drawer.draw(
        *(camera, matrices, [None], np.zeros(len(matrices), np.int32)),
        instances=one_each,
        pictures=pictures,
        background=np.zeros(3, np.float32),
        antialiased=antialiased,
    )
    assert pictures.alpha is not None
    return pictures.alpha


def empty_who(device: Device, views: int, size: tuple[int, int], instances: int) -> WhoDevice:
    """Nobody in pictures of (height, width) [px], with room for so many instances."""
    return WhoDevice(
        device.zeros((views, *size), np.uint32), device.zeros((instances, _SEEN), np.uint32)
    )


def _read(number: int, row: list[int]) -> SeenInstance:
    pixels, whole, both = row[:3]
    left, top, right, bottom = row[3:]
    box = (left, top, right, bottom) if pixels else None
    return SeenInstance(number, pixels, whole, both / whole if whole else 0.0, box)
