"""The scan over lists: where they begin, in which order they are drawn, what the host is told."""

from __future__ import annotations

import shutil

import numpy as np
import pytest

from gn0.device.host import DeviceHost
from gn0.render.cuda.records import PlaceLists, ScanCounts, SumCounts
from gn0.render.cuda.replay import NO_ROOM
from gn0.render.cuda.source import kernel_source
from gn0.render.cuda.tables import NOWHERE, VIEW
from gn0.render.cuda.tune import MANY, Tuning

pytestmark = pytest.mark.skipif(not shutil.which("g++"), reason="the host emulation needs g++")

SCAN, CLASSES = 2048, 18  # counts a block; words of `Classes`
# any sizes will do; the checked emulation has compiled these for test_draw_races.py
SMALL = Tuning(capacity=128, buckets=128, stage=32, views=2, large=2)


@pytest.mark.parametrize("checked", [False, True])
@pytest.mark.parametrize("stride, over", [(0, False), (1, False), (4, False), (4, True)])
@pytest.mark.parametrize("tiles", [1, 700, SCAN, SCAN + 1, 3 * SCAN + 77])
def test_scans_arrange_all_lists(tiles: int, stride: int, over: bool, checked: bool) -> None:
    """One block or several; every tile once, longer classes of lists first.

    stride: 0 where all lists have the same room, else of what was counted before.
    """
    device = DeviceHost(seed=tiles, checked=checked)
    kernels = device.load(kernel_source(SMALL if checked else MANY))
    stream = np.random.default_rng(tiles)
    many = np.minimum(stream.lognormal(5, 2.5, tiles), 2.0**20).astype(np.uint32)
    counted = many // 4 if stride == 4 else many
    room = counted * 4 + counted + 256 if stride == 4 else counted
    if over:
        many[tiles // 2] = room[tiles // 2] + 1
    begins = counted if stride else many
    counts = device.upload(np.append(begins, np.zeros(CLASSES, np.uint32)))
    classes, whole = counts[tiles:], np.uint32(tiles)
    blocks = -(-tiles // SCAN)
    sums, starts = device.empty(blocks, np.uint64), None
    order = device.empty(tiles, np.uint32)
    state, told = device.empty(4, np.uint64), device.empty(4, np.uint64)
    views = np.zeros(300, VIEW)
    views["spare"] = NOWHERE
    views["spare"][[290, 17], 0] = 290 << 2, 17 << 2 | 1
    table = device.upload(views.view(np.uint32))
    needed = int(many.sum())
    if stride:
        starts = device.empty(tiles + 1, np.uint64)
        scan = (counts, whole, np.uint32(stride))
        if blocks > 1:
            adding = SumCounts(*scan, starts=None, sums=sums, classes=None)
            kernels["sum_counts"].launch(blocks, 256, adding)
        kernels["place_lists"].launch(blocks, 256, PlaceLists(*scan, sums, starts))
        begin = np.append(0, np.cumsum(room.astype(np.uint64)))
        assert starts.numpy().tolist() == begin.tolist()
        assert counts.numpy()[:tiles].tolist() == begin[:-1].tolist(), "where the first goes"
        device.upload((begin[:-1] + many).astype(np.uint32), counts[:tiles])
        needed = NO_ROOM if over else int(begin[-1])
    if blocks > 1:
        adding = SumCounts(counts, whole, np.uint32(0), starts, sums, classes)
        kernels["sum_counts"].launch(blocks, 256, adding)
    scanning = ScanCounts(
        counts=counts,
        all_tiles=whole,
        starts=starts,
        sums=sums,
        classes=classes,
        order=order,
        written=table,
        views=np.uint32(len(views)),
        state=state,
        told=told,
    )
    kernels["scan_counts"].launch(blocks, 256, scanning)
    expected = [needed, int(many.max()), 17 << 2 | 1, int(many.sum())]
    assert told.numpy().tolist() == state.numpy().tolist() == expected
    drawn = order.numpy()
    assert sorted(drawn.tolist()) == list(range(tiles))
    bits = np.array([max(int(n).bit_length() - 10, 0) for n in many[drawn]])
    assert (np.diff(np.minimum(bits, 7)) <= 0).all(), "longer classes first"
