"""Which splats a view really shows: the blending loop, kept only for its weights.

A splat counts when at some pixel its weight (opacity there times what the splats before it let
through) exceeds a threshold. Same rules and order as `cpu_raster`, without colours.
"""

from __future__ import annotations

import numpy as np

from gn0.jit import njit, prange
from gn0.render.cpu_bin import sort_tile
from gn0.render.cpu_pack import CHUNK, FIELDS
from gn0.render.cpu_raster import BATCH, GATHERED, LOG_MIN, TILE, exponential, gather_batch
from gn0.render.renderer import ALPHA_CAP, TRANSMITTANCE_STOP

F = np.float32
_CAP, _STOP = F(ALPHA_CAP), F(TRANSMITTANCE_STOP)
_ONE, _ZERO = F(1.0), F(0.0)


@njit(error_model="numpy")
def _mark_tile(records, indices, rows, x_px, y_px, columns, lines, threshold, marks, through):  # type: ignore[no-untyped-def]
    """Mark what shows in one tile; `through` [TILE * TILE] holds transmittances."""
    for r in range(TILE):
        for j in range(TILE):
            through[r * TILE + j] = _ONE if r < lines and j < columns else _ZERO
    gathered = np.empty(GATHERED, np.float32)
    reach = np.empty(2 * BATCH, np.int32)
    peaks = np.empty(TILE, np.float32)
    for start in range(0, rows.shape[0], BATCH):
        size = min(BATCH, rows.shape[0] - start)
        gather_batch(records, rows[start : start + size], x_px, y_px, gathered, reach)
        for b in range(size):
            dx0, dy0 = gathered[b], gathered[BATCH + b]
            qx, qy = gathered[2 * BATCH + b], gathered[3 * BATCH + b]
            qk, log_o = gathered[4 * BATCH + b], gathered[5 * BATCH + b]
            q0 = qx * dx0
            peaks[:] = _ZERO  # a maximum a column: a single one would forbid vector instructions
            for r in range(reach[b], reach[BATCH + b]):
                dy = dy0 + F(r)
                begin = q0 + qy * dy
                k0 = log_o - qk * dy * dy
                row = through[r * TILE : (r + 1) * TILE]
                for j in range(TILE):
                    q = begin + qx * F(j)
                    p = k0 - q * q
                    e = min(exponential(p), _CAP)
                    e = e if p >= LOG_MIN else _ZERO
                    T = row[j]
                    w = e * T
                    after = T - w
                    keep = after > _STOP
                    w = w if keep else _ZERO
                    peaks[j] = w if w > peaks[j] else peaks[j]
                    row[j] = after if keep else _ZERO
            for j in range(TILE):
                if peaks[j] > threshold:
                    marks[indices[rows[start + b]]] = 1
            if b & 15 == 15:  # what is behind cannot weigh more than what is let through
                open_pixels = 0
                for k in range(TILE * TILE):
                    open_pixels += through[k] > threshold
                if open_pixels == 0:
                    return


@njit(parallel=True)
def mark_tiles(  # type: ignore[no-untyped-def]
    records, indices, ordered, starts, tile_rows, tile_keys, spare_rows, spare_keys, row_order,
    tiles_x, width, height, threshold, marks,
):  # fmt: skip
    """Set `marks` [N] to 1 for each splat that shows with more than `threshold` somewhere.

    Several tiles may mark one splat; they write the same value, so their order does not show.
    """
    for step in prange(row_order.shape[0] * tiles_x):
        tile_y, tile_x = row_order[step // tiles_x], step % tiles_x
        t = tile_y * tiles_x + tile_x
        x_px, y_px = tile_x * TILE, tile_y * TILE
        columns, lines = min(TILE, width - x_px), min(TILE, height - y_px)
        rows, keys = tile_rows[starts[t] : starts[t + 1]], tile_keys[starts[t] : starts[t + 1]]
        more_rows = spare_rows[starts[t] : starts[t + 1]]
        more_keys = spare_keys[starts[t] : starts[t + 1]]
        sort_tile(keys, rows, more_keys, more_rows, indices, records, ordered)
        through = np.empty(TILE * TILE, np.float32)
        _mark_tile(records, indices, rows, x_px, y_px, columns, lines, threshold, marks, through)


@njit(parallel=True)
def gather_chunks(pack, reach, lanes, out, boxes):  # type: ignore[no-untyped-def]
    """Copy packed splats `lanes` [n] into fresh chunks `out` [C, FIELDS * CHUNK] and box them.

    `reach` is the number of the field that is −1 where a chunk is padded.
    """
    for c in prange(boxes.shape[0]):
        first = c * CHUNK
        count = min(CHUNK, lanes.shape[0] - first)
        for f in range(FIELDS):
            for k in range(count):
                lane = lanes[first + k]
                out[c, f * CHUNK + k] = pack[lane // CHUNK, f * CHUNK + lane % CHUNK]
            for k in range(count, CHUNK):
                out[c, f * CHUNK + k] = -_ONE if f == reach else _ZERO
        for axis in range(3):
            low, high = out[c, axis * CHUNK], out[c, axis * CHUNK]
            for k in range(count):
                low = min(low, out[c, axis * CHUNK + k])
                high = max(high, out[c, axis * CHUNK + k])
            boxes[c, axis], boxes[c, 3 + axis] = low, high
        most = _ZERO
        for k in range(count):
            most = max(most, out[c, reach * CHUNK + k])
        boxes[c, 6] = most
