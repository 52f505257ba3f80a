"""The scan over lists: where they begin, in which order they are drawn, what the host is told."""

from __future__ import annotations

import shutil

import numpy as np
import pytest

from gn0.device.host import DeviceHost
from gn0.render.cuda.draw import kernel_source
from gn0.render.cuda.tables import NOWHERE, VIEW
from gn0.render.cuda.tune import MANY

pytestmark = pytest.mark.skipif(not shutil.which("g++"), reason="the host emulation needs g++")

SCAN, CLASSES = 2048, 17  # counts a block; words of `Classes`


@pytest.mark.parametrize("checked", [False, True])
@pytest.mark.parametrize("room", [0, 4096])
@pytest.mark.parametrize("tiles", [1, 700, SCAN, SCAN + 1, 3 * SCAN + 77])
def test_a_scan_arranges_all_lists(tiles: int, room: int, checked: bool) -> None:
    """One block or several; every tile once, longer classes of lists first."""
    device = DeviceHost(seed=tiles, checked=checked)
    kernels = device.load(kernel_source(MANY))
    stream = np.random.default_rng(tiles)
    many = np.minimum(stream.lognormal(5, 2.5, tiles), 2.0**20).astype(np.uint32)
    counts = device.upload(np.append(many, np.zeros(CLASSES, np.uint32)))
    classes, whole = counts[tiles:], np.uint32(tiles)
    blocks = -(-tiles // SCAN)
    sums, starts = device.empty(blocks, np.uint64), device.empty(tiles + 1, np.uint64)
    order = device.empty(tiles, np.uint32)
    state, told = device.empty(3, np.uint64), device.empty(3, np.uint64)
    views = np.zeros(300, VIEW)
    views["spare"] = NOWHERE
    views["spare"][[290, 17], 0] = 290 << 2, 17 << 2 | 1
    table = device.upload(views.view(np.uint32))
    if blocks > 1:
        kernels["sum_counts"].launch(blocks, 256, counts, whole, sums, classes)
    kernels["scan_counts"].launch(
        *(blocks, 256, counts, whole, np.uint32(room), sums, starts, classes, order),
        *(table, np.uint32(len(views)), state, told),
    )
    expected = [int(many.sum()), int(many.max()), 17 << 2 | 1]
    assert told.numpy().tolist() == state.numpy().tolist() == expected
    drawn = order.numpy()
    assert sorted(drawn.tolist()) == list(range(tiles))
    bits = np.array([max(int(n).bit_length() - 10, 0) for n in many[drawn]])
    assert (np.diff(np.minimum(bits, 7)) <= 0).all(), "longer classes first"
    if room:
        assert counts.numpy()[:tiles].tolist() == many.tolist(), "lists have their places already"
    else:
        begin = np.append(0, np.cumsum(many.astype(np.uint64)))
        assert starts.numpy().tolist() == begin.tolist()
        assert counts.numpy()[:tiles].tolist() == begin[:-1].tolist()
