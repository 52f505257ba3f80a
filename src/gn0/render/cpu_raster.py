"""Blending, a 16x16 tile at a time: each tile is one independent piece of work.

Rows are blended 16 pixels wide without branches. exp() is the 16th power of a cubic (relative
error under 1e-4 over the range that counts). A pixel that has ended keeps its transmittance with
a negative sign, which makes every later weight fall away.
"""

from __future__ import annotations

import math

import numpy as np

from gn0.jit import njit, prange
from gn0.render.cpu_project import (
    CB,
    CG,
    CR,
    DEPTH,
    LOGO,
    QK,
    QX,
    QY,
    Y0,
    Y1,
    U,
    V,
)
from gn0.render.renderer import ALPHA_CAP, ALPHA_MIN, TRANSMITTANCE_STOP

F = np.float32
TILE = 16
_CAP, _STOP = F(ALPHA_CAP), F(TRANSMITTANCE_STOP)
_LOG_MIN = F(math.log(ALPHA_MIN))
_LOWEST = F(-5.6)  # below log(1/255): such pixels are skipped
_E1, _E2, _E3 = F(6.24807182e-02), F(1.93270083e-03), F(3.43559133e-05)
_ONE, _ZERO, _HALF = F(1.0), F(0.0), F(0.5)
_CHECK = 8  # splats between looks for finished rows


@njit(parallel=True)
def raster_tiles(  # type: ignore[no-untyped-def]
    records, starts, items, tiles_x, width, height, background, wants, rgb_u8, rgb_f32, depth,
    alpha,
):  # fmt: skip
    """Blend all tiles into the pictures asked for (`wants`: u8, f32, depth, alpha)."""
    for t in prange(starts.shape[0] - 1):
        acc = np.empty((TILE, 5, TILE), np.float32)  # a row: transmittance, red, green, blue, depth
        signs = acc.view(np.int32)
        tile_y = t // tiles_x
        x_px, y_px = (t - tile_y * tiles_x) * TILE, tile_y * TILE
        columns, lines = min(TILE, width - x_px), min(TILE, height - y_px)
        acc[:] = _ZERO
        acc[:, 0, :] = -_ONE
        for r in range(lines):
            for j in range(columns):
                acc[r, 0, j] = _ONE
        live = (1 << lines) - 1
        left, top = F(x_px) + _HALF, F(y_px) + _HALF
        for i in range(starts[t], starts[t + 1]):
            o = records[items[i]]
            y0 = max(np.int32(o[Y0]) - y_px, 0)
            y1 = min(np.int32(o[Y1]) - y_px, lines)
            qx, qy, qk, log_o = o[QX], o[QY], o[QK], o[LOGO]
            red, green, blue, z = o[CR], o[CG], o[CB], o[DEPTH]
            start = qx * (left - o[U])
            dy0 = top - o[V]
            for r in range(y0, y1):
                if (live >> r) & 1 == 0:
                    continue
                dy = dy0 + F(r)
                q0 = start + qy * dy
                k0 = log_o - qk * dy * dy
                row = acc[r]
                for j in range(TILE):
                    q = q0 + qx * F(j)
                    p = k0 - q * q
                    s = max(p, _LOWEST)
                    e = _ONE + s * (_E1 + s * (_E2 + s * _E3))
                    e = e * e
                    e = e * e
                    e = e * e
                    e = e * e
                    e = min(e, _CAP)
                    e = e if p >= _LOG_MIN else _ZERO
                    T = row[0, j]
                    w = e * T
                    after = T - w
                    keep = after > _STOP
                    w = w if keep else _ZERO
                    row[0, j] = after if keep else -abs(T)
                    row[1, j] += w * red
                    row[2, j] += w * green
                    row[3, j] += w * blue
                    row[4, j] += w * z
            if (i & (_CHECK - 1)) == 0:
                for r in range(lines):
                    if (live >> r) & 1:
                        ended = np.int32(-1)
                        for j in range(TILE):
                            ended &= signs[r, 0, j]
                        if ended < 0:
                            live &= ~(1 << r)
                if live == 0:
                    break
        for r in range(lines):
            row = acc[r]
            y = y_px + r
            for j in range(columns):
                x = x_px + j
                T = abs(row[0, j])
                opacity = _ONE - T
                if wants[0] or wants[1]:
                    for channel in range(3):
                        value = row[1 + channel, j] + T * background[channel]
                        if wants[0]:
                            value = min(max(value, _ZERO), _ONE)
                            rgb_u8[y, x, channel] = np.uint8(value * F(255.0) + _HALF)
                        else:
                            rgb_f32[y, x, channel] = value
                if wants[2]:
                    far = np.float32(np.inf)
                    depth[y, x] = row[4, j] / opacity if opacity >= _HALF else far
                if wants[3]:
                    alpha[y, x] = opacity
