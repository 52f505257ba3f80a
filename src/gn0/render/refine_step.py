"""One step of a fit: from sums over footprints to splats, and from splats to the packed cloud.

A splat's parameters [PARAMETERS]: its centre along its own three axes [m], the 2x2 matrix whose
columns span its footprint on the first two axes [m], the logit of its opacity, its display colour.
"""

from __future__ import annotations

import math

import numpy as np

from gn0.jit import njit, prange
from gn0.render.cpu_pack import CHUNK, EXTENT, LOG_OPACITY, REACH, RED
from gn0.render.cpu_project import CENTRE, FX, FY, LIM_XN, LIM_XP, LIM_YN, LIM_YP, QK, QX, QY
from gn0.render.gradient import SUMS
from gn0.render.renderer import ALPHA_MIN

F = np.float32
PARAMETERS = 11
THIRD = 2  # the thin axis
_LOG_MIN = F(math.log(ALPHA_MIN))
_ZERO, _ONE, _TWO = F(0.0), F(1.0), F(2.0)
# decay of Adam's first and second moment: short, because a splat is seen only now and then
_FAST, _SLOW = F(0.6), F(0.9)
_TINY = F(1e-12)
_LOGIT_LOW, _LOGIT_HIGH = F(-5.0), F(7.0)


@njit(parallel=True)
def write_pack(param, base, frame, thickness, chunks, pack, boxes):  # type: ignore[no-untyped-def]
    """Write the splats of `chunks` into a packed cloud whose order is theirs."""
    for v in prange(chunks.shape[0]):
        c = chunks[v]
        reach_max = _ZERO
        for k in range(CHUNK):
            i = c * CHUNK + k
            if i >= param.shape[0]:
                pack[c, REACH * CHUNK + k] = -_ONE
                continue
            p, f = param[i], frame[i]
            log_opacity = -np.log(_ONE + np.exp(-p[7]))
            squared = _TWO * (log_opacity - _LOG_MIN)
            extent = np.sqrt(max(squared, _ZERO))
            spread = thickness[i] * thickness[i]
            for axis in range(3):
                a, b, n = f[axis], f[3 + axis], f[6 + axis]
                mean = base[i, axis] + a * p[0] + b * p[1] + n * p[2]
                m1, m2 = a * p[3] + b * p[5], a * p[4] + b * p[6]
                spread += m1 * m1 + m2 * m2
                pack[c, axis * CHUNK + k] = mean
                pack[c, (3 + 3 * axis) * CHUNK + k] = m1
                pack[c, (4 + 3 * axis) * CHUNK + k] = m2
                pack[c, (5 + 3 * axis) * CHUNK + k] = n * thickness[i]
                pack[c, (RED + axis) * CHUNK + k] = max(p[8 + axis], _ZERO)
                if k == 0:
                    boxes[c, axis] = mean
                    boxes[c, 3 + axis] = mean
                boxes[c, axis] = min(boxes[c, axis], mean)
                boxes[c, 3 + axis] = max(boxes[c, 3 + axis], mean)
            reach = extent * np.sqrt(spread) if squared > _ZERO else -_ONE  # never too short
            pack[c, REACH * CHUNK + k] = reach
            pack[c, EXTENT * CHUNK + k] = extent
            pack[c, LOG_OPACITY * CHUNK + k] = log_opacity
            reach_max = max(reach_max, reach)
        boxes[c, 6] = reach_max


