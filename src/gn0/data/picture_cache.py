"""The cache of pictures: what every layout has in common.

    pictures/<layout>/manifest.json   settings, and size and digest of every file
    pictures/<layout>/…               the files of that layout

A cache is made from poses and scenes alone, so it can be thrown away and made again.
"""

from __future__ import annotations

import hashlib
import io
import struct
import zlib
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import IO, Any

import msgspec
import numpy as np
from numpy.typing import NDArray
from PIL import Image

from gn0.config import Config, decode_json
from gn0.data.dataset import PICTURE_FOLDER, FileRecord, compute_seal
from gn0.data.sample_pictures import StepPictures
from gn0.data.sample_table import DEPTH, EpisodeRows
from gn0.data.settings import PictureSettings
from gn0.errors import DataError, FormatError, StorageError
from gn0.geometry import U8
from gn0.missions.episode import Episode
from gn0.storage import read_bytes, safe_join, write_atomic, write_json

MANIFEST = "manifest.json"
CACHE_LAYOUT = 2  # of the manifest and of the files it names
READABLE = (1, 2)  # 1 kept goals and maps beside the shards, and had fewer LeRobot features
_LIMIT = 2**30  # bytes of a manifest
_PNG_LEVEL = 1  # zlib's quickest: half the time for a tenth more bytes
_PNG_UP = 2  # filter: a line is its difference from the one above


class CacheManifest(Config, frozen=True):
    """The content of `manifest.json`.

    Attributes:
        layout: version of this file's layout.
        settings: how the pictures are kept.
        files: every file of the cache but this one, sorted by path.
        seal: digest of all the rest.
    """

    layout: int
    settings: PictureSettings
    files: tuple[FileRecord, ...]
    seal: str = ""


@dataclass(frozen=True, eq=False)
class DrawnStep:
    """A sample with its pictures.

    Attributes:
        row: row of its part's table, from 0.
        step: step of its episode, from 0.
        block: the rows of its episode.
        episode: the episode.
        pictures: what it shows.
        hashes: hashes of the raw pixels, by name.
        places: (row, column) of the start and of the agent in the map pictures.
        base: the occupancy picture [H, W, 3] before dots are drawn, and its hash.
        goal: what the goal looks like [H, W, 3], and the picture's hash; None where the mission
            is no goal mission.
        kept: encoded pictures, shared by samples that show the same.
    """

    row: int
    step: int
    block: EpisodeRows
    episode: Episode
    pictures: StepPictures
    hashes: dict[str, str]
    places: tuple[tuple[int, int], tuple[int, int]]
    base: tuple[U8, str]
    goal: tuple[U8, str] | None = None
    kept: dict[str, bytes] = field(default_factory=dict)

    def encoded(self, name: str, settings: PictureSettings) -> bytes:
        """A picture as the bytes of a file, encoded once."""
        if name not in self.kept:
            picture = getattr(self.pictures, name)
            self.kept[name] = (
                encode_depth(picture) if name == DEPTH else encode_picture(picture, settings)
            )
        return self.kept[name]


def encode_picture(rgb: U8, settings: PictureSettings) -> bytes:
    """A picture [H, W, 3] as the bytes of a jpg (4:2:0) or png file."""
    stream = io.BytesIO()
    image = Image.fromarray(rgb)
    if settings.format == "png":
        image.save(stream, "PNG", compress_level=_PNG_LEVEL)
    else:
        image.save(stream, "JPEG", quality=settings.quality, subsampling=2)
    return stream.getvalue()


def encode_map(rgb: U8) -> bytes:
    """A map picture [H, W, 3] as the bytes of a png file: once a scene and light, so small."""
    stream = io.BytesIO()
    Image.fromarray(rgb).save(stream, "PNG", compress_level=9)
    return stream.getvalue()


def encode_depth(millimetres: NDArray[np.uint16]) -> bytes:
    """A depth picture [H, W] as the bytes of a 16-bit grey png file.

    Each line is written as its difference from the one above, and deflated by runs alone: half
    the time of Pillow's quickest for a tenth more bytes.
    """
    height, width = millimetres.shape
    lines = np.empty((height, 1 + 2 * width), np.uint8)
    lines[:, 0] = _PNG_UP
    data = millimetres.astype(">u2").view(np.uint8)
    lines[0, 1:] = data[0]
    np.subtract(data[1:], data[:-1], out=lines[1:, 1:])
    pressed = zlib.compressobj(_PNG_LEVEL, strategy=zlib.Z_RLE)
    head = struct.pack(">IIBBBBB", width, height, 16, 0, 0, 0, 0)
    chunks = (
        (b"IHDR", head),
        (b"IDAT", pressed.compress(lines.data) + pressed.flush()),
        (b"IEND", b""),
    )
    return b"\x89PNG\r\n\x1a\n" + b"".join(
        struct.pack(">I", len(body)) + name + body + struct.pack(">I", zlib.crc32(name + body))
        for name, body in chunks
    )


def decode_depth(data: bytes, file: Path | str, name: str) -> NDArray[np.uint16]:
    """A 16-bit grey png picture as uint16 [H, W].

    Raises:
        FormatError: it is damaged, or none.
    """
    try:
        with Image.open(io.BytesIO(data), formats=("PNG",)) as image:
            if image.mode != "I;16":
                raise ValueError(f"a picture of mode {image.mode!r}")
            return np.asarray(image, np.uint16)
    except Exception as error:  # Pillow raises whatever its decoders do
        raise FormatError(
            f"depth cannot be decoded: {error}", file=file, field=name,
            remedy="run `gn0 data repair`",
        ) from None  # fmt: skip


