"""From packed chunks to screen: culling, EWA projection, spherical harmonics.

The 2D covariance is kept as a factor, F = J W M with M Mᵀ the 3D covariance, and its determinant
as a sum of squared minors (Cauchy-Binet), so thin splats lose no digits in float32. A splat's
exponent is (qx·dx + qy·dy)² + dy²·k, the Cholesky form of half the Mahalanobis distance.

Source of the rules: gsplat (EWA splatting, Zwicker et al. 2001); see `docs/renderer.md`.
"""

from __future__ import annotations

import math

import numpy as np

from gn0.jit import njit, prange
from gn0.render.cpu_pack import (
    BLUE,
    CHUNK,
    EXTENT,
    FIELDS,
    GREEN,
    LOG_OPACITY,
    POSED_NORMAL,
    REACH,
    RED,
)
from gn0.render.cpu_posed import unfold_chunk
from gn0.render.cpu_sh import sh_colour
from gn0.render.renderer import ALPHA_MIN, DILATION, EXTENT_MAX

F = np.float32
RECORD = 12  # floats a projected splat: fewer take less time to write than lines they straddle
U, V, QX, QY, QK, LOGO, DEPTH, CR, CG, CB, ORDER = range(11)

# fields of the view parameters, float32 [VIEW_FIELDS]
ROTATION, CENTRE, FX, FY, CX, CY, NEAR, FAR = 0, 9, 12, 13, 14, 15, 16, 17
LIM_XP, LIM_XN, LIM_YP, LIM_YN, GAIN_X, GAIN_Y, WIDTH, HEIGHT = 18, 19, 20, 21, 22, 23, 24, 25
NEARER = 26  # m by which splats are sorted as if nearer
VIEW_FIELDS = 27

# fields of a chunk in flight
_Z, _U, _V, _QX, _QY, _QK, _RX, _RY, _THIN, _X0, _X1, _Y0, _Y1, _GR, _GG, _GB = range(16)
_LANES = 16

_PAD = F(EXTENT_MAX * math.sqrt(DILATION) + 0.5)  # px: what the dilation can add, and rounding
_EPS = F(DILATION)
_LOG_MIN = F(math.log(ALPHA_MIN))
_HALF, _ONE, _ZERO, _TWO = F(0.5), F(1.0), F(0.0), F(2.0)
_SLACK = F(0.01)  # px: rounding of a footprint's edge
_LARGEST = F(1e9)  # px: a footprint larger than this overflows further on


@njit
def cull_chunks(boxes, view, ortho, seen):  # type: ignore[no-untyped-def]
    """List chunks that may touch the picture in `seen`; returns how many there are.

    A chunk is dropped only if the test of `project_chunks` would drop each of its splats.
    """
    n = 0
    for c in range(boxes.shape[0]):
        cx = (boxes[c, 0] + boxes[c, 3]) * _HALF - view[CENTRE]
        cy = (boxes[c, 1] + boxes[c, 4]) * _HALF - view[CENTRE + 1]
        cz = (boxes[c, 2] + boxes[c, 5]) * _HALF - view[CENTRE + 2]
        hx = (boxes[c, 3] - boxes[c, 0]) * _HALF
        hy = (boxes[c, 4] - boxes[c, 1]) * _HALF
        hz = (boxes[c, 5] - boxes[c, 2]) * _HALF
        slack = (abs(cx) + abs(cy) + abs(cz) + hx + hy + hz) * F(1e-5)
        keep = True
        for plane in range(6):
            # n·p + d > allowance for all centres p means out of sight
            if plane == 0:  # nearer than near
                a, b, e = -view[6], -view[7], -view[8]
                d, allow = view[NEAR], _ZERO
            elif plane == 1:
                a, b, e = view[6], view[7], view[8]
                d, allow = -view[FAR], _ZERO
            else:
                axis = 0 if plane < 4 else 1
                f = view[FX + axis]
                lim = (view[WIDTH + axis] - view[CX + axis] + _PAD) / f
                sign = _ONE
                if plane % 2 == 1:
                    lim = (view[CX + axis] + _PAD) / f
                    sign = -_ONE
                a, b, e = view[3 * axis], view[3 * axis + 1], view[3 * axis + 2]
                a, b, e = sign * a, sign * b, sign * e
                d = _ZERO
                if ortho:
                    d = -lim
                else:
                    a, b, e = a - lim * view[6], b - lim * view[7], e - lim * view[8]
                allow = boxes[c, 6] * view[GAIN_X + axis]
            lowest = a * cx + b * cy + e * cz - abs(a) * hx - abs(b) * hy - abs(e) * hz + d
            if lowest > allow * F(1.0001) + slack * (abs(a) + abs(b) + abs(e)):
                keep = False
        if keep:
            seen[n] = c
            n += 1
    return n