@njit(error_model="numpy")
def gradient_of(s, p, base, f, record, view, g):  # type: ignore[no-untyped-def]
    """Gradient of the loss by a splat's parameters, into `g`, from its sums `s` in one picture.

    The 2D covariance is F Fᵀ + dilation, F = J W [t1 t2] A; with Q its inverse and S the second
    moments of h, dL/dF = Q S Q F. J is taken as constant.
    """
    x = base[0] + f[0] * p[0] + f[3] * p[1] + f[6] * p[2] - view[CENTRE]
    y = base[1] + f[1] * p[0] + f[4] * p[1] + f[7] * p[2] - view[CENTRE + 1]
    z = base[2] + f[2] * p[0] + f[5] * p[1] + f[8] * p[2] - view[CENTRE + 2]
    iz = _ONE / (view[6] * x + view[7] * y + view[8] * z)
    tx = (view[0] * x + view[1] * y + view[2] * z) * iz
    ty = (view[3] * x + view[4] * y + view[5] * z) * iz
    tx, ty = min(view[LIM_XP], max(-view[LIM_XN], tx)), min(view[LIM_YP], max(-view[LIM_YN], ty))
    jx, jy = view[FX] * iz, view[FY] * iz
    m0, m1, m2 = view[0] - tx * view[6], view[1] - tx * view[7], view[2] - tx * view[8]
    n0, n1, n2 = view[3] - ty * view[6], view[4] - ty * view[7], view[5] - ty * view[8]
    u0 = jx * (m0 * f[0] + m1 * f[1] + m2 * f[2])
    u1 = jx * (m0 * f[3] + m1 * f[4] + m2 * f[5])
    u2 = jx * (m0 * f[6] + m1 * f[7] + m2 * f[8])
    v0 = jy * (n0 * f[0] + n1 * f[1] + n2 * f[2])
    v1 = jy * (n0 * f[3] + n1 * f[4] + n2 * f[5])
    v2 = jy * (n0 * f[6] + n1 * f[7] + n2 * f[8])
    qx, qy, qk = record[QX], record[QY], record[QK]
    A, B, C = _TWO * qx * qx, _TWO * qx * qy, _TWO * (qy * qy + qk)
    gu, gv = A * s[1] + B * s[2], B * s[1] + C * s[2]
    a0, a1, b0, b1 = (
        A * s[3] + B * s[4],
        A * s[4] + B * s[5],
        B * s[3] + C * s[4],
        B * s[4] + C * s[5],
    )
    k00, k01, k11 = a0 * A + a1 * B, a0 * B + a1 * C, b0 * B + b1 * C
    f00, f01 = u0 * p[3] + u1 * p[5], u0 * p[4] + u1 * p[6]
    f10, f11 = v0 * p[3] + v1 * p[5], v0 * p[4] + v1 * p[6]
    h00, h01 = k00 * f00 + k01 * f10, k00 * f01 + k01 * f11
    h10, h11 = k01 * f00 + k11 * f10, k01 * f01 + k11 * f11
    g[0], g[1], g[2] = gu * u0 + gv * v0, gu * u1 + gv * v1, gu * u2 + gv * v2
    g[3], g[4] = u0 * h00 + v0 * h10, u0 * h01 + v0 * h11
    g[5], g[6] = u1 * h00 + v1 * h10, u1 * h01 + v1 * h11
    g[7] = s[0] * (_ONE - _ONE / (_ONE + np.exp(-p[7])))
    g[8], g[9], g[10] = s[6], s[7], s[8]


@njit(parallel=True, error_model="numpy")
def descend(  # type: ignore[no-untyped-def]
    sums, indices, records, param, base, frame, size, limit, view, first, second, seen, rates, bound
):
    """Move the splats that took part in a picture by one step of Adam.

    `rates` [PARAMETERS] are step lengths, those of centre and axes in sizes of the splat. `bound`
    [3] is how far a centre may go along its axes [m], `limit` [N] a matrix's largest entry [m].
    """
    for block in prange((sums.shape[0] + CHUNK - 1) // CHUNK):
        g = np.empty(PARAMETERS, np.float32)
        for row in range(block * CHUNK, min((block + 1) * CHUNK, sums.shape[0])):
            s = sums[row]
            anything = False
            for k in range(SUMS):
                anything |= s[k] != _ZERO
            if not anything:
                continue
            i = indices[row]
            p = param[i]
            gradient_of(s, p, base[i], frame[i], records[row], view, g)
            seen[i] += 1
            fast = _ONE - _FAST ** F(seen[i])
            slow = _ONE - _SLOW ** F(seen[i])
            for k in range(PARAMETERS):
                first[i, k] = _FAST * first[i, k] + (_ONE - _FAST) * g[k]
                second[i, k] = _SLOW * second[i, k] + (_ONE - _SLOW) * g[k] * g[k]
                change = rates[k] * (first[i, k] / fast) / (np.sqrt(second[i, k] / slow) + _TINY)
                p[k] -= change * size[i] if k < 7 else change
            for k in range(3):
                p[k] = min(max(p[k], -bound[k]), bound[k])
            for k in range(3, 7):
                p[k] = min(max(p[k], -limit[i]), limit[i])
            p[7] = min(max(p[7], _LOGIT_LOW), _LOGIT_HIGH)
