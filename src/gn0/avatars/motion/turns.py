"""Rotations as motion needs them: quaternions (w, x, y, z) of many frames at once."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gn0.geometry import F64
from gn0.jit import njit, njit_borrowing, prange

_MANY = 1024  # rotations that are worth several threads
_AXES = {"x": 1, "y": 2, "z": 3}


def quats_of(vectors: NDArray[np.floating]) -> F64:
    """Unit quaternions [..., 4] of axis-angle vectors [..., 3] rad; exact near zero."""
    v = np.asarray(vectors, np.float64)
    half = np.linalg.norm(v, axis=-1, keepdims=True) / 2.0
    return np.concatenate([np.cos(half), v * (np.sinc(half / np.pi) / 2.0)], axis=-1)


def vectors_of_quats(quats: NDArray[np.floating]) -> F64:
    """Axis-angle vectors [..., 3] rad, of length 0..π, of unit quaternions [..., 4]."""
    q = np.asarray(quats, np.float64)
    q = np.where(q[..., :1] < 0, -q, q)
    length = np.linalg.norm(q[..., 1:], axis=-1, keepdims=True)
    angle = 2.0 * np.arctan2(length, q[..., :1])
    safe = np.where(length > 1e-12, length, 1.0)
    return np.where(length > 1e-12, angle / safe, 2.0) * q[..., 1:]


def multiply(a: NDArray[np.floating], b: NDArray[np.floating]) -> F64:
    """Products [..., 4] of quaternions: first `b` turns, then `a`."""
    w, x, y, z = np.moveaxis(np.asarray(a, np.float64), -1, 0)
    p, q, r, s = np.moveaxis(np.asarray(b, np.float64), -1, 0)
    return np.stack(
        [
            w * p - x * q - y * r - z * s,
            w * q + x * p + y * s - z * r,
            w * r - x * s + y * p + z * q,
            w * s + x * r - y * q + z * p,
        ],
        axis=-1,
    )


def about_axis(axis: str, angles: NDArray[np.floating]) -> F64:
    """Quaternions [..., 4] of turns by `angles` [...] rad about "x", "y" or "z"."""
    half = np.asarray(angles, np.float64) / 2.0
    quats = np.zeros((*half.shape, 4))
    quats[..., 0], quats[..., _AXES[axis]] = np.cos(half), np.sin(half)
    return quats


def slerp(a: NDArray[np.floating], b: NDArray[np.floating], share: NDArray[np.floating]) -> F64:
    """Quaternions [..., 4] the `share` [...] of the shorter way from `a` to `b`."""
    shape = np.broadcast_shapes(np.shape(a), np.shape(b), (*np.shape(share), 1))
    first, second, part = (
        np.broadcast_to(np.asarray(one, np.float64), to)
        for one, to in ((a, shape), (b, shape), (share, shape[:-1]))
    )
    found = np.empty((math.prod(shape[:-1]), 4))
    flat = first.reshape(-1, 4), second.reshape(-1, 4), part.reshape(-1)
    (_slerp_many if len(found) > _MANY else _slerp)(*flat, found)
    return found.reshape(shape)


@njit
def _slerp(a, b, share, out):  # type: ignore[no-untyped-def]
    for n in range(a.shape[0]):
        slerp_one(a[n], b[n], share[n], out[n], 0)


@njit(parallel=True)
def _slerp_many(a, b, share, out):  # type: ignore[no-untyped-def]
    for n in prange(a.shape[0]):
        slerp_one(a[n], b[n], share[n], out[n], 0)


@njit_borrowing
def slerp_one(a, b, t, out, to, at=-1):  # type: ignore[no-untyped-def]
    """Write at `to` what is the share `t` of the way between quaternions there, or those `at`."""
    at = to if at < 0 else at
    a0, a1, a2, a3 = a[at], a[at + 1], a[at + 2], a[at + 3]
    b0, b1, b2, b3 = b[at], b[at + 1], b[at + 2], b[at + 3]
    sign = -1.0 if a0 * b0 + a1 * b1 + a2 * b2 + a3 * b3 < 0.0 else 1.0
    b0, b1, b2, b3 = sign * b0, sign * b1, sign * b2, sign * b3
    less = (a0 - b0) ** 2 + (a1 - b1) ** 2 + (a2 - b2) ** 2 + (a3 - b3) ** 2
    left, right = 1.0 - t, t
    if less > 0.0:
        more = (a0 + b0) ** 2 + (a1 + b1) ** 2 + (a2 + b2) ** 2 + (a3 + b3) ** 2
        # the angle by its chords, which keeps its digits where the arc cosine has none
        angle = 2.0 * math.atan2(math.sqrt(less), math.sqrt(more))
        left, right = math.sin((1.0 - t) * angle), math.sin(t * angle)
    w, x = left * a0 + right * b0, left * a1 + right * b1
    y, z = left * a2 + right * b2, left * a3 + right * b3
    length = math.sqrt(w * w + x * x + y * y + z * z)
    out[to], out[to + 1], out[to + 2], out[to + 3] = w / length, x / length, y / length, z / length


def matrices_of(quats: NDArray[np.floating]) -> F64:
    """Rotation matrices [..., 3, 3] of unit quaternions [..., 4]."""
    from gn0.geometry import rotation_from_quaternion

    q = np.asarray(quats, np.float64)
    return rotation_from_quaternion(q).reshape(*q.shape[:-1], 3, 3)


def quats_of_matrices(matrices: NDArray[np.floating]) -> F64:
    """Unit quaternions [..., 4] of rotation matrices [..., 3, 3]."""
    from gn0.geometry import quaternion_from_rotation

    m = np.asarray(matrices, np.float64)
    return quaternion_from_rotation(m).reshape(*m.shape[:-2], 4)


def least_turns(start: NDArray[np.floating], end: NDArray[np.floating]) -> F64:
    """The smallest rotations [..., 3, 3] that turn directions `start` into `end` [..., 3].

    None where a direction has no length; half a turn about some axis where they are opposite.
    """
    a, b = np.broadcast_arrays(np.asarray(start, np.float64), np.asarray(end, np.float64))
    lengths = np.linalg.norm(a, axis=-1) * np.linalg.norm(b, axis=-1)
    with np.errstate(invalid="ignore", divide="ignore"):
        u = a / np.linalg.norm(a, axis=-1, keepdims=True)
        v = b / np.linalg.norm(b, axis=-1, keepdims=True)
    known = lengths > 1e-18
    u, v = np.where(known[..., None], u, 0.0), np.where(known[..., None], v, 0.0)
    middle = u + v
    opposite = known & (np.linalg.norm(middle, axis=-1) < 1e-9)
    side = np.eye(3)[np.argmin(np.abs(u), axis=-1)]
    side = np.cross(u, side)
    with np.errstate(invalid="ignore", divide="ignore"):
        side = side / np.linalg.norm(side, axis=-1, keepdims=True)
    quats = np.concatenate([1.0 + (u * v).sum(-1, keepdims=True), np.cross(u, v)], axis=-1)
    half = np.concatenate([np.zeros_like(side[..., :1]), side], axis=-1)
    quats = np.where(opposite[..., None], half, quats)
    quats = np.where(known[..., None], quats, [1.0, 0.0, 0.0, 0.0])
    return matrices_of(quats / np.linalg.norm(quats, axis=-1, keepdims=True))


def as_numbers(values: NDArray[Any]) -> F64:
    """Values as float64, silent about NaNs that would signal; checks name them by their frame."""
    with np.errstate(invalid="ignore"):
        return values.astype(np.float64)


def nearest_rotations(matrices: NDArray[np.floating]) -> F64:
    """Rotations [..., 3, 3] of matrices that may also scale [..., 3, 3]; none for flat ones."""
    given = np.asarray(matrices, np.float64)
    with np.errstate(all="ignore"):
        products = given @ np.swapaxes(given, -1, -2)
    if (
        given.size
        and np.abs(products - np.eye(3)).max() < 1e-12
        and (np.linalg.det(given) > 0).all()
    ):
        return given  # as most are
    u, values, vt = np.linalg.svd(np.asarray(matrices, np.float64))
    turn = u @ vt
    flip = np.linalg.det(turn) < 0
    u[..., :, 2] = np.where(flip[..., None], -u[..., :, 2], u[..., :, 2])
    flat = values[..., 1] <= 1e-12 * np.maximum(values[..., 0], 1e-300)
    return np.where(flat[..., None, None], np.eye(3), u @ vt)


def angles_between(a: NDArray[np.floating], b: NDArray[np.floating]) -> F64:
    """Angles [...] rad between directions [..., 3]; exact for small ones."""
    cross = np.linalg.norm(np.cross(a, b), axis=-1)
    return np.arctan2(cross, (np.asarray(a) * np.asarray(b)).sum(axis=-1))


@njit(inline="always")
def unit_quat(m00, m01, m02, m10, m11, m12, m20, m21, m22):  # type: ignore[no-untyped-def]
    """(w, x, y, z), w ≥ 0, of a matrix by rows; as `gn0.geometry.quaternion_from_rotation`."""
    a, b, c = m21 - m12, m02 - m20, m10 - m01
    p, q, r = m10 + m01, m20 + m02, m21 + m12
    t0, t1 = 1 + m00 + m11 + m22, 1 + m00 - m11 - m22
    t2, t3 = 1 - m00 + m11 - m22, 1 - m00 - m11 + m22
    if t0 >= t1 and t0 >= t2 and t0 >= t3:
        w, x, y, z = t0, a, b, c
    elif t1 >= t2 and t1 >= t3:
        w, x, y, z = a, t1, p, q
    elif t2 >= t3:
        w, x, y, z = b, p, t2, r
    else:
        w, x, y, z = c, q, r, t3
    length = math.sqrt(w * w + x * x + y * y + z * z)
    if w < 0:
        length = -length
    return w / length, x / length, y / length, z / length
