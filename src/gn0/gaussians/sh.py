"""Real spherical harmonics as 3DGS uses them: bands 0 to 3, channel-last, and their rotation.

Coefficients are stored `[N, K, 3]`, K = (degree + 1)². Basis and signs follow the original 3DGS
(Kerbl et al. 2023), after Green, "Spherical Harmonic Lighting" (2003).
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from gn0.errors import FormatError
from gn0.gaussians.cloud import SH_C0
from gn0.geometry import F32, F64

MAX_DEGREE = 3  # what GaussianCloud holds and every backend evaluates


def coefficient_count(degree: int) -> int:
    """Coefficients per channel up to and including a degree, the DC term counted."""
    return (degree + 1) ** 2


def degree_of_rest(rest: int) -> int | None:
    """SH degree that has `rest` values beyond DC over three channels; None if there is none.

    0 → 0, 9 → 1, 24 → 2, 45 → 3, 72 → 4 …
    """
    if rest % 3:
        return None
    root = math.isqrt(rest // 3 + 1)
    return root - 1 if root * root == rest // 3 + 1 else None


def rest_columns(degree: int, kept: int) -> list[int]:
    """Which `f_rest_i` make up `sh[:, 1:, :]`, in C order, for files of SH `degree`.

    3DGS PLY stores the rest channel by channel, i = channel · (K − 1) + coefficient; a cloud is
    channel-last. Bands above `kept` are left out: they are orthogonal to those below.
    """
    per_channel = coefficient_count(degree) - 1
    take = coefficient_count(min(degree, kept)) - 1
    return [c * per_channel + k for k in range(take) for c in range(3)]


def sh_basis(directions: NDArray[np.floating], degree: int) -> F64:
    """SH basis values [N, K] for unit directions [N, 3], float64.

    Raises:
        FormatError: degree outside 0..3.
    """
    if not 0 <= degree <= MAX_DEGREE:
        raise FormatError(f"SH degree {degree} is outside 0..{MAX_DEGREE}", field="sh")
    d = np.asarray(directions, np.float64)
    x, y, z = d[:, 0], d[:, 1], d[:, 2]
    terms = [np.full_like(x, SH_C0)]
    if degree >= 1:
        c1 = math.sqrt(3 / (4 * math.pi))
        terms += [-c1 * y, c1 * z, -c1 * x]
    if degree >= 2:
        c2 = math.sqrt(15 / (4 * math.pi))
        terms += [
            c2 * x * y,
            -c2 * y * z,
            0.5 * c2 / math.sqrt(3) * (2 * z * z - x * x - y * y),
            -c2 * x * z,
            0.5 * c2 * (x * x - y * y),
        ]
    if degree >= 3:
        a = math.sqrt(35 / (32 * math.pi))
        b = math.sqrt(105 / (4 * math.pi))
        c = math.sqrt(21 / (32 * math.pi))
        terms += [
            -a * y * (3 * x * x - y * y),
            b * x * y * z,
            -c * y * (4 * z * z - x * x - y * y),
            0.5 * math.sqrt(7 / (4 * math.pi)) * z * (2 * z * z - 3 * x * x - 3 * y * y),
            -c * x * (4 * z * z - x * x - y * y),
            0.5 * b * z * (x * x - y * y),
            -a * x * (x * x - 3 * y * y),
        ]
    return np.stack(terms, axis=1)


def evaluate_sh(sh: F32, directions: NDArray[np.floating]) -> F64:
    """Colours [N, 3] of coefficients [N, K, 3] seen along unit directions [N, 3].

    max(0, SH + 0.5), as 3DGS; the direction runs from the camera to the Gaussian.
    """
    degree = math.isqrt(sh.shape[1]) - 1
    basis = sh_basis(directions, degree)
    return np.maximum(0.0, np.einsum("nk,nkc->nc", basis, sh.astype(np.float64)) + 0.5)


def sh_rotation(rotation: NDArray[np.floating], degree: int) -> F64:
    """Matrix [K, K] that turns coefficients with the scene.

    With f'(d) = f(Rᵀ d): the rotated coefficients are `matrix @ coefficients`. Each band maps to
    itself, so a least-squares fit on fixed directions is exact up to rounding.
    """
    r = np.asarray(rotation, np.float64)
    directions = _sphere_directions(64)
    matrix = np.zeros((coefficient_count(degree),) * 2)
    here, there = sh_basis(directions, degree), sh_basis(directions @ r, degree)
    for band in range(degree + 1):
        span = slice(band * band, (band + 1) ** 2)
        matrix[span, span] = np.linalg.pinv(here[:, span]) @ there[:, span]
    return matrix


def rotate_sh(sh: F32, rotation: NDArray[np.floating]) -> F32:
    """Coefficients [N, K, 3] of a cloud whose scene is turned by `rotation` [3, 3]."""
    degree = math.isqrt(sh.shape[1]) - 1
    if degree == 0:
        return sh
    matrix = sh_rotation(rotation, degree).astype(np.float32)
    return np.ascontiguousarray(np.einsum("jk,nkc->njc", matrix, sh, optimize=True))


def _sphere_directions(count: int) -> F64:
    """Unit directions [count, 3] on a Fibonacci spiral: even, fixed, no randomness."""
    i = np.arange(count) + 0.5
    z = 1 - 2 * i / count
    azimuth = math.pi * (1 + math.sqrt(5)) * i
    ring = np.sqrt(1 - z * z)
    return np.stack([ring * np.cos(azimuth), ring * np.sin(azimuth), z], axis=1)
