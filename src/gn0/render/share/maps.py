"""Occupancy pictures of steps, painted where views are drawn: a map and two dots."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np

from gn0.device.device import Device, DeviceArray, KernelSource
from gn0.render.encoding import Dots, MapPicture

SOURCE = KernelSource("maps", (Path(__file__).parent / "kernels" / "maps.cu",))
KEPT = 2**28  # bytes of maps on the device, beyond those that are being painted
_THREADS = 256
_RUN = 4096  # pixels a block, as in the kernel
_SHOWN = np.dtype([("grey", "u8"), ("at", "i4", (2, 2)), ("radius", "i4")], align=True)


class PaintMaps(NamedTuple):
    """`paint_maps`: maps with dots, by a row of `_SHOWN` each."""

    shown: DeviceArray
    rows: np.int32
    cols: np.int32
    pictures: DeviceArray


@dataclass(frozen=True, eq=False)
class Painted:
    """Occupancy pictures of one size.

    Attributes:
        pictures: uint8 [n, H, W, 3].
        encode: whether files of them are wanted.
        rows: which of them belong to each of the wishes that were painted, by number.
    """

    pictures: DeviceArray
    encode: bool
    rows: dict[int, slice]


class MapPainter:
    """Paints occupancy pictures; keeps the maps that it has painted.

    Args:
        device: paints.
    """

    def __init__(self, device: Device) -> None:
        self._device = device
        self._maps: OrderedDict[str, DeviceArray] = OrderedDict()

    def paint(self, wishes: Sequence[tuple[MapPicture, Dots]]) -> list[Painted]:
        """The pictures of some maps with dots, those of one size side by side.

        Raises:
            FormatError: a map is invalid.
            DeviceMemoryError: there is no room.
        """
        groups: dict[tuple[tuple[int, int], bool], list[int]] = {}
        for number, (bare, dots) in enumerate(wishes):
            groups.setdefault((bare.shape, dots.encode), []).append(number)
        found = []
        for (shape, encode), numbers in groups.items():
            rows, parts, at = {}, [], 0
            for number in numbers:
                bare, dots = wishes[number]
                shown = np.zeros(dots.count, _SHOWN)
                shown["grey"] = self._hold(bare).pointer
                shown["at"] = np.frombuffer(dots.places, np.int32).reshape(-1, 2, 2)
                shown["radius"] = dots.radius
                rows[number] = slice(at, at + dots.count)
                parts.append(shown)
                at += dots.count
            pictures = self._device.empty((at, *shape, 3), np.uint8)
            if pictures.size:
                painting = PaintMaps(
                    shown=self._device.upload(np.concatenate(parts)),
                    rows=np.int32(shape[0]),
                    cols=np.int32(shape[1]),
                    pictures=pictures,
                )
                grid = (at, -(-shape[0] * shape[1] // _RUN))
                self._device.load(SOURCE)["paint_maps"].launch(grid, _THREADS, painting)
            found.append(Painted(pictures, encode, rows))
        while sum(array.nbytes for array in self._maps.values()) > KEPT:
            self._maps.popitem(last=False)
        return found

    def _hold(self, bare: MapPicture) -> DeviceArray:
        """The grey of a map on the device."""
        if bare.name not in self._maps:
            self._maps[bare.name] = self._device.upload(bare.pixels)
        self._maps.move_to_end(bare.name)
        return self._maps[bare.name]
