"""JPEG files and digests of what is drawn, of mosaics of what was seen, and of maps with dots."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from gn0.device.device import Device, DeviceArray
from gn0.errors import RenderError
from gn0.render.encoding import Dots, Encode, MapPicture
from gn0.render.share.digest import Mosaics, digest_on_device
from gn0.render.share.jpeg import JpegDevice, JpegEncoder
from gn0.render.share.maps import MapPainter
from gn0.render.share.request import Connection, Request

Tile = tuple[DeviceArray, int]  # tiles of a batch, and which of them


@dataclass(frozen=True, eq=False)
class MapFiles:
    """Occupancy pictures of one size.

    Attributes:
        coded: files of them; None where digests alone are wanted.
        rows: which of them are a request's, by its identity.
    """

    coded: JpegDevice | None
    rows: dict[int, slice]


@dataclass(frozen=True, eq=False)
class Files:
    """Files of a batch.

    Attributes:
        views: one entry per view of the batch, in order.
        digests: uint8 [n, 16] of raw pixels.
        hashed: rows of `digests` by what they are of: "files" for the views, "mosaics", "depth"
            where it is wanted, and "maps 0", "maps 1", … in the order of `maps`.
        tiles: reduced views [V, h, w, 3]; None without mosaics.
        mosaics: mosaics of each step of the requests that ended in this batch; None without.
        steps: how many steps each of those requests has, in order.
        maps: occupancy pictures of those requests that want them.
    """

    views: JpegDevice
    digests: DeviceArray
    hashed: dict[str, slice]
    tiles: DeviceArray | None = None
    mosaics: JpegDevice | None = None
    steps: dict[int, int] = field(default_factory=dict)
    maps: Sequence[MapFiles] = ()


class FileMaker:
    """Encodes batches of a server; keeps what each connection has seen last.

    Args:
        device: encodes.
    """

    def __init__(self, device: Device) -> None:
        self._device, self._encoder = device, JpegEncoder(device)
        self._painter = MapPainter(device)
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
        kinds: dict[str, DeviceArray | Mosaics] = {"files": rgb}
        tiles, mosaics = None, None
        steps: dict[int, int] = {}
        seen: list[tuple[Request, list[Tile], list[Tile]]] = []
        if encode.tile is not None:
            tiles = self._encoder.reduce(rgb, *encode.tile)
            table, steps, seen = self._look_back(tiles, encode.tile, pieces)
            if steps:
                kinds["mosaics"] = Mosaics(table, encode.tile, encode.columns)
                mosaics = self._encoder.encode_mosaics(
                    table, encode.tile, encode.columns, encode.quality
                )
        if depth is not None:
            kinds["depth"] = depth
        maps = []
        for group, (coded, pictures) in enumerate(self._paint(encode.quality, pieces)):
            kinds[f"maps {group}"] = pictures
            maps.append(coded)
        hashed, at = {}, 0
        for name, kind in kinds.items():
            count = len(kind.table) if isinstance(kind, Mosaics) else len(kind)
            hashed[name] = slice(at, at + count)
            at += count
        digests = digest_on_device(self._device, list(kinds.values()))
        for request, past, _ in seen:  # only now: a batch that is drawn again begins where it did
            self._seen[request.connection] = past
        return Files(views, digests, hashed, tiles, mosaics, steps, maps)

    def _look_back(
        self,
        tiles: DeviceArray,
        tile: tuple[int, int],
        pieces: Sequence[tuple[Request, slice, bool]],
    ) -> tuple[NDArray[np.uint64], dict[int, int], list[tuple[Request, list[Tile], list[Tile]]]]:
        """Where the tiles of each step's mosaic are, of requests that are whole now.

        Returns:
            Addresses uint64 [steps, cells]; how many steps each request has; what each has seen
            last, and its own tiles, which must stay until its mosaics are made.
        """
        tables: list[NDArray[np.uint64]] = []
        steps: dict[int, int] = {}
        seen: list[tuple[Request, list[Tile], list[Tile]]] = []
        size = 3 * tile[0] * tile[1]
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
            seen.append((request, past, own))
        return np.concatenate(tables) if tables else np.zeros((0, 1), np.uint64), steps, seen

    def _paint(
        self, quality: int, pieces: Sequence[tuple[Request, slice, bool]]
    ) -> Iterator[tuple[MapFiles, DeviceArray]]:
        """Occupancy pictures of requests that are whole now, and files of them."""
        owners: list[Request] = []
        wishes: list[tuple[MapPicture, Dots]] = []
        for request, _, last in pieces:
            wish = request.draw.encode
            if last and wish is not None and wish.dots is not None and wish.dots.count:
                assert request.shown is not None
                owners.append(request)
                wishes.append((request.shown, wish.dots))
        for painted in self._painter.paint(wishes) if wishes else ():
            coded = self._encoder.encode(painted.pictures, quality) if painted.encode else None
            rows = {id(owners[number]): rows for number, rows in painted.rows.items()}
            yield MapFiles(coded, rows), painted.pictures

    def forget(self, requests: Sequence[Request]) -> None:
        """Begin these requests anew."""
        for request in requests:
            self._parts.pop(id(request), None)
