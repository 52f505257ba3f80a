"""KSPLAT 0.x, the format of the GaussianSplats3D viewer: sections of buckets, compression 0 to 2.

A 4096-byte header, section headers of 1024 bytes, then each section: sizes of its last buckets,
bucket centres, and one record a Gaussian. Compression 0 holds floats; 1 and 2 hold positions in 16
bits around the centre of their bucket, and halves; 2 holds SH in bytes between two bounds.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gn0.gaussians.cloud_file import CloudBuilder, CloudFile
from gn0.gaussians.cloud_source import CloudSource
from gn0.gaussians.sh import coefficient_count
from gn0.gaussians.splat import COLOUR_OF_BYTE, UNIT_OF_BYTE
from gn0.geometry import F32

_HEADER = 4096
_SECTION = 1024
_SECTIONS_LIMIT = 65536
_MOST_DEGREE = 3
_BLOCK_BYTES = 1 << 21
# type and bytes of positions, scales and rotations, and of SH, by compression level
_VALUES = ("<f4", "<f2", "<f2")
_PLACES = ("<f4", "<u2", "<u2")
_SH = ("<f4", "<f2", "u1")
_STEPS = (1, 32767, 32767)  # half the range of a position in its bucket, unless the file says


@dataclass(frozen=True)
class _Section:
    """One section, its layout checked against the file."""

    count: int
    degree: int
    full_buckets: int
    bucket_size: int
    partial_at: int
    partial_buckets: int
    centres_at: int
    buckets: int
    block: float
    steps: int
    data_at: int
    record: np.dtype[Any]


def looks_like_ksplat(head: bytes, size: int) -> bool:
    """Version 0.x, and a section count that agrees with the size."""
    if size < _HEADER + _SECTION or len(head) < 24 or head[0] != 0 or head[1] == 0:
        return False
    sections, used, _, splats = struct.unpack_from("<4I", head, 4)
    return bool(
        used <= sections < _SECTIONS_LIMIT
        and splats > 0
        and (sections * _SECTION + _HEADER <= size)
    )


def decode_ksplat(source: CloudSource) -> CloudFile:
    """Decode an open .ksplat file.

    Raises:
        FormatError: another compression, broken, truncated or forged.
    """
    header = source.read(0, _HEADER, "the header")
    sections, _, _, count = struct.unpack_from("<4I", header, 4)
    compression = struct.unpack_from("<H", header, 20)[0]
    low, high = struct.unpack_from("<2f", header, 36)
    low, high = low or -1.5, high or 1.5  # older files say 0 and mean these
    if compression > 2:
        raise source.refuse(f"KSPLAT compression {compression} is not read (0 to 2 are)", 20)
    if not (np.isfinite(low) and np.isfinite(high)):
        raise source.refuse("KSPLAT bounds of SH are not finite", 36)
    listed = _sections(source, sections, compression)
    total = sum(section.count for section in listed)
    if total != count:
        raise source.refuse(f"KSPLAT claims {count} Gaussians, its sections hold {total}", 16)
    degree = max((section.degree for section in listed), default=0)
    builder = CloudBuilder(source.file, count, degree, source.limit_bytes, 16)
    start = 0
    for section in listed:
        _decode_section(source, section, builder, start, compression, (low, high))
        start += section.count
    cloud, dropped = builder.build()
    return CloudFile(
        cloud=cloud,
        path=source.file,
        format="ksplat",
        stored=count,
        dropped=dropped,
        sh_degree=degree,
        encoding=f"compression {compression}",
    )


def _sections(source: CloudSource, number: int, compression: int) -> list[_Section]:
    """All sections that hold Gaussians, each within the file."""
    listed = []
    at = _HEADER + number * _SECTION
    for index in range(number):
        place = _HEADER + index * _SECTION
        head = source.read(place, _SECTION, "a section header")
        count, room, bucket_size, buckets = struct.unpack_from("<4I", head, 0)
        block = struct.unpack_from("<f", head, 16)[0]
        bucket_bytes = struct.unpack_from("<H", head, 20)[0]
        steps, full, partial = (struct.unpack_from("<I", head, i)[0] for i in (24, 32, 36))
        degree = struct.unpack_from("<H", head, 40)[0]
        if degree > _MOST_DEGREE:
            raise source.refuse(f"section {index} has SH degree {degree}", place + 40)
        record = _record(compression, degree)
        partial_at, centres_at = at, at + 4 * partial
        data_at = centres_at + buckets * bucket_bytes
        end = data_at + room * record.itemsize
        if count > room or end > source.size:
            raise source.refuse(
                f"file is truncated or forged: section {index} of {count} Gaussians in {room} "
                f"places ends at byte {end}, but the file ends at byte {source.size}",
                place,
            )
        at = end
        if count == 0:
            continue
        if compression:
            if full + partial > buckets or bucket_bytes < 12 or full * bucket_size > count:
                raise source.refuse(f"section {index} has buckets that do not fit", place + 8)
            if full * bucket_size < count and not partial:
                raise source.refuse(f"section {index} has too few buckets", place + 36)
        listed.append(
            _Section(
                count=count,
                degree=degree,
                full_buckets=full,
                bucket_size=bucket_size,
                partial_at=partial_at,
                partial_buckets=partial,
                centres_at=centres_at,
                buckets=buckets,
                block=block,
                steps=steps or _STEPS[compression],
                data_at=data_at,
                record=record,
            )
        )
    return listed


def _record(compression: int, degree: int) -> np.dtype[Any]:
    """Layout of one Gaussian."""
    values = _VALUES[compression]
    return np.dtype(
        [
            ("place", _PLACES[compression], (3,)),
            ("scale", values, (3,)),
            ("rotation", values, (4,)),
            ("colour", "u1", (4,)),
            ("sh", _SH[compression], (3 * (coefficient_count(degree) - 1),)),
        ]
    )


def _decode_section(
    source: CloudSource,
    section: _Section,
    builder: CloudBuilder,
    start: int,
    compression: int,
    bounds: tuple[float, float],
) -> None:
    """Decode one section block by block."""
    bucket_ends = _bucket_ends(source, section) if compression else None
    order = _sh_order(section.degree)
    rows = max(1, _BLOCK_BYTES // section.record.itemsize)
    for first in range(0, section.count, rows):
        last = min(first + rows, section.count)
        size = section.record.itemsize
        data = source.read(section.data_at + first * size, (last - first) * size, "a section")
        records = np.frombuffer(data, section.record)
        with np.errstate(all="ignore"):
            means = records["place"].astype(np.float32)
            if bucket_ends is not None:
                number = np.searchsorted(bucket_ends, np.arange(first, last), side="right")
                centres = _centres(source, section, number)
                step = section.block / 2.0 / section.steps
                offsets = records["place"].astype(np.float64) - section.steps
                means = (offsets * step + centres).astype(np.float32)
            scales = records["scale"].astype(np.float32)
            scales = np.where(scales >= 0, scales, np.float32(np.nan))
            sh = np.zeros((last - first, builder.sh.shape[1], 3), np.float32)
            sh[:, 0] = COLOUR_OF_BYTE[records["colour"][:, :3]]
            if section.degree:
                codes = records["sh"].astype(np.float32)
                if compression == 2:
                    low, high = bounds
                    codes = (low + codes.astype(np.float64) / 255.0 * (high - low)).astype("f4")
                rest = codes[:, order].reshape(last - first, -1, 3)
                sh[:, 1 : 1 + rest.shape[1]] = rest
        builder.put(
            start + first,
            means,
            records["rotation"].astype(np.float32),
            scales,
            UNIT_OF_BYTE[records["colour"][:, 3]],
            sh.reshape(last - first, -1),
        )


def _bucket_ends(source: CloudSource, section: _Section) -> NDArray[np.int64]:
    """Gaussian after the last of each bucket: full ones first, then those of given sizes."""
    data = source.read(section.partial_at, 4 * section.partial_buckets, "bucket sizes")
    sizes = np.frombuffer(data, "<u4").astype(np.int64)
    full = section.full_buckets * section.bucket_size
    if full + int(sizes.sum()) < section.count:
        raise source.refuse(
            f"the buckets hold {full + int(sizes.sum())} Gaussians, the section {section.count}",
            section.partial_at,
        )
    first = np.arange(1, section.full_buckets + 1, dtype=np.int64) * section.bucket_size
    return np.concatenate([first, full + np.cumsum(sizes)])


def _centres(source: CloudSource, section: _Section, number: NDArray[np.int64]) -> F32:
    """Centres [R, 3] of the buckets of a block, which are neighbours in the file."""
    low, high = int(number[0]), int(number[-1]) + 1
    data = source.read(section.centres_at + low * 12, (high - low) * 12, "bucket centres")
    return np.frombuffer(data, "<f4").reshape(-1, 3)[number - low]


def _sh_order(degree: int) -> NDArray[np.intp]:
    """Where coefficient-major values [(K − 1) · 3] lie in a record: band by band, red first."""
    order = []
    for band in range(1, degree + 1):
        base, width = 3 * (band * band - 1), 2 * band + 1
        order += [base + channel * width + k for k in range(width) for channel in range(3)]
    return np.array(order, np.intp)
