"""Where binary PLY rows with lists end: they must be walked, since each has its own length."""

from __future__ import annotations

from pathlib import Path
from typing import IO, Literal

from gn0.errors import FormatError
from gn0.gaussians.ply_header import PlyElement

_BLOCK = 1 << 20


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
    order: Literal["little", "big"] = "big" if byte_order == ">" else "little"
    # (bytes of an item, bytes of the length in front, is the length signed)
    columns = [
        (int(p.type[1]), int((p.count_type or "u0")[1]), (p.count_type or "u0")[0] == "i")
        for p in element.properties
    ]
    at, block_start, block = start, start, b""
    for row in range(element.count):
        for index, (width, count_width, signed) in enumerate(columns):
            if not count_width:
                at += width
                continue
            local = at - block_start
            if local + count_width > len(block):
                stream.seek(at)
                block_start, block, local = at, stream.read(_BLOCK), 0
            # past the end of the file this reads as 0, and is caught below
            length = int.from_bytes(block[local : local + count_width], order, signed=signed)
            at += count_width + max(0, length) * width
            if length < 0 or at > size:
                raise FormatError(
                    f"element {element.name!r}, row {row}: a list of {length} items does not fit, "
                    "so the file is truncated or forged",
                    file=file,
                    offset=min(block_start + local, size),
                    field=element.properties[index].name,
                    remedy="fetch or write the file again",
                )
    return at
