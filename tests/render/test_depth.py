"""Depth in whole millimetres: its range, its rounding, and what nothing reads as."""

from __future__ import annotations

import shutil

import numpy as np
import pytest

from gn0.device.host import DeviceHost
from gn0.render.cuda.depth import scale_on_device
from gn0.render.depth import to_metres, to_millimetres

METRES = np.array(
    [
        *(np.inf, np.nan, -np.inf, -1.0, 0.0, 0.0004, 0.0005, 0.001, 0.0015, 0.0025, 0.01, 1.0),
        *(1.2344, 1.2346, 10.0, 65.534, 65.5349, 65.535, 65.5354, 70.0, 1e6, 3e38),
    ],
    np.float32,
)
MILLIMETRES = [
    *(0, 0, 1, 1, 1, 1, 1, 1, 2, 2, 10, 1000),
    *(1234, 1235, 10000, 65534, 65535, 65535, 65535, 65535, 65535, 65535),
]


def test_metres_become_the_nearest_millimetre_and_nothing_becomes_0() -> None:
    found = to_millimetres(METRES)
    assert found.dtype == np.uint16
    assert found.tolist() == MILLIMETRES


def test_halves_go_to_the_even_millimetre() -> None:
    halves = np.array([0.0625, 0.1875, 4.0625], np.float32)  # 62.5, 187.5 and 4062.5 mm, exactly
    assert to_millimetres(halves).tolist() == [62, 188, 4062]


def test_a_sensor_reads_it_within_half_a_millimetre_in_its_range() -> None:
    rng = np.random.default_rng(0)
    depth = rng.uniform(0.01, 60.0, 100_000).astype(np.float32)
    back = to_metres(to_millimetres(depth), (0.0, 100.0))
    assert back.dtype == np.float32
    assert np.abs(back.astype(np.float64) - depth).max() < 0.0005 + 1e-5
    assert to_millimetres(back).tolist() == to_millimetres(depth).tolist()
    clipped = to_metres(np.array([0, 1, 499, 500, 3000, 9999, 10001, 65535], np.uint16), (0.5, 10))
    assert clipped.tolist() == [10.0, 0.5, 0.5, 0.5, 3.0, np.float32(9.999), 10.0, 10.0]


@pytest.mark.skipif(not shutil.which("g++"), reason="the host emulation needs g++")
@pytest.mark.parametrize("checked", [False, True])
def test_a_device_makes_the_same_values(checked: bool) -> None:
    device = DeviceHost(seed=3, checked=checked)
    rng = np.random.default_rng(1)
    many = rng.uniform(0, 80, (3, 23, 17)).astype(np.float32)
    many.reshape(-1)[: len(METRES)] = METRES
    halves = (np.arange(23 * 17, dtype=np.float32) / 16).reshape(1, 23, 17)
    for depth in (many, halves, many[:0]):
        found = scale_on_device(device, device.upload(depth))
        np.testing.assert_array_equal(found.numpy(), to_millimetres(depth))


def test_pictures_without_depth_stay_as_they_are() -> None:
    from gn0.render.renderer import RenderResult

    pictures = RenderResult(np.zeros((1, 2, 2, 3), np.uint8), None, None)
    assert pictures.in_millimetres() is pictures
