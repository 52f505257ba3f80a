"""The same bytes whatever the order of threads and blocks, the batches and the kernels' sizes."""

from __future__ import annotations

import logging
import shutil
from dataclasses import replace

import numpy as np
import pytest

from gn0.device.host import DeviceHost
from gn0.errors import ConfigError, DeviceMemoryError
from gn0.figures.flat import build_flat, flat_bev, flat_camera, flat_views
from gn0.render.cuda.draw import Drawer
from gn0.render.cuda.pack import upload_cloud
from gn0.render.cuda.tune import FEW, Tuning
from gn0.testing.check_renderer import random_cloud

pytestmark = pytest.mark.skipif(not shutil.which("g++"), reason="the host emulation needs g++")

CLOUD = build_flat(5000, sh_degree=1).select(np.random.default_rng(1).permutation(5000))
TAIL = random_cloud(200, seed=5)
SCENES = ((flat_camera(52, 40), flat_views(5)), (flat_bev(72)[0], flat_bev(72)[1][None]))


def bytes_of(device: DeviceHost, drawer: Drawer, scenes=SCENES, cloud=CLOUD) -> list[bytes]:
    packed, tail = upload_cloud(device, cloud), upload_cloud(device, TAIL, sort=False)
    out = []
    for camera, views in scenes:
        pictures = drawer.pictures(camera, len(views), ("rgb", "depth", "alpha"))
        drawer.draw(
            camera, views, [packed], np.zeros(len(views), np.int32), tails=[tail],
            tail_of=np.zeros(len(views), np.int32) - (np.arange(len(views)) % 2),
            pictures=pictures, background=np.array([0.2, 0.4, 0.6], np.float32),
        )  # fmt: skip
        got = pictures.numpy()
        out += [a.tobytes() for a in (got.rgb, got.depth, got.alpha)]
    return out


@pytest.fixture(scope="module")
def want() -> list[bytes]:
    device = DeviceHost()
    return bytes_of(device, Drawer(device))


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_the_order_of_threads_and_blocks_cannot_show(want: list[bytes], seed: int) -> None:
    device = DeviceHost(seed)
    assert bytes_of(device, Drawer(device)) == want


TUNINGS = [
    Tuning(pixels=4, capacity=64, buckets=128, stage=32),  # several groups; parts that fit none
    Tuning(
        pixels=1, buckets=256, stage=64, views=1, chunks=3, large=0
    ),  # whole warps list everything
    Tuning(pixels=4, region_height=4, group=False, views=3, large=10**6),
    Tuning(pixels=1, region_width=4, region_height=2, stage=32),
    FEW,
    Tuning(stage=256, chunks=1, puts=3, predicate=False),
    Tuning(early=True, capacity=256),
    Tuning(pixels=1, region_width=8, region_height=4, large=16),
    Tuning(pixels=2, region_height=8, capacity=1024, buckets=1024, stage=160),
]


@pytest.mark.parametrize("tuning", TUNINGS, ids=range(len(TUNINGS)))
def test_the_sizes_of_the_kernels_cannot_show(want: list[bytes], tuning: Tuning) -> None:
    device = DeviceHost(seed=7)
    assert bytes_of(device, Drawer(device, replace(tuning, spread=4))) == want


def test_kernels_refuse_sizes_that_do_not_fit() -> None:
    for wrong in (
        {"pixels": 3},
        {"buckets": 300},
        {"capacity": 96},
        {"capacity": 64},
        {"stage": 33},
    ):
        with pytest.raises(ConfigError):
            Tuning(**wrong)


def test_batches_cannot_show(want: list[bytes], caplog: pytest.LogCaptureFixture) -> None:
    """Room for about one view: several batches, said once."""
    device = DeviceHost()
    drawer = Drawer(device, memory=25_000)
    with caplog.at_level(logging.WARNING):
        assert bytes_of(device, drawer) == want
    assert drawer.batches > 3
    assert len(caplog.messages) == 1
    assert "at a time" in caplog.messages[0]


def test_lists_that_overflow_are_made_again(want: list[bytes]) -> None:
    """A first guess far too low: nothing of it is seen, and the next call guesses better."""
    device = DeviceHost()
    drawer = Drawer(device)
    drawer._first_density = 0.0
    drawer._held["entries"] = device.empty(16, np.uint64)
    assert bytes_of(device, drawer) == want
    assert drawer.repeats >= 1
    before = drawer.repeats
    assert bytes_of(device, drawer) == want
    assert drawer.repeats == before


def test_a_full_device_makes_batches_smaller(
    want: list[bytes], caplog: pytest.LogCaptureFixture
) -> None:
    """The card has room for the lists of two views, whatever was allowed."""
    device = DeviceHost()
    drawer = Drawer(device, memory=2**30)
    drawer._first_density = 4.0
    empty = device.empty
    device.empty = lambda shape, kind: empty(shape, kind) if small(shape, kind) else refuse()  # type: ignore[method-assign]
    with caplog.at_level(logging.WARNING):
        assert bytes_of(device, drawer) == want
    assert len(caplog.messages) == 1


def small(shape: object, kind: object) -> bool:
    """Whether lists of this size have room."""
    return kind is not np.uint64 or not isinstance(shape, int) or shape < 80_000


def refuse() -> None:
    raise DeviceMemoryError("no room")


def test_a_card_without_room_for_one_view_is_an_error() -> None:
    device = DeviceHost()
    device.empty, empty = lambda s, k: refuse() if k is np.uint64 else empty(s, k), device.empty  # type: ignore[method-assign]
    with pytest.raises(DeviceMemoryError):
        bytes_of(device, Drawer(device))
