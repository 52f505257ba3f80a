""".splat: 32 bytes per Gaussian, no header, no spherical harmonics.

Each record is float32 x y z, float32 linear scales, bytes r g b a, and the quaternion w x y z in
bytes. Writers cut v · 128 + 128 down to whole bytes, so the middle of a step is b / 255 · 2 − 1 but
for its length, which normalising takes away.
"""

from __future__ import annotations

import numpy as np

from gn0.gaussians.cloud import SH_C0
from gn0.gaussians.cloud_file import CloudBuilder, CloudFile
from gn0.gaussians.cloud_source import REFETCH, CloudSource
from gn0.geometry import F32, U8

RECORD = 32
_BLOCK = 1 << 15  # records
_BYTES = np.arange(256, dtype=np.float64)
COLOUR_OF_BYTE: F32 = ((_BYTES / 255.0 - 0.5) / SH_C0).astype(np.float32)
UNIT_OF_BYTE: F32 = (_BYTES / 255.0).astype(np.float32)
_SIGNED_OF_BYTE: F32 = (_BYTES / 255.0 * 2.0 - 1.0).astype(np.float32)


def looks_like_splat(head: bytes, size: int) -> bool:
    """Whether a file without a magic may be .splat: finite places and sane scales at its start.

    A few bad records do not speak against it, nor does a size that is no multiple of 32 where
    enough records look right: such a file is cut off.
    """
    rows = len(head) // RECORD
    if rows < (8 if size % RECORD else 1):
        return False
    records = np.frombuffer(head[: rows * RECORD], np.uint8).reshape(-1, RECORD)
    places = np.ascontiguousarray(records[:, :24]).view("<f4")
    with np.errstate(invalid="ignore"):
        sane = (np.abs(places) < 1e6).all(axis=1) & (places[:, 3:] >= 0).all(axis=1)
        positive = (places[sane, 3:] > 1e-12).any()
    return bool(sane.mean() > 0.5 and positive and (records[:, 28:] != 128).any())


def decode_splat(source: CloudSource) -> CloudFile:
    """Decode an open .splat file.

    Raises:
        FormatError: its size is no multiple of 32 bytes, or every Gaussian is non-finite.
    """
    if source.size % RECORD:
        raise source.refuse(
            f".splat has records of {RECORD} bytes; {source.size} bytes are not a multiple of it",
            source.size // RECORD * RECORD,
            remedy=REFETCH,
        )
    count = source.size // RECORD
    builder = CloudBuilder(source.file, count, 0, source.limit_bytes, 0)
    for start in range(0, count, _BLOCK):
        rows = min(_BLOCK, count - start)
        data = source.read(start * RECORD, rows * RECORD, "the records")
        records: U8 = np.frombuffer(data, np.uint8).reshape(rows, RECORD)
        floats = np.frombuffer(data, "<f4").reshape(rows, 8)
        colours = COLOUR_OF_BYTE[records[:, 24:27]]
        scales = np.where(floats[:, 3:6] >= 0, floats[:, 3:6], np.float32(np.nan))
        builder.put(
            start,
            floats[:, 0:3],
            _SIGNED_OF_BYTE[records[:, 28:32]],
            scales,
            UNIT_OF_BYTE[records[:, 27]],
            colours,
        )
    cloud, dropped = builder.build()
    return CloudFile(
        cloud=cloud,
        path=source.file,
        format="splat",
        stored=count,
        dropped=dropped,
        sh_degree=0,
        encoding="binary_little_endian",
    )
