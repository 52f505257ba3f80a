"""Views that only the device knows are drawn as if the host had named them: the same bytes."""

from __future__ import annotations

import shutil

import numpy as np
import pytest

from gn0.device.host import DeviceHost
from gn0.errors import RenderError
from gn0.render.cuda.draw import Drawer
from gn0.render.cuda.pack import upload_cloud
from gn0.render.cuda.replay import Heard
from gn0.render.cuda.tables import CLOUD, choose_shares, most_blocks, share_work
from gn0.render.cuda.tune import Tuning
from gn0.testing.renderer_check import random_cloud
from gn0_figures.flat import build_flat, flat_camera, flat_views

pytestmark = pytest.mark.skipif(not shutil.which("g++"), reason="the host emulation needs g++")

CAMERA, VIEWS = flat_camera(40, 33), flat_views(7)
CLOUDS = [build_flat(1500), random_cloud(0, seed=1), random_cloud(700, seed=2), build_flat(900)]
SHOWN = np.array([3, 0, 2, 2, 3, 1, 3], np.int32)


def draw(drawer: Drawer, there: bool, shown: np.ndarray | None, views=VIEWS) -> list[bytes]:
    """Pictures with the poses on the device, or on the host; cloud 4 is one that is not here."""
    device = drawer.device
    packed = [upload_cloud(device, cloud) for cloud in CLOUDS]
    pictures = drawer.pictures(CAMERA, len(views), ("rgb", "depth", "alpha"))
    given: tuple = (views, packed, np.zeros(len(views), np.int32) if shown is None else shown)
    if there:
        chosen = None if shown is None else device.upload(shown)
        given = (device.upload(views), [*packed, None], chosen)
    drawer.draw(CAMERA, *given, pictures=pictures, background=np.zeros(3, np.float32))
    got = pictures.numpy()
    return [a.tobytes() for a in (got.rgb, got.depth, got.alpha)]


@pytest.fixture(scope="module")
def want() -> list[bytes]:
    return draw(Drawer(DeviceHost()), False, SHOWN)


@pytest.mark.parametrize("seed", [0, 1])
@pytest.mark.parametrize("shown", [None, SHOWN], ids=["one cloud", "four clouds"])
def test_the_host_needs_to_know_no_view(shown, seed: int) -> None:
    device = DeviceHost(seed)
    tuning = Tuning(capacity=128, buckets=128, stage=32, views=2, large=2, split=7)
    there = draw(Drawer(device, tuning), True, shown)
    assert there == draw(Drawer(device, tuning), False, shown)


def test_all_is_queued_before_the_host_waits(want, monkeypatch) -> None:
    """No copy to the host: the device writes four words there before the blending."""
    device, told = DeviceHost(), []
    drawer = Drawer(device)
    drawer.on_stage = told.append
    wait = Heard.wait

    def note(heard: Heard) -> tuple[int, int, int, int]:
        told.append("wait")
        return wait(heard)

    monkeypatch.setattr(Heard, "wait", note)
    packed = [upload_cloud(device, cloud) for cloud in CLOUDS]
    pictures = drawer.pictures(CAMERA, len(VIEWS), ("rgb", "depth", "alpha"))
    poses, chosen = device.upload(VIEWS), device.upload(SHOWN)
    with monkeypatch.context() as no_waiting:
        no_waiting.setattr(device, "download", None)
        no_waiting.setattr(device, "download_async", None)
        no_waiting.setattr(device, "synchronize", None)
        for _ in range(2):
            drawer.draw(CAMERA, poses, packed, chosen,
                        pictures=pictures, background=np.zeros(3, np.float32))  # fmt: skip
    # the second call knows how long lists are
    assert told[:8] == ["upload", "count", "scan", "emit", "scan", "blend", "end", "wait"]
    assert told[8:] == ["upload", "emit", "scan", "blend", "end", "wait"]
    assert pictures.numpy().rgb.tobytes() == want[0]


def test_batches_and_lists_that_overflow_cannot_show(want) -> None:
    device = DeviceHost()
    assert draw(small := Drawer(device, memory=25_000), True, SHOWN) == want
    assert small.batches > 2
    drawer = Drawer(device)
    drawer._first_density = 0.0
    drawer._held["entries"] = device.empty(16, np.uint64)
    assert draw(drawer, True, SHOWN) == want
    assert drawer.repeats >= 1
    before = drawer.repeats
    assert draw(drawer, True, SHOWN) == want
    assert drawer.repeats == before


@pytest.mark.parametrize(
    ("change", "match"),
    [
        (lambda views, shown: views.__setitem__((4, 1, 3), np.nan), "view 4: .*not finite"),
        (lambda views, shown: views.__setitem__((4, 1, 3), -np.inf), "view 4: .*not finite"),
        (lambda views, shown: views.__setitem__((2, 0), 2 * views[2, 0]), "view 2: .*not a rigid"),
        (lambda views, shown: views.__setitem__((6, 0), -views[6, 0]), "view 6: .*not a rigid"),
        (lambda views, shown: views.__setitem__((0, 3, 0), 1.0), "view 0: .*not a rigid"),
        (lambda views, shown: shown.__setitem__(3, 4), "view 3: .*scene that is not here"),
        (lambda views, shown: shown.__setitem__(3, -1), "view 3: .*scene that is not here"),
        (lambda views, shown: shown.__setitem__(3, 5), "view 3: .*scene that is not here"),
    ],
)
def test_a_view_that_is_none_is_told(change, match: str) -> None:
    views, shown = VIEWS.copy(), SHOWN.copy()
    change(views, shown)
    drawer = Drawer(DeviceHost())
    with pytest.raises(RenderError, match=match):
        draw(drawer, True, shown, views)
    assert draw(drawer, True, SHOWN), "the next call is not spoilt"


def test_a_grid_holds_all_shares_whatever_is_chosen() -> None:
    rng = np.random.default_rng(0)
    for _ in range(200):
        clouds = np.zeros(rng.integers(1, 9), CLOUD)
        clouds["chunks"] = rng.integers(0, 30, len(clouds))
        shown = rng.integers(0, len(clouds), rng.integers(1, 40))
        each = int(rng.integers(1, 6))
        least = share_work(clouds, shown, 0 * shown - 1, each).blocks
        assert least <= most_blocks(clouds["chunks"], len(shown), each)


def test_blocks_of_few_people_take_few_chunks_whatever_scenes_take() -> None:
    views, scene, person = 1024, np.full(40, 800), np.full(2, 43)
    found = choose_shares([(scene, views), (person, views)], 32, 8, 8192)
    assert (found.each, found.each_of_parts) == (7, 1)
    assert found.of_parts == most_blocks(person, views, 32) < found.blocks
    clouds = np.zeros(42, CLOUD)
    clouds["chunks"] = np.concatenate([scene, person])
    shown, nobody = np.arange(views) % 40, np.full(views, -1)
    known = share_work(clouds, shown, nobody, 32, 8, 2048, np.full(views, 41)).sizes
    assert (known.each, known.each_of_parts, known.of_parts) == (8, 1, 43 * 32)
