"""Rows of an array by key: the least recent make room."""

from __future__ import annotations

from collections.abc import Hashable, Sequence
from typing import Any

import numpy as np
from numpy.typing import DTypeLike, NDArray


class KeptRows:
    """Rows by key, of a bounded number.

    Args:
        dtype: of a row.
        most: rows.
    """

    def __init__(self, dtype: DTypeLike, most: int) -> None:
        self._dtype, self._most = np.dtype(dtype), most
        self._at: dict[Hashable, int] = {}
        self._keys: list[Hashable] = []  # of each row
        self._rows: NDArray[Any] = np.empty(0, self._dtype)
        self._used = np.zeros(0, np.int64)  # number of the look that found each last
        self._look = 0

    def __len__(self) -> int:
        return len(self._at)

    def find(self, keys: Sequence[Hashable]) -> NDArray[np.int64]:
        """Where the rows of keys are, for `read`, until the next `keep`; -1: nowhere."""
        self._look += 1
        get = self._at.get
        at = np.array([get(key, -1) for key in keys], np.int64)
        self._used[at[at >= 0]] = self._look
        return at

    def read(self, at: NDArray[np.int64]) -> NDArray[Any]:
        """A copy of rows."""
        return self._rows[at]

    def keep(self, keys: Sequence[Hashable], rows: NDArray[Any]) -> None:
        """Keep rows, as many as there is room for; those whose keys are here stay as they are."""
        first: dict[Hashable, int] = {}
        for n, key in enumerate(keys):
            if key not in self._at:
                first.setdefault(key, n)
        chosen = list(first.items())[: self._most]
        places = self._make_places(len(chosen))
        for place, (key, _) in zip(places, chosen, strict=True):
            self._at[key] = place
            self._keys[place] = key
        self._rows[places] = rows[[n for _, n in chosen]]
        self._used[places] = self._look

    def _make_places(self, count: int) -> list[int]:
        """Places of so many new rows."""
        if not len(self._rows):  # memory that nobody wrote to is none yet
            self._rows = np.empty(self._most, self._dtype)
            self._used = np.zeros(self._most, np.int64)
        fresh = min(count, self._most - len(self._keys))
        places = list(range(len(self._keys), len(self._keys) + fresh))
        self._keys += [None] * fresh
        if count > fresh:
            old = len(self._keys) - fresh
            gone = np.argsort(self._used[:old], kind="stable")[: count - fresh].tolist()
            for place in gone:
                del self._at[self._keys[place]]
            places += gone
        return places
