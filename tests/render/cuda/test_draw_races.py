"""No kernel of a drawing call reads or writes what another thread may be writing.

On the checked emulation (`gn0.device.host`): what order the threads took, and what another order
would have done, does not matter to it.
"""

from __future__ import annotations

import shutil

import numpy as np
import pytest

from gn0.device.host import DeviceHost
from gn0.maps.grid import OccupancyGrid
from gn0.render.cuda.draw import Drawer
from gn0.render.cuda.pack import upload_cloud
from gn0.render.cuda.tune import Tuning
from gn0.render.cuda.visible import VisibleSets
from gn0.render.visible_places import VisibleOptions
from gn0.testing.renderer_check import random_cloud
from gn0_figures.flat import build_flat, flat_bev, flat_camera, flat_views

pytestmark = pytest.mark.skipif(not shutil.which("g++"), reason="the host emulation needs g++")

# several groups of splats a tile, parts that fit no group, several stages, blocks for two views
SMALL = Tuning(capacity=128, buckets=128, stage=32, views=2, large=2)


@pytest.mark.parametrize(
    "tuning, degree",
    [(SMALL, 3), pytest.param(Tuning(threads=256, group=False), 0, marks=pytest.mark.slow)],
)
def test_pictures(tuning: Tuning, degree: int) -> None:
    device = DeviceHost(seed=degree + 1, checked=True)
    drawer = Drawer(device, tuning)
    cloud = build_flat(1500, sh_degree=degree).select(np.random.default_rng(1).permutation(1500))
    packed = upload_cloud(device, cloud)
    tail = upload_cloud(device, random_cloud(300, seed=5), sort=False)
    bev, looks_down = flat_bev(40)
    views = flat_views(3)
    for camera, matrices in ((flat_camera(37, 20), views), (bev, looks_down[None])):
        count = len(matrices)
        pictures = drawer.pictures(camera, count, ("rgb", "depth", "alpha"))
        drawer.draw(
            camera, matrices, [packed], np.zeros(count, np.int32), tails=[tail],
            tail_of=np.arange(count, dtype=np.int32) % 2 - 1, pictures=pictures,
            background=np.zeros(3, np.float32), antialiased=degree > 0,
        )  # fmt: skip
        assert np.isfinite(pictures.numpy().alpha).all()


def test_views_that_only_the_device_knows() -> None:
    device = DeviceHost(seed=2, checked=True)
    drawer, camera, views = Drawer(device, SMALL), flat_camera(36, 20), flat_views(5)
    packed = [upload_cloud(device, build_flat(size)) for size in (700, 300)]
    pictures = drawer.pictures(camera, len(views), ("rgb",))
    chosen = device.upload(np.array([1, 0, 1, 1, 0], np.int32))
    drawer.draw(
        camera, device.upload(views), packed, chosen, pictures=pictures,
        background=np.zeros(3, np.float32),
    )  # fmt: skip
    assert pictures.numpy().rgb.any()


@pytest.mark.slow
def test_visible_sets() -> None:
    device = DeviceHost(seed=3, checked=True)
    floor = OccupancyGrid(np.zeros((8, 12), np.uint8), 0.1, (2.0, 2.0))
    options = VisibleOptions(places=1, pixels=20)
    sets = VisibleSets(Drawer(device, SMALL), "", floor, 1.2, options, cache=False)
    packed = upload_cloud(device, build_flat(1200))
    found = sets.open(sets.cells[:2], packed)
    assert all(part.slots is not None for part in found.values())
