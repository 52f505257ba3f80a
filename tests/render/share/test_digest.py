"""Digests of a device are those of `content_hash`."""

from __future__ import annotations

import shutil

import numpy as np
import pytest

from gn0.device.device import DeviceArray
from gn0.device.host import DeviceHost
from gn0.render.share.digest import Mosaics, digest_on_device
from gn0.storage import array_head, content_hash

pytestmark = pytest.mark.skipif(not shutil.which("g++"), reason="the host emulation needs g++")


def digests(found: np.ndarray) -> list[str]:
    return [bytes(row).hex() for row in found]


@pytest.mark.parametrize("shape", [(1, 1, 3), (7, 5, 3), (3, 35, 3), (36, 48, 3), (107,), (64,)])
@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
def test_digests_of_whole_pictures(shape: tuple[int, ...], dtype: type) -> None:
    """Sizes that end within a block, with it, and at any place in memory."""
    device = DeviceHost(seed=1)
    rng = np.random.default_rng(len(shape))
    shown: np.ndarray = rng.integers(0, 256, (11, *shape)).astype(dtype)
    found = digest_on_device(device, [device.upload(shown)]).numpy()
    assert digests(found) == [content_hash(picture) for picture in shown]


def lay_out(tiles: np.ndarray, numbers: np.ndarray, columns: int) -> np.ndarray:
    """Mosaics of tiles [V, cells], row by row; those of number -1 are black."""
    tiles = np.concatenate([tiles, np.zeros_like(tiles[:1])])
    grid = tiles[numbers.reshape(len(numbers), -1, columns)]  # V, rows, columns, h, w, 3
    v, rows, _, h, *_ = grid.shape
    return np.ascontiguousarray(grid.transpose(0, 1, 3, 2, 4, 5).reshape(v, rows * h, -1, 3))


def point_at(held: DeviceArray, numbers: np.ndarray) -> np.ndarray:
    size = held.nbytes // len(held)
    return np.where(numbers < 0, 0, held.pointer + numbers * size).astype(np.uint64)


@pytest.mark.parametrize("tile", [(20, 12), (160, 3), (1, 1), (43, 2)])
def test_digests_of_mosaics_and_others_at_once(tile: tuple[int, int]) -> None:
    device = DeviceHost(seed=2)
    rng = np.random.default_rng(0)
    width, height = tile
    tiles = rng.integers(0, 256, (5, height, width, 3), dtype=np.uint8)
    numbers = rng.integers(-1, 5, (9, 6))
    numbers[0] = -1
    held = device.upload(tiles)
    kinds: list[DeviceArray | Mosaics] = [
        device.empty((0, 4, 4, 3), np.uint8),
        held,
        Mosaics(point_at(held, numbers), tile, 2),
        held,
    ]
    found = digest_on_device(device, kinds).numpy()
    whole = lay_out(tiles, numbers, 2)
    wanted = [content_hash(picture) for picture in [*tiles, *whole, *tiles]]
    assert digests(found) == wanted
    assert digest_on_device(device, []).shape == (0, 16)


@pytest.mark.parametrize("checked", [False, True])
@pytest.mark.parametrize("width", [1, 2, 7, 10, 11, 33, 43, 44, 45, 160])
def test_rows_that_end_anywhere_in_a_block(width: int, checked: bool) -> None:
    """Rows shorter than what a lane reads, than a block, and longer; one kind a grid."""
    device = DeviceHost(seed=width, checked=checked)
    rng = np.random.default_rng(width)
    height = 2 if width > 11 else 5
    tiles = rng.integers(0, 256, (4, height, width, 3), dtype=np.uint8)
    held = device.upload(tiles)
    kinds, wanted = [], []
    for rows, columns in [(1, 1), (1, 4), (2, 1), (3, 2), (4, 4)]:
        numbers = rng.integers(-1, 4, (3, rows * columns))
        kinds.append(Mosaics(point_at(held, numbers), (width, height), columns))
        wanted += [content_hash(shown) for shown in lay_out(tiles, numbers, columns)]
    assert digests(digest_on_device(device, kinds).numpy()) == wanted


@pytest.mark.parametrize("count", [1, 8, 9, 70])
def test_as_many_pictures_as_there_are(count: int) -> None:
    """One and several a warp, with lanes to spare, of kinds that end at different times."""
    device = DeviceHost(seed=count)
    rng = np.random.default_rng(count)
    kinds = [rng.integers(0, 256, (n, 5 * n + 1), np.uint8) for n in (count, 1, 3)]
    found = digest_on_device(device, [device.upload(kind) for kind in kinds]).numpy()
    assert digests(found) == [content_hash(shown) for kind in kinds for shown in kind]


@pytest.mark.parametrize("more", range(-1, 2))
def test_a_picture_that_ends_with_a_block(more: int) -> None:
    device = DeviceHost(seed=3)
    for blocks in (1, 2, 3):
        size = 128 * blocks + more
        size -= len(array_head(np.dtype(np.uint8), (size,)))
        shown = np.random.default_rng(size).integers(0, 256, (3, size), np.uint8)
        head = len(array_head(shown.dtype, shown.shape[1:]))
        assert (head + size) == 128 * blocks + more or blocks == 1  # its size has fewer digits
        found = digest_on_device(device, [device.upload(shown)]).numpy()
        assert digests(found) == [content_hash(picture) for picture in shown]
