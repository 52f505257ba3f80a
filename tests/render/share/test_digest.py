"""Digests of a device are those of `content_hash`."""

from __future__ import annotations

import shutil

import numpy as np
import pytest

from gn0.device.host import DeviceHost
from gn0.render.share.digest import Mosaics, digest_on_device
from gn0.storage import content_hash

pytestmark = pytest.mark.skipif(not shutil.which("g++"), reason="the host emulation needs g++")


def digests(found: np.ndarray) -> list[str]:
    return [bytes(row).hex() for row in found]


@pytest.mark.parametrize("shape", [(1, 1, 3), (7, 5, 3), (3, 35, 3), (36, 48, 3), (107,), (64,)])
@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
def test_digests_of_whole_pictures(shape: tuple[int, ...], dtype: type) -> None:
    """Sizes that end within a block, with it, and at any place in memory."""
    device = DeviceHost(seed=1)
    rng = np.random.default_rng(len(shape))
    shown = rng.integers(0, 256, (11, *shape)).astype(dtype)
    found = digest_on_device(device, [device.upload(shown)]).numpy()
    assert digests(found) == [content_hash(picture) for picture in shown]


@pytest.mark.parametrize("tile", [(20, 12), (160, 3), (1, 1), (43, 2)])
def test_digests_of_mosaics_and_others_at_once(tile: tuple[int, int]) -> None:
    device = DeviceHost(seed=2)
    rng = np.random.default_rng(0)
    width, height = tile
    tiles = rng.integers(0, 256, (5, height, width, 3), dtype=np.uint8)
    numbers = rng.integers(-1, 5, (9, 6))
    numbers[0] = -1
    held = device.upload(tiles)
    table = np.where(numbers < 0, 0, held.pointer + numbers * tiles[0].nbytes).astype(np.uint64)
    whole = [
        np.concatenate(
            [
                np.concatenate([tiles[n] if n >= 0 else np.zeros_like(tiles[0]) for n in line], 1)
                for line in row.reshape(3, 2)
            ]
        )
        for row in numbers
    ]
    kinds = [device.empty((0, 4, 4, 3), np.uint8), held, Mosaics(table, tile, 2), held]
    found = digest_on_device(device, kinds).numpy()
    wanted = [content_hash(picture) for picture in [*tiles, *whole, *tiles]]
    assert digests(found) == wanted
    assert digest_on_device(device, []).shape == (0, 16)
