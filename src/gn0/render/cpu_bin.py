"""Tile lists: which splats touch which 16x16 tile, and in which order.

Chunks are cut into a fixed number of blocks. Each block counts its entries a tile as it projects;
a scan over (tile, block) then gives every block its own places, so the lists do not depend on the
number of threads. A tile sorts its own list by (float32 depth bits, index in the cloud).
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from gn0.geometry import F32
from gn0.jit import njit, prange
from gn0.render.cpu_pack import CHUNK
from gn0.render.cpu_project import ORDER

BLOCKS = 16  # blocks a cloud at most: enough for any core count in use, few enough to scan
BLOCK_LEAST = 4  # chunks of a block, of clouds that are too small for so many
_DIGIT, _DIGIT_LONG, _DIGIT_LONGEST = 9, 12, 13  # most bits a radix pass, by the list's length
_LONG, _LONGEST = 1024, 2400
_BLOCK = 64  # entries looked at for ties at once
_SMALL = 24  # lists this short are sorted by insertion


class ArrangedView(NamedTuple):
    """The splats of a view, tile by tile, as kernels take them; good until the next view.

    Attributes:
        rects: int16 [rows, 4] px, first and past-the-last pixel of each row in x, then in y.
        records: [rows, RECORD], see `gn0.render.cpu_project`.
        indices: uint32 [rows], of each row in its cloud.
        ordered: whether rows come in the order of their indices.
        starts: int32 [tiles + 1], where the list of each tile begins.
        tile_rows, tile_keys: rows and depth keys of all lists, not sorted yet.
        spare_rows, spare_keys: memory for sorting, as large.
        row_order: the rows of tiles, so that threads have their share of each part.
    """

    rects: Any
    records: F32
    indices: Any
    ordered: bool
    starts: Any
    tile_rows: Any
    tile_keys: Any
    spare_rows: Any
    spare_keys: Any
    row_order: Any

    @property
    def unboxed(self) -> tuple[Any, ...]:
        """All but `rects`, for kernels that do not look at them."""
        return self[1:]


@njit
def scan_tiles(histogram, starts):  # type: ignore[no-untyped-def]
    """Turn counts [blocks, tiles] into places, fill `starts` [tiles + 1], return the total.

    Nothing may be filled when the total exceeds what `starts` can hold (2^31 - 1).
    """
    total = np.int64(0)
    for t in range(histogram.shape[1]):
        starts[t] = total
        for b in range(histogram.shape[0]):
            count = histogram[b, t]
            histogram[b, t] = total
            total += count
    starts[histogram.shape[1]] = total
    return total


@njit(parallel=True)
def fill_tiles(ranges, turns, counts, rects, keys, tiles_x, histogram, tile_rows, tile_keys):  # type: ignore[no-untyped-def]
    """List each tile's rows and their depth keys, block by block.

    `ranges` [blocks, 2] are the chunks of a block, `rects` [rows, 4] the pixels of each row;
    `histogram` holds its places and is used up.
    `turns` [blocks] says which block is when, so that each thread has its share of a large cloud.
    """
    for turn in prange(ranges.shape[0]):
        b = turns[turn]
        cursor = histogram[b]
        for v in range(ranges[b, 0], ranges[b, 1]):
            for row in range(v * CHUNK, v * CHUNK + counts[v]):
                key = keys[row]
                r = rects[row]
                left, right = r[0] >> 4, (r[1] + 15) >> 4
                for ty in range(r[2] >> 4, (r[3] + 15) >> 4):
                    for t in range(ty * tiles_x + left, ty * tiles_x + right):
                        place = cursor[t]
                        cursor[t] = place + 1
                        tile_rows[place] = row
                        tile_keys[place] = key


@njit
def sort_tile(keys, rows, spare_keys, spare_rows, indices, records, ordered):  # type: ignore[no-untyped-def]
    """Sort one tile's list in place by (key, index of the row in its cloud).

    Lists arrive in packed order, which is index order when `ordered`.
    """
    n = keys.shape[0]
    if n <= _SMALL:
        for i in range(1, n):
            key, row = keys[i], rows[i]
            j = i - 1
            while j >= 0 and (
                keys[j] > key or (keys[j] == key and indices[rows[j]] > indices[row])
            ):
                keys[j + 1], rows[j + 1] = keys[j], rows[j]
                j -= 1
            keys[j + 1], rows[j + 1] = key, row
        return
    bins = np.empty(1 << _DIGIT_LONGEST, np.int32)
    _sort_radix(keys, rows, spare_keys, spare_rows, bins)
    if ordered:
        return
    tied = False
    for i in range(1, n):
        tied |= keys[i] == keys[i - 1]
    if tied and _sort_runs(keys, rows, indices):
        return
    if tied:  # order all by index, then again, stably, by depth
        for i in range(n):
            keys[i] = indices[rows[i]]
        _sort_radix(keys, rows, spare_keys, spare_rows, bins)
        for i in range(n):
            keys[i] = np.float32(records[rows[i], ORDER]).view(np.uint32)
        _sort_radix(keys, rows, spare_keys, spare_rows, bins)


@njit
def _sort_runs(keys, rows, indices):  # type: ignore[no-untyped-def]
    """Put rows of equal keys in the order of their indices; False if that would take too long.

    In a list that is sorted by depth, runs of one depth are nearly always of two or three.
    """
    n = keys.shape[0]
    patience = 8 * n
    for block in range(1, n, _BLOCK):
        end = min(block + _BLOCK, n)
        tied = False
        for i in range(block, end):
            tied |= keys[i] == keys[i - 1]
        if not tied:
            continue
        for i in range(block, end):
            key, row = keys[i], rows[i]
            j = i - 1
            while j >= 0 and keys[j] == key and indices[rows[j]] > indices[row]:
                rows[j + 1] = rows[j]
                j -= 1
            rows[j + 1] = row
            patience -= i - 1 - j
        if patience < 0:
            return False
    return True


@njit
def _sort_radix(keys, rows, spare_keys, spare_rows, bins):  # type: ignore[no-untyped-def]
    n = keys.shape[0]
    low, high = keys[0], keys[0]
    for i in range(n):
        low, high = min(low, keys[i]), max(high, keys[i])
    span = np.uint32(high - low)
    from_keys, from_rows, to_keys, to_rows = keys, rows, spare_keys, spare_rows
    bits = 0
    while bits < 32 and (span >> np.uint32(bits)) > 0:
        bits += 1
    # a pass costs its entries and its bins: long lists take few passes, and two need no copy back
    widest = _DIGIT if n < _LONG else _DIGIT_LONG if n < _LONGEST else _DIGIT_LONGEST
    passes = (bits + widest - 1) // widest
    digit = (bits + passes - 1) // max(passes, 1)
    size = 1 << digit
    mask = np.uint32(size - 1)
    for turn in range(passes):
        shift = np.uint32(turn * digit)
        bins[:size] = 0
        for i in range(n):
            bins[((from_keys[i] - low) >> shift) & mask] += 1
        total = 0
        for d in range(size):
            count = bins[d]
            bins[d] = total
            total += count
        for i in range(n):
            key = from_keys[i]
            d = ((key - low) >> shift) & mask
            place = bins[d]
            bins[d] = place + 1
            to_keys[place] = key
            to_rows[place] = from_rows[i]
        from_keys, to_keys = to_keys, from_keys
        from_rows, to_rows = to_rows, from_rows
    if passes % 2 == 1:
        keys[:] = spare_keys
        rows[:] = spare_rows
