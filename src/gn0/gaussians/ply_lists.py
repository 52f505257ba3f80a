"""Where binary PLY rows with lists end: they must be walked, since each tells its own length."""

from __future__ import annotations

from pathlib import Path
from typing import IO, Any

import numpy as np
from numpy.typing import NDArray

from gn0.errors import FormatError
from gn0.gaussians.ply_header import PlyElement
from gn0.jit import njit

_BLOCK = 1 << 20
_WORD = 8  # the longest list length


def end_of_list_rows(
    stream: IO[bytes], start: int, element: PlyElement, byte_order: str, file: Path, size: int
) -> int:
    """Byte after the last row of a binary element with lists.

    Args:
        stream: the file.
        start: byte of the first row.
        element: the element to walk over.
        byte_order: "<" or ">".
        file: its name, for messages.
        size: its size [bytes].

    Raises:
        FormatError: a row runs past the end of the file, or a list has a negative length.
    """
    widths = np.array([int(p.type[1]) for p in element.properties], np.int64)
    counts = np.array(
        [int(p.count_type[1]) if p.count_type else 0 for p in element.properties], np.int64
    )
    signed = np.array([(p.count_type or "u")[0] == "i" for p in element.properties], np.bool_)
    at, row, column = start, 0, 0
    while row < element.count:
        stream.seek(at)
        block = np.frombuffer(stream.read(_BLOCK), np.uint8)
        step, row, column, bad = _walk(
            block, row, column, element.count, widths, counts, signed, byte_order == ">", size - at
        )
        at += step
        if bad or (row < element.count and at >= size):
            what = "a list has a negative or impossible length" if bad else "rows run past the end"
            raise FormatError(
                f"file is truncated or forged: in element {element.name!r}, row {row}, {what}",
                file=file,
                offset=min(at, size),
                field=element.properties[column].name,
                remedy="fetch or write the file again",
            )
        if not step and len(block) < _WORD and row < element.count:
            # fewer bytes are left than the next length needs
            raise FormatError(
                f"file is truncated inside element {element.name!r}, row {row}",
                file=file,
                offset=size,
                field=element.name,
                remedy="fetch or write the file again",
            )
    return at


@njit
def _walk(
    block: NDArray[np.uint8],
    row: int,
    column: int,
    rows: int,
    widths: NDArray[np.int64],
    counts: NDArray[np.int64],
    signed: NDArray[np.bool_],
    big_endian: bool,
    left: int,
) -> Any:
    """Walk as far as a block reaches: (bytes passed, row, column, bad length met)."""
    at = 0
    end = len(block)
    while row < rows:
        while column < len(widths):
            width = counts[column]
            if width == 0:
                at += widths[column]
            else:
                if at + width > end:
                    return at, row, column, False
                length = np.int64(0)
                for i in range(width):
                    k = i if big_endian else width - 1 - i
                    length = (length << 8) | np.int64(block[at + k])
                if signed[column] and length >> (8 * width - 1):
                    return at, row, column, True
                if length * widths[column] > left - at - width:
                    return at, row, column, True
                at += width + length * widths[column]
            column += 1
        column = 0
        row += 1
    return at, row, column, False
