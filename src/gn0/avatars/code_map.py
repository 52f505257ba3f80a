"""A table from codes to numbers that takes and gives thousands at once, in compiled code."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from gn0.jit import njit

U64 = NDArray[np.uint64]
I64 = NDArray[np.int64]
_MIX = np.uint64(0x9E3779B97F4A7C15)
_HALF = np.uint64(32)
_NONE = np.uint64(0)


class CodeMap:
    """Numbers by code, a whole number above 0 below 2⁶⁴.

    A code lies in the first free place from its own on, and no place between is free.
    """

    def __init__(self) -> None:
        self._codes = np.zeros(64, np.uint64)
        self._numbers = np.zeros(64, np.int64)
        self._count = 0

    def __len__(self) -> int:
        return self._count

    def find(self, codes: U64) -> I64:
        """The numbers of codes [n]; -1 of those that are not here."""
        found = np.empty(len(codes), np.int64)
        _find(self._codes, self._numbers, codes, found)
        return found

    def put(self, codes: U64, numbers: I64) -> None:
        """Give codes numbers; of a code that comes twice the last one counts."""
        most = self._count + len(codes)
        if 2 * most > len(self._codes):
            old, held = self._codes, self._numbers
            places = 1 << (4 * most).bit_length()
            self._codes, self._numbers = np.zeros(places, np.uint64), np.zeros(places, np.int64)
            there = old != _NONE
            _put(self._codes, self._numbers, old[there], held[there])
        self._count += _put(self._codes, self._numbers, codes, numbers)

    def drop(self, codes: U64) -> None:
        """Forget codes; those that are not here do not matter."""
        self._count -= _drop(self._codes, self._numbers, codes)

    @property
    def numbers(self) -> I64:
        """All that are held, in no order."""
        return self._numbers[self._codes != _NONE]


@njit
def _home(code, last):  # type: ignore[no-untyped-def]
    return np.int64((code * _MIX) >> _HALF) & last


@njit
def _find(held, numbers, codes, found):  # type: ignore[no-untyped-def]
    last = held.shape[0] - 1
    for n in range(codes.shape[0]):
        at = _home(codes[n], last)
        while held[at] != _NONE and held[at] != codes[n]:
            at = (at + 1) & last
        found[n] = numbers[at] if held[at] != _NONE else -1


@njit
def _put(held, numbers, codes, values):  # type: ignore[no-untyped-def]
    last, more = held.shape[0] - 1, 0
    for n in range(codes.shape[0]):
        at = _home(codes[n], last)
        while held[at] != _NONE and held[at] != codes[n]:
            at = (at + 1) & last
        more += held[at] == _NONE
        held[at], numbers[at] = codes[n], values[n]
    return more


@njit
def _drop(held, numbers, codes):  # type: ignore[no-untyped-def]
    last, less = held.shape[0] - 1, 0
    for n in range(codes.shape[0]):
        at = _home(codes[n], last)
        while held[at] != _NONE and held[at] != codes[n]:
            at = (at + 1) & last
        if held[at] == _NONE:
            continue
        less += 1
        # those behind it move up as far as they may, so that no place before them is free
        behind = (at + 1) & last
        while held[behind] != _NONE:
            if ((behind - _home(held[behind], last)) & last) >= ((behind - at) & last):
                held[at], numbers[at] = held[behind], numbers[behind]
                at = behind
            behind = (behind + 1) & last
        held[at] = _NONE
    return less
