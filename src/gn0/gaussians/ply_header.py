"""The PLY header: a small, strict grammar, checked against the file's size before any allocation.

Accepts what real writers produce (LF, CRLF or CR line ends, padded words, comments and obj_info
anywhere, old and new type names, elements and properties nobody asked for) and refuses the rest
with the byte at which it went wrong. The format is G. Turk's "The PLY Polygon File Format" (1994).
"""

from __future__ import annotations

import re
from collections.abc import Iterable
from dataclasses import dataclass, field
from pathlib import Path
from typing import IO

import numpy as np

from gn0.errors import FormatError

HEADER_LIMIT = 64 * 1024  # bytes; a 3DGS header of SH degree 3 has about 1.5 kB
MAX_COUNT_DIGITS = 20  # more than any file system can hold

_SCALAR_TYPES = {
    **dict.fromkeys(("char", "int8"), "i1"),
    **dict.fromkeys(("uchar", "uint8"), "u1"),
    **dict.fromkeys(("short", "int16"), "i2"),
    **dict.fromkeys(("ushort", "uint16"), "u2"),
    **dict.fromkeys(("int", "int32"), "i4"),
    **dict.fromkeys(("uint", "uint32"), "u4"),
    **dict.fromkeys(("float", "float32"), "f4"),
    **dict.fromkeys(("double", "float64"), "f8"),
}
_BYTE_ORDERS = {"ascii": "", "binary_little_endian": "<", "binary_big_endian": ">"}
_END = {
    b"\n": re.compile(rb"\n[ \t]*end_header[ \t]*\r?\n"),
    b"\r": re.compile(rb"\r[ \t]*end_header[ \t]*\r"),  # a data byte 10 may follow
}


@dataclass(frozen=True)
class PlyProperty:
    """One property of an element.

    Attributes:
        name: as written in the header.
        type: NumPy kind and size without byte order, e.g. "f4"; of the items, for a list.
        count_type: type of the length in front of a list; None for a scalar.
    """

    name: str
    type: str
    count_type: str | None = None


@dataclass(frozen=True)
class PlyElement:
    """One element: a table of `count` rows.

    Attributes:
        name: as written in the header.
        count: number of rows, as claimed.
        properties: columns in file order.
        offset: byte of its line in the header, for messages.
    """

    name: str
    count: int
    properties: tuple[PlyProperty, ...]
    offset: int = 0

    @property
    def has_lists(self) -> bool:
        """Whether any property is a list, so that rows differ in length."""
        return any(p.count_type for p in self.properties)

    @property
    def names(self) -> tuple[str, ...]:
        """Property names in file order."""
        return tuple(p.name for p in self.properties)

    def least_bytes(self, binary: bool) -> int:
        """The fewest bytes a row can take: exact for fixed binary rows."""
        if not binary:  # a digit and a separator each
            return 2 * len(self.properties)
        return sum(int((p.count_type or p.type)[1]) for p in self.properties)

    def row_type(self, byte_order: str) -> np.dtype[np.void]:
        """Structured NumPy type of a fixed binary row."""
        return np.dtype([(p.name, byte_order + p.type) for p in self.properties])


@dataclass(frozen=True)
class PlyHeader:
    """A parsed header.

    Attributes:
        byte_order: "<", ">" or "" for ascii.
        elements: in file order.
        comments: comment lines, without the word.
        obj_info: obj_info lines, without the word.
        data_offset: byte at which the data starts.
        line_end: what ends a line: LF, or CR for files of that kind.
    """

    byte_order: str
    elements: tuple[PlyElement, ...]
    comments: tuple[str, ...]
    obj_info: tuple[str, ...]
    data_offset: int
    line_end: bytes = b"\n"

    @property
    def is_binary(self) -> bool:
        """Whether the data is binary."""
        return bool(self.byte_order)

    def find(self, name: str) -> PlyElement | None:
        """The element of that name, if any."""
        return next((e for e in self.elements if e.name == name), None)


@dataclass
class _Draft:
    """An element while its lines are being read."""

    name: str
    count: int
    offset: int
    properties: list[PlyProperty] = field(default_factory=list)
    seen: set[str] = field(default_factory=set)


def load_ply_header(stream: IO[bytes], file: Path | str, size: int) -> PlyHeader:
    """Read and check the header at the start of a stream.

    Args:
        stream: the file, opened in binary.
        file: its name, for messages.
        size: its size [bytes]; every element's claim is checked against it.

    Raises:
        FormatError: not a PLY file, a broken header, or rows that the file cannot hold.
    """
    stream.seek(0)
    header = parse_ply_header(stream.read(HEADER_LIMIT + 1), file)
    check_sizes(header, file, size)
    return header


