"""Splat files by content: one way in for every format, and a plain description of a file."""

from __future__ import annotations

import os
import stat
import struct
import zlib
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Any

import numpy as np

from gn0.errors import FormatError, StorageError
from gn0.gaussians.cloud_file import CloudFile
from gn0.gaussians.ply import decode_ply
from gn0.gaussians.ply_header import load_ply_header
from gn0.gaussians.ply_packed import decode_ply_packed, is_packed
from gn0.gaussians.ply_rows import PlySource
from gn0.storage import storage_error

_HEAD = 4096  # bytes shown to the recognisers
_CONVERT = "convert it to .ply first, e.g. with PlayCanvas's splat-transform"


@dataclass(frozen=True)
class CloudFormat:
    """One splat format: how to know it, and how to read it.

    Attributes:
        name: its name in plain words.
        recognise: whether the first bytes (up to 4 KiB) of a file of a given size look like it.
        decode: reader of (stream, file, size, limit_bytes); None while there is none.
        remedy: what to do where there is no reader.
    """

    name: str
    recognise: Callable[[bytes, int], bool]
    decode: Callable[[IO[bytes], Path, int, int | None], CloudFile] | None = None
    remedy: str = _CONVERT


def load_cloud(path: Path | str, *, limit_bytes: int | None = None) -> CloudFile:
    """Read a splat file of any format we know, told by its content and not by its name.

    Args:
        path: the file.
        limit_bytes: refuse a cloud that takes more than this decoded, if given.

    Raises:
        FormatError: not a splat file, a format without a reader, broken, truncated or forged.
        StorageError: the file is missing or cannot be read.
    """
    path = Path(path)
    if "\0" in str(path):
        raise StorageError("file name holds a NUL", where=repr(str(path)), remedy="check the path")
    try:
        # O_NONBLOCK: opening a named pipe must not wait for a writer
        fd = os.open(path, os.O_RDONLY | getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_BINARY", 0))
        with os.fdopen(fd, "rb", buffering=0) as stream:
            info = os.fstat(stream.fileno())
            if stat.S_ISDIR(info.st_mode):
                raise _folder(path)
            if not stat.S_ISREG(info.st_mode):
                raise FormatError(
                    "is not a regular file (a pipe or device)",
                    file=path,
                    remedy="copy the splats into a file first",
                )
            head = stream.read(_HEAD)
            for form in CLOUD_FORMATS:
                if form.recognise(head, info.st_size):
                    if form.decode is None:
                        raise FormatError(
                            f"this is {form.name}, which is not supported yet",
                            file=path,
                            offset=0,
                            remedy=form.remedy,
                        )
                    return form.decode(stream, path, info.st_size, limit_bytes)
    except OSError as error:
        if path.is_dir():  # not every system opens a folder
            raise _folder(path) from error
        raise storage_error(error, path, "read") from error
    raise FormatError(
        "is no splat file that we know" if head else "the file is empty",
        file=path,
        offset=0,
        remedy="pass a 3DGS .ply or PlayCanvas .compressed.ply file",
    )


def describe_cloud_file(path: Path | str, *, limit_bytes: int | None = None) -> dict[str, Any]:
    """What a splat file holds, as plain JSON values, in the order a person wants to read it.

    Raises:
        FormatError: as `load_cloud`.
        StorageError: as `load_cloud`.
    """
    file = load_cloud(path, limit_bytes=limit_bytes)
    cloud = file.cloud
    quantiles = (0.01, 0.5, 0.99)
    low, high = np.quantile(cloud.means.astype(np.float64), [0.01, 0.99], axis=0)
    size = Path(path).stat().st_size
    return {
        "file": str(path),
        "format": file.format,
        "encoding": file.encoding,
        "bytes": size,
        "bytes_per_gaussian": round(size / file.stored, 2),
        "gaussians": len(cloud),
        "dropped_non_finite": file.dropped,
        "sh_degree": file.sh_degree,
        "bounds_m": _rounded(cloud.bounds()),
        "bounds_98_percent_m": _rounded(np.stack([low, high])),
        "scale_m_at_1_50_99_percent": _rounded(np.quantile(cloud.scales, quantiles)),
        "opacity_at_1_50_99_percent": _rounded(np.quantile(cloud.opacities, quantiles)),
        "content_hash": cloud.content_hash,
        "comments": list(file.comments),
        "extra_properties": list(file.extra_properties),
        "extra_elements": dict(file.extra_elements),
        "notes": list(file.notes),
    }


def _rounded(values: np.ndarray[Any, Any]) -> Any:
    return np.array([float(f"{v:.5g}") for v in values.ravel()]).reshape(values.shape).tolist()


def _folder(path: Path) -> FormatError:
    if (path / "meta.json").is_file():
        return FormatError(
            "this is an unbundled SOG folder, which is not supported yet",
            file=path,
            remedy=_CONVERT,
        )
    return FormatError(
        "is a folder, not a splat file", file=path, remedy="pass the .ply file inside it"
    )


def _decode_any_ply(stream: IO[bytes], file: Path, size: int, limit_bytes: int | None) -> CloudFile:
    source = PlySource(stream, file, size, load_ply_header(stream, file, size))
    decode = decode_ply_packed if is_packed(source.header) else decode_ply
    return decode(source, limit_bytes)


def _starts(*magics: bytes) -> Callable[[bytes, int], bool]:
    return lambda head, size: head.startswith(magics)


def _is_gzip_spz(head: bytes, size: int) -> bool:
    if not head.startswith(b"\x1f\x8b"):
        return False
    try:
        return zlib.decompressobj(31).decompress(head, 4) == b"NGSP"
    except zlib.error:
        return False


def _is_zip_sog(head: bytes, size: int) -> bool:
    return head.startswith(b"PK\x03\x04") and (b".webp" in head or b"meta.json" in head)


def _is_json(head: bytes, size: int) -> bool:
    text = head.lstrip(b"\xef\xbb\xbf \t\r\n")
    return text.startswith(b"{") and b'"' in text


def _is_page(head: bytes, size: int) -> bool:
    text = head.lstrip(b"\xef\xbb\xbf \t\r\n").lower()
    return text.startswith((b"<!doctype html", b"<html", b"<?xml"))


def _is_ksplat(head: bytes, size: int) -> bool:
    """Version 0.x, a 4096-byte header whose section count agrees with the size."""
    if size < 4096 + 1024 or len(head) < 24 or head[0] != 0 or head[1] == 0:
        return False
    sections, used, _, splats = struct.unpack_from("<4I", head, 4)
    return used <= sections < 65536 and splats > 0 and sections * 1024 + 4096 <= size


def _is_splat(head: bytes, size: int) -> bool:
    """.splat has no magic: 32-byte records, finite places and sane scales in the first few."""
    if size == 0 or size % 32 or len(head) < 32:
        return False
    records = np.frombuffer(head[: len(head) // 32 * 32], np.uint8).reshape(-1, 32)
    places = np.ascontiguousarray(records[:, :24]).view("<f4")
    with np.errstate(invalid="ignore"):
        sane = np.isfinite(places).all() and (np.abs(places) < 1e6).all()
        positive = (places[:, 3:] >= 0).all() and (places[:, 3:] > 1e-12).any()
    return bool(sane and positive and (records[:, 28:] != 128).any())


# Tried in order; a reader for a further format is one more `decode` here.
CLOUD_FORMATS: tuple[CloudFormat, ...] = (
    CloudFormat("PLY", _starts(b"ply\n", b"ply\r"), _decode_any_ply),
    CloudFormat("SPZ", _starts(b"NGSP")),
    CloudFormat("SPZ (gzip)", _is_gzip_spz),
    CloudFormat("a gzip archive", _starts(b"\x1f\x8b"), remedy="unpack it first"),
    CloudFormat("SOG (a bundle)", _is_zip_sog),
    CloudFormat("a zip archive", _starts(b"PK\x03\x04", b"PK\x05\x06"), remedy="unpack it first"),
    CloudFormat("binary glTF (GLB)", _starts(b"glTF")),
    CloudFormat(
        "a Git LFS pointer, not the file itself",
        _starts(b"version https://git-lfs"),
        remedy="fetch the real file with 'git lfs pull'",
    ),
    CloudFormat(
        "a web page", _is_page, remedy="the download failed or needs a log-in: fetch it again"
    ),
    CloudFormat("JSON (SOG meta.json or glTF)", _is_json),
    CloudFormat("KSPLAT", _is_ksplat),
    CloudFormat(".splat", _is_splat),
)
