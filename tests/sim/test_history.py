"""The mosaic: sixteen tiles, newest first, row by row, black where nothing was seen."""

from __future__ import annotations

import numpy as np
import pytest

from gn0.sim.history import History, build_mosaic, mosaic_size, reduce_picture


def picture(value: int, height: int = 360, width: int = 480) -> np.ndarray:
    return np.full((height, width, 3), value, np.uint8)


def tile(mosaic: np.ndarray, index: int) -> np.ndarray:
    row, column = divmod(index, 4)
    return mosaic[row * 120 : (row + 1) * 120, column * 160 : (column + 1) * 160]


def test_empty_is_black() -> None:
    mosaic = History().mosaic()
    assert mosaic.shape == (480, 640, 3)
    assert mosaic.dtype == np.uint8
    assert not mosaic.any()


@pytest.mark.parametrize("count", [1, 4, 5, 16, 23])
def test_newest_is_top_left_and_the_oldest_falls_off(count: int) -> None:
    history = History()
    for value in range(1, count + 1):
        history.add(picture(value))
    mosaic = history.mosaic()
    for index in range(16):
        expected = max(count - index, 0)
        assert (tile(mosaic, index) == expected).all()


def test_clear_forgets() -> None:
    history = History()
    history.add(picture(9))
    history.clear()
    assert not history.mosaic().any()
    assert history.tiles == ()


def test_reduction_is_the_mean_of_the_area() -> None:
    rng = np.random.default_rng(0)
    rgb = rng.integers(0, 256, (360, 480, 3), dtype=np.uint8)
    small = reduce_picture(rgb, 160, 120)
    mean = rgb.reshape(120, 3, 160, 3, 3).mean(axis=(1, 3))
    assert np.abs(small - mean).max() < 1.0  # Pillow rounds after each axis


def test_reduction_keeps_the_brightness_of_odd_sizes() -> None:
    rgb = np.random.default_rng(1).integers(0, 256, (224, 224, 3), dtype=np.uint8)
    assert reduce_picture(rgb, 160, 120).mean() == pytest.approx(rgb.mean(), abs=0.5)


def test_tiles_of_another_size() -> None:
    history = History(size=(32, 24))
    for value in (1, 2):
        history.add(picture(value))
    mosaic = history.mosaic()
    assert mosaic.shape == (96, 128, 3) == (*mosaic_size((32, 24))[::-1], 3)
    assert (mosaic[:24, :32] == 2).all() and (mosaic[:24, 32:64] == 1).all()
    assert not mosaic[:, 64:].any()


def test_a_view_as_large_as_a_tile_is_kept_as_it_was() -> None:
    history, view = History(size=(32, 24)), picture(5, 24, 32)
    history.add(view)
    view[:] = 9
    assert (history.tiles[0] == 5).all()


def test_mosaics_share_no_memory_with_their_tiles() -> None:
    tiles = [np.ones((120, 160, 3), np.uint8)]
    build_mosaic(tiles)[:] = 7
    assert (tiles[0] == 1).all()
