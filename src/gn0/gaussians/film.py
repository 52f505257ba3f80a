"""Between light and display values: the sRGB curve, and the film curve of baked scenes."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from gn0.geometry import F32, F64

BRIGHTEST = 6.3985  # exposed light at which the film curve reaches white


def encode_srgb(linear: NDArray[np.floating]) -> F32:
    """Display values 0..1 of linear light (IEC 61966-2-1), clipped."""
    x = np.clip(np.asarray(linear, np.float32), 0.0, 1.0)
    high = np.float32(1.055) * np.power(x, np.float32(1 / 2.4)) - np.float32(0.055)
    return np.where(x <= 0.0031308, np.float32(12.92) * x, high).astype(np.float32)


def decode_srgb(display: NDArray[np.floating]) -> F32:
    """Linear light of display values 0..1 (IEC 61966-2-1)."""
    x = np.clip(np.asarray(display, np.float32), 0.0, 1.0)
    high = np.power((x + np.float32(0.055)) / np.float32(1.055), np.float32(2.4))
    return np.where(x <= 0.04045, x / np.float32(12.92), high).astype(np.float32)


def develop_film(exposed: NDArray[np.floating]) -> F32:
    """Display values 0..1 of exposed light: sRGB(filmic(x)).

    filmic(x) = x (a x + b) / (x (c x + d) + e), the rational fit of the ACES film curve by
    K. Narkowicz (2015) with a lifted toe, so that dark corners keep detail.
    """
    x = np.maximum(np.asarray(exposed, np.float32), 0)
    y = x * (2.51 * x + 0.10) / (x * (2.43 * x + 0.59) + 0.14)
    return encode_srgb(y)


def expose_film(display: NDArray[np.floating]) -> F64:
    """Exposed light of display values 0..1: the inverse of `develop_film`, at most `BRIGHTEST`."""
    y = decode_srgb(display).astype(np.float64)
    a, b, c = 2.51 - 2.43 * y, 0.10 - 0.59 * y, -0.14 * y
    x = (-b + np.sqrt(b * b - 4.0 * a * c)) / (2.0 * a)
    return np.clip(x, 0.0, BRIGHTEST)