@njit(error_model="numpy")
def _project_block(  # type: ignore[no-untyped-def]
    begin, end, pack, order, first_index, sh, degree, chunks, view, ortho, antialiased, row0,
    tiles_x, records, rects, keys, indices, counts, tiles, gain, normals, still, floor, floor_at,
):  # fmt: skip
    """Project chunks begin to end of `chunks`; see `project_chunks`."""
    r00, r01, r02 = view[0], view[1], view[2]
    r10, r11, r12 = view[3], view[4], view[5]
    r20, r21, r22 = view[6], view[7], view[8]
    ex, ey, ez = view[CENTRE], view[CENTRE + 1], view[CENTRE + 2]
    fx, fy, cx, cy = view[FX], view[FY], view[CX], view[CY]
    near, far, width, height = view[NEAR], view[FAR], view[WIDTH], view[HEIGHT]
    nearer = view[NEARER]
    lxp, lxn, lyp, lyn = view[LIM_XP], view[LIM_XN], view[LIM_YP], view[LIM_YN]
    pinhole = _ZERO if ortho else _ONE
    lit, turned = gain.shape[0] > 0, gain.shape[0] > 1
    gr, gg, gb = (gain[0, 0], gain[0, 1], gain[0, 2]) if lit else (_ONE, _ONE, _ONE)
    grx, ggx, gbx = (gain[1, 0], gain[1, 1], gain[1, 2]) if turned else (_ZERO, _ZERO, _ZERO)
    gry, ggy, gby = (gain[2, 0], gain[2, 1], gain[2, 2]) if turned else (_ZERO, _ZERO, _ZERO)
    grz, ggz, gbz = (gain[3, 0], gain[3, 1], gain[3, 2]) if turned else (_ZERO, _ZERO, _ZERO)
    tiles[:] = 0
    lanes = np.empty(_LANES * CHUNK, np.float32)
    ok = np.empty(CHUNK, np.int32)
    posed = still.shape[0] > 0
    unfolded = np.empty(FIELDS * CHUNK if posed else 0, np.float32)
    for v in range(begin, end):
        own = pack[chunks[v]]
        p = own
        if posed:
            unfold_chunk(own, still[chunks[v]], floor, floor_at - chunks[v] * CHUNK, unfolded)
            p = unfolded
        for k in range(CHUNK):
            x, y, z = p[k] - ex, p[CHUNK + k] - ey, p[2 * CHUNK + k] - ez
            X = r00 * x + r01 * y + r02 * z
            Y = r10 * x + r11 * y + r12 * z
            Z = r20 * x + r21 * y + r22 * z + _ZERO  # + 0: no negative zero among the keys
            inside = (near <= Z) & (far >= Z) & (p[REACH * CHUNK + k] >= _ZERO)
            iz = _ONE / (Z if (inside & (pinhole > _ZERO)) else _ONE)
            tx, ty = X * iz, Y * iz
            u, w = fx * tx + cx, fy * ty + cy
            # J clamps x/z and y/z to the picture widened by 0.3 of its half angle
            tx = min(lxp, max(-lxn, tx)) * pinhole
            ty = min(lyp, max(-lyn, ty)) * pinhole
            jx, jy = fx * iz, fy * iz
            m0, m1, m2 = jx * (r00 - tx * r20), jx * (r01 - tx * r21), jx * (r02 - tx * r22)
            n0, n1, n2 = jy * (r10 - ty * r20), jy * (r11 - ty * r21), jy * (r12 - ty * r22)
            f0 = m0 * p[3 * CHUNK + k] + m1 * p[6 * CHUNK + k] + m2 * p[9 * CHUNK + k]
            f1 = m0 * p[4 * CHUNK + k] + m1 * p[7 * CHUNK + k] + m2 * p[10 * CHUNK + k]
            f2 = m0 * p[5 * CHUNK + k] + m1 * p[8 * CHUNK + k] + m2 * p[11 * CHUNK + k]
            g0 = n0 * p[3 * CHUNK + k] + n1 * p[6 * CHUNK + k] + n2 * p[9 * CHUNK + k]
            g1 = n0 * p[4 * CHUNK + k] + n1 * p[7 * CHUNK + k] + n2 * p[10 * CHUNK + k]
            g2 = n0 * p[5 * CHUNK + k] + n1 * p[8 * CHUNK + k] + n2 * p[11 * CHUNK + k]
            a0 = f0 * f0 + f1 * f1 + f2 * f2
            d0 = g0 * g0 + g1 * g1 + g2 * g2
            b = f0 * g0 + f1 * g1 + f2 * g2
            e0, e1, e2 = f0 * g1 - f1 * g0, f0 * g2 - f2 * g0, f1 * g2 - f2 * g1
            thin = e0 * e0 + e1 * e1 + e2 * e2
            a, d = a0 + _EPS, d0 + _EPS
            det = thin + _EPS * (a0 + d)
            # exponent = ((d dx - b dy)² / det + dy²) / 2d
            qx = np.sqrt(_HALF * d / det)
            extent = p[EXTENT * CHUNK + k]
            lanes[_QX * CHUNK + k] = qx
            lanes[_QY * CHUNK + k] = -(b / d) * qx
            lanes[_QK * CHUNK + k] = _HALF / d
            lanes[_RX * CHUNK + k] = extent * np.sqrt(a)
            lanes[_RY * CHUNK + k] = extent * np.sqrt(d)
            lanes[_THIN * CHUNK + k] = thin / det
            lanes[_U * CHUNK + k], lanes[_V * CHUNK + k], lanes[_Z * CHUNK + k] = u, w, Z
            rx, ry = lanes[_RX * CHUNK + k], lanes[_RY * CHUNK + k]
            # what float32 cannot hold is dropped: comparisons with NaN are false
            inside = inside & (rx < _LARGEST) & (ry < _LARGEST) & (qx > _ZERO)
            inside = inside & (u + rx > _ZERO) & (u - rx < width)
            inside = inside & (w + ry > _ZERO) & (w - ry < height)
            # pixel centres within the footprint's box: columns x0 <= x < x1
            x0 = max(np.ceil(u - rx - _HALF - _SLACK), _ZERO)
            x1 = min(np.floor(u + rx - _HALF + _SLACK) + _ONE, width)
            y0 = max(np.ceil(w - ry - _HALF - _SLACK), _ZERO)
            y1 = min(np.floor(w + ry - _HALF + _SLACK) + _ONE, height)
            lanes[_X0 * CHUNK + k], lanes[_X1 * CHUNK + k] = x0, x1
            lanes[_Y0 * CHUNK + k], lanes[_Y1 * CHUNK + k] = y0, y1
            ok[k] = 1 if inside & (x0 < x1) & (y0 < y1) else 0
        if turned:
            if posed:
                facing, at = own, POSED_NORMAL * CHUNK
            else:
                facing, at = normals[chunks[v]], 0
            for k in range(CHUNK):
                n0, n1, n2 = facing[at + k], facing[at + CHUNK + k], facing[at + 2 * CHUNK + k]
                lanes[_GR * CHUNK + k] = max(gr + grx * n0 + gry * n1 + grz * n2, _ZERO)
                lanes[_GG * CHUNK + k] = max(gg + ggx * n0 + ggy * n1 + ggz * n2, _ZERO)
                lanes[_GB * CHUNK + k] = max(gb + gbx * n0 + gby * n1 + gbz * n2, _ZERO)
        elif lit:
            for k in range(CHUNK):
                lanes[_GR * CHUNK + k] = max(gr, _ZERO)
                lanes[_GG * CHUNK + k] = max(gg, _ZERO)
                lanes[_GB * CHUNK + k] = max(gb, _ZERO)
        n = 0
        row = row0 + v * CHUNK
        for k in range(CHUNK):
            if ok[k] == 0:
                continue
            log_opacity = p[LOG_OPACITY * CHUNK + k]
            x0, x1 = lanes[_X0 * CHUNK + k], lanes[_X1 * CHUNK + k]
            y0, y1 = lanes[_Y0 * CHUNK + k], lanes[_Y1 * CHUNK + k]
            if antialiased:
                if lanes[_THIN * CHUNK + k] <= _ZERO:
                    continue
                log_opacity += _HALF * np.float32(math.log(lanes[_THIN * CHUNK + k]))
                squared = _TWO * (log_opacity - _LOG_MIN)
                if squared <= _ZERO:
                    continue
                shrink = np.sqrt(squared) / p[EXTENT * CHUNK + k]
                u, w = lanes[_U * CHUNK + k], lanes[_V * CHUNK + k]
                rx, ry = lanes[_RX * CHUNK + k] * shrink, lanes[_RY * CHUNK + k] * shrink
                x0 = max(np.ceil(u - rx - _HALF - _SLACK), _ZERO)
                x1 = min(np.floor(u + rx - _HALF + _SLACK) + _ONE, width)
                y0 = max(np.ceil(w - ry - _HALF - _SLACK), _ZERO)
                y1 = min(np.floor(w + ry - _HALF + _SLACK) + _ONE, height)
                if not (x0 < x1 and y0 < y1):
                    continue
            index = order[chunks[v] * CHUNK + k]
            o = records[row + n]
            o[U], o[V], o[QX], o[QY], o[QK] = (
                lanes[_U * CHUNK + k],
                lanes[_V * CHUNK + k],
                lanes[_QX * CHUNK + k],
                lanes[_QY * CHUNK + k],
                lanes[_QK * CHUNK + k],
            )
            away = lanes[_Z * CHUNK + k]
            o[LOGO], o[DEPTH], o[ORDER] = log_opacity, away, max(away - nearer, away * _HALF)
            if degree == 0:
                o[CR], o[CG], o[CB] = (
                    p[RED * CHUNK + k],
                    p[GREEN * CHUNK + k],
                    p[BLUE * CHUNK + k],
                )
            else:
                o[CR], o[CG], o[CB] = sh_colour(
                    sh[index], degree, p[k] - ex, p[CHUNK + k] - ey, p[2 * CHUNK + k] - ez
                )
            if lit:
                o[CR] *= lanes[_GR * CHUNK + k]
                o[CG] *= lanes[_GG * CHUNK + k]
                o[CB] *= lanes[_GB * CHUNK + k]
            t = rects[row + n]
            t[0], t[1], t[2], t[3] = np.int16(x0), np.int16(x1), np.int16(y0), np.int16(y1)
            keys[row + n] = np.float32(o[ORDER]).view(np.uint32)
            indices[row + n] = first_index + index
            n += 1
            left, right = np.int32(x0) >> 4, (np.int32(x1) + 15) >> 4
            for ty in range(np.int32(y0) >> 4, (np.int32(y1) + 15) >> 4):
                for tile in range(ty * tiles_x + left, ty * tiles_x + right):
                    tiles[tile] += 1
        counts[v] = n


