"""JPEG files of a device are Pillow's, byte for byte."""

from __future__ import annotations

import io
import shutil

import numpy as np
import pytest
from PIL import Image

from gn0.device.host import DeviceHost
from gn0.render.share.jpeg import JpegEncoder, read_tables

pytestmark = pytest.mark.skipif(not shutil.which("g++"), reason="the host emulation needs g++")


def pillow(picture: np.ndarray, quality: int) -> bytes:
    stream = io.BytesIO()
    Image.fromarray(picture).save(stream, "JPEG", quality=quality, subsampling=2)
    return stream.getvalue()


def pictures(width: int, height: int, seed: int = 0) -> np.ndarray:
    """Smooth, noisy, flat, saturated, and with hard edges."""
    rng = np.random.default_rng(seed)
    y, x = np.mgrid[:height, :width]
    smooth = np.stack([x * 3 + y, x + y * 2, 255 - x], 2) % 256
    noise = rng.integers(0, 256, (height, width, 3))
    flat = np.full((height, width, 3), 200)
    hard = np.where(((x // 5 + y // 3) % 2)[..., None], (255, 0, 0), (0, 0, 255))
    soft = np.clip(smooth + rng.normal(0, 6, smooth.shape), 0, 255)
    return np.stack([smooth, noise, flat, hard, soft]).astype(np.uint8)


@pytest.mark.parametrize("size", [(64, 48), (48, 40), (33, 17), (8, 8), (1, 1), (23, 90)])
@pytest.mark.parametrize("quality", [85, 90, 100, 5])
def test_files_are_pillows(size: tuple[int, int], quality: int) -> None:
    device = DeviceHost(seed=quality)
    shown = pictures(*size)
    files = JpegEncoder(device).encode(device.upload(shown), quality).files()
    for picture, file in zip(shown, files, strict=True):
        assert file == pillow(picture, quality)


def test_mosaics_are_made_of_tiles() -> None:
    device = DeviceHost(seed=2)
    tiles = pictures(20, 12)
    table = np.array([[0, 1, 2, 3], [4, -1, 0, -1], [-1, -1, -1, -1]], np.int32)
    held = device.upload(tiles)
    places = np.where(table < 0, 0, held.pointer + table.astype(np.int64) * tiles[0].nbytes)
    files = JpegEncoder(device).encode_mosaics(places, (20, 12), 2, 85).files()
    for row, file in zip(table, files, strict=True):
        whole = np.zeros((24, 40, 3), np.uint8)
        for place, tile in enumerate(row.tolist()):
            if tile >= 0:
                y, x = divmod(place, 2)
                whole[y * 12 : y * 12 + 12, x * 20 : x * 20 + 20] = tiles[tile]
        assert file == pillow(whole, 85)


@pytest.mark.parametrize("factor", [(3, 3), (2, 4), (1, 1), (5, 7)])
def test_tiles_are_reduced_as_pillow_does(factor: tuple[int, int]) -> None:
    device = DeviceHost(seed=1)
    size = (6 * factor[0], 4 * factor[1])
    shown = pictures(*size)
    tiles = JpegEncoder(device).reduce(device.upload(shown), 6, 4).numpy()
    for picture, tile in zip(shown, tiles, strict=True):
        wanted = Image.fromarray(picture).resize((6, 4), Image.Resampling.BOX)
        np.testing.assert_array_equal(tile, np.asarray(wanted))


@pytest.mark.parametrize("size", [(33, 17), (16, 48)])
def test_no_thread_reads_what_another_may_be_writing(size: tuple[int, int]) -> None:
    device = DeviceHost(seed=4, checked=True)
    shown, encoder = pictures(*size), JpegEncoder(device)
    files = encoder.encode(device.upload(shown), 90).files()
    assert files[1] == pillow(shown[1], 90)
    assert encoder.reduce(device.upload(shown), size[0], 1).numpy().any()


def test_no_pictures_are_no_files() -> None:
    device = DeviceHost()
    assert JpegEncoder(device).encode(device.empty((0, 8, 8, 3), np.uint8), 85).files() == []
    assert read_tables(8, 8, 85).head[:2] == b"\xff\xd8"
