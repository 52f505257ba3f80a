"""The zip of a SOG bundle, with every size checked before it is trusted.

Only what SOG bundles use is known: stored and deflated entries, sizes in the central directory.
Python's own zipfile would do, but it builds its objects before any limit can be put on them and
answers hostile bytes with a dozen kinds of exception.
"""

from __future__ import annotations

import zlib
from dataclasses import dataclass

from gn0.gaussians.cloud_source import REFETCH, CloudSource, little

_END = b"PK\x05\x06"
_CENTRAL = b"PK\x01\x02"
_LOCAL = b"PK\x03\x04"
_END_BYTES = 22
_COMMENT_LIMIT = 65535
_DIRECTORY_LIMIT = 1 << 20
_STORED, _DEFLATED = 0, 8
_ENCRYPTED = 0x1


@dataclass(frozen=True)
class ZipEntry:
    """One file in the zip.

    Attributes:
        name: its name.
        method: 0 stored, 8 deflated.
        flags: general purpose bits.
        crc: CRC-32 of its bytes.
        packed: bytes in the zip.
        size: bytes unpacked.
        header: byte at which its local header begins.
        listed: byte of its entry in the central directory.
    """

    name: str
    method: int
    flags: int
    crc: int
    packed: int
    size: int
    header: int
    listed: int


def load_zip_directory(source: CloudSource) -> dict[str, ZipEntry]:
    """Entries of a zip by name; nothing is unpacked.

    Raises:
        FormatError: cut off, damaged, or of a kind that no SOG bundle is (zip64, many disks).
    """
    tail_at = max(0, source.size - _END_BYTES - _COMMENT_LIMIT)
    tail = source.read(tail_at, source.size - tail_at, "the end of the zip")
    found = tail.rfind(_END)
    if found < 0 or len(tail) - found < _END_BYTES:
        raise source.refuse(
            "the zip has no directory at its end: the file is cut off or damaged",
            source.size,
            remedy=REFETCH,
        )
    end = tail_at + found
    record = tail[found : found + _END_BYTES]
    count, length, at = little(record, 10, 2), little(record, 12, 4), little(record, 16, 4)
    if 0xFFFFFFFF in (length, at) or count == 0xFFFF or little(record, 4, 4):
        raise source.refuse("this kind of zip (zip64 or split) is not read", end, field="zip")
    if length > _DIRECTORY_LIMIT or at + length > end:
        raise source.refuse(
            f"the zip directory of {length} bytes at byte {at} does not fit the file", end
        )
    directory = source.read(at, length, "the zip directory")
    entries: dict[str, ZipEntry] = {}
    place = 0
    for _ in range(count):
        fixed = directory[place : place + 46]
        if len(fixed) < 46 or fixed[:4] != _CENTRAL:
            raise source.refuse("the zip directory is damaged", at + place, remedy=REFETCH)
        name_length, extra, comment = (little(fixed, i, 2) for i in (28, 30, 32))
        name = directory[place + 46 : place + 46 + name_length].decode("utf-8", "replace")
        entry = ZipEntry(
            name=name,
            method=little(fixed, 10, 2),
            flags=little(fixed, 8, 2),
            crc=little(fixed, 16, 4),
            packed=little(fixed, 20, 4),
            size=little(fixed, 24, 4),
            header=little(fixed, 42, 4),
            listed=at + place,
        )
        if name in entries:
            raise source.refuse("the zip names a file twice", entry.listed, field=name)
        entries[name] = entry
        place += 46 + name_length + extra + comment
    return entries


def read_zip_entry(source: CloudSource, entry: ZipEntry, limit: int) -> bytes:
    """The unpacked bytes of an entry, CRC checked.

    Args:
        source: the zip.
        entry: one of its entries.
        limit: the most bytes it may unpack to.

    Raises:
        FormatError: too large, damaged, encrypted, or packed in another way.
    """

    def refuse(what: str, offset: int = entry.header) -> Exception:
        return source.refuse(what, offset, field=entry.name, remedy=REFETCH)

    if entry.flags & _ENCRYPTED:
        raise refuse("the zip entry is encrypted")
    if entry.method not in (_STORED, _DEFLATED):
        raise refuse(f"zip compression method {entry.method} is not read (stored and deflate are)")
    if entry.size > limit:
        raise refuse(
            f"the zip entry claims {entry.size} bytes, more than the {limit} it may have",
            entry.listed,
        )
    local = source.read(entry.header, 30, "a zip entry")
    if local[:4] != _LOCAL:
        raise refuse("the zip entry does not begin where the directory says")
    start = entry.header + 30 + little(local, 26, 2) + little(local, 28, 2)
    packed = source.read(start, entry.packed, "a zip entry")
    if entry.method == _STORED:
        data = packed
    else:
        unpacker = zlib.decompressobj(-15)
        try:
            data = unpacker.decompress(packed, entry.size + 1)
        except zlib.error as error:
            raise refuse(f"the zip entry cannot be unpacked: {error}", start) from error
    if len(data) != entry.size:
        raise refuse(
            f"the zip entry does not unpack to the {entry.size} bytes that it claims", start
        )
    if zlib.crc32(data) != entry.crc:
        raise refuse("the zip entry is damaged: its CRC does not agree", start)
    return data