@njit(parallel=True)
def project_chunks(  # type: ignore[no-untyped-def]
    pack, order, first_index, sh, degree, chunks, view, ortho, antialiased, row0, tiles_x, records,
    rects, keys, indices, counts, histogram, gain, normals, still, floor, floor_at,
):  # fmt: skip
    """Project the splats of `chunks`; chunk v fills rows from `row0 + v * CHUNK`.

    Fills `records` [rows, RECORD], `rects` [rows, 4] (first and past-the-last pixel in x, in y),
    `keys` [rows] (bits of the depth that they are sorted by), `indices` [rows] (index in the
    cloud, plus `first_index`), `counts[v]`, the rows filled, and `histogram` [blocks, tiles],
    entries of block b's chunks.
    Colours are multiplied by `gain` (see `cpu_parts.PlacedPart`) at the splat's normal. Chunks of a
    posed cloud, which has `still` rows, are unfolded first.
    """
    blocks = histogram.shape[0]
    for block in prange(blocks):
        begin, end = block * len(chunks) // blocks, (block + 1) * len(chunks) // blocks
        _project_block(
            begin, end, pack, order, first_index, sh, degree, chunks, view, ortho, antialiased,
            row0, tiles_x, records, rects, keys, indices, counts, histogram[block], gain, normals,
            still, floor, floor_at,
        )  # fmt: skip
