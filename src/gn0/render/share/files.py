"""JPEG files and digests of what is drawn, and of mosaics of what was seen, on the device."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from gn0.device.device import Device, DeviceArray
from gn0.errors import RenderError
from gn0.render.share.digest import Mosaics, digest_on_device
from gn0.render.share.jpeg import JpegDevice, JpegEncoder
from gn0.render.share.messages import Encode
from gn0.render.share.request import Connection, Request

Tile = tuple[DeviceArray, int]  # tiles of a batch, and which of them


@dataclass(frozen=True, eq=False)
class Files:
    """Files of a batch.

    Attributes:
        views: of each view of the batch, in order.
        digests: uint8 [n, 16] of the raw pixels of each view, of each mosaic, and of each view's
            depth where it is wanted.
        tiles: reduced views [V, h, w, 3]; None without mosaics.
        mosaics: of each step of the requests that ended in this batch; None without.
        steps: of those requests, how many steps each has, in order.
    """

    views: JpegDevice
    digests: DeviceArray
    tiles: DeviceArray | None = None
    mosaics: JpegDevice | None = None
    steps: dict[int, int] = field(default_factory=dict)


class FileMaker:
    """Encodes batches of a server; keeps what each connection has seen last.

    Args:
        device: encodes.
    """

    def __init__(self, device: Device) -> None:
        self._device, self._encoder = device, JpegEncoder(device)
        self._seen: dict[Connection, list[Tile]] = {}
        self._parts: dict[int, list[Tile]] = {}  # views of requests that are not whole yet

    def make(
        self,
        rgb: DeviceArray,
        encode: Encode,
        pieces: Sequence[tuple[Request, slice, bool]],
        depth: DeviceArray | None = None,
    ) -> Files:
        """Files of a batch.

        Args:
            rgb: its pictures uint8 [V, H, W, 3].
            encode: what is wanted, alike for all its requests but for steps.
            pieces: request, its rows in the batch, and whether these are the last.
            depth: uint16 [V, H, W], where its digests are wanted too.

        Raises:
            RenderError: a step has no view.
            DeviceMemoryError: there is no room.
        """
        self._seen = {one: past for one, past in self._seen.items() if not one.closed}
        views = self._encoder.encode(rgb, encode.quality)
        deep = [] if depth is None else [depth]
        if encode.tile is None:
            return Files(views, digest_on_device(self._device, [rgb, *deep]))
        tiles = self._encoder.reduce(rgb, *encode.tile)
        tables, steps, seen = [], {}, []
        size = 3 * encode.tile[0] * encode.tile[1]
        for request, rows, last in pieces:
            own = self._parts.pop(id(request), [])
            own += [(tiles, row) for row in range(rows.start, rows.stop)]
            if not last:
                self._parts[id(request)] = own
                continue
            wish = request.draw.encode
            assert wish is not None
            past: list[Tile] = [] if wish.begin else self._seen.get(request.connection, [])
            numbers = np.frombuffer(wish.steps, np.int32).tolist()
            table = np.zeros((len(numbers), wish.cells), np.uint64)
            for step, number in enumerate(numbers):
                if not 0 <= number < len(own):
                    raise RenderError(f"step {step} has no view {number}", where="drawing socket")
                table[step, : len(past)] = [array.pointer + at * size for array, at in past]
                past = [own[number], *past][: wish.cells]
            steps[id(request)] = len(numbers)
            tables.append(table)
            seen.append((request, past))
        mosaics, laid = None, []
        if tables:
            table = np.concatenate(tables)
            laid = [Mosaics(table, encode.tile, encode.columns)]
            mosaics = self._encoder.encode_mosaics(
                table, encode.tile, encode.columns, encode.quality
            )
        digests = digest_on_device(self._device, [rgb, *laid, *deep])
        for request, past in seen:  # only now: a batch that is drawn again begins where it did
            self._seen[request.connection] = past
        return Files(views, digests, tiles, mosaics, steps)

    def forget(self, requests: Sequence[Request]) -> None:
        """Begin these requests anew."""
        for request in requests:
            self._parts.pop(id(request), None)