def parse_ply_header(head: bytes, file: Path | str) -> PlyHeader:
    """Parse the first bytes of a file (up to `HEADER_LIMIT` of them).

    Raises:
        FormatError: not a PLY header, cut off, over 64 KiB, or broken.
    """

    def refuse(what: str, offset: int, remedy: str = "write the file again") -> FormatError:
        return FormatError(what, file=file, offset=offset, remedy=remedy)

    if not head.startswith((b"ply\n", b"ply\r")):
        raise refuse("is not a PLY file: it does not start with 'ply'", 0, "check the path")
    line_end = b"\r" if head[3:4] == b"\r" and head[4:5] != b"\n" else b"\n"
    end = _END[line_end].search(head[:HEADER_LIMIT])
    if end is None:
        if len(head) > HEADER_LIMIT:
            raise refuse(
                f"PLY header has no end_header within {HEADER_LIMIT} bytes",
                HEADER_LIMIT,
                "shorten the comments, or check that this is a splat file",
            )
        raise refuse("PLY header is cut off: no end_header", len(head), "fetch the file again")
    byte_order: str | None = None
    comments: list[str] = []
    obj_info: list[str] = []
    drafts: list[_Draft] = []
    names: set[str] = set()
    for offset, line in _lines(head[: end.end()], line_end):
        words = line.split()
        keyword = words[0] if words else ""
        if not words or (offset == 0 and words == ["ply"]):
            continue
        if keyword in ("comment", "obj_info"):
            rest = line.strip()[len(keyword) :].strip()
            (comments if keyword == "comment" else obj_info).append(rest)
        elif keyword == "end_header" and len(words) == 1:
            break
        elif keyword == "format":
            if len(words) != 3 or words[1] not in _BYTE_ORDERS or words[2] != "1.0":
                known = ", ".join(_BYTE_ORDERS)
                raise refuse(f"unknown PLY format {_quote(line)}", offset, f"known, 1.0: {known}")
            if byte_order is not None:
                raise refuse("second format line in the PLY header", offset)
            byte_order = _BYTE_ORDERS[words[1]]
        elif keyword == "element":
            if len(words) != 3:
                raise refuse(f"malformed PLY header line {_quote(line)}", offset)
            if words[1] in names:
                raise refuse(f"PLY element {_quote(words[1])} is declared twice", offset)
            names.add(words[1])
            drafts.append(_Draft(words[1], _count(words, file, offset), offset))
        elif keyword == "property":
            if not drafts:
                raise refuse("PLY property stands before any element", offset)
            new = _property(words)
            if new is None:
                raise refuse(f"malformed PLY property {_quote(line)}", offset)
            if new.name in drafts[-1].seen:
                raise refuse(f"PLY property {_quote(new.name)} is declared twice", offset)
            drafts[-1].seen.add(new.name)
            drafts[-1].properties.append(new)
        else:
            raise refuse(f"unknown PLY header line {_quote(line)}", offset)
    if byte_order is None:
        raise refuse("PLY header has no format line", end.start())
    elements = tuple(PlyElement(d.name, d.count, tuple(d.properties), d.offset) for d in drafts)
    return PlyHeader(byte_order, elements, tuple(comments), tuple(obj_info), end.end(), line_end)


def check_sizes(header: PlyHeader, file: Path | str, size: int) -> None:
    """Check with exact integers that the file can hold the rows its header claims.

    Raises:
        FormatError: truncated, or a forged count.
    """
    at = header.data_offset
    for element in header.elements:
        row = element.least_bytes(header.is_binary)
        need = element.count * row
        if not header.is_binary and need:
            need -= 1  # the last line may lack its end
        if need > size - at:
            raise FormatError(
                f"file is truncated or its header is forged: element {_quote(element.name)} "
                f"claims {element.count} rows, at least {need} bytes from byte {at}, "
                f"but the file ends at byte {size}",
                file=file,
                offset=size,
                field=element.name,
                remedy="fetch or write the file again",
            )
        at += need


def _lines(head: bytes, line_end: bytes) -> Iterable[tuple[int, str]]:
    """(byte offset, text) of each header line; comments may hold any bytes."""
    offset = 0
    for raw in head.split(line_end):
        yield offset, raw.rstrip(b"\r").decode("utf-8", errors="replace")
        offset += len(raw) + 1


def _count(words: list[str], file: Path | str, offset: int) -> int:
    text = words[2]
    if not (text.isascii() and text.isdigit()):
        raise FormatError(
            f"PLY element {_quote(words[1])} has count {_quote(text)}, not a whole number ≥ 0",
            file=file,
            offset=offset,
            field=words[1],
            remedy="write the file again",
        )
    digits = text.lstrip("0") or "0"
    # int() of a digit string as long as the header would be slow; a capped one is as impossible
    return int(digits) if len(digits) <= MAX_COUNT_DIGITS else 10**MAX_COUNT_DIGITS


def _property(words: list[str]) -> PlyProperty | None:
    if len(words) == 3 and words[1] in _SCALAR_TYPES:
        return PlyProperty(words[2], _SCALAR_TYPES[words[1]])
    if len(words) == 5 and words[1] == "list":
        count_type, item_type = _SCALAR_TYPES.get(words[2]), _SCALAR_TYPES.get(words[3])
        if count_type and item_type and count_type[0] != "f":
            return PlyProperty(words[4], item_type, count_type)
    return None


def _quote(text: str) -> str:
    """A short, printable quotation of untrusted text."""
    text = text.strip()
    return repr(text if len(text) <= 60 else text[:57] + "...")
