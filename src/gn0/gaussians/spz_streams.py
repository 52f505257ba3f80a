"""Where the bytes of an SPZ come from: the bare file, one gzip stream, or a ZSTD stream a plane.

A gzip or ZSTD of a few kilobytes can unpack to terabytes. So nothing is unpacked whole: each
stream gives exactly as many bytes as were asked for, and what it claims is held against what its
packed size can possibly hold before room is made.
"""

from __future__ import annotations

import zlib
from typing import Protocol

import numpy as np

from gn0.errors import FormatError
from gn0.gaussians.cloud_source import REFETCH, CloudSource
from gn0.geometry import U8

GZIP_RATIO = 1032  # deflate cannot pack better than this
ZSTD_RATIO = 1 << 15  # a block of 128 KiB takes at least 4 bytes
_CHUNK = 1 << 16
_TRAILING_LIMIT = 1 << 24  # extensions after the planes; real ones are a few bytes


class PlaneStream(Protocol):
    """Bytes of an SPZ after its header, in order."""

    def most(self) -> int:
        """More bytes than this it cannot hold."""
        ...

    def take(self, count: int, plane: str) -> U8:
        """The next `count` bytes [count]."""
        ...

    def finish(self) -> tuple[str, ...]:
        """Check that the stream ends well; notes on what was left over."""
        ...


class BareStream:
    """The file itself, from a byte on."""

    def __init__(self, source: CloudSource, at: int) -> None:
        self.source = source
        self.at = at

    def most(self) -> int:
        """All bytes of the file."""
        return self.source.size - self.at

    def take(self, count: int, plane: str) -> U8:
        """The next bytes.

        Raises:
            FormatError: the file ends before.
        """
        data = self.source.read(self.at, count, f"the {plane}")
        self.at += count
        return np.frombuffer(data, np.uint8)

    def finish(self) -> tuple[str, ...]:
        """A note where the file goes on."""
        left = self.source.size - self.at
        return (f"{left} bytes after the last plane were not read",) if left else ()


class GzipStream:
    """One gzip stream, its CRC and length checked at the end."""

    def __init__(self, source: CloudSource) -> None:
        self.source = source
        self._unzip = zlib.decompressobj(31)
        self._at = 0
        self._pending = b""

    def most(self) -> int:
        """What deflate can at best pack into a file of this size."""
        return self.source.size * GZIP_RATIO

    def take(self, count: int, plane: str) -> U8:
        """The next bytes.

        Raises:
            FormatError: damaged, cut off, or the stream ends before.
        """
        out = np.empty(count, np.uint8)
        filled = 0
        while filled < count:
            part = self._next(min(count - filled, 1 << 20))
            if not part:
                raise self.source.refuse(
                    f"the gzip stream ends within the {plane}: {filled} of {count} bytes are there",
                    self._place(),
                    field=plane,
                    remedy=REFETCH,
                )
            out[filled : filled + len(part)] = np.frombuffer(part, np.uint8)
            filled += len(part)
        return out

    def finish(self) -> tuple[str, ...]:
        """Check CRC and length; notes on what follows the planes.

        Raises:
            FormatError: damaged, cut off, or it unpacks to far more than its header says.
        """
        over = 0
        while part := self._next(_CHUNK):
            over += len(part)
            if over > _TRAILING_LIMIT:
                raise self.source.refuse(
                    "the gzip stream unpacks to far more than its header says: a gzip bomb?",
                    self._place(),
                )
        if not self._unzip.eof:
            raise self.source.refuse(
                "the gzip stream is cut off: its checksum is missing", self._place(), remedy=REFETCH
            )
        notes = [f"{over} unpacked bytes after the last plane were not read"] if over else []
        left = self.source.size - self._place()
        if left:
            notes.append(f"{left} bytes after the gzip stream were not read")
        return tuple(notes)

    def _place(self) -> int:
        return self._at - len(self._pending) - len(self._unzip.unused_data)

    def _next(self, most: int) -> bytes:
        """Some bytes, at least one and at most `most`; none at the end of stream or file."""
        while not self._unzip.eof:
            if not self._pending:
                self.source.stream.seek(self._at)
                self._pending = self.source.stream.read(_CHUNK)
                self._at += len(self._pending)
            at_end = not self._pending
            try:
                part = self._unzip.decompress(self._pending, most)
            except zlib.error as error:
                raise self.source.refuse(
                    f"the gzip stream is damaged: {error}", self._place(), remedy=REFETCH
                ) from error
            self._pending = self._unzip.unconsumed_tail
            if part or at_end:
                return part
        return b""


class ZstdStreams:
    """One ZSTD stream a plane, at places that a table of contents gives."""

    def __init__(self, source: CloudSource, at: int, table: list[tuple[int, int]]) -> None:
        self.source = source
        self._at = at
        self._table = table
        self._next = 0

    def most(self) -> int:
        """What ZSTD can at best pack into streams of these sizes."""
        left = self.source.size - self._at
        return sum(min(raw, min(packed, left) * ZSTD_RATIO) for packed, raw in self._table)

    def take(self, count: int, plane: str) -> U8:
        """The bytes of the next plane, all of them.

        Raises:
            FormatError: the plane is missing, damaged, cut off, or of another length.
        """
        if self._next >= len(self._table):
            raise self._refuse(f"there is no stream for the {plane}", plane)
        packed, raw = self._table[self._next]
        self._next += 1
        if raw != count:
            raise self._refuse(f"the {plane} have {raw} bytes, not {count}", plane)
        data = self.source.read(self._at, packed, f"the {plane}")
        import pyarrow as pa  # here, so that reading a PLY does not load it

        out = np.empty(count, np.uint8)
        filled = 0
        try:
            with pa.CompressedInputStream(pa.BufferReader(data), "zstd") as stream:
                while filled < count:
                    part = stream.read(min(count - filled, 1 << 20))
                    if not part:
                        break
                    out[filled : filled + len(part)] = np.frombuffer(part, np.uint8)
                    filled += len(part)
                over = stream.read(1)
        except (OSError, ValueError, pa.ArrowException) as error:
            raise self._refuse(f"the ZSTD stream of the {plane} is damaged: {error}", plane) from (
                error
            )
        if filled < count or over:
            side = "less" if filled < count else "more"
            raise self._refuse(f"the {plane} unpack to {side} than {count} bytes", plane)
        self._at += packed
        return out

    def finish(self) -> tuple[str, ...]:
        """Notes on streams and bytes left over."""
        notes = []
        if self._next < len(self._table):
            notes.append(f"{len(self._table) - self._next} further streams were not read")
        left = self.source.size - self._at - sum(p for p, _ in self._table[self._next :])
        if left > 0:
            notes.append(f"{left} bytes after the last stream were not read")
        return tuple(notes)

    def _refuse(self, what: str, plane: str) -> FormatError:
        return self.source.refuse(what, self._at, field=plane, remedy=REFETCH)
