"""Rows of an array by code: those that nobody looked for of late make room."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import DTypeLike, NDArray

from gn0.avatars.code_map import I64, U64, CodeMap
from gn0.jit import njit, prange


class KeptRows:
    """Rows by code, of a bounded number.

    A hand goes round all of them for room, and passes over once who was looked for since it came
    by: close to the least recent, without sorting a hundred thousand.

    Args:
        dtype: of a row.
        most: rows.

    Attributes:
        rows: all of them [most]; `find` says which counts.
    """

    def __init__(self, dtype: DTypeLike, most: int) -> None:
        self._dtype, self._most = np.dtype(dtype), most
        self._at = CodeMap()
        self._codes = np.zeros(0, np.uint64)  # of each row
        self.rows: NDArray[Any] = np.empty(0, self._dtype)
        self._used = np.zeros(0, np.int64)  # number of the look that found each last; 0: passed
        self._look = self._filled = self._hand = 0

    def __len__(self) -> int:
        return len(self._at)

    def find(self, codes: U64) -> I64:
        """Where the rows of codes are, for `read`, until the next `keep`; -1: nowhere."""
        self._look += 1
        at = self._at.find(codes)
        self._used[at[at >= 0]] = self._look
        return at

    def read(self, at: I64) -> NDArray[Any]:
        """A copy of rows."""
        return self.rows[at]

    def copy(self, at: I64, out: NDArray[Any], to: I64) -> None:
        """Copy rows that are arrays of numbers to rows of another array, by all cores."""
        if len(at):
            _copy_rows(self.rows, at, out, to)

    def keep(self, codes: U64, rows: NDArray[Any], of: I64 | None = None) -> None:
        """Keep rows, as many as there is room for; those whose codes are here stay as they are.

        Who was found by the last look makes room last.

        Args:
            codes: of rows [n].
            rows: of each code, or an array that has them.
            of: which of `rows` is of each code [n]; without it they are in order.
        """
        fresh = np.flatnonzero(self._at.find(codes) < 0)
        _, first = np.unique(codes[fresh], return_index=True)
        chosen = fresh[np.sort(first)][: self._most]
        places = self._make_places(len(chosen))
        new = codes[chosen]
        self._at.put(new, places)
        self._codes[places] = new
        at = chosen if of is None else of[chosen]
        if rows.ndim > 1:
            _copy_rows(rows, at, self.rows, places)
        else:
            self.rows[places] = rows[at]
        self._used[places] = self._look

    def _make_places(self, count: int) -> I64:
        """Places of so many new rows."""
        if not len(self.rows):  # memory that nobody wrote to is none yet
            self.rows = np.empty(self._most, self._dtype)
            self._used = np.zeros(self._most, np.int64)
            self._codes = np.zeros(self._most, np.uint64)
        fresh = min(count, self._most - self._filled)
        places = np.arange(self._filled, self._filled + count)
        if count > fresh:
            gone = places[fresh:]
            self._hand = _go_round(self._used[: self._filled], self._hand, self._look, gone)
            self._at.drop(self._codes[gone])
        self._filled += fresh
        return places


@njit(parallel=True)
def _copy_rows(rows, at, out, to):  # type: ignore[no-untyped-def]
    """Write rows `at` of an array [N, width] to rows `to` of another."""
    for n in prange(at.shape[0]):
        one, other = at[n], to[n]
        for k in range(rows.shape[1]):
            out[other, k] = rows[one, k]


@njit
def _go_round(used, hand, look, gone):  # type: ignore[no-untyped-def]
    """Find rows that make room; those of the last look only when all others have."""
    count, found, steps = used.shape[0], 0, 0
    while found < gone.shape[0]:
        at, hand = hand, (hand + 1) % count
        steps += 1
        if used[at] < 0:  # chosen already
            continue
        if steps <= 2 * count and used[at] > 0:
            if used[at] != look:
                used[at] = 0
            continue
        gone[found], used[at] = at, -1
        found += 1
    return hand
