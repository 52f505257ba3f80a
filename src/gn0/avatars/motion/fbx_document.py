"""The records of a binary FBX, read where they are wanted.

A record is: where it ends, how many properties it has and how many bytes they take (three numbers
of 32 bits, of 64 from version 7.5 on), its name, its properties, then its children and a record of
zeros. Only places are kept, and arrays are unpacked one by one, so a file of many small records
costs no memory. Source: A. Gessler's description for Blender (2013) and files of the FBX SDK.
"""

from __future__ import annotations

import struct
import zlib
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gn0.errors import FormatError

MAGIC = b"Kaydara FBX Binary  \0"
REEXPORT = "export as binary FBX 7.1 to 7.7 (FBX 2011 or later)"
REFETCH = "fetch or export the file again"
_START = 27  # bytes of the header
_WIDE_SINCE = 7500
_SCALARS = {
    "Y": struct.Struct("<h"), "C": struct.Struct("<b"), "B": struct.Struct("<b"),
    "I": struct.Struct("<i"), "F": struct.Struct("<f"), "D": struct.Struct("<d"),
    "L": struct.Struct("<q"),
}  # fmt: skip
_ARRAYS = {"f": "<f4", "d": "<f8", "l": "<i8", "i": "<i4", "b": "i1", "c": "u1"}
_PROPERTY_LIMIT = 4096  # of one record; versions 6 keep whole arrays as properties
_ARRAY_LIMIT = 1 << 24  # bytes of one unpacked array; a curve of an hour has half of it


@dataclass(frozen=True, slots=True)
class FbxRecord:
    """Where one record is.

    Attributes:
        name: its name.
        at: byte at which it begins.
        count: number of its properties.
        values: byte at which they begin.
        children: byte at which its children begin.
        end: byte after it.
    """

    name: str
    at: int
    count: int
    values: int
    children: int
    end: int


class FbxDocument:
    """A binary FBX in memory."""

    def __init__(self, data: bytes, file: Path | str) -> None:
        """Check the header.

        Raises:
            FormatError: text FBX, no FBX, or a version that is none.
        """
        self.data = data
        self.file = file
        if not data.startswith(MAGIC):
            text = data.lstrip()[:1] == b";" or b"FBXHeaderExtension" in data[:4096]
            raise FormatError(
                "is FBX as text, which is not read" if text else "is not a binary FBX",
                file=file,
                offset=0,
                remedy=REEXPORT,
            )
        if len(data) < _START + 13:
            raise self.refuse("is cut off within its header", len(data))
        self.version = int.from_bytes(data[23:27], "little")
        if not 6000 <= self.version < 8000:
            raise self.refuse(f"FBX version {self.version} is not read", 23, remedy=REEXPORT)
        wide = self.version >= _WIDE_SINCE
        self._head = struct.Struct("<QQQB" if wide else "<IIIB")

    def refuse(
        self, what: str, offset: int | None = None, *, field: str = "", remedy: str = REFETCH
    ) -> FormatError:
        """An error about this file, to be raised."""
        return FormatError(what, file=self.file, offset=offset, field=field, remedy=remedy)

    def roots(self) -> Iterator[FbxRecord]:
        """The records at the top.

        Raises:
            FormatError: as `children`.
        """
        return self._records(_START, len(self.data))

    def children(self, record: FbxRecord) -> Iterator[FbxRecord]:
        """The records within a record, one by one.

        Raises:
            FormatError: one that ends outside its parent or before its properties.
        """
        return self._records(record.children, record.end)

    def child(self, record: FbxRecord, name: str) -> FbxRecord | None:
        """The first record of a name within a record."""
        return next((found for found in self.children(record) if found.name == name), None)

    def _records(self, at: int, stop: int) -> Iterator[FbxRecord]:
        head = self._head
        while at + head.size <= stop:
            end, count, size, letters = head.unpack_from(self.data, at)
            if end == 0:
                return
            values = at + head.size + letters
            if not values + size <= end <= stop:
                raise self.refuse(
                    f"a record at byte {at} ends at byte {end}, outside what it lies in: cut off "
                    "or forged",
                    at,
                )
            if count > size:  # a byte each
                raise self.refuse(f"a record claims {count} properties in {size} bytes", at)
            name = self.data[at + head.size : values].decode("utf-8", "replace")
            yield FbxRecord(name, at, count, values, values + size, end)
            at = end

    def properties(self, record: FbxRecord, most: int = _PROPERTY_LIMIT) -> list[Any]:
        """The first `most` properties of a record: numbers, texts, bytes; arrays unpacked.

        Raises:
            FormatError: cut off, or of an unknown kind.
        """
        found: list[Any] = []
        at = record.values
        for _ in range(min(record.count, most)):
            value, at = self._property(at, record)
            found.append(value)
        return found

    def array_length(self, record: FbxRecord) -> int:
        """How many values the array of a record has; 0 where it is none."""
        at = record.values
        if at + 13 > record.children or chr(self.data[at]) not in _ARRAYS:
            return 0
        return int.from_bytes(self.data[at + 1 : at + 5], "little")

    def array(self, record: FbxRecord | None, kinds: str) -> NDArray[Any] | None:
        """The array of a record, of one of the kinds; None where there is no record.

        Raises:
            FormatError: another kind, or damaged.
        """
        if record is None:
            return None
        found = self.properties(record, 1)
        if (
            not found
            or not isinstance(found[0], np.ndarray)
            or chr(self.data[record.values]) not in kinds
        ):
            raise self.refuse("should be an array of numbers", record.at, field=record.name)
        array: NDArray[Any] = found[0]
        return array

    def _property(self, at: int, record: FbxRecord) -> tuple[Any, int]:
        stop = record.children
        kind = chr(self.data[at]) if at < stop else ""
        at += 1
        if kind in _SCALARS:
            size = _SCALARS[kind].size
            if at + size <= stop:
                return _SCALARS[kind].unpack_from(self.data, at)[0], at + size
        elif kind in ("S", "R") and at + 4 <= stop:
            size = int.from_bytes(self.data[at : at + 4], "little")
            if at + 4 + size <= stop:
                raw = self.data[at + 4 : at + 4 + size]
                return (raw.decode("utf-8", "replace") if kind == "S" else raw), at + 4 + size
        elif kind in _ARRAYS and at + 12 <= stop:
            count, coding, size = struct.unpack_from("<III", self.data, at)
            if at + 12 + size <= stop:
                packed = memoryview(self.data)[at + 12 : at + 12 + size]
                return self._array(kind, count, coding, packed, at, record), at + 12 + size
        else:
            raise self.refuse(f"a property of unknown kind {kind!r}", at - 1, field=record.name)
        raise self.refuse("a property runs out of its record", at - 1, field=record.name)

    def _array(
        self, kind: str, count: int, coding: int, packed: memoryview, at: int, record: FbxRecord
    ) -> NDArray[Any]:
        dtype = np.dtype(_ARRAYS[kind])
        size = count * dtype.itemsize
        if coding not in (0, 1) or size > _ARRAY_LIMIT:
            raise self.refuse(
                f"an array of {count} values, packed in way {coding}, is not read",
                at,
                field=record.name,
            )
        raw: bytes | memoryview = packed
        if coding:
            try:
                raw = zlib.decompressobj().decompress(packed, size + 1)
            except zlib.error as error:
                raise self.refuse(
                    f"an array cannot be unpacked: {error}", at, field=record.name
                ) from None
        if len(raw) != size:
            raise self.refuse(
                f"an array of {len(raw)} bytes or more should have {size}", at, field=record.name
            )
        return np.frombuffer(raw, dtype)
