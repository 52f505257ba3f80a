"""Curves of an FBX: keys in time, held, straight or cubic between them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gn0.avatars.motion.fbx_document import FbxDocument, FbxRecord
from gn0.avatars.motion.turns import as_numbers
from gn0.geometry import F64

TICKS = 46_186_158_000  # a second of FBX time
_CONSTANT, _CUBIC = 0x2, 0x8
_HOLD_NEXT = 0x100  # of constant keys: the value of the next key holds
_LONGEST = 1e6  # s


@dataclass(frozen=True, eq=False)
class FbxCurve:
    """Keys of one number.

    Attributes:
        times: of the keys [K] s, rising.
        values: at the keys [K].
        flags: how it goes on after each key [K].
        slopes: per second, after a key and before the next one [K, 2].
    """

    times: F64
    values: F64
    flags: NDArray[np.int64]
    slopes: F64

    def at(self, times: F64) -> F64:
        """Values [N] at `times` [N] s; held before the first key and after the last."""
        if len(self.times) == 1:
            return np.full(len(times), self.values[0])
        k = np.clip(np.searchsorted(self.times, times, "right") - 1, 0, len(self.times) - 2)
        span = self.times[k + 1] - self.times[k]
        u = np.clip((times - self.times[k]) / np.where(span > 0, span, 1.0), 0.0, 1.0)
        first, last = self.values[k], self.values[k + 1]
        flags = self.flags[k]
        straight = first + (last - first) * u
        out, back = self.slopes[k, 0] * span, self.slopes[k, 1] * span
        cubic = (
            first * (1 + 2 * u) * (1 - u) ** 2
            + last * u**2 * (3 - 2 * u)
            + out * u * (1 - u) ** 2
            - back * u**2 * (1 - u)
        )
        held = np.where(((flags & _HOLD_NEXT) != 0) & (u > 0), last, first)
        held = np.where(u >= 0.999, last, held)  # frames are not quite on keys
        value = np.where((flags & _CUBIC) != 0, cubic, straight)
        return np.where((flags & _CONSTANT) != 0, held, value)


def decode_curve(document: FbxDocument, record: FbxRecord) -> FbxCurve:
    """The keys of an AnimationCurve.

    Raises:
        FormatError: no keys, times that fall, or arrays of different lengths.
    """
    parts = {part.name: part for part in document.children(record)}

    def refuse(what: str, field: str) -> Exception:
        return document.refuse(what, record.at, field=field)

    ticks = document.array(parts.get("KeyTime"), "l")
    values = document.array(parts.get("KeyValueFloat"), "fd")
    if ticks is None or values is None or len(ticks) != len(values) or not len(ticks):
        raise refuse("a curve has no keys, or more times than values", "KeyTime")
    times = ticks.astype(np.float64) / TICKS
    if (np.diff(times) < 0).any() or np.abs(times).max() > _LONGEST:
        raise refuse("the times of a curve fall, or are beyond a million seconds", "KeyTime")
    if not np.isfinite(values).all():
        bad = int(np.flatnonzero(~np.isfinite(values))[0])
        raise refuse(f"key {bad} of a curve is not finite", "KeyValueFloat")
    flags = np.zeros(len(times), np.int64)
    slopes = np.zeros((len(times), 2))
    kinds = document.array(parts.get("KeyAttrFlags"), "i")
    shares = document.array(parts.get("KeyAttrRefCount"), "i")
    more = document.array(parts.get("KeyAttrDataFloat"), "fi")
    if kinds is not None and shares is not None:
        counts = shares.astype(np.int64)
        fits = len(counts) == len(kinds) and (counts >= 0).all() and counts.sum() == len(times)
        if not fits:
            raise refuse("attributes of keys do not add up to the keys", "KeyAttrRefCount")
        flags = np.repeat(kinds.astype(np.int64), counts)
        if more is not None and len(more) == 4 * len(kinds):
            four = as_numbers(np.ascontiguousarray(more).view("<f4")).reshape(-1, 4)[:, :2]
            slopes = np.repeat(np.where(np.abs(four) < 1e9, four, 0.0), counts, axis=0)
        else:
            flags = flags & ~_CUBIC
    return FbxCurve(times, as_numbers(values), flags, slopes)
