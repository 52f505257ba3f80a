"""Rows of one PLY element, block by block, whatever the encoding.

A file is never read whole: blocks of about a megabyte are turned into plain columns, so memory
stays at the decoded result plus a few megabytes however wide the rows are.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Any

import numpy as np
from numpy.typing import NDArray

from gn0.errors import FormatError
from gn0.gaussians.ply_ascii import iterate_ascii_rows, skip_ascii_lines
from gn0.gaussians.ply_header import PlyElement, PlyHeader
from gn0.gaussians.ply_lists import end_of_list_rows

BLOCK_BYTES = 1 << 20  # fits the second-level cache with its decoded columns
_REMEDY = "fetch or write the file again"


@dataclass(frozen=True)
class PlySource:
    """An open PLY file with its parsed header.

    Attributes:
        stream: the file, opened in binary, seekable.
        file: its name, for messages.
        size: its size [bytes].
        header: the parsed header, already checked against `size`.
    """

    stream: IO[bytes]
    file: Path
    size: int
    header: PlyHeader


def start_of_element(source: PlySource, wanted: PlyElement) -> int:
    """Byte at which an element's rows begin.

    Raises:
        FormatError: rows before it run past the end of the file.
    """
    at = source.header.data_offset
    for element in source.header.elements:
        if element is wanted or element.name == wanted.name:
            break
        if not source.header.is_binary:
            at = skip_ascii_lines(source.stream, at, element, source.header, source.file)
        elif element.has_lists:
            at = end_of_list_rows(
                source.stream, at, element, source.header.byte_order, source.file, source.size
            )
        else:
            at += element.count * element.least_bytes(True)
    return at


def note_trailing_bytes(source: PlySource) -> tuple[str, ...]:
    """A note where a binary file goes on after all the rows its header speaks of."""
    header = source.header
    if not header.is_binary or any(e.has_lists for e in header.elements):
        return ()
    used = header.data_offset + sum(e.count * e.least_bytes(True) for e in header.elements)
    left = source.size - used
    return (f"{left} bytes after the last row were not read",) if left else ()


def iterate_rows(
    source: PlySource,
    element: PlyElement,
    names: Sequence[str],
    dtype: type[np.generic],
    block_bytes: int = BLOCK_BYTES,
) -> Iterator[tuple[int, NDArray[Any]]]:
    """Blocks of an element's rows: (first row, values [R, len(names)] of `dtype`).

    Values are cast as NumPy casts; a double beyond float32 becomes inf. Integers may be asked for
    only where the file stores them (checked in ascii files). A block is valid until the next one.

    Args:
        source: the open file.
        element: an element without lists.
        names: the properties wanted, in the order wanted.
        dtype: np.float32, np.uint32 or np.uint8.
        block_bytes: size of a block, for binary files.

    Raises:
        FormatError: the file ends early, or an ascii row is malformed.
    """
    start = start_of_element(source, element)
    if not source.header.is_binary:
        yield from iterate_ascii_rows(
            source.stream, start, element, source.header, source.file, names, dtype
        )
        return
    row_bytes = element.least_bytes(True)
    if start + element.count * row_bytes > source.size:
        raise FormatError(
            f"file is truncated: element {element.name!r} needs {element.count * row_bytes} bytes "
            f"from byte {start}, but the file ends at byte {source.size}",
            file=source.file,
            offset=source.size,
            field=element.name,
            remedy=_REMEDY,
        )
    row_type = element.row_type(source.header.byte_order)
    rows_a_block = max(1, block_bytes // max(1, row_bytes))
    buffer = bytearray(min(rows_a_block, element.count) * row_bytes)
    types = {row_type[name] for name in element.names}
    uniform = types.pop() if len(types) == 1 else None
    columns = np.array([element.names.index(name) for name in names], np.intp)
    source.stream.seek(start)
    for first in range(0, element.count, rows_a_block):
        count = min(rows_a_block, element.count - first)
        view = memoryview(buffer)[: count * row_bytes]
        _read_exactly(source, view, start + first * row_bytes, element)
        if uniform is not None:
            table = np.frombuffer(view, uniform).reshape(count, len(element.names))
            yield first, _take_columns(table, columns, dtype)
        else:
            records = np.frombuffer(view, row_type)
            values = np.empty((count, len(names)), dtype)
            with np.errstate(over="ignore", invalid="ignore"):
                for j, name in enumerate(names):
                    values[:, j] = records[name]
            yield first, values


def _take_columns(
    table: NDArray[Any], columns: NDArray[np.intp], dtype: type[np.generic]
) -> NDArray[Any]:
    """Some columns of a table [R, P] as `dtype`; a view where they lie side by side."""
    first, count = int(columns[0]), len(columns)
    if np.array_equal(columns, np.arange(first, first + count)):
        picked = table[:, first : first + count]
    else:
        picked = table[:, columns]
    with np.errstate(over="ignore", invalid="ignore"):
        return picked.astype(dtype, copy=False)


def _read_exactly(source: PlySource, view: memoryview, offset: int, element: PlyElement) -> None:
    filled = 0
    while filled < len(view):
        got = source.stream.readinto(view[filled:])  # type: ignore[attr-defined]
        if not got:
            raise FormatError(
                f"file ended inside element {element.name!r}: it shrank while being read",
                file=source.file,
                offset=offset + filled,
                field=element.name,
                remedy=_REMEDY,
            )
        filled += got
