"""Tile lists: in (depth bits, index in the cloud) order for any list, tied or not."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from gn0.render.cpu import spread_rows
from gn0.render.cpu_bin import fill_tiles, scan_tiles, sort_tile
from gn0.render.cpu_pack import CHUNK
from gn0.render.cpu_project import ORDER, RECORD
from gn0.render.cpu_raster import TILE


@settings(max_examples=60, deadline=None)
@given(
    n=st.integers(0, 700),
    depths=st.sampled_from([1, 3, 40, 10**6]),
    low=st.sampled_from([0.0, 0.05, 1.9, 900.0]),
    seed=st.integers(0, 2**32 - 1),
)
def test_a_list_is_sorted_by_depth_then_index(n: int, depths: int, low: float, seed: int) -> None:
    stream = np.random.default_rng(seed)
    records = np.zeros((n + 5, RECORD), np.float32)
    records[:, ORDER] = low + stream.integers(0, depths, n + 5) * np.float32(0.37)
    indices = stream.permutation(10 * (n + 5))[: n + 5].astype(np.uint32)
    rows = stream.permutation(n + 5)[:n].astype(np.int32)
    keys = np.ascontiguousarray(records[rows, ORDER]).view(np.uint32)
    order = np.lexsort((indices[rows], records[rows, ORDER]))
    want = rows[order]
    sort_tile(keys, rows, np.empty_like(keys), np.empty_like(rows), indices, records, False)
    assert (rows == want).all()


def test_lists_that_come_in_index_order_keep_it() -> None:
    stream = np.random.default_rng(1)
    records = np.zeros((500, RECORD), np.float32)
    records[:, ORDER] = stream.integers(1, 5, 500)
    rows = np.arange(500, dtype=np.int32)
    keys = np.ascontiguousarray(records[:, ORDER]).view(np.uint32)
    want = np.argsort(records[:, ORDER], kind="stable")
    spare = np.empty_like(keys), np.empty_like(rows)
    sort_tile(keys, rows, *spare, rows.astype(np.uint32), records, True)
    assert (rows == want).all()


def test_lists_hold_every_splat_of_every_tile_once() -> None:
    """Against a plain loop: 3 chunks in 5 blocks over a 7x4 tile grid."""
    stream = np.random.default_rng(2)
    chunks, tiles_x, tiles_y, blocks = 3, 7, 4, 5
    counts = np.array([256, 0, 31], np.int32)
    rects = np.zeros((chunks * CHUNK, 4), np.int16)
    rects[:, 0], rects[:, 2] = stream.integers(0, 6, len(rects)), stream.integers(0, 3, len(rects))
    rects *= TILE
    rects[:, 0] += stream.integers(0, TILE, len(rects)).astype(np.int16)
    rects[:, 1] = (rects[:, 0] + stream.integers(1, 20, len(rects))).clip(max=TILE * tiles_x)
    rects[:, 2] += 3
    rects[:, 3] = rects[:, 2] + stream.integers(1, 14, len(rects))
    keys = stream.integers(0, 2**31, len(rects)).astype(np.uint32)
    edges = np.arange(blocks + 1) * chunks // blocks
    ranges = np.column_stack([edges[:-1], edges[1:]])
    want: list[list[int]] = [[] for _ in range(tiles_x * tiles_y)]
    histogram = np.zeros((blocks, tiles_x * tiles_y), np.int32)
    for b, (first, last) in enumerate(ranges):
        for v in range(first, last):
            for row in range(v * CHUNK, v * CHUNK + counts[v]):
                x0, x1, y0, y1 = rects[row]
                touched = {
                    (y // TILE) * tiles_x + x // TILE for y in range(y0, y1) for x in range(x0, x1)
                }
                for t in touched:
                    want[t].append(row)
                    histogram[b, t] += 1
    starts = np.empty(tiles_x * tiles_y + 1, np.int32)
    total = scan_tiles(histogram, starts)
    assert total == sum(map(len, want)) == starts[-1]
    rows, listed = np.empty(total, np.int32), np.empty(total, np.uint32)
    turns = spread_rows(blocks)
    fill_tiles(ranges, turns, counts, rects, keys, tiles_x, histogram, rows, listed)
    assert [rows[starts[t] : starts[t + 1]].tolist() for t in range(len(want))] == want
    assert (listed == keys[rows]).all()


@pytest.mark.parametrize("count", [1, 2, 3, 14, 30, 64, 257])
def test_row_order_is_a_permutation_that_spreads(count: int) -> None:
    order = spread_rows(count)
    assert sorted(order.tolist()) == list(range(count))
    if count >= 14:  # each half of the work sees the whole height
        half = order[: count // 2]
        assert half.min() < count / 8 and half.max() > count * 6 / 8


@pytest.mark.parametrize("n", [2, 3, 23, 24, 25, 26, 60])
@pytest.mark.parametrize("depths", [1, 2, 3])
def test_equal_depths_of_short_lists_are_in_index_order(n: int, depths: int) -> None:
    """Lists up to 24 are sorted by insertion, longer ones by digits: ties come out alike."""
    stream = np.random.default_rng(n)
    for _ in range(4):
        records = np.zeros((n, RECORD), np.float32)
        records[:, ORDER] = 1.0 + stream.integers(0, depths, n)
        indices = stream.permutation(n).astype(np.uint32)
        rows = stream.permutation(n).astype(np.int32)
        keys = np.ascontiguousarray(records[rows, ORDER]).view(np.uint32)
        want = rows[np.lexsort((indices[rows], records[rows, ORDER]))]
        sort_tile(keys, rows, np.empty_like(keys), np.empty_like(rows), indices, records, False)
        assert (rows == want).all()


@pytest.mark.parametrize("at", [0, 1, 17, 38])
def test_one_tie_anywhere_in_a_long_list_is_in_index_order(at: int) -> None:
    records = np.zeros((40, RECORD), np.float32)
    records[:, ORDER] = 1.0 + np.arange(40)
    records[at + 1, ORDER] = records[at, ORDER]
    indices = np.arange(40, dtype=np.uint32)[::-1].copy()
    rows = np.random.default_rng(at).permutation(40).astype(np.int32)
    for order in (rows, rows[::-1]):
        mine = order.copy()
        keys = np.ascontiguousarray(records[mine, ORDER]).view(np.uint32)
        want = mine[np.lexsort((indices[mine], records[mine, ORDER]))]
        sort_tile(keys, mine, np.empty_like(keys), np.empty_like(mine), indices, records, False)
        assert (mine == want).all()


@pytest.mark.parametrize("n", [1023, 1024, 2399, 2400, 9000])
@pytest.mark.parametrize("depths", [1, 7, 300, 10**7])
def test_long_lists_are_sorted_by_depth_then_index(n: int, depths: int) -> None:
    """Their digits are wider; ties are few, in runs of hundreds, or all there is."""
    stream = np.random.default_rng(n)
    records = np.zeros((n, RECORD), np.float32)
    records[:, ORDER] = 0.05 + stream.integers(0, depths, n) * np.float32(0.013)
    indices = stream.permutation(n).astype(np.uint32)
    for rows in (stream.permutation(n).astype(np.int32), np.argsort(-indices.astype(np.int64))):
        mine = rows.astype(np.int32)
        keys = np.ascontiguousarray(records[mine, ORDER]).view(np.uint32)
        want = mine[np.lexsort((indices[mine], records[mine, ORDER]))]
        sort_tile(keys, mine, np.empty_like(keys), np.empty_like(mine), indices, records, False)
        assert (mine == want).all()
        assert (keys == records[mine, ORDER].view(np.uint32)).all()
