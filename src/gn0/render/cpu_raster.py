"""Blending, one 16x16 tile at a time: each tile is an independent piece of work.

A tile sorts its list, then takes it in batches: gather the records (independent loads, so memory
latencies overlap), find the rows that the splat's ellipse reaches inside the tile, and blend those
rows 16 or 8 pixels wide without branches. exp() is the 16th power of a cubic (relative error under
1e-4 over the range that counts). A pixel that has ended keeps its transmittance with a negative
sign, which makes every later weight fall away.

Only IEEE operations in a fixed order: no fused multiply-add, no reassociation. The bytes depend on
neither the thread count nor the width of the vector unit.
"""

from __future__ import annotations

import math

import numpy as np

from gn0.jit import njit, prange
from gn0.render.cpu_bin import sort_tile
from gn0.render.cpu_project import (
    CB,
    CG,
    CR,
    DEPTH,
    LOGO,
    QK,
    QX,
    QY,
    U,
    V,
)
from gn0.render.renderer import ALPHA_CAP, ALPHA_MIN, TRANSMITTANCE_STOP

F = np.float32
TILE = 16
_ROW = 5 * TILE  # transmittance, red, green, blue, depth of a picture row
_CAP, _STOP = F(ALPHA_CAP), F(TRANSMITTANCE_STOP)
LOG_MIN = F(math.log(ALPHA_MIN))
_LOWEST = F(-5.6)  # below log(1/255): such pixels are skipped
_E1, _E2, _E3 = F(6.24807182e-02), F(1.93270083e-03), F(3.43559133e-05)
_ONE, _ZERO, _HALF = F(1.0), F(0.0), F(0.5)
_FAR_AWAY = F(np.inf)
_LAST = F(TILE - 1)
_EDGE = F(0.02)  # px: rounding of the row range
BATCH = 64
GATHERED = 10 * BATCH + 1  # floats of a batch: ten fields, and one that nobody reads
# quads are four pixels of a row: bit 4 r + k of a tile's 64 is row r, columns 4 k to 4 k + 3
_NONE, _ONE_BIT, _SIDE = np.uint64(0), np.uint64(1), np.uint64(15)
_LEFT, _RIGHT, _OUTER = np.uint64(3), np.uint64(12), np.uint64(9)
_ALL, _COLUMN = np.uint64(0xFFFFFFFFFFFFFFFF), np.uint64(0x1111111111111111)
_ENDED = np.int64(-0x7FFFFFFF80000000)  # sign bits of two float32


@njit(inline="always", error_model="numpy")
def exponential(p):  # type: ignore[no-untyped-def]
    """exp(p) for p from _LOWEST to 0: the 16th power of a cubic."""
    s = max(p, _LOWEST)
    e = _ONE + s * (_E1 + s * (_E2 + s * _E3))
    e = e * e
    e = e * e
    e = e * e
    return e * e


@njit(error_model="numpy")
def blend(acc, y0, y1, live, q0, qx, qy, dy0, qk, log_o, red, green, blue, z, first, lanes):  # type: ignore[no-untyped-def]
    """Blend one splat into `lanes` columns from `first` of rows y0 to y1 of a tile.

    Rows without a quad in `live` are left out.
    """
    for r in range(y0, y1):
        if (live >> np.uint64(4 * r)) & _SIDE == _NONE:
            continue
        dy = dy0 + F(r)
        start = q0 + qy * dy
        k0 = log_o - qk * dy * dy
        row = acc[r * _ROW : (r + 1) * _ROW]
        for j in range(first, first + lanes):
            q = start + qx * F(j)
            p = k0 - q * q
            e = min(exponential(p), _CAP)
            e = e if p >= LOG_MIN else _ZERO
            T = row[j]
            w = e * T
            after = T - w
            keep = after > _STOP
            w = w if keep else _ZERO
            row[j] = after if keep else -abs(T)
            row[1 * TILE + j] += w * red
            row[2 * TILE + j] += w * green
            row[3 * TILE + j] += w * blue
            row[4 * TILE + j] += w * z


