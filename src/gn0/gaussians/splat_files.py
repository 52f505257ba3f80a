"""Splat files by content: one way in for every format, and a plain description of a file."""

from __future__ import annotations

import os
import stat
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from gn0.errors import FormatError, StorageError
from gn0.gaussians.cloud_file import CloudFile
from gn0.gaussians.cloud_source import CloudSource
from gn0.gaussians.gltf import decode_glb, decode_gltf
from gn0.gaussians.ksplat import decode_ksplat, looks_like_ksplat
from gn0.gaussians.ply import decode_ply
from gn0.gaussians.ply_header import load_ply_header
from gn0.gaussians.ply_packed import decode_ply_packed, is_packed
from gn0.gaussians.ply_rows import PlySource
from gn0.gaussians.sog import META_NAME, decode_sog_bundle, decode_sog_folder
from gn0.gaussians.sog_streamed import INDEX_NAME, decode_sog_streamed
from gn0.gaussians.splat import decode_splat, looks_like_splat
from gn0.gaussians.spz import MAGIC, decode_spz, decode_spz_gzip
from gn0.storage import plain_path, storage_error

_HEAD = 4096  # bytes shown to the recognisers
_CONVERT = "convert it to .ply first, e.g. with PlayCanvas's splat-transform"
_INSIDE = (INDEX_NAME, META_NAME)  # what a folder of splats is known by
AXES_AS_STORED = "as stored; the format fixes none (captures: often y down; GN0's own scenes: z up)"
READABLE = ".ply, .compressed.ply, .spz, .sog, .splat, .ksplat, .glb, .gltf or a SOG folder"


@dataclass(frozen=True)
class CloudFormat:
    """One splat format: how to know it, and how to read it.

    Attributes:
        name: its name in plain words.
        recognise: whether the first bytes (up to 4 KiB) of a file of a given size look like it.
        decode: its reader; None for what we only know by name.
        remedy: what to do where there is no reader.
        levels: whether files of it may have several levels of detail.
    """

    name: str
    recognise: Callable[[bytes, int], bool]
    decode: Callable[[CloudSource], CloudFile] | None = None
    remedy: str = _CONVERT
    levels: bool = False


