"""Columns of a table of episodes as Python values: there, of the right kind, and without nulls."""

from __future__ import annotations

from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa

from gn0.errors import FormatError

TEXT, REAL = pa.string(), pa.float64()


def read_column(table: pa.Table, name: str, kind: pa.DataType, path: Path | str) -> list[Any]:
    """The values of a column that must be there, of that kind, without nulls.

    Raises:
        FormatError: it is missing, of another type, or holds a null; names the row.
    """
    column = _find_column(table, name, kind, path)
    if _holds_lists(column.type) and all(_is_plain(chunk) for chunk in column.chunks):
        return [row for chunk in column.chunks for row in _list_rows(chunk)]
    values: list[Any] = column.to_pylist()
    return [v if isinstance(v, str) else str(v) for v in values] if kind == TEXT else values


def count_column(table: pa.Table, name: str, kind: pa.DataType, path: Path | str) -> list[range]:
    """How long the lists of a column are, as ranges: what nobody reads need not be made objects.

    Raises:
        FormatError: see `read_column`.
    """
    column = _find_column(table, name, kind, path)
    return [
        range(count)
        for chunk in column.chunks
        for count in np.diff(chunk.offsets.to_numpy()).tolist()
    ]


def _find_column(
    table: pa.Table, name: str, kind: pa.DataType, path: Path | str
) -> pa.ChunkedArray:
    places = [i for i, column in enumerate(table.column_names) if column == name]
    if len(places) != 1:
        what = "column is missing" if not places else "column appears more than once"
        raise FormatError(
            what, file=path, field=name, remedy="see docs/suites.md: its table of columns"
        )
    column = table.column(places[0])
    if not _fits(column.type, kind):
        raise FormatError(
            f"column is {column.type}, expected {kind}", file=path, field=name, remedy="convert it"
        )
    if not all(_is_plain(chunk) for chunk in column.chunks):
        for row, value in enumerate(column.to_pylist(), 1):
            if value is None or (isinstance(value, list) and None in value):
                raise FormatError(
                    f"row {row} is null", file=path, field=name, remedy="no cell may be null"
                )
    return column


def _holds_lists(kind: pa.DataType) -> bool:
    return bool(pa.types.is_list(kind) or pa.types.is_large_list(kind))


def _is_plain(chunk: pa.Array) -> bool:
    """Whether it is plain to see that neither a cell nor a value in one is null."""
    held = chunk.flatten() if _holds_lists(chunk.type) else chunk
    return not (chunk.null_count or held.null_count or pa.types.is_dictionary(held.type))


def _list_rows(chunk: pa.Array) -> list[list[Any]]:
    """Lists of numbers; Arrow's own way makes an object of each number first."""
    held = chunk.flatten().to_numpy(zero_copy_only=False).tolist()
    ends = chunk.offsets.to_numpy()
    return [held[a:b] for a, b in pairwise((ends - ends[0]).tolist())]


def _fits(found: pa.DataType, wanted: pa.DataType) -> bool:
    """Whether a column can be read as wanted: any width of the same family, ids as text or int."""
    if pa.types.is_list(wanted):
        is_list = pa.types.is_list(found) or pa.types.is_large_list(found)
        return is_list and _fits(found.value_type, wanted.value_type)
    if pa.types.is_dictionary(found):
        return _fits(found.value_type, wanted)
    if wanted == TEXT:
        text = (
            pa.types.is_string(found)
            or pa.types.is_large_string(found)
            or pa.types.is_string_view(found)
        )
        return text or pa.types.is_integer(found)
    if wanted == REAL:
        return pa.types.is_floating(found) or pa.types.is_integer(found)
    return pa.types.is_integer(found)
