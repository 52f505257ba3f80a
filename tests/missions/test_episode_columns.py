"""Columns come as Arrow itself would give them, value by value and type by type."""

from __future__ import annotations

from typing import Any

import numpy as np
import pyarrow as pa
import pytest

from gn0.errors import FormatError
from gn0.missions.episode_columns import count_column, read_column

TEXTS, REALS, INTS = pa.string(), pa.list_(pa.float64()), pa.list_(pa.int64())
LISTS = [[0.1, -0.0, np.inf], [], [1e-310], [3.0, 2.5]]


def _table(*chunks: pa.Array) -> pa.Table:
    return pa.table({"it": pa.chunked_array(list(chunks))})


def _same(mine: list[Any], theirs: list[Any]) -> None:
    assert repr(mine) == repr(theirs)  # NaN and -0.0 as they are, and numbers of Python alone


@pytest.mark.parametrize("kind", [
    pa.list_(pa.float64()), pa.list_(pa.float32()), pa.large_list(pa.float64()),
    pa.list_(pa.int16()), pa.list_(pa.uint8()), pa.large_list(pa.int64()),
])  # fmt: skip
def test_lists_of_numbers_of_any_width_in_any_cut(kind: pa.DataType) -> None:
    whole = [[5, 4, 3], [], [2], [1, 0]] if pa.types.is_integer(kind.value_type) else LISTS
    array = pa.array(whole, kind)
    wanted = INTS if pa.types.is_integer(kind.value_type) else REALS
    for table in (
        _table(array),
        _table(array.slice(1, 2), array, array.slice(3)),
        _table(array).slice(1, 3),
        _table(array.slice(4)),
    ):
        theirs = table.column(0).to_pylist()
        _same(read_column(table, "it", wanted, "x"), theirs)
        counts = count_column(table, "it", wanted, "x")
        assert [len(count) for count in counts] == [len(row) for row in theirs]


def test_words_and_what_is_kept_by_number() -> None:
    words = pa.array(["a", "b", "a"]).dictionary_encode()
    assert read_column(_table(words), "it", TEXTS, "x") == ["a", "b", "a"]
    assert read_column(_table(pa.array([3, 4])), "it", TEXTS, "x") == ["3", "4"]
    held = pa.ListArray.from_arrays([0, 2, 3], pa.array([1.5, 2.5, 1.5]).dictionary_encode())
    assert read_column(_table(held), "it", REALS, "x") == [[1.5, 2.5], [1.5]]
    assert [len(one) for one in count_column(_table(held), "it", REALS, "x")] == [2, 1]


@pytest.mark.parametrize("chunk", [
    pa.array([[1.0], None]), pa.array([[1.0], [2.0, None]]),
    pa.ListArray.from_arrays(
        [0, 1, 2], pa.DictionaryArray.from_arrays(pa.array([0, 1]), pa.array([1.0, None]))
    ),
])  # fmt: skip
def test_no_null_passes_wherever_it_hides(chunk: pa.Array) -> None:
    for read in (read_column, count_column):
        with pytest.raises(FormatError, match="row 3 is null"):
            read(_table(pa.array([[0.0]], chunk.type), chunk), "it", REALS, "x")