def load_cloud(
    path: Path | str, *, level: int | None = None, limit_bytes: int | None = None
) -> CloudFile:
    """Read a splat file of any format we know, detected from its content, not from its name.

    Args:
        path: the file, or the folder of an unbundled or streamed SOG.
        level: level of detail of a streamed SOG, 0 the finest, which is also the default.
        limit_bytes: refuse a cloud that takes more than this decoded, if given.

    Raises:
        FormatError: not a splat file, a format without a reader, broken, truncated or forged; or
            there is no such level.
        StorageError: the file is missing or cannot be read.
    """
    path = plain_path(path)
    if "\0" in str(path):
        raise StorageError("file name holds a NUL", where=repr(str(path)), remedy="check the path")
    try:
        if path.is_dir():
            path = _file_of_folder(path)
        # O_NONBLOCK: opening a named pipe must not wait for a writer
        fd = os.open(path, os.O_RDONLY | getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_BINARY", 0))
        with os.fdopen(fd, "rb", buffering=0) as stream:
            info = os.fstat(stream.fileno())
            if not stat.S_ISREG(info.st_mode):
                raise FormatError(
                    "is not a regular file (a pipe or device)",
                    file=path,
                    remedy="copy the splats into a file first",
                )
            source = CloudSource(stream, path, info.st_size, limit_bytes, level)
            head = stream.read(_HEAD)
            for form in CLOUD_FORMATS:
                if form.recognise(head, info.st_size):
                    return _decode(form, source)
    except OSError as error:
        raise storage_error(error, path, "read") from error
    raise FormatError(
        "not a splat file of a known format" if head else "the file is empty",
        file=path,
        offset=0,
        remedy=f"pass a {READABLE}",
    )


def _decode(form: CloudFormat, source: CloudSource) -> CloudFile:
    """Decode a recognised file, or say why not."""
    if form.decode is None:
        raise source.refuse(f"this is {form.name}", remedy=form.remedy)
    if source.level and not form.levels:
        raise source.refuse(
            f"there is no level {source.level}: {form.name} has one level of detail, 0",
            None,
            field="level",
            remedy="leave the level out",
        )
    file = form.decode(source)
    return file if file.size else replace(file, size=source.size)


def describe_cloud_file(
    path: Path | str, *, level: int | None = None, limit_bytes: int | None = None
) -> dict[str, Any]:
    """What a splat file holds, as plain JSON values, in the order a person wants to read it.

    Raises:
        FormatError: as `load_cloud`.
        StorageError: as `load_cloud`.
    """
    file = load_cloud(path, level=level, limit_bytes=limit_bytes)
    cloud = file.cloud
    quantiles = (0.01, 0.5, 0.99)
    low, high = np.quantile(cloud.means.astype(np.float64), [0.01, 0.99], axis=0)
    return {
        "file": str(file.path),
        "format": file.format,
        "encoding": file.encoding,
        "bytes": file.size,
        "bytes_per_gaussian": round(file.size / file.stored, 2),
        "gaussians": len(cloud),
        "dropped_non_finite": file.dropped,
        "sh_degree": file.sh_degree,
        "levels": file.levels,
        "level": file.level,
        "axes": file.frame or AXES_AS_STORED,
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


def _file_of_folder(folder: Path) -> Path:
    """The file by which a folder of splats is read.

    Raises:
        FormatError: it is no such folder.
    """
    for name in _INSIDE:
        if (folder / name).is_file():
            return folder / name
    raise FormatError(
        f"is a folder, not a splat file, and has no {META_NAME} or {INDEX_NAME} (SOG) in it",
        file=folder,
        remedy="pass the splat file inside it",
    )


def _decode_any_ply(source: CloudSource) -> CloudFile:
    header = load_ply_header(source.stream, source.file, source.size)
    ply = PlySource(source.stream, source.file, source.size, header)
    decode = decode_ply_packed if is_packed(header) else decode_ply
    return decode(ply, source.limit_bytes)


def _starts(*magics: bytes) -> Callable[[bytes, int], bool]:
    return lambda head, size: head.startswith(magics)


def _is_json(head: bytes, size: int) -> bool:
    text = head.lstrip(b"\xef\xbb\xbf \t\r\n")
    return text.startswith(b"{") and b'"' in text


def _decode_json(source: CloudSource) -> CloudFile:
    """Tell the kinds of JSON apart by the keys that only they have."""
    span = min(source.size, 1 << 16)  # the middle of a glTF may be one long text
    ends = source.read(0, span, "JSON") + source.read(source.size - span, span, "JSON")
    for keys, form in _JSON_FORMATS:
        if all(key in ends for key in keys):
            return _decode(form, source)
    raise source.refuse(
        "this is JSON, but neither SOG (meta.json, lod-meta.json) nor glTF",
        remedy=f"pass a {READABLE}",
    )


def _is_page(head: bytes, size: int) -> bool:
    text = head.lstrip(b"\xef\xbb\xbf \t\r\n").lower()
    return text.startswith((b"<!doctype html", b"<html", b"<?xml"))


_JSON_FORMATS: tuple[tuple[tuple[bytes, ...], CloudFormat], ...] = (
    (
        (b'"lodLevels"', b'"filenames"'),
        CloudFormat("a streamed SOG", _is_json, decode_sog_streamed, levels=True),
    ),
    ((b'"means"', b'"quats"'), CloudFormat("a SOG folder", _is_json, decode_sog_folder)),
    ((b'"asset"', b'"meshes"'), CloudFormat("glTF", _is_json, decode_gltf)),
)

# Tried in order; a reader for a further format is one more `decode` here.
CLOUD_FORMATS: tuple[CloudFormat, ...] = (
    CloudFormat("PLY", _starts(b"ply\n", b"ply\r"), _decode_any_ply),
    CloudFormat("SPZ", _starts(MAGIC), decode_spz),
    CloudFormat("SPZ in gzip", _starts(b"\x1f\x8b"), decode_spz_gzip),
    CloudFormat("a SOG bundle", _starts(b"PK\x03\x04", b"PK\x05\x06"), decode_sog_bundle),
    CloudFormat("binary glTF", _starts(b"glTF"), decode_glb),
    CloudFormat(
        "a Git LFS pointer, not the file itself",
        _starts(b"version https://git-lfs"),
        remedy="fetch the real file with 'git lfs pull'",
    ),
    CloudFormat(
        "a web page", _is_page, remedy="the download failed or needs a log-in: fetch it again"
    ),
    CloudFormat(
        "a picture (WebP), perhaps one plane of a SOG folder",
        lambda head, size: head[:4] == b"RIFF" and head[8:12] == b"WEBP",
        remedy="pass the folder or its meta.json",
    ),
    CloudFormat("JSON", _is_json, _decode_json, levels=True),
    CloudFormat("KSPLAT", looks_like_ksplat, decode_ksplat),
    CloudFormat(".splat", looks_like_splat, decode_splat),
)
