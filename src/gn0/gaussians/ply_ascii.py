"""Ascii PLY rows: one line a row, read in blocks by a compiled tokeniser.

Numbers are exact: a decimal of at most 15 digits and a small exponent is one correctly rounded
operation on doubles (Clinger 1990, "How to Read Floating Point Numbers Accurately"); every other
token goes through Python's `float`.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import IO, Any

import numpy as np
from numpy.typing import NDArray

from gn0.errors import FormatError
from gn0.gaussians.ply_header import PlyElement, PlyHeader
from gn0.jit import njit

_BLOCK = 1 << 20
_MAX_TOKEN = 400  # bytes; the longest exact decimal of a double that writers print is shorter
_REMEDY = "write the file again"
_OK, _END_OF_BLOCK, _BAD_ROW, _LONG_TOKEN = 0, 1, 2, 3
_POWERS = 10.0 ** np.arange(23)  # exact doubles


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
                f"file ended inside element {element.name!r}, {left} of {element.count} rows "
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

    Raises:
        FormatError: too few rows, a row with too many or too few values, or a value that is not
            a number (or, for integer types, not a whole number that fits).
    """
    width = len(element.names)
    columns = np.array([element.names.index(name) for name in names], np.intp)
    rows_a_block = max(1, _BLOCK // (8 * max(1, width)))
    table = np.empty((min(rows_a_block, element.count), width), np.float64)
    line_end = header.line_end[0]
    stream.seek(start)
    at, pending, ended = start, b"", False
    first = filled = 0  # first row of the table; rows in it
    while first + filled < element.count:
        room = min(len(table), element.count - first) - filled
        fresh = stream.read(_BLOCK) if not ended else b""
        ended = ended or not fresh
        text = pending + fresh + (bytes([line_end]) if ended and pending else b"")
        block = np.frombuffer(text, np.uint8)
        position = 0
        while True:
            hard = np.empty((min(len(block) // 2 + 1, room * width + 1), 3), np.int64)
            rows, position, fault, hard_count = _parse(
                block, position, line_end, table[filled : filled + room], _POWERS, hard
            )
            for token, end, slot in hard[:hard_count]:
                table[filled + slot // width, slot % width] = _slow_float(
                    text[token:end], file, at + int(token), first + filled + int(slot) // width
                )
            filled += rows
            if fault in (_BAD_ROW, _LONG_TOKEN):
                row = first + filled
                what = (
                    f"row {row} of element {element.name!r} does not have {width} values"
                    if fault == _BAD_ROW
                    else f"a value in row {row} of element {element.name!r} is over "
                    f"{_MAX_TOKEN} characters long"
                )
                raise FormatError(
                    what, file=file, offset=at + position, field=element.name, remedy=_REMEDY
                )
            if filled == len(table) or first + filled == element.count:
                yield first, _cast(table[:filled], columns, dtype, element, file, first)
                first, filled = first + filled, 0
                room = min(len(table), element.count - first)
            if fault == _END_OF_BLOCK or first == element.count:
                break
        pending = text[position:]
        at += position
        if len(pending) > _BLOCK + _MAX_TOKEN * width:  # a line of blanks, or no line at all
            raise FormatError(
                f"a row of element {element.name!r} is over {len(pending)} bytes long",
                file=file,
                offset=at,
                field=element.name,
                remedy=_REMEDY,
            )
        if ended and first + filled < element.count:
            raise FormatError(
                f"file ended inside element {element.name!r}: {first + filled} of "
                f"{element.count} rows found",
                file=file,
                offset=at,
                field=element.name,
                remedy="fetch or write the file again",
            )


def _slow_float(token: bytes, file: Path, offset: int, row: int) -> float:
    try:
        if b"_" in token:  # Python's digit groups are no PLY numbers
            raise ValueError
        return float(token)
    except ValueError:
        shown = token[:40].decode("ascii", errors="replace")
        raise FormatError(
            f"{shown!r} in row {row} is not a number", file=file, offset=offset, remedy=_REMEDY
        ) from None


def _cast(
    table: NDArray[np.float64],
    columns: NDArray[np.intp],
    dtype: type[np.generic],
    element: PlyElement,
    file: Path,
    first: int,
) -> NDArray[Any]:
    picked = table[:, columns]
    if np.issubdtype(dtype, np.integer):
        high = np.iinfo(dtype).max
        wrong = ~((picked >= 0) & (picked <= high) & (picked == np.floor(picked)))
        if wrong.any():
            row, column = (int(i) for i in np.argwhere(wrong)[0])
            raise FormatError(
                f"row {first + row} of element {element.name!r} holds {picked[row, column]:g}, "
                f"not a whole number of 0..{high}",
                file=file,
                field=element.names[columns[column]],
                remedy=_REMEDY,
            )
    with np.errstate(over="ignore", invalid="ignore"):
        return picked.astype(dtype)


@njit
def _parse(
    block: NDArray[np.uint8],
    at: int,
    line_end: int,
    table: NDArray[np.float64],
    powers: NDArray[np.float64],
    hard: NDArray[np.int64],
) -> Any:
    """Parse whole lines into `table`: (rows, position, fault, hard tokens).

    Stops before a line that the block does not finish. A hard token (start, end, slot) is one that
    needs the slow, exact path.
    """
    rows = 0
    width = table.shape[1]
    hard_count = 0
    end = len(block)
    while rows < len(table):
        line_start = at
        line_hard = hard_count
        column = 0
        finished = False
        while at < end:
            byte = block[at]
            if byte == line_end:
                at += 1
                finished = True
                break
            if byte == 32 or byte == 9 or byte == 13 or byte == 10:
                at += 1
                continue
            token = at
            negative = byte == 45
            if byte == 45 or byte == 43:
                at += 1
            mantissa = np.int64(0)
            digits = 0  # significant
            scale = 0
            any_digit = False
            dotted = False
            while at < end:
                byte = block[at]
                if 48 <= byte <= 57:
                    any_digit = True
                    if digits or byte != 48:
                        digits += 1
                    if digits <= 18:
                        mantissa = mantissa * 10 + (np.int64(byte) - 48)
                    if dotted:
                        scale -= 1
                elif byte == 46 and not dotted:
                    dotted = True
                else:
                    break
                at += 1
            easy = any_digit and digits <= 15
            if easy and at + 1 < end and (block[at] == 101 or block[at] == 69):
                cursor = at + 1
                minus = block[cursor] == 45
                if block[cursor] == 45 or block[cursor] == 43:
                    cursor += 1
                exponent = 0
                exponent_digits = 0
                while cursor < end and 48 <= block[cursor] <= 57:
                    if exponent < 10000:
                        exponent = exponent * 10 + (np.int64(block[cursor]) - 48)
                    exponent_digits += 1
                    cursor += 1
                if exponent_digits:
                    scale += -exponent if minus else exponent
                    at = cursor
                else:
                    easy = False
            # whatever is left of the token makes it a hard one
            while at < end:
                byte = block[at]
                if byte == 32 or byte == 9 or byte == 13 or byte == 10:
                    break
                easy = False
                at += 1
            if at - token > 400:
                return rows, token, 3, line_hard
            if at >= end:
                break  # the token may go on in the next block
            if column >= width:
                return rows, token, 2, line_hard
            if easy and -22 <= scale <= 22:
                value = float(mantissa)
                value = value * powers[scale] if scale >= 0 else value / powers[-scale]
                table[rows, column] = -value if negative else value
            else:
                hard[hard_count, 0] = token
                hard[hard_count, 1] = at
                hard[hard_count, 2] = rows * width + column
                hard_count += 1
            column += 1
        if not finished:
            return rows, line_start, 1, line_hard
        if column == 0:
            continue  # a blank line
        if column != width:
            return rows, line_start, 2, line_hard
        rows += 1
    return rows, at, 0, hard_count
