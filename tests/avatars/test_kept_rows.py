"""Rows by code, and the table of codes: what it finds, and who makes room."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from gn0.avatars.code_map import CodeMap
from gn0.avatars.kept_rows import KeptRows


def rows(*keys: int) -> np.ndarray:
    return np.array([[key, -key] for key in keys], np.float32)


def codes(keys: Iterable[int]) -> np.ndarray:
    return np.array([*keys], np.uint64)


def test_rows_that_nobody_looked_for_make_room() -> None:
    kept = KeptRows((np.float32, (2,)), 4)
    assert kept.find(codes([1, 2])).tolist() == [-1, -1]
    kept.keep(codes([1, 2, 1]), rows(1, 2, 9))
    assert len(kept) == 2 and (kept.read(kept.find(codes([2, 1]))) == rows(2, 1)).all()
    kept.keep(codes([3, 4]), rows(3, 4))
    kept.find(codes([1, 3]))
    kept.keep(codes([5, 6]), rows(5, 6))
    found = kept.find(codes(range(1, 7)))
    assert (found >= 0).tolist() == [True, False, True, False, True, True]
    assert (kept.read(kept.find(codes([5, 1, 6, 3]))) == rows(5, 1, 6, 3)).all()
    kept.keep(codes(range(10, 20)), rows(*range(10, 20)))
    assert (kept.read(kept.find(codes(range(10, 14)))) == rows(10, 11, 12, 13)).all(), "who fits"
    assert len(kept) == 4 and kept.find(codes([14, 5])).tolist() == [-1, -1]


def test_rows_of_the_last_look_stay_while_others_are_there() -> None:
    kept = KeptRows((np.float32, (2,)), 8)
    for n in range(1, 200, 5):
        wanted = codes(range(n, n + 4))
        assert (kept.find(wanted) < 0).all()
        kept.keep(wanted, rows(*range(n, n + 4)))
        more = codes([*range(n, n + 4), n + 4])
        kept.find(more)
        kept.keep(more[4:], rows(n + 4))
        assert (kept.find(more) >= 0).all()
        kept.keep(codes([10**6 + n]), rows(0))
        assert (kept.find(more) >= 0).all() and len(kept) <= 8


def test_codes_are_found_where_others_came_and_went() -> None:
    table, want = CodeMap(), {}
    stream = np.random.Generator(np.random.PCG64(5))
    for turn in range(300):
        many = stream.integers(1, 500, 40).astype(np.uint64)
        if turn % 3:
            numbers = stream.integers(0, 10**6, 40)
            table.put(many, numbers)
            want |= dict(zip(many.tolist(), numbers.tolist(), strict=True))
        else:
            table.drop(np.concatenate([many, many]))
            for code in many.tolist():
                want.pop(code, None)
        assert len(table) == len(want) and sorted(table.numbers) == sorted(want.values())
        found = table.find(np.arange(1, 501, dtype=np.uint64))
        assert found.tolist() == [want.get(code, -1) for code in range(1, 501)]
    high = codes([2**64 - 1, 2**63, 1])
    table.put(high, np.array([1, 2, 3]))
    assert table.find(high).tolist() == [1, 2, 3]
