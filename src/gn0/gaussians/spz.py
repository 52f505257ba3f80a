"""SPZ, Niantic's packed splats: versions 1 to 3 (gzip, or bare) and 4 (ZSTD).

A header, then one plane after another: positions, alphas, colours, scales, rotations, SH.
Positions are 24-bit fixed point (halves in version 1), log scales b / 16 − 10, colours
(b / 255 − ½) / 0.15, SH (b − 128) / 128 by coefficient with the channel inside; rotations x y z in
a byte each (1, 2), or the smallest three of x y z w in 9 bits and a sign (3, 4).

SPZ stores x right, y up, z back; writers turn their splats into it. They are turned back here by
180° about x, so that a cloud comes out as from the PLY it was made of.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gn0.gaussians.cloud_file import CloudBuilder, CloudFile
from gn0.gaussians.cloud_source import CloudSource, little
from gn0.gaussians.rotation import scatter_rotation
from gn0.gaussians.sh import MAX_DEGREE, coefficient_count, sh_rotation
from gn0.gaussians.splat import UNIT_OF_BYTE
from gn0.gaussians.spz_streams import BareStream, GzipStream, PlaneStream, ZstdStreams
from gn0.geometry import F32, U8

MAGIC = b"NGSP"
FRAME = "as in the PLY it was made of, usually x right, y down, z forward (SPZ: x right, y up)"
_HEADER = 16
_HEADER_V4 = 32
_MOST_DEGREE = 4
_STREAMS_LIMIT = 64
_BLOCK = 1 << 15  # Gaussians
_TURN = np.diag([1.0, -1.0, -1.0])  # SPZ's axes to PLY's
_ANTIALIASED, _EXTENSIONS = 0x1, 0x2
_BYTES = np.arange(256, dtype=np.float32)
_COLOUR_OF_BYTE: F32 = (_BYTES / np.float32(255) - np.float32(0.5)) / np.float32(0.15)
_SCALE_OF_BYTE: F32 = np.exp(_BYTES / np.float32(16) - np.float32(10))
_SH_OF_BYTE: F32 = (_BYTES - np.float32(128)) / np.float32(128)
_THIRD_OF_BYTE: F32 = _BYTES / np.float32(127.5) - np.float32(1)


@dataclass(frozen=True)
class _Header:
    """The first 16 bytes."""

    version: int
    count: int
    degree: int
    fractional_bits: int
    flags: int
    streams: int

    def planes(self) -> dict[str, int]:
        """Bytes of each plane, in file order."""
        n = self.count
        sizes = {
            "positions": n * (6 if self.version == 1 else 9),
            "alphas": n,
            "colours": n * 3,
            "scales": n * 3,
            "rotations": n * (3 if self.version < 3 else 4),
        }
        if self.degree:
            sizes["SH"] = n * 3 * (coefficient_count(self.degree) - 1)
        return sizes


def decode_spz(source: CloudSource) -> CloudFile:
    """Decode an open SPZ that begins with its magic: version 4, or an earlier one without gzip.

    Raises:
        FormatError: another version, broken, truncated or forged.
    """
    header = _parse_header(source.read(0, _HEADER, "the SPZ header"), source)
    if header.version < 4:
        return _decode(header, BareStream(source, _HEADER), source, "bare")
    at = little(source.read(0, _HEADER_V4, "the SPZ header"), 16, 4)
    if not 0 < header.streams <= _STREAMS_LIMIT or at < _HEADER_V4:
        raise source.refuse(
            f"SPZ 4 claims {header.streams} streams, listed from byte {at}", 15, field="streams"
        )
    listed = source.read(at, 16 * header.streams, "the table of streams")
    table = [
        (little(listed, i * 16, 8), little(listed, i * 16 + 8, 8)) for i in range(header.streams)
    ]
    streams = ZstdStreams(source, at + len(listed), table)
    return _decode(header, streams, source, "zstd")


def decode_spz_gzip(source: CloudSource) -> CloudFile:
    """Decode an open gzip file, which should hold an SPZ of version 1 to 3.

    Raises:
        FormatError: gzip of something else, another version, broken, truncated or forged.
    """
    stream = GzipStream(source)
    data = stream.take(_HEADER, "SPZ header").tobytes()
    if not data.startswith(MAGIC):
        raise source.refuse("this gzip file holds no SPZ", remedy="unpack it first")
    header = _parse_header(data, source)
    if header.version > 3:
        raise source.refuse(f"SPZ {header.version} is not packed with gzip", 0, field="version")
    return _decode(header, stream, source, "gzip")


def _parse_header(data: bytes, source: CloudSource) -> _Header:
    header = _Header(little(data, 4, 4), little(data, 8, 4), *data[12:16])
    if not 1 <= header.version <= 4:
        raise source.refuse(
            f"SPZ version {header.version} is not read (1 to 4 are)",
            4,
            field="version",
            remedy="convert it with a current splat-transform",
        )
    if header.degree > _MOST_DEGREE:
        raise source.refuse(f"SPZ has SH degree {header.degree}, more than 4", 12, field="shDegree")
    if header.fractional_bits > 30:
        raise source.refuse(
            f"SPZ claims {header.fractional_bits} fractional bits of 24", 13, field="fractionalBits"
        )
    return header


def _decode(header: _Header, stream: PlaneStream, source: CloudSource, encoding: str) -> CloudFile:
    """Decode the planes that follow a header."""
    sizes = header.planes()
    if sum(sizes.values()) > stream.most():
        raise source.refuse(
            f"file is truncated or its header is forged: {header.count} Gaussians take "
            f"{sum(sizes.values())} bytes, and at most {stream.most()} can be there",
            8,
            field="numPoints",
        )
    kept = min(header.degree, MAX_DEGREE)
    builder = CloudBuilder(source.file, header.count, kept, source.limit_bytes, 8)
    planes = {name: stream.take(size, name) for name, size in sizes.items()}
    notes = list(stream.finish())
    sh_signs = np.rint(np.diag(sh_rotation(_TURN, kept))).astype(np.float32)[1:, None]
    for start in range(0, header.count, _BLOCK):
        stop = min(start + _BLOCK, header.count)

        def rows(name: str, first: int = start, last: int = stop) -> U8:
            width = len(planes[name]) // header.count
            return planes[name][first * width : last * width].reshape(last - first, width)

        quats = _unpack_rotation(rows("rotations"), header.version)
        quats[:, 2:] *= np.float32(-1)
        means = _unpack_positions(rows("positions"), header)
        with np.errstate(invalid="ignore"):  # halves may be NaN
            means[:, 1:] *= np.float32(-1)
        builder.put(
            start,
            means,
            quats,
            _SCALE_OF_BYTE[rows("scales")],
            UNIT_OF_BYTE[rows("alphas")[:, 0]],
            _COLOUR_OF_BYTE[rows("colours")],
        )
        if kept:
            codes = rows("SH").reshape(stop - start, -1, 3)[:, : coefficient_count(kept) - 1]
            builder.put_rest(start, _SH_OF_BYTE[codes] * sh_signs)
    cloud, dropped = builder.build()
    if header.degree > kept:
        notes.append(f"SH degree {header.degree} cut to {kept}")
    if header.flags & _ANTIALIASED:
        notes.append("trained with antialiasing, which no renderer here uses")
    if header.flags & _EXTENSIONS:
        notes.append("extensions (they hold no splats) were not read")
    return CloudFile(
        cloud=cloud,
        path=source.file,
        format=f"spz-v{header.version}",
        stored=header.count,
        dropped=dropped,
        sh_degree=header.degree,
        encoding=encoding,
        notes=tuple(notes),
        frame=FRAME,
    )


def _unpack_positions(codes: U8, header: _Header) -> F32:
    """Positions [R, 3] in SPZ's axes."""
    if header.version == 1:
        return np.ascontiguousarray(codes).view("<f2").astype(np.float32)
    words = np.zeros((len(codes) * 3, 4), np.uint8)
    words[:, 1:] = codes.reshape(-1, 3)
    fixed = (words.view("<i4") >> 8).reshape(-1, 3)  # the shift copies the sign
    return fixed.astype(np.float32) * np.float32(2.0**-header.fractional_bits)


def _unpack_rotation(codes: U8, version: int) -> F32:
    """Quaternions (w, x, y, z) [R, 4] in SPZ's axes."""
    if version < 3:
        quats = np.empty((len(codes), 4), np.float32)
        quats[:, 1:] = _THIRD_OF_BYTE[codes]
        rest = 1.0 - np.einsum("ij,ij->i", quats[:, 1:], quats[:, 1:])
        quats[:, 0] = np.sqrt(np.maximum(0.0, rest))
        return quats
    words: NDArray[Any] = np.ascontiguousarray(codes).view("<u4").ravel()
    three = np.empty((len(words), 3), np.float32)
    for column, shift in enumerate((20, 10, 0)):
        field = words >> np.uint32(shift)
        size = (field & np.uint32(511)).astype(np.float32) * np.float32(math.sqrt(0.5) / 511)
        three[:, column] = np.where(field & np.uint32(512), -size, size)
    largest = np.sqrt(np.maximum(0.0, 1.0 - np.einsum("ij,ij->i", three, three)))
    xyzw = scatter_rotation(three, largest, words >> np.uint32(30))
    return np.ascontiguousarray(xyzw[:, [3, 0, 1, 2]])
