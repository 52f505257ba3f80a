"""Band-limited noise on integer hashes: the same bytes on every machine.

All functions take float64 coordinates [M] in units of the pattern and return float64 [M].
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from gn0.geometry import F64
from gn0.jit import njit, prange


@njit(inline="always")
def _hash(x, y, seed):  # type: ignore[no-untyped-def]
    """Integer hash of a lattice point (rounds of lowbias32, C. Wellons)."""
    h = np.uint32(np.int64(x) & np.int64(0xFFFFFFFF))
    h = np.uint32(h * np.uint32(0x9E3779B1)) ^ np.uint32(np.int64(y) & np.int64(0xFFFFFFFF))
    h ^= h >> np.uint32(16)
    h = np.uint32(h * np.uint32(0x7FEB352D)) + np.uint32(seed)
    h ^= h >> np.uint32(15)
    h = np.uint32(h * np.uint32(0x846CA68B))
    h ^= h >> np.uint32(16)
    return h


@njit(parallel=True)
def _random_kernel(x, y, seed, out):  # type: ignore[no-untyped-def]
    for i in prange(len(x)):
        out[i] = _hash(np.int64(np.floor(x[i])), np.int64(np.floor(y[i])), seed) / 4294967296.0


@njit(inline="always")
def _gradient(ix, iy, fx, fy, seed):  # type: ignore[no-untyped-def]
    h = _hash(ix, iy, seed)
    # eight directions of equal length
    k = h & np.uint32(7)
    a, b = (1.0, 0.41421356) if k & np.uint32(1) else (0.41421356, 1.0)
    sx = -1.0 if k & np.uint32(2) else 1.0
    sy = -1.0 if k & np.uint32(4) else 1.0
    return sx * a * fx + sy * b * fy


@njit(parallel=True)
def _fractal_kernel(x, y, seed, weights, out):  # type: ignore[no-untyped-def]
    norm = 0.0
    for o in range(len(weights)):
        norm += weights[o] * weights[o]
    for i in prange(len(x)):
        px, py = x[i], y[i]
        total = 0.0
        for o in range(len(weights)):
            if weights[o] > 0.0:
                gx, gy = np.floor(px), np.floor(py)
                fx, fy = px - gx, py - gy
                ix, iy = np.int64(gx), np.int64(gy)
                s = seed + o * 7919
                n00 = _gradient(ix, iy, fx, fy, s)
                n10 = _gradient(ix + 1, iy, fx - 1.0, fy, s)
                n01 = _gradient(ix, iy + 1, fx, fy - 1.0, s)
                n11 = _gradient(ix + 1, iy + 1, fx - 1.0, fy - 1.0, s)
                wx = fx * fx * fx * (fx * (fx * 6.0 - 15.0) + 10.0)
                wy = fy * fy * fy * (fy * (fy * 6.0 - 15.0) + 10.0)
                low = n00 + wx * (n10 - n00)
                high = n01 + wx * (n11 - n01)
                total += weights[o] * (low + wy * (high - low))
            # an irrational turn and shift hides the lattice of the next octave
            px, py = 2.0 * (0.8 * px - 0.6 * py) + 17.3, 2.0 * (0.6 * px + 0.8 * py) - 5.7
        out[i] = total * 1.9


@njit(parallel=True)
def _cells_kernel(x, y, seed, first, second, tone):  # type: ignore[no-untyped-def]
    for i in prange(len(x)):
        ix, iy = np.int64(np.floor(x[i])), np.int64(np.floor(y[i]))
        d1, d2, best = 9.0, 9.0, np.uint32(0)
        for a in range(-1, 2):
            for b in range(-1, 2):
                h = _hash(ix + a, iy + b, seed)
                cx = ix + a + 0.1 + 0.8 * (h & np.uint32(0xFFFF)) / 65536.0
                cy = iy + b + 0.1 + 0.8 * (h >> np.uint32(16)) / 65536.0
                d = np.sqrt((cx - x[i]) ** 2 + (cy - y[i]) ** 2)
                if d < d1:
                    d1, d2, best = d, d1, h
                elif d < d2:
                    d2 = d
        first[i], second[i] = d1, d2
        tone[i] = _hash(best & np.uint32(0xFFFF), best >> np.uint32(16), seed + 1) / 4294967296.0


def _pair(x: NDArray[np.floating], y: NDArray[np.floating]) -> tuple[F64, F64]:
    bx, by = np.broadcast_arrays(np.asarray(x, np.float64), np.asarray(y, np.float64))
    return np.ascontiguousarray(bx), np.ascontiguousarray(by)


def random_cells(x: NDArray[np.floating], y: NDArray[np.floating] | float, seed: int) -> F64:
    """A random value 0..1 for each unit cell."""
    px, py = _pair(x, np.asarray(y))
    out = np.empty(len(px))
    _random_kernel(px, py, seed, out)
    return out


def fade(period: float, footprint: float) -> float:
    """Weight 0..1 of detail of wavelength `period` seen at `footprint` (both in one unit)."""
    t = min(max((period / max(footprint, 1e-9) - 1.5) / 2.5, 0.0), 1.0)
    return t * t * (3 - 2 * t)


def fractal(
    x: NDArray[np.floating],
    y: NDArray[np.floating],
    seed: int,
    *,
    octaves: int = 4,
    gain: float = 0.5,
    footprint: float = 0.0,
) -> F64:
    """Gradient noise in octaves, about −1..1; octaves too fine for `footprint` fade out."""
    px, py = _pair(x, y)
    weights = np.array([gain**o * fade(0.5**o, footprint) for o in range(octaves)])
    out = np.empty(len(px))
    _fractal_kernel(px, py, seed, weights, out)
    return out


def cells(x: NDArray[np.floating], y: NDArray[np.floating], seed: int) -> tuple[F64, F64, F64]:
    """Cellular noise: distances to the nearest two feature points, and the cell's random tone."""
    px, py = _pair(x, y)
    first, second, tone = np.empty(len(px)), np.empty(len(px)), np.empty(len(px))
    _cells_kernel(px, py, seed, first, second, tone)
    return first, second, tone


def stripes(x: NDArray[np.floating], share: float, footprint: float) -> F64:
    """How much of a stripe (0 ≤ frac(x) < share) lies in a box of width `footprint` at x."""
    width = max(footprint, 1e-6)

    def filled(p: F64) -> F64:
        whole = np.floor(p)
        return whole * share + np.minimum(p - whole, share)

    at: F64 = np.asarray(x, np.float64)
    return (filled(at + width / 2) - filled(at - width / 2)) / width


def step(x: NDArray[np.floating], width: float) -> F64:
    """A soft step from 0 to 1 across `width`, centred on x = 0."""
    t = np.clip(np.asarray(x, np.float64) / max(width, 1e-6) + 0.5, 0.0, 1.0)
    return t * t * (3 - 2 * t)
