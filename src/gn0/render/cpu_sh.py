"""Colour of one splat from its spherical harmonics, seen along a direction."""

from __future__ import annotations

import numpy as np

from gn0.jit import njit

F = np.float32
# real spherical harmonics in the order and with the signs of 3DGS (Kerbl et al. 2023)
_C0 = F(0.28209479177387814)
_C1 = F(0.4886025119029199)
_C2A, _C2B, _C2C = F(1.0925484305920792), F(0.31539156525252005), F(0.5462742152960396)
_C3A, _C3B, _C3C = F(0.5900435899266435), F(2.890611442640554), F(0.4570457994644658)
_C3D, _C3E = F(0.3731763325901154), F(1.445305721320277)


@njit
def sh_colour(sh, degree, x, y, z):  # type: ignore[no-untyped-def]
    """Red, green, blue = max(0, SH + 0.5) for coefficients `sh` [K, 3] along (x, y, z).

    The direction goes from the camera's centre to the splat and need not be normalised.
    """
    zero = F(0.0)
    length = np.sqrt(x * x + y * y + z * z)
    scale = F(1.0) / length if length > zero else zero
    x, y, z = x * scale, y * scale, z * scale
    r, g, b = _C0 * sh[0, 0], _C0 * sh[0, 1], _C0 * sh[0, 2]
    for k in range(1, (degree + 1) * (degree + 1)):
        weight = zero
        if k == 1:
            weight = -_C1 * y
        elif k == 2:
            weight = _C1 * z
        elif k == 3:
            weight = -_C1 * x
        elif k == 4:
            weight = _C2A * x * y
        elif k == 5:
            weight = -_C2A * y * z
        elif k == 6:
            weight = _C2B * (F(2.0) * z * z - x * x - y * y)
        elif k == 7:
            weight = -_C2A * x * z
        elif k == 8:
            weight = _C2C * (x * x - y * y)
        elif k == 9:
            weight = -_C3A * y * (F(3.0) * x * x - y * y)
        elif k == 10:
            weight = _C3B * x * y * z
        elif k == 11:
            weight = -_C3C * y * (F(4.0) * z * z - x * x - y * y)
        elif k == 12:
            weight = _C3D * z * (F(2.0) * z * z - F(3.0) * x * x - F(3.0) * y * y)
        elif k == 13:
            weight = -_C3C * x * (F(4.0) * z * z - x * x - y * y)
        elif k == 14:
            weight = _C3E * z * (x * x - y * y)
        else:
            weight = -_C3A * x * (x * x - F(3.0) * y * y)
        r += weight * sh[k, 0]
        g += weight * sh[k, 1]
        b += weight * sh[k, 2]
    half = F(0.5)
    return max(r + half, zero), max(g + half, zero), max(b + half, zero)
