"""Depth order and tile lists: stable parallel radix sort, counting, scan, scatter.

Work is cut into a fixed number of blocks; within each stage a block writes only where the scan
over (bucket, block) put it, so lists are in (depth bits, splat index) order for any thread count.
"""

from __future__ import annotations

import numpy as np

from gn0.jit import njit, prange

BLOCKS = 8
RADIX_BITS = 9
RADIX = 1 << RADIX_BITS


@njit(parallel=True)
def gather_rows(row_starts, counts, starts, keys, sort_keys, sort_rows):  # type: ignore[no-untyped-def]
    """Densely list rows and depth keys of all chunks: chunk v's go to `starts[v]` onwards."""
    for v in prange(counts.shape[0]):
        row, out = row_starts[v], starts[v]
        for k in range(counts[v]):
            sort_keys[out + k] = keys[row + k]
            sort_rows[out + k] = row + k


@njit(parallel=True)
def key_range(keys, n):  # type: ignore[no-untyped-def]
    """Smallest and largest of the first n keys."""
    low = np.full(BLOCKS, 0xFFFFFFFF, np.uint32)
    high = np.zeros(BLOCKS, np.uint32)
    for b in prange(BLOCKS):
        lo, hi = np.uint32(0xFFFFFFFF), np.uint32(0)
        for i in range(b * n // BLOCKS, (b + 1) * n // BLOCKS):
            lo, hi = min(lo, keys[i]), max(hi, keys[i])
        low[b], high[b] = lo, hi
    return low.min(), high.max()


@njit(parallel=True)
def radix_pass(keys, rows, n, base, shift, keys_out, rows_out, histogram):  # type: ignore[no-untyped-def]
    """One stable counting pass on bits `shift` onwards of `keys - base`."""
    mask = np.uint32(RADIX - 1)
    for b in prange(BLOCKS):
        counts = histogram[b]
        counts[:] = 0
        for i in range(b * n // BLOCKS, (b + 1) * n // BLOCKS):
            counts[((keys[i] - base) >> shift) & mask] += 1
    total = 0
    for bucket in range(RADIX):
        for b in range(BLOCKS):
            count = histogram[b, bucket]
            histogram[b, bucket] = total
            total += count
    for b in prange(BLOCKS):
        cursor = histogram[b]
        for i in range(b * n // BLOCKS, (b + 1) * n // BLOCKS):
            bucket = ((keys[i] - base) >> shift) & mask
            out = cursor[bucket]
            cursor[bucket] = out + 1
            keys_out[out] = keys[i]
            rows_out[out] = rows[i]


@njit(parallel=True)
def take(values, rows, n, out):  # type: ignore[no-untyped-def]
    """`out[i] = values[rows[i]]` for the first n."""
    for b in prange(BLOCKS):
        for i in range(b * n // BLOCKS, (b + 1) * n // BLOCKS):
            out[i] = values[rows[i]]


@njit
def has_ties(keys, n):  # type: ignore[no-untyped-def]
    """Whether two neighbours of the first n sorted keys are equal."""
    for i in range(1, n):  # noqa: SIM110 (compiled)
        if keys[i] == keys[i - 1]:
            return True
    return False


@njit(parallel=True)
def count_tiles(rows, n, rects, tiles_x, histogram):  # type: ignore[no-untyped-def]
    """Count entries a tile: `histogram` [BLOCKS, tiles]; returns their sum."""
    totals = np.zeros(BLOCKS, np.int64)
    for b in prange(BLOCKS):
        counts = histogram[b]
        counts[:] = 0
        total = 0
        for i in range(b * n // BLOCKS, (b + 1) * n // BLOCKS):
            r = rects[rows[i]]
            total += (r[1] - r[0]) * (r[3] - r[2])
            for ty in range(r[2], r[3]):
                for tx in range(r[0], r[1]):
                    counts[ty * tiles_x + tx] += 1
        totals[b] = total
    return totals.sum()


@njit(parallel=True)
def fill_tiles(rows, n, rects, tiles_x, histogram, starts, items):  # type: ignore[no-untyped-def]
    """Fill the tile lists: tile t holds rows `items[starts[t]:starts[t + 1]]`, front to back."""
    total = 0
    for t in range(histogram.shape[1]):
        starts[t] = total
        for b in range(BLOCKS):
            count = histogram[b, t]
            histogram[b, t] = total
            total += count
    starts[histogram.shape[1]] = total
    for b in prange(BLOCKS):
        cursor = histogram[b]
        for i in range(b * n // BLOCKS, (b + 1) * n // BLOCKS):
            row = rows[i]
            r = rects[row]
            for ty in range(r[2], r[3]):
                for tx in range(r[0], r[1]):
                    t = ty * tiles_x + tx
                    items[cursor[t]] = row
                    cursor[t] += 1
