"""ASCII PLY rows: one line per row, read in blocks, every value exact."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import IO, Any

import numpy as np
from numpy.typing import NDArray

from gn0.errors import FormatError
from gn0.gaussians.ply_header import PlyElement, PlyHeader

_BLOCK = 1 << 18
_MAX_TOKEN = 400  # bytes a value may take; writers print at most some twenty
_REMEDY = "write the file again"


def skip_ascii_lines(
    stream: IO[bytes], start: int, element: PlyElement, header: PlyHeader, file: Path
) -> int:
    """Byte after the lines of an element, one line a row.

    Raises:
        FormatError: the file ends first.
    """
    left, at = element.count, start
    stream.seek(start)
    while left:
        block = stream.read(_BLOCK)
        if not block:
            raise FormatError(
                f"file ended inside element {element.name!r}: {left} of {element.count} rows "
                "are missing",
                file=file,
                offset=at,
                field=element.name,
                remedy=_REMEDY,
            )
        ends = np.flatnonzero(np.frombuffer(block, np.uint8) == header.line_end[0])
        if len(ends) >= left:
            return at + int(ends[left - 1]) + 1
        left -= len(ends)
        at += len(block)
    return at


def iterate_ascii_rows(
    stream: IO[bytes],
    start: int,
    element: PlyElement,
    header: PlyHeader,
    file: Path,
    names: Sequence[str],
    dtype: type[np.generic],
) -> Iterator[tuple[int, NDArray[Any]]]:
    """Blocks of rows: (first row, values [R, len(names)] of `dtype`).

    Blank lines are passed over; what follows the last row is not looked at.

    Raises:
        FormatError: too few rows, a row with too many or too few values, or a value that is not
            a number (or, for integer types, not a whole number that fits).
    """
    width = len(element.names)
    columns = np.array([element.names.index(name) for name in names], np.intp)
    stream.seek(start)
    first, at, rest = 0, start, b""  # rows done; byte at which `rest` begins

    def refuse(what: str, row: int, offset: int) -> FormatError:
        return FormatError(
            f"row {row} of element {element.name!r} {what}",
            file=file,
            offset=offset,
            field=element.name,
            remedy=_REMEDY,
        )

    while first < element.count:
        block = stream.read(_BLOCK)
        text = rest + block
        lines = text.split(header.line_end)
        rest = lines.pop() if block else b""  # a line that goes on in the next block
        if len(rest) > _MAX_TOKEN * (width + 1):
            raise refuse(f"is over {len(rest)} bytes long", first, at)
        values: list[float] = []
        row, offset = first, at
        for line in lines:
            words = line.split()
            if words and row < element.count:
                if len(words) != width:
                    raise refuse(f"has {len(words)} values, not {width}", row, offset)
                try:
                    if b"_" in line:  # Python's digit groups are no PLY numbers
                        raise ValueError
                    values.extend(map(float, words))
                except ValueError:
                    bad = next(word for word in words if not _is_number(word))
                    shown = bad[:40].decode("ascii", errors="replace")
                    raise refuse(f"holds {shown!r}, not a number", row, offset) from None
                row += 1
            offset += len(line) + 1
        if row > first:
            table = np.array(values, np.float64).reshape(-1, width)
            yield first, _cast(table[:, columns], columns, dtype, element, file, first, at)
        first, at = row, offset
        if not block and first < element.count:
            raise FormatError(
                f"file ended inside element {element.name!r}: {first} of {element.count} rows",
                file=file,
                offset=at - 1,
                field=element.name,
                remedy="fetch or write the file again",
            )


def _is_number(word: bytes) -> bool:
    try:
        float(word)
    except ValueError:
        return False
    return b"_" not in word


def _cast(
    table: NDArray[np.float64],
    columns: NDArray[np.intp],
    dtype: type[np.generic],
    element: PlyElement,
    file: Path,
    first: int,
    offset: int,
) -> NDArray[Any]:
    """Values as `dtype`; for integers each must be one."""
    if np.issubdtype(dtype, np.integer):
        high = int(np.iinfo(np.dtype(dtype).name).max)
        wrong = ~((table >= 0) & (table <= high) & (table == np.floor(table)))
        if wrong.any():
            row, column = (int(i) for i in np.argwhere(wrong)[0])
            raise FormatError(
                f"row {first + row} of element {element.name!r} holds {table[row, column]:g}, "
                f"not a whole number of 0..{high}",
                file=file,
                offset=offset,
                field=element.names[columns[column]],
                remedy=_REMEDY,
            )
    with np.errstate(over="ignore", invalid="ignore"):
        return table.astype(dtype)