def decode_picture(data: bytes, file: Path | str, name: str) -> U8:
    """A jpg or png picture as uint8 [H, W, 3].

    Raises:
        FormatError: it is damaged.
    """
    try:
        with Image.open(io.BytesIO(data), formats=("JPEG", "PNG")) as image:
            return np.asarray(image.convert("RGB"), np.uint8)
    except Exception as error:  # Pillow raises whatever its decoders do
        raise FormatError(
            f"picture cannot be decoded: {error}", file=file, field=name,
            remedy="run `gn0 data repair`",
        ) from None  # fmt: skip


def cache_folder(folder: Path, layout: str) -> Path:
    """Folder of a cache layout in a dataset."""
    return folder / PICTURE_FOLDER / layout


def record_file(path: str, data: bytes) -> FileRecord:
    """Size and digest of a file's bytes; `path` is relative to the cache."""
    digest = hashlib.blake2b(data, digest_size=16).hexdigest()
    return FileRecord(path=path, size=len(data), digest=digest)


def write_recorded(
    folder: Path, path: str, write: Callable[[Callable[[bytes], int]], None]
) -> FileRecord:
    """Write a file through `write(put)`, and say its size and digest.

    Args:
        folder: folder of the cache.
        path: relative to it.
        write: calls `put(data)` for each piece; that returns the offset after it.
    """
    digest, size = hashlib.blake2b(digest_size=16), 0

    def pour(stream: IO[bytes]) -> None:
        def put(data: bytes) -> int:
            nonlocal size
            stream.write(data)
            digest.update(data)
            size += len(data)
            return size

        write(put)

    write_atomic(safe_join(folder, path), pour)
    return FileRecord(path=path, size=size, digest=digest.hexdigest())


def write_maps(folder: Path, step: DrawnStep, known: dict[str, FileRecord]) -> tuple[str, str]:
    """Write a sample's BEV and bare occupancy picture, unless `known`; returns their paths."""
    paths = []
    for picture, name in ((step.pictures.bev, step.hashes["bev"]), step.base):
        path = f"maps/{name}.png"
        if path not in known:
            known[path] = write_once(folder, path, encode_map(picture))
        paths.append(path)
    return paths[0], paths[1]


def write_goal(
    folder: Path, step: DrawnStep, known: dict[str, FileRecord], settings: PictureSettings
) -> str:
    """Write a sample's goal picture, unless `known`; returns its path, or "" without one."""
    if step.goal is None:
        return ""
    path = f"goals/{step.goal[1]}.{settings.format}"
    if path not in known:
        known[path] = write_once(folder, path, encode_picture(step.goal[0], settings))
    return path


def write_once(folder: Path, path: str, data: bytes) -> FileRecord:
    """Write a file that is named by its content, unless it is there already."""
    target = safe_join(folder, path)
    record = record_file(path, data)
    if not (target.is_file() and target.stat().st_size == len(data)
            and target.read_bytes() == data):  # fmt: skip
        write_atomic(target, lambda stream: (stream.write(data), None)[1])
    return record


def save_manifest(
    folder: Path, settings: PictureSettings, files: Iterator[FileRecord]
) -> CacheManifest:
    """Write the manifest of a cache, which makes it whole."""
    by_path = {record.path: record for record in files}
    manifest = CacheManifest(
        layout=CACHE_LAYOUT,
        settings=settings,
        files=tuple(by_path[path] for path in sorted(by_path)),
    )
    manifest = msgspec.structs.replace(manifest, seal=compute_seal(manifest))
    target = cache_folder(folder, settings.layout) / MANIFEST
    write_json(target, msgspec.to_builtins(manifest))
    return manifest


def load_manifest(folder: Path, layout: str) -> CacheManifest | None:
    """The manifest of a cache; None where there is no whole cache of that layout.

    Raises:
        FormatError: it is damaged, or of another layout version.
    """
    path = cache_folder(folder, layout) / MANIFEST
    if not path.is_file():
        return None
    data = read_bytes(path, _LIMIT)
    found: Any = decode_json(data, dict, file=path).get("layout")
    if found not in READABLE:
        raise FormatError(
            f"cache layout {found}, this version reads {CACHE_LAYOUT}", file=path, field="layout",
            remedy="delete the folder and run `gn0 data render`",
        )  # fmt: skip
    manifest = decode_json(data, CacheManifest, file=path)
    if manifest.seal != compute_seal(manifest):
        raise FormatError(
            "something in it was changed after it was written", file=path, field="seal",
            remedy="run `gn0 data repair`",
        )  # fmt: skip
    return manifest


def check_cache_free(folder: Path, settings: PictureSettings) -> bool:
    """Whether a cache of exactly these settings is there already, whole.

    Raises:
        DataError: one of other settings is.
    """
    manifest = load_manifest(folder, settings.layout)
    if manifest is None:
        return False
    if manifest.settings != settings:
        raise DataError(
            f"there is a {settings.layout} cache of other settings",
            where=cache_folder(folder, settings.layout),
            remedy="give the same settings, or delete that folder",
        )  # fmt: skip
    return True


def read_cached(folder: Path, layout: str, path: str) -> bytes:
    """A file of a cache.

    Raises:
        StorageError: it is missing or unreadable.
    """
    target = safe_join(cache_folder(folder, layout), path)
    try:
        return read_bytes(target)
    except StorageError as error:
        raise StorageError(error.what, where=target, remedy="run `gn0 data repair`") from None
