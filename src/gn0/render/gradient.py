"""How each splat would have to change to bring a picture nearer to a target: the backward pass.

A tile is blended twice, front to back. The first pass gives the colour of each pixel; the second
knows what still lies behind each splat, because front-to-back sums leave it as a remainder, and so
needs no reverse order. Every (tile, splat) entry writes its own sums; a splat's entries are added
up in list order. No sum depends on the thread count.

Source: the gradient of alpha blending as in 3D Gaussian Splatting (Kerbl et al. 2023), written for
the moments of each footprint instead of for its nine parameters.
"""

from __future__ import annotations

import numpy as np

from gn0.jit import njit, prange
from gn0.render.cpu_bin import sort_tile
from gn0.render.cpu_raster import BATCH, GATHERED, LOG_MIN, TILE, blend, exponential, gather_batch
from gn0.render.renderer import ALPHA_CAP, TRANSMITTANCE_STOP

F = np.float32
# sums of an entry over its pixels, h = dL/d(exponent), d = pixel - centre, w = weight, g = dL/dC
SUM_H, SUM_HX, SUM_HY, SUM_HXX, SUM_HXY, SUM_HYY, SUM_RED = 0, 1, 2, 3, 4, 5, 6
SUMS = 9
# as `blend` lays them out: transmittance, then colour (pass 1) or gradient (pass 2), then depth
# (unused) or the g·C still behind
_ROW = 5 * TILE
_CHECK = 16  # splats between looks for finished rows
_ONE, _ZERO, _HALF, _TWO = F(1.0), F(0.0), F(0.5), F(2.0)
_CLEAR = F(0.02)  # transmittance below this is no gap: blending ends before it is zero
_CAP, _STOP = F(ALPHA_CAP), F(TRANSMITTANCE_STOP)


@njit(parallel=True)
def sort_tiles(tile_rows, tile_keys, spare_rows, spare_keys, starts, indices, records, ordered):  # type: ignore[no-untyped-def]
    """Sort each tile's list in place by (depth, index)."""
    for t in prange(starts.shape[0] - 1):
        a, b = starts[t], starts[t + 1]
        sort_tile(
            tile_keys[a:b], tile_rows[a:b], spare_keys[a:b], spare_rows[a:b], indices, records,
            ordered,
        )  # fmt: skip


@njit(error_model="numpy")
def _unblend(acc, y0, y1, live, q0, qx, qy, dx0, dy0, qk, log_o, red, green, blue, lanes):  # type: ignore[no-untyped-def]
    """Sums of one splat in a tile, one lane a column: `lanes` [SUMS * TILE]."""
    lanes[:] = _ZERO
    for r in range(y0, y1):
        if (live >> r) & 1 == 0:
            continue
        dy = dy0 + F(r)
        start = q0 + qy * dy
        k0 = log_o - qk * dy * dy
        row = acc[r * _ROW : (r + 1) * _ROW]
        for j in range(TILE):
            dx = dx0 + F(j)
            q = start + qx * F(j)
            p = k0 - q * q
            e = exponential(p)
            free = _ONE if e < _CAP else _ZERO  # a capped pixel does not see the exponent
            e = min(e, _CAP)
            e = e if p >= LOG_MIN else _ZERO
            T = row[j]
            w = e * T
            after = T - w
            keep = after > _STOP
            w = w if keep else _ZERO
            row[j] = after if keep else -abs(T)
            own = w * (
                row[1 * TILE + j] * red + row[2 * TILE + j] * green + row[3 * TILE + j] * blue
            )
            behind = row[4 * TILE + j] - own
            row[4 * TILE + j] = behind
            h = (own - e * behind / (_ONE - e)) * free
            h = h if keep else _ZERO
            hx, hy = h * dx, h * dy
            lanes[0 * TILE + j] += h
            lanes[1 * TILE + j] += hx
            lanes[2 * TILE + j] += hy
            lanes[3 * TILE + j] += hx * dx
            lanes[4 * TILE + j] += hx * dy
            lanes[5 * TILE + j] += hy * dy
            lanes[6 * TILE + j] += w * row[1 * TILE + j]
            lanes[7 * TILE + j] += w * row[2 * TILE + j]
            lanes[8 * TILE + j] += w * row[3 * TILE + j]


@njit(error_model="numpy")
def _still_live(acc, live, lines):  # type: ignore[no-untyped-def]
    """The rows of `live` that have a pixel whose transmittance has not ended."""
    for r in range(lines):
        if (live >> r) & 1:
            highest = -_ONE
            for j in range(TILE):
                highest = max(highest, acc[r * _ROW + j])
            if highest < _ZERO:
                live &= ~(1 << r)
    return live


@njit
def _row_quads(live, lines):  # type: ignore[no-untyped-def]
    """Rows of `live` as `blend` has them: four bits a row."""
    quads = np.uint64(0)
    for r in range(lines):
        if (live >> r) & 1:
            quads |= np.uint64(15) << np.uint64(4 * r)
    return quads


