"""The same bytes whatever the order of threads and blocks, the batches and the kernels' sizes."""

from __future__ import annotations

import logging
import shutil
from dataclasses import replace

import numpy as np
import pytest

from gn0.device.host import DeviceHost
from gn0.errors import ConfigError, DeviceError, DeviceMemoryError
from gn0.render.cuda import draw
from gn0.render.cuda.draw import Drawer
from gn0.render.cuda.pack import upload_cloud
from gn0.render.cuda.replay import NO_ROOM, Heard
from gn0.render.cuda.tables import NOWHERE
from gn0.render.cuda.tune import FEW, Tuning
from gn0.testing.renderer_check import random_cloud
from gn0_figures.flat import build_flat, flat_bev, flat_camera, flat_views

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


# several groups, parts that fit none; whole warps list everything. Other files here take the same
# sizes: the emulation compiles each once
SMALL = Tuning(capacity=128, buckets=128, stage=32, views=2, large=2, split=7)
ROUGH = Tuning(threads=256, buckets=256, capacity=256, stage=64, large=0, chunks=1, split=500)
TUNINGS = [
    SMALL,
    Tuning(
        threads=256, buckets=256, stage=64, views=1, chunks=3, large=0
    ),  # whole warps list everything
    Tuning(stage=64, group=False, views=3, large=10**6),
    Tuning(threads=256, stage=32, buckets=256, capacity=256),
    FEW,
    Tuning(stage=256, chunks=1, puts=3, predicate=False),
    Tuning(turns=1, capacity=256),
    Tuning(threads=256, stage=256, large=16, turns=3),
    Tuning(capacity=1024, buckets=1024, stage=160),
]


@pytest.mark.parametrize(
    "tuning",
    [
        pytest.param(tuning, id=str(k), marks=[pytest.mark.slow] * (k % 4 != 0))
        for k, tuning in enumerate(TUNINGS)
    ],
)
def test_the_sizes_of_the_kernels_cannot_show(want: list[bytes], tuning: Tuning) -> None:
    device = DeviceHost(seed=7)
    assert bytes_of(device, Drawer(device, replace(tuning, spread=4))) == want


@pytest.mark.parametrize("width", [52, 50, pytest.param(37, marks=pytest.mark.slow)])
def test_quarters_of_tiles_cannot_show(width: int) -> None:
    """Once lists have equal room, the longest tiles are drawn by four blocks each."""
    scenes = ((flat_camera(width, 43), flat_views(2)), (flat_bev(72)[0], flat_bev(72)[1][None]))
    device = DeviceHost(seed=3)
    want = bytes_of(device, Drawer(device), scenes)
    for tuning in (SMALL, ROUGH):
        drawer = Drawer(device, tuning)
        assert bytes_of(device, drawer, scenes) == want
        assert max(drawer._longest.values()) > 2 * tuning.capacity
        assert bytes_of(device, drawer, scenes) == want
        assert "aside" in drawer._held


@pytest.mark.parametrize("sample", [2, pytest.param(4, marks=pytest.mark.slow)])
def test_a_sample_of_the_count_cannot_show(
    want: list[bytes], sample: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Lists get room by some of the splats, many chunks a block or one, and a tail counts too."""
    monkeypatch.setattr(draw, "_SAMPLED", 1)
    for tuning in (Tuning(spread=4), Tuning(spread=10**6), SMALL):
        drawer = Drawer(DeviceHost(seed=5), replace(tuning, sample=sample))
        drawer._first_density = 8.0
        assert bytes_of(drawer.device, drawer) == want
        assert drawer.repeats == 0


def test_lists_that_a_sample_misses_are_counted_in_full(monkeypatch: pytest.MonkeyPatch) -> None:
    """All that is counted lies behind the camera: what is drawn is the same, a try later."""
    monkeypatch.setattr(draw, "_SAMPLED", 1)
    camera, views = flat_camera(48, 40), flat_views(1)
    _, _, ahead, at = np.linalg.inv(views[0])[:3].T
    near = random_cloud(2048, seed=9)
    near = near.select(np.arange(2048) % 1)  # one splat again and again: none is left out
    spread = np.random.default_rng(0).normal(size=(2048, 3)) * 0.02
    number = np.arange(2048)
    counted = number % 4 == 0  # of the first chunk of a block, and blocks have one
    centres = at + np.where(counted, -2.0, 2.0)[:, None] * ahead + spread
    cloud = replace(near, means=centres.astype(np.float32))
    device, pictures = DeviceHost(), []
    packed = upload_cloud(device, cloud, sort=False)
    for tuning in (Tuning(sample=1), Tuning()):
        drawer = Drawer(device, tuning)
        drawer._first_density = 100.0
        drawer._roomy = False  # lists never have equal room
        for _ in range(4):
            drawn = drawer.pictures(camera, 1, ("rgb", "depth"))
            drawer.draw(
                camera, views, [packed], np.zeros(1, np.int32), pictures=drawn,
                background=np.zeros(3, np.float32),
            )  # fmt: skip
            pictures.append(drawn.numpy().rgb.tobytes())
    assert drawer.repeats == 2, "then no sample is trusted any more"
    assert len(set(pictures)) == 1
    assert any(pictures[0])


def test_a_device_that_cannot_count_is_said_to(monkeypatch: pytest.MonkeyPatch) -> None:
    """Lists that outgrow a full count, too: an error, no endless trying."""
    device = DeviceHost()
    drawer = Drawer(device)
    monkeypatch.setattr(Heard, "wait", lambda self: (NO_ROOM, 1, NOWHERE, 1))
    with pytest.raises(DeviceError, match="more than was counted"):
        bytes_of(device, drawer)


def test_kernels_refuse_sizes_that_do_not_fit() -> None:
    for wrong in (
        {"threads": 64},
        {"split": -1},
        {"sample": 3},
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
