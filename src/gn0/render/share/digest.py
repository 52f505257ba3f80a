"""Digests of pictures made where the pictures are: those of `gn0.storage.content_hash`."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from gn0.device.device import Device, DeviceArray, KernelSource
from gn0.storage import array_head

SOURCE = KernelSource("digest", (Path(__file__).parent / "kernels" / "digest.cu",))
SIZE = 16  # bytes of a digest
_LANES = 4  # of a picture
_PICTURES = 8  # at most that a warp takes
_SCHEDULERS = 4  # of a multiprocessor: a warp each, while there are enough
_HEAD = 64
_KIND = np.dtype(
    [
        ("pixels", "u8"), ("table", "u8"), ("size", "u4"), ("line", "u4"), ("height", "u4"),
        ("columns", "u4"), ("rows", "u4"), ("first", "u4"), ("count", "u4"), ("begin", "u4"),
        ("said", "u4"),
        ("head", "u1", _HEAD),
    ],
    align=True,
)  # fmt: skip


class DigestPictures(NamedTuple):
    """`digest_pictures`: of pictures of several kinds, by a row of `_KIND` each."""

    kinds: DeviceArray
    kind_count: np.int32
    digests: DeviceArray


@dataclass(frozen=True, eq=False)
class Mosaics:
    """Mosaics that are not laid out: which tiles each has.

    Attributes:
        table: address on the device of each mosaic's tiles uint8 [h, w, 3] [V, cells], row by row;
            0 is black.
        tile: their width and height [px].
        columns: columns of a mosaic.
    """

    table: NDArray[np.uint64]
    tile: tuple[int, int]
    columns: int


def digest_on_device(device: Device, kinds: Sequence[DeviceArray | Mosaics]) -> DeviceArray:
    """Digests of pictures on a device: `content_hash` of each.

    Args:
        device: hashes.
        kinds: arrays of pictures [V, …], each picture an array of its own, and mosaics. What they
            name must stay until the work is done.

    Returns:
        uint8 [n, 16], of all pictures, in order.
    """
    given = [kind for kind in kinds if _count(kind)]
    count = sum(map(_count, given))
    found = device.empty((count, SIZE), np.uint8)
    if not count:
        return found
    each = min(-(-count // (_SCHEDULERS * device.multiprocessors)), _PICTURES)  # a block
    rows = np.zeros(len(given), _KIND)
    held, first, begin = [], 0, 0
    for row, kind in zip(rows, given, strict=True):
        row["first"], row["count"], row["begin"] = first, _count(kind), begin
        if isinstance(kind, Mosaics):
            width, height = kind.tile
            grid = kind.table.shape[1] // kind.columns
            shape: tuple[int, ...] = (height * grid, width * kind.columns, 3)
            dtype = np.dtype(np.uint8)
            table = device.upload(np.ascontiguousarray(kind.table, np.uint64))
            held.append(table)
            row["table"], row["line"], row["height"] = table.pointer, 3 * width, height
            row["columns"], row["rows"] = kind.columns, grid
        else:
            shape, dtype = kind.shape[1:], kind.dtype
            row["pixels"], row["line"] = kind.pointer, kind.nbytes // len(kind)
            row["height"] = row["columns"] = row["rows"] = 1
        row["size"] = int(np.prod(shape)) * dtype.itemsize
        head = array_head(dtype, shape)
        row["said"] = len(head)
        row["head"][: len(head)] = np.frombuffer(head, np.uint8)
        first += _count(kind)
        begin += -(-_count(kind) // each)
    record = DigestPictures(device.upload(rows), np.int32(len(rows)), found)
    device.load(SOURCE)["digest_pictures"].launch(begin, _LANES * each, record)
    return found


def _count(kind: DeviceArray | Mosaics) -> int:
    return len(kind.table) if isinstance(kind, Mosaics) else len(kind)
