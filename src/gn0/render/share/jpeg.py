"""JPEG files made on a device: the bytes that Pillow (libjpeg) writes, without the wait.

Quantisation and Huffman tables, and everything before the first coded bit, are taken from a file
that Pillow itself writes for a picture of that size, so both agree by construction; the tests
compare whole files.
"""

from __future__ import annotations

import io
import struct
from dataclasses import dataclass
from functools import lru_cache
from itertools import pairwise
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from gn0.device.device import Device, DeviceArray, KernelSource
from gn0.errors import DeviceError, RenderError

SOURCE = KernelSource("jpeg", (Path(__file__).parent / "kernels" / "jpeg.cu",))
_THREADS = 128
_END = b"\xff\xd9"


class JpegTransform(NamedTuple):
    """`jpeg_transform`: quantised coefficients of pictures, or of mosaics of tiles."""

    pixels: DeviceArray | None
    table: DeviceArray | None
    width: np.int32
    height: np.int32
    tile_width: np.int32
    tile_height: np.int32
    columns: np.int32
    cells: np.int32
    steps: DeviceArray
    views: np.int32
    coefficients: DeviceArray


class JpegCount(NamedTuple):
    """`jpeg_count`: bits of each block."""

    coefficients: DeviceArray
    codes: DeviceArray
    blocks: np.int32
    bits: DeviceArray


class JpegScan(NamedTuple):
    """`jpeg_scan`: where each block's bits begin, and how many a picture has."""

    blocks: np.int32
    bits: DeviceArray
    totals: DeviceArray


class JpegWrite(NamedTuple):
    """`jpeg_write`: the bits."""

    coefficients: DeviceArray
    codes: DeviceArray
    blocks: np.int32
    starts: DeviceArray
    room: np.int32
    words: DeviceArray


class JpegStuff(NamedTuple):
    """`jpeg_stuff`: how many bytes they are with those that a file needs between; and those."""

    words: DeviceArray
    totals: DeviceArray
    room: np.int32
    starts: DeviceArray | None
    sizes: DeviceArray
    out: DeviceArray | None


class ReduceTiles(NamedTuple):
    """`reduce_tiles`: smaller pictures."""

    pictures: DeviceArray
    views: np.int32
    width: np.int32
    height: np.int32
    by_x: np.int32
    by_y: np.int32
    tiles: DeviceArray


@dataclass(frozen=True, eq=False)
class JpegTables:
    """What a JPEG file of one size and quality says before its first coded bit.

    Attributes:
        head: those bytes.
        steps: quantisation int32 [2, 64], luma and chroma, in zigzag order.
        codes: Huffman codes uint32 [2, 272]: 256 AC symbols and 16 DC sizes, each
            length << 16 | code.
    """

    head: bytes
    steps: NDArray[np.int32]
    codes: NDArray[np.uint32]


@lru_cache(maxsize=64)
def read_tables(width: int, height: int, quality: int) -> JpegTables:
    """The tables that Pillow uses for a picture of that size, 4:2:0.

    Raises:
        DeviceError: this Pillow writes another kind of file.
    """
    stream = io.BytesIO()
    Image.new("RGB", (width, height)).save(stream, "JPEG", quality=quality, subsampling=2)
    data = stream.getvalue()
    steps = np.zeros((2, 64), np.int32)
    codes = np.zeros((2, 272), np.uint32)
    at = 2
    while True:
        marker, size = struct.unpack_from(">HH", data, at)
        body = data[at + 4 : at + 2 + size]
        at += 2 + size
        if marker == 0xFFDB:
            for begin in range(0, len(body), 65):
                if body[begin] > 1:
                    raise DeviceError("Pillow writes quantisation tables of another kind")
                steps[body[begin]] = np.frombuffer(body, np.uint8, 64, begin + 1)
        elif marker == 0xFFC4:
            _read_codes(body, codes)
        elif marker in (0xFFC1, 0xFFC2):
            raise DeviceError("Pillow writes no baseline JPEG")
        elif marker == 0xFFDA:
            return JpegTables(data[:at], steps, codes)


def _read_codes(body: bytes, codes: NDArray[np.uint32]) -> None:
    """Take Huffman tables: counts of each length, then the symbols in order."""
    at = 0
    while at < len(body):
        kind, table = divmod(body[at], 16)
        counts = body[at + 1 : at + 17]
        at += 17
        code = 0
        for length, count in enumerate(counts, 1):
            for _ in range(count):
                symbol = body[at] + (0 if kind else 256)
                codes[table, symbol] = length << 16 | code
                code += 1
                at += 1
            code <<= 1


@dataclass(frozen=True, eq=False)
class JpegDevice:
    """JPEG files on a device, without what they have in common.

    Attributes:
        head: the bytes that each begins with.
        data: uint8 [total], the coded bytes of all.
        starts: where each begins in `data` int64 [V + 1].
    """

    head: bytes
    data: DeviceArray
    starts: NDArray[np.int64]

    def files(self, data: NDArray[np.uint8] | None = None) -> list[bytes]:
        """The files; `data` is a host copy where there is one already."""
        host = self.data.numpy() if data is None else data
        return join_files(self.head, host, self.starts)


