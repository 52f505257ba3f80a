"""PlayCanvas compressed PLY: 16 bytes a splat in chunks of 256, SH in one byte a value.

Decoded as PlayCanvas's own splat-transform does. Each word has its first value in the high bits:
position and log scale are 11-10-11 bits between the bounds of their chunk; rotation is the index of
the largest of (w, x, y, z) in 2 bits, then the other three in 10 bits each over ±√½; colour is a
byte each of r, g, b (between bounds where the chunk has them, else 0..1) and opacity.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import IO, Any

import numpy as np
from numpy.typing import NDArray

from gn0.errors import FormatError
from gn0.gaussians.cloud import SH_C0, GaussianCloud
from gn0.gaussians.cloud_file import CloudBuilder, CloudFile
from gn0.gaussians.morton import morton_order
from gn0.gaussians.ply import (
    ENCODINGS,
    check_writable,
    comment_lines,
    log_scales,
    unused_elements,
    unused_properties,
)
from gn0.gaussians.ply_header import PlyElement, PlyHeader
from gn0.gaussians.ply_rows import PlySource, iterate_rows, note_trailing_bytes
from gn0.gaussians.sh import degree_of_rest
from gn0.geometry import F32, F64, U8
from gn0.storage import plain_path, write_atomic

CHUNK = 256
_BOUNDS = tuple(f"{e}_{a}" for e in ("min", "max") for a in "xyz") + tuple(
    f"{e}_scale_{a}" for e in ("min", "max") for a in "xyz"
)
_COLOUR_BOUNDS = tuple(f"{e}_{c}" for e in ("min", "max") for c in "rgb")
_PACKED = ("packed_position", "packed_rotation", "packed_scale", "packed_color")
_LOG_SCALE_LIMIT = 20.0  # what splat-transform clamps to; e^-20 m is 2 nm
_REMEDY = "write the file again, e.g. with splat-transform"
_WRITE_CHUNKS = 64
_BLOCK = 1 << 17  # bytes of words; their decoded doubles fit the second-level cache


def is_packed(header: PlyHeader) -> bool:
    """Whether a header is meant as compressed PLY (it may still be broken)."""
    vertex = header.find("vertex")
    return vertex is not None and any(name in vertex.names for name in _PACKED)


def decode_ply_packed(source: PlySource, limit_bytes: int | None = None) -> CloudFile:
    """Decode an open compressed PLY.

    Args:
        source: the open file, for which `is_packed` holds.
        limit_bytes: the largest decoded size allowed, if any.

    Raises:
        FormatError: elements or properties are missing, of the wrong type or count, or cut off.
    """
    vertex, chunk, sh = _elements(source)
    rest = len(sh.names) if sh is not None else 0
    degree = degree_of_rest(rest) or 0
    coloured = set(_COLOUR_BOUNDS) <= set(chunk.names)
    builder = CloudBuilder(source.file, vertex.count, degree, limit_bytes, vertex.offset)
    fields = (*_BOUNDS, *_COLOUR_BOUNDS) if coloured else _BOUNDS
    bounds = np.empty((chunk.count, len(fields)), np.float32)
    for start, rows in iterate_rows(source, chunk, fields, np.float32):
        bounds[start : start + len(rows)] = rows
    for start, rows in iterate_rows(source, vertex, _PACKED, np.uint32, _BLOCK):
        position, rotation, scale, colour = (np.ascontiguousarray(rows[:, i]) for i in range(4))
        with np.errstate(all="ignore"):  # bounds may be NaN; their splats are dropped
            box = bounds[np.arange(start, start + len(rows)) // CHUNK].astype(np.float64)
            rgba = _unpack_bytes(colour)
            rgb = rgba[:, :3]
            if coloured:
                rgb = _lerp(box[:, 12:15], box[:, 15:18], rgb)
            builder.put(
                start,
                _lerp(box[:, 0:3], box[:, 3:6], _unpack_111011(position)).astype(np.float32),
                _unpack_rotation(rotation),
                np.exp(_lerp(box[:, 6:9], box[:, 9:12], _unpack_111011(scale)).astype(np.float32)),
                rgba[:, 3].astype(np.float32),
                ((rgb - 0.5) / SH_C0).astype(np.float32),
            )
    if sh is not None and rest:
        names = [f"f_rest_{i}" for i in range(rest)]
        for start, codes in iterate_rows(source, sh, names, np.uint8, _BLOCK):
            builder.put_rest(start, _unpack_sh(codes))
    cloud, dropped = builder.build()
    return CloudFile(
        cloud=cloud,
        path=source.file,
        format="ply-packed",
        stored=vertex.count,
        dropped=dropped,
        sh_degree=degree,
        encoding=ENCODINGS[source.header.byte_order],
        comments=source.header.comments,
        extra_properties=unused_properties(vertex, set(_PACKED)),
        extra_elements=unused_elements(source.header, {"vertex", "chunk", "sh"}),
        notes=note_trailing_bytes(source),
    )


def save_ply_packed(
    cloud: GaussianCloud, path: Path | str, *, comments: Sequence[str] = ()
) -> NDArray[np.int64]:
    """Write a cloud as compressed PLY, in Morton order, atomically.

    Args:
        cloud: the Gaussians.
        path: the file to write.
        comments: comment lines for the header.

    Returns:
        The order [N] in which they were written: row i of the file is Gaussian order[i]. Whatever
        goes beside the file (labels, albedo) must be put in this order.

    Raises:
        FormatError: the cloud is empty or holds values that no reader would keep.
        StorageError: the file cannot be written.
    """
    path = plain_path(path)
    check_writable(cloud, path)
    order = morton_order(cloud.means)
    count = len(order)
    chunks = -(-count // CHUNK)
    rest = 3 * (cloud.sh.shape[1] - 1)
    header = ["ply", "format binary_little_endian 1.0", *comment_lines(comments)]
    header += [f"element chunk {chunks}"]
    header += [f"property float {name}" for name in (*_BOUNDS, *_COLOUR_BOUNDS)]
    header += [f"element vertex {count}", *(f"property uint {name}" for name in _PACKED)]
    if rest:
        header += [f"element sh {count}", *(f"property uchar f_rest_{i}" for i in range(rest))]
    header += ["end_header"]
    bounds = np.empty((chunks, 18), "<f4")
    packed = np.empty((count, 4), "<u4")
    for first in range(0, chunks, _WRITE_CHUNKS):
        last = min(first + _WRITE_CHUNKS, chunks)
        # the last chunk is filled with copies of its last splat, which change no bounds
        rows = np.minimum(np.arange(first * CHUNK, last * CHUNK), count - 1)
        bounds[first:last], words = _pack_chunks(cloud, order[rows], last - first)
        span = slice(first * CHUNK, min(last * CHUNK, count))
        packed[span] = words[: span.stop - span.start]

    def write(stream: IO[bytes]) -> None:
        stream.write(("\n".join(header) + "\n").encode("utf-8"))
        stream.write(bounds.data.cast("B"))
        stream.write(packed.data.cast("B"))
        step = CHUNK * _WRITE_CHUNKS
        for start in range(0, count if rest else 0, step):
            coefficients = cloud.sh[order[start : start + step], 1:]
            stream.write(_pack_sh(coefficients).data.cast("B"))

    write_atomic(path, write)
    return order


def _elements(source: PlySource) -> tuple[PlyElement, PlyElement, PlyElement | None]:
    """The vertex, chunk and sh elements, their columns, types and counts checked."""
    header = source.header

    def refuse(what: str, element: PlyElement | None, field: str) -> FormatError:
        offset = element.offset if element is not None else 0
        return FormatError(what, file=source.file, offset=offset, field=field, remedy=_REMEDY)

    def require(element: PlyElement, names: Sequence[str], type_: str, words: str) -> None:
        types = {p.name: p.type if p.count_type is None else "list" for p in element.properties}
        for name in names:
            if types.get(name) != type_:
                state = "missing" if name not in types else f"not {words}"
                raise refuse(f"compressed PLY: {element.name} property is {state}", element, name)
        if element.has_lists:
            raise refuse("compressed PLY: an element has a list", element, element.name)

    vertex, chunk, sh = (header.find(name) for name in ("vertex", "chunk", "sh"))
    if vertex is None or chunk is None:
        raise refuse("compressed PLY has no chunk element", vertex, "chunk")
    require(vertex, _PACKED, "u4", "uint")
    require(chunk, _BOUNDS, "f4", "float")
    if any(name in chunk.names for name in _COLOUR_BOUNDS):
        require(chunk, _COLOUR_BOUNDS, "f4", "float")
    expected = -(-vertex.count // CHUNK)
    if chunk.count != expected:
        raise refuse(
            f"compressed PLY has {chunk.count} chunks for {vertex.count} splats, not {expected}",
            chunk,
            "chunk",
        )
    if sh is not None:
        if len(sh.names) not in (9, 24, 45):
            raise refuse(
                f"compressed PLY has {len(sh.names)} SH properties, not 9, 24 or 45", sh, "sh"
            )
        require(sh, [f"f_rest_{i}" for i in range(len(sh.names))], "u1", "uchar")
        if sh.count != vertex.count:
            raise refuse(
                f"compressed PLY has {sh.count} SH rows for {vertex.count} splats", sh, "sh"
            )
    return vertex, chunk, sh


def _lerp(low: F64, high: F64, t: F64) -> F64:
    return low * (1.0 - t) + high * t


def _unpack_111011(words: NDArray[np.uint32]) -> F64:
    """Three fractions 0..1 [R, 3] of 11, 10 and 11 bits, the first one highest."""
    out = np.empty((len(words), 3))
    np.divide(words >> 21, 2047.0, out=out[:, 0])
    np.divide((words >> 11) & 1023, 1023.0, out=out[:, 1])
    np.divide(words & 2047, 2047.0, out=out[:, 2])
    return out


def _unpack_bytes(words: NDArray[np.uint32]) -> F64:
    """Four fractions 0..1 [R, 4] of a byte each, the first one highest."""
    return words.astype(">u4").view(np.uint8).reshape(-1, 4) / 255.0


def _unpack_rotation(words: NDArray[np.uint32]) -> F32:
    """Quaternions (w, x, y, z) [R, 4] of the smallest three and the index of the largest."""
    three = np.empty((len(words), 3))
    for column, shift in enumerate((20, 10, 0)):
        np.subtract(((words >> shift) & 1023) / 1023.0, 0.5, out=three[:, column])
    three *= math.sqrt(2.0)
    largest = np.sqrt(np.maximum(0.0, 1.0 - np.einsum("ij,ij->i", three, three)))
    quats = np.empty((len(words), 4), np.float32)
    which = words >> 30
    for slot in range(4):
        rows = np.flatnonzero(which == slot)
        others = [i for i in range(4) if i != slot]
        picked = np.empty((len(rows), 4), np.float32)
        picked[:, slot] = largest[rows]
        picked[:, others] = three[rows]
        quats[rows] = picked
    return quats


def _unpack_sh(codes: U8) -> F32:
    """SH beyond DC [R, (K − 1), 3] of bytes [R, rest] channel by channel.

    A byte b stands for the middle of its step, (b + 0.5) / 256 of −4..4; the two end bytes stand
    for exactly −4 and 4. All of these are exact in float32.
    """
    values = codes * np.float32(1 / 32) + np.float32(1 / 64 - 4)
    np.putmask(values, codes == 0, np.float32(-4))
    np.putmask(values, codes == 255, np.float32(4))
    return values.reshape(len(codes), 3, -1).transpose(0, 2, 1)


def _pack_sh(coefficients: F32) -> U8:
    """Bytes [R, rest] channel by channel, each the one that `_unpack_sh` brings nearest."""
    level = (coefficients * np.float32(0.125) + np.float32(0.5)) * np.float32(256)
    codes = np.clip(np.floor(level), 0, 255)
    codes[(level >= 0.75) & (level < 1)] = 1  # byte 1 (at 1.5) is nearer than byte 0 (at 0)
    codes[(level >= 255) & (level < 255.25)] = 254
    by_channel = codes.astype(np.uint8).transpose(0, 2, 1)
    return np.ascontiguousarray(by_channel).reshape(len(coefficients), -1)


def _pack_chunks(
    cloud: GaussianCloud, rows: NDArray[np.int64], chunks: int
) -> tuple[F32, NDArray[np.uint32]]:
    """Bounds [chunks, 18] and words [chunks · 256, 4] of whole chunks of Gaussians."""
    colours = cloud.sh[rows, 0] * np.float32(SH_C0) + np.float32(0.5)
    scales = np.clip(log_scales(cloud.scales[rows]), -_LOG_SCALE_LIMIT, _LOG_SCALE_LIMIT)
    bounds: list[F64] = []
    units: list[F64] = []
    for values in (cloud.means[rows], scales, colours):
        grouped = np.ascontiguousarray(values.T, np.float64).reshape(3, chunks, CHUNK)
        low, high = grouped.min(axis=2), grouped.max(axis=2)
        span = np.where(high > low, high - low, 1.0)
        units.append(((grouped - low[..., None]) / span[..., None]).reshape(3, -1))
        bounds += [low, high]
    words = np.empty((len(rows), 4), np.uint32)
    words[:, 0] = _pack_111011(units[0])
    words[:, 1] = _pack_rotation(cloud.quats[rows])
    words[:, 2] = _pack_111011(units[1])
    red, green, blue = (_levels(unit, 8) for unit in units[2])
    alpha = _levels(cloud.opacities[rows].astype(np.float64), 8)
    words[:, 3] = red << 24 | green << 16 | blue << 8 | alpha
    return np.concatenate(bounds).T.astype(np.float32), words


def _levels(units: F64, bits: int) -> NDArray[np.uint32]:
    """Fractions rounded to whole levels of so many bits."""
    top = (1 << bits) - 1
    return np.clip(np.floor(units * top + 0.5), 0, top).astype(np.uint32)


def _pack_111011(units: F64) -> NDArray[Any]:
    """Three rows of fractions [3, R] as words, the first one in the high bits."""
    high, middle, low = units
    return _levels(high, 11) << 21 | _levels(middle, 10) << 11 | _levels(low, 11)


def _pack_rotation(quats: F32) -> NDArray[Any]:
    """The smallest three of unit quaternions, sign chosen so that the largest is positive."""
    q = quats.astype(np.float64)
    q /= np.sqrt(np.einsum("ij,ij->i", q, q))[:, None]
    largest = np.argmax(np.abs(q), axis=1)
    at = np.arange(len(q))
    q *= np.where(q[at, largest] < 0, -1.0, 1.0)[:, None]
    others = np.array([[1, 2, 3], [0, 2, 3], [0, 1, 3], [0, 1, 2]])[largest]
    a, b, c = (_levels(q[at, others[:, i]] * math.sqrt(0.5) + 0.5, 10) for i in range(3))
    return largest.astype(np.uint32) << 30 | a << 20 | b << 10 | c
