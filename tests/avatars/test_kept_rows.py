"""Rows by key, the least recent of which make room."""

from __future__ import annotations

import numpy as np

from gn0.avatars.kept_rows import KeptRows


def rows(*keys: int) -> np.ndarray:
    return np.array([[key, -key] for key in keys], np.float32)


def test_the_least_recent_rows_make_room() -> None:
    kept = KeptRows((np.float32, (2,)), 4)
    assert kept.find([1, 2]).tolist() == [-1, -1]
    kept.keep([1, 2, 1], rows(1, 2, 9))
    assert len(kept) == 2 and (kept.read(kept.find([2, 1])) == rows(2, 1)).all()
    kept.keep([3, 4], rows(3, 4))
    kept.find([1, 3])
    kept.keep([5, 6], rows(5, 6))
    assert (kept.find(range(1, 7)) >= 0).tolist() == [True, False, True, False, True, True]
    assert (kept.read(kept.find([5, 1, 6, 3])) == rows(5, 1, 6, 3)).all()
    kept.keep(range(10, 20), rows(*range(10, 20)))
    assert (kept.read(kept.find(range(10, 14))) == rows(10, 11, 12, 13)).all(), "as many as fit"
    assert len(kept) == 4 and kept.find([14, 5]).tolist() == [-1, -1]