@njit(error_model="numpy")
def gather_batch(records, rows, x_px, y_px, gathered, reach):  # type: ignore[no-untyped-def]
    """Bring a batch of splats into the frame of a tile whose first pixel is (x_px, y_px).

    Fills `gathered` field by field, and `reach` with the rows y0 <= r < y1 where the ellipse
    (qx dx + qy dy)² + qk dy² <= tau, beyond which opacity is under 1/255, meets the tile.
    """
    left, top = F(x_px) + _HALF, F(y_px) + _HALF
    warm = _ZERO  # records lie far apart: a loop as short as this waits for many of them at once
    for b in range(rows.shape[0]):
        warm += records[rows[b], U]
    gathered[10 * BATCH] = warm
    for b in range(rows.shape[0]):
        o = records[rows[b]]
        gathered[b] = left - o[U]
        gathered[BATCH + b] = top - o[V]
        gathered[2 * BATCH + b] = o[QX]
        gathered[3 * BATCH + b] = o[QY]
        gathered[4 * BATCH + b] = o[QK]
        gathered[5 * BATCH + b] = o[LOGO]
        gathered[6 * BATCH + b] = o[CR]
        gathered[7 * BATCH + b] = o[CG]
        gathered[8 * BATCH + b] = o[CB]
        gathered[9 * BATCH + b] = o[DEPTH]
    for b in range(rows.shape[0]):
        dx0, dy0 = gathered[b], gathered[BATCH + b]
        qx, qy = gathered[2 * BATCH + b], gathered[3 * BATCH + b]
        k = gathered[4 * BATCH + b]
        tau = gathered[5 * BATCH + b] - LOG_MIN
        peak = qy * np.sqrt(tau / k) / qx  # the ellipse's lowest point lies at dx = -peak
        low = min(max(-peak, dx0), dx0 + _LAST)
        high = min(max(peak, dx0), dx0 + _LAST)
        square = qy * qy + k
        scale = _ONE / square
        mixed = qx * qy
        inner = tau * square
        steep = k * qx * qx
        down = np.sqrt(max(inner - steep * low * low, _ZERO))
        up = np.sqrt(max(inner - steep * high * high, _ZERO))
        y1 = (down - mixed * low) * scale - dy0
        y0 = (-up - mixed * high) * scale - dy0
        reach[b] = np.int32(min(max(np.ceil(y0 - _EDGE), _ZERO), _LAST + _ONE))
        reach[BATCH + b] = np.int32(min(max(np.floor(y1 + _EDGE) + _ONE, _ZERO), _LAST + _ONE))


@njit(inline="always")
def _cover_quads(x0, x1, y0, y1):  # type: ignore[no-untyped-def]
    """Bits of the quads that columns x0 to x1 and rows y0 to y1 of a tile touch; none is empty."""
    columns = (_SIDE << np.uint64(x0 >> 2)) & (_SIDE >> np.uint64(3 - ((x1 - 1) >> 2)))
    rows = (_ALL << np.uint64(4 * y0)) & (_ALL >> np.uint64(4 * (TILE - y1)))
    return rows & (columns * _COLUMN)