@njit(error_model="numpy")
def _turn_round(acc, x_px, y_px, columns, lines, target, scale, closed):  # type: ignore[no-untyped-def]
    """Colours become gradients of scale · Σ (C − target)²; returns the squared error.

    When `closed`, what shows through a gap counts in the gradient as the colour least like the
    target: black behind bright pixels, white behind dark ones, channel by channel. Pixels whose
    target is black show no surface, and black is behind them.
    """
    total = 0.0
    for r in range(TILE):
        for j in range(TILE):
            at = r * _ROW + j
            if r >= lines or j >= columns:
                for c in range(5):
                    acc[at + c * TILE] = _ZERO
                acc[at] = -_ONE
                continue
            behind = _ZERO
            pixel = target[y_px + r, x_px + j]
            through = abs(acc[at])
            gap = through if closed and through > _CLEAR else _ZERO
            gap = gap if pixel[0] | pixel[1] | pixel[2] else _ZERO
            for c in range(3):
                colour = acc[at + (1 + c) * TILE]
                wanted = F(pixel[c]) * F(1.0 / 255.0)
                off = colour - wanted
                total += np.float64(off) * np.float64(off)
                if wanted < _HALF:
                    colour += gap
                    off += gap
                acc[at + (1 + c) * TILE] = _TWO * off * scale
                behind += _TWO * off * scale * colour
            acc[at + 4 * TILE] = behind
            acc[at] = _ONE
    return total


@njit(parallel=True, error_model="numpy")
def sum_entries(  # type: ignore[no-untyped-def]
    records, tile_rows, starts, row_order, tiles_x, width, height, target, scale, closed, sums,
    errors,
):  # fmt: skip
    """Gradient sums of every (tile, splat) entry of a picture against `target` [H, W, 3] uint8.

    Lists must be sorted. The background is black, or when `closed` an error, see `_turn_round`.
    Fills `sums` [entries, SUMS] and the squared error of each tile before black, `errors` [tiles].
    """
    for step in prange(row_order.shape[0] * tiles_x):
        tile_y, tile_x = row_order[step // tiles_x], step % tiles_x
        t = tile_y * tiles_x + tile_x
        x_px, y_px = tile_x * TILE, tile_y * TILE
        columns, lines = min(TILE, width - x_px), min(TILE, height - y_px)
        begin, rows = starts[t], tile_rows[starts[t] : starts[t + 1]]
        acc = np.zeros(TILE * _ROW, np.float32)
        for r in range(TILE):
            for j in range(TILE):
                acc[r * _ROW + j] = _ONE if r < lines and j < columns else -_ONE
        o = np.empty(GATHERED, np.float32)
        reach = np.empty(2 * BATCH, np.int32)
        lanes = np.zeros(SUMS * TILE, np.float32)
        for second in range(2):
            if second:
                errors[t] = _turn_round(acc, x_px, y_px, columns, lines, target, scale, closed)
                sums[begin : begin + rows.shape[0]] = _ZERO
            live = (1 << lines) - 1
            quads = _row_quads(live, lines)
            for first in range(0, rows.shape[0], BATCH):
                size = min(BATCH, rows.shape[0] - first)
                gather_batch(records, rows[first : first + size], x_px, y_px, o, reach)
                for b in range(size):
                    y0, y1 = reach[b], min(reach[BATCH + b], lines)
                    dx0, dy0 = o[b], o[BATCH + b]
                    qx, qy, qk = o[2 * BATCH + b], o[3 * BATCH + b], o[4 * BATCH + b]
                    log_o, q0 = o[5 * BATCH + b], qx * dx0
                    red, green, blue = o[6 * BATCH + b], o[7 * BATCH + b], o[8 * BATCH + b]
                    if not second:
                        blend(
                            acc, y0, y1, quads, q0, qx, qy, dy0, qk, log_o, red, green, blue,
                            _ZERO, 0, TILE,
                        )  # fmt: skip
                    else:
                        _unblend(
                            acc, y0, y1, live, q0, qx, qy, dx0, dy0, qk, log_o, red, green, blue,
                            lanes,
                        )  # fmt: skip
                        for k in range(SUMS):
                            value = _ZERO
                            for j in range(TILE):
                                value += lanes[k * TILE + j]
                            sums[begin + first + b, k] = value
                    if (b & (_CHECK - 1)) == _CHECK - 1:
                        live = _still_live(acc, live, lines)
                        quads = _row_quads(live, lines)
                        if live == 0:
                            break
                if live == 0:
                    break


@njit(parallel=True)
def sum_rows(tile_rows, entries, sums, parts, out):  # type: ignore[no-untyped-def]
    """Add up the entries of each projected splat, in list order: `out` [rows, SUMS]."""
    n = out.shape[0]
    for part in prange(parts):
        low, high = part * n // parts, (part + 1) * n // parts
        out[low:high] = _ZERO
        for e in range(entries):
            row = tile_rows[e]
            if low <= row < high:
                for k in range(SUMS):
                    out[row, k] += sums[e, k]