def join_files(head: bytes, data: NDArray[np.uint8], starts: NDArray[np.int64]) -> list[bytes]:
    """Whole files from what they have in common and their own bytes `data[starts[i]:…]`."""
    return [head + data[begin:end].tobytes() + _END for begin, end in pairwise(starts.tolist())]


class JpegEncoder:
    """Encodes pictures that are on a device.

    Args:
        device: encodes.
    """

    def __init__(self, device: Device) -> None:
        self.device = device
        self._kernels = device.load(SOURCE)
        self._tables: dict[int, tuple[DeviceArray, DeviceArray]] = {}

    def encode(self, pictures: DeviceArray, quality: int) -> JpegDevice:
        """JPEG files of pictures uint8 [V, H, W, 3]."""
        count, height, width, _ = pictures.shape
        return self._encode(pictures, None, count, (width, height), (1, 1), 1, quality)

    def encode_mosaics(
        self, table: NDArray[np.uint64], tile: tuple[int, int], columns: int, quality: int
    ) -> JpegDevice:
        """JPEG files of mosaics.

        Args:
            table: address on the device of each mosaic's tiles uint8 [h, w, 3] [V, cells], row by
                row; 0 is black. The tiles must stay until this has returned.
            tile: their width and height [px].
            columns: columns of a mosaic.
            quality: 1 to 100.
        """
        size = (tile[0] * columns, tile[1] * (table.shape[1] // columns))
        numbers = self.device.upload(np.ascontiguousarray(table, np.uint64))
        return self._encode(None, numbers, len(table), size, tile, columns, quality)

    def reduce(self, pictures: DeviceArray, width: int, height: int) -> DeviceArray:
        """Pictures uint8 [V, H, W, 3] reduced to [V, height, width, 3] as Pillow's BOX does.

        Raises:
            RenderError: a side is no whole multiple.
        """
        count, high, wide, _ = pictures.shape
        if wide % width or high % height:
            raise RenderError(f"{wide}x{high} is not a multiple of {width}x{height}")
        tiles = self.device.empty((count, height, width, 3), np.uint8)
        reducing = ReduceTiles(
            pictures=pictures,
            views=np.int32(count),
            width=np.int32(wide),
            height=np.int32(high),
            by_x=np.int32(wide // width),
            by_y=np.int32(high // height),
            tiles=tiles,
        )
        self._kernels["reduce_tiles"].launch(-(-tiles.size // _THREADS), _THREADS, reducing)
        return tiles

    def _encode(
        self,
        pixels: DeviceArray | None,
        table: DeviceArray | None,
        count: int,
        size: tuple[int, int],
        tile: tuple[int, int],
        columns: int,
        quality: int,
    ) -> JpegDevice:
        device, kernels = self.device, self._kernels
        tables = read_tables(*size, quality)
        if not count:
            return JpegDevice(tables.head, device.empty(0, np.uint8), np.zeros(1, np.int64))
        if quality not in self._tables:
            self._tables[quality] = device.upload(tables.steps), device.upload(tables.codes)
        steps, codes = self._tables[quality]
        width, height = size
        units = -(-width // 16) * -(-height // 16)
        blocks = units * 6
        cells = 1 if table is None else table.shape[1]
        coefficients = device.empty((count, blocks, 64), np.uint16)
        transform = JpegTransform(
            pixels=pixels,
            table=table,
            width=np.int32(width),
            height=np.int32(height),
            tile_width=np.int32(tile[0]),
            tile_height=np.int32(tile[1]),
            columns=np.int32(columns),
            cells=np.int32(cells),
            steps=steps,
            views=np.int32(count),
            coefficients=coefficients,
        )
        kernels["jpeg_transform"].launch(-(-count * units // 4), 128, transform)
        grid = (-(-blocks // _THREADS), count)
        bits, totals = device.empty((count, blocks), np.uint32), device.empty(count, np.uint32)
        sizing = JpegCount(coefficients, codes, np.int32(blocks), bits)
        kernels["jpeg_count"].launch(grid, _THREADS, sizing)
        kernels["jpeg_scan"].launch(count, 256, JpegScan(np.int32(blocks), bits, totals))
        room = int(totals.numpy().max()) // 32 + 2
        words = device.zeros((count, room), np.uint32)
        writing = JpegWrite(
            coefficients=coefficients,
            codes=codes,
            blocks=np.int32(blocks),
            starts=bits,
            room=np.int32(room),
            words=words,
        )
        kernels["jpeg_write"].launch(grid, _THREADS, writing)
        sizes = device.empty(count, np.uint32)
        stuffing = JpegStuff(words, totals, np.int32(room), starts=None, sizes=sizes, out=None)
        kernels["jpeg_stuff"].launch(count, 256, stuffing)
        starts = np.zeros(count + 1, np.int64)
        np.cumsum(sizes.numpy(), out=starts[1:])
        data = device.empty(int(starts[-1]), np.uint8)
        places = device.upload(starts[:-1].astype(np.uint64))
        stuffing = stuffing._replace(starts=places, out=data)
        kernels["jpeg_stuff"].launch(count, 256, stuffing)
        return JpegDevice(tables.head, data, starts)