@njit(error_model="numpy")
def _blend_tile(records, rects, rows, x_px, y_px, columns, lines, acc):  # type: ignore[no-untyped-def]
    """Blend `rows`, front to back, into `acc` [TILE * _ROW].

    Each picture row holds TILE transmittances, reds, greens, blues and depths. Splats whose pixels
    have all ended are left out before their records are read: as many of a body lie behind its
    front as are seen.
    """
    signs = acc.view(np.int64)
    acc[:] = _ZERO
    for r in range(TILE):
        for j in range(TILE):
            acc[r * _ROW + j] = _ONE if r < lines and j < columns else -_ONE
    live = _cover_quads(0, columns, 0, lines)  # quads of pixels that have not all ended
    gathered = np.empty(GATHERED, np.float32)
    reach = np.empty(2 * BATCH, np.int32)
    taken, quads = np.empty(BATCH, np.int32), np.empty(BATCH, np.uint64)
    first = 0
    while first < rows.shape[0]:
        size = 0
        while first < rows.shape[0] and size < BATCH:
            row = rows[first]
            first += 1
            box = rects[row]
            x0, x1 = max(np.int64(box[0]) - x_px, 0), min(np.int64(box[1]) - x_px, TILE)
            y0, y1 = max(np.int64(box[2]) - y_px, 0), min(np.int64(box[3]) - y_px, TILE)
            touched = live & _cover_quads(x0, x1, y0, y1)
            taken[size], quads[size] = row, touched
            size += int(touched != _NONE)
        gather_batch(records, taken[:size], x_px, y_px, gathered, reach)
        for b in range(size):
            y0, y1, still = reach[b], reach[BATCH + b], quads[b]
            if y0 < y1:
                dx0, dy0 = gathered[b], gathered[BATCH + b]
                qx, qy = gathered[2 * BATCH + b], gathered[3 * BATCH + b]
                qk, log_o = gathered[4 * BATCH + b], gathered[5 * BATCH + b]
                red, green = gathered[6 * BATCH + b], gathered[7 * BATCH + b]
                blue, z = gathered[8 * BATCH + b], gathered[9 * BATCH + b]
                q0 = qx * dx0
                # columns that are still open lie in a half of the tile, in its middle, or anywhere
                across = still | (still >> np.uint64(32))
                across |= across >> np.uint64(16)
                across |= across >> np.uint64(8)
                across |= across >> np.uint64(4)
                if across & _RIGHT == _NONE:
                    blend(acc, y0, y1, still, q0, qx, qy, dy0, qk, log_o, red, green, blue, z, 0, 8)
                elif across & _LEFT == _NONE:
                    blend(acc, y0, y1, still, q0, qx, qy, dy0, qk, log_o, red, green, blue, z, 8, 8)
                elif across & _OUTER == _NONE:
                    blend(acc, y0, y1, still, q0, qx, qy, dy0, qk, log_o, red, green, blue, z, 4, 8)
                else:
                    blend(
                        acc, y0, y1, still, q0, qx, qy, dy0, qk, log_o, red, green, blue, z, 0, 16
                    )
        for r in range(lines):
            at = np.uint64(4 * r)
            if (live >> at) & _SIDE != _NONE:
                for quad in range(4):
                    pair = r * (_ROW // 2) + 2 * quad
                    if signs[pair] & signs[pair + 1] & _ENDED == _ENDED:
                        live &= ~(_ONE_BIT << (at + np.uint64(quad)))
        if live == _NONE:
            return


@njit(error_model="numpy")
def _write_tile(  # type: ignore[no-untyped-def]
    acc, x_px, y_px, columns, lines, background, wants, rgb_u8, rgb_f32, depth, alpha
):
    """Finish a tile's pixels and store what was asked for."""
    levels = np.empty((3, TILE), np.int32)
    for r in range(lines):
        row = acc[r * _ROW : (r + 1) * _ROW]
        y = y_px + r
        if wants[0]:
            for channel in range(3):
                behind = background[channel]
                for j in range(TILE):
                    value = row[(1 + channel) * TILE + j] + abs(row[j]) * behind
                    value = min(max(value, _ZERO), _ONE)
                    levels[channel, j] = np.int32(value * F(255.0) + _HALF)
            for j in range(columns):
                rgb_u8[y, x_px + j, 0] = levels[0, j]
                rgb_u8[y, x_px + j, 1] = levels[1, j]
                rgb_u8[y, x_px + j, 2] = levels[2, j]
        if wants[1]:
            for j in range(columns):
                for channel in range(3):
                    value = row[(1 + channel) * TILE + j] + abs(row[j]) * background[channel]
                    rgb_f32[y, x_px + j, channel] = value
        if wants[2]:
            for j in range(TILE):
                opacity = _ONE - abs(row[j])
                row[4 * TILE + j] = row[4 * TILE + j] / opacity if opacity >= _HALF else _FAR_AWAY
            for j in range(columns):
                depth[y, x_px + j] = row[4 * TILE + j]
        if wants[3]:
            for j in range(columns):
                alpha[y, x_px + j] = _ONE - abs(row[j])


@njit(parallel=True)
def raster_tiles(  # type: ignore[no-untyped-def]
    rects, records, indices, ordered, starts, tile_rows, tile_keys, spare_rows, spare_keys,
    row_order, tiles_x, width, height, background, wants, rgb_u8, rgb_f32, depth, alpha,
):  # fmt: skip
    """Sort and blend all tiles into the pictures asked for (`wants`: u8, f32, depth, alpha).

    `row_order` is a permutation of the tile rows that spreads the work over threads.
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
        acc = np.empty(TILE * _ROW, np.float32)
        _blend_tile(records, rects, rows, x_px, y_px, columns, lines, acc)
        _write_tile(
            acc, x_px, y_px, columns, lines, background, wants, rgb_u8, rgb_f32, depth, alpha
        )
