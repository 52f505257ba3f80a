"""Scenes packed into one byte string, for machines that do not see the folder.

A parcel is a count, then for each file the lengths of its name and of its content (little-endian
64-bit), its name relative to the folder, and its content. Nothing in it is executed or followed:
names go through `safe_join`, and the worker checks the scene's content hash as it always does.
"""

from __future__ import annotations

import os
import struct
import tempfile
from pathlib import Path

from gn0.errors import FormatError
from gn0.storage import TEMPORARY_PREFIX, cache_dir, read_bytes, safe_join, storage_error

_HEAD = struct.Struct("<8sQ")
_ENTRY = struct.Struct("<QQ")
MAGIC = b"gn0parc1"
MARKER = "scene.json"


def pack_folder(folder: Path) -> bytes:
    """All plain files below a folder, in order of their names.

    Raises:
        StorageError: the folder cannot be read.
    """
    try:
        files = sorted(p for p in folder.rglob("*") if p.is_file() and not p.is_symlink())
    except OSError as error:
        raise storage_error(error, folder, "read") from error
    parts = [_HEAD.pack(MAGIC, len(files))]
    for path in files:
        name, data = path.relative_to(folder).as_posix().encode(), read_bytes(path)
        parts += [_ENTRY.pack(len(name), len(data)), name, data]
    return b"".join(parts)


def read_parcel(parcel: bytes) -> dict[str, memoryview]:
    """The files of a parcel by name.

    Raises:
        FormatError: cut, forged, or no parcel at all.
    """
    view = memoryview(parcel)
    if len(view) < _HEAD.size or view[: len(MAGIC)] != MAGIC:
        raise FormatError("not a packed scene", remedy="send it again")
    _, count = _HEAD.unpack_from(view)
    files: dict[str, memoryview] = {}
    at = _HEAD.size
    for _ in range(count):  # a forged count ends at the first entry that is not there
        if at + _ENTRY.size > len(view):
            raise FormatError("the packed scene is cut short", offset=at, remedy="send it again")
        name_bytes, data_bytes = _ENTRY.unpack_from(view, at)
        at += _ENTRY.size
        if name_bytes > 4096 or at + name_bytes + data_bytes > len(view):
            raise FormatError("the packed scene is cut short", offset=at, remedy="send it again")
        try:
            name = str(view[at : at + name_bytes], "utf-8")
        except UnicodeDecodeError:
            raise FormatError("a name is not UTF-8", offset=at, remedy="send it again") from None
        at += name_bytes
        files[name] = view[at : at + data_bytes]
        at += data_bytes
    if at != len(view):
        raise FormatError("bytes are left over", offset=at, remedy="send it again")
    return files


def unpack_scene(parcel: bytes, content_hash: str, into: Path | None = None) -> Path:
    """Unpack a scene into the cache, once, and return its folder.

    Args:
        parcel: see `pack_folder`.
        content_hash: names the folder; what is in it is checked by who loads it.
        into: folder of all unpacked scenes; by default below the cache.

    Raises:
        FormatError: cut or forged.
        StorageError: a name climbs out of the folder, or the cache cannot be written.
    """
    root = into if into is not None else cache_dir() / "parcels"
    folder = safe_join(root, content_hash)
    if (folder / MARKER).is_file():
        return folder
    files = read_parcel(parcel)
    try:
        root.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory(prefix=TEMPORARY_PREFIX, dir=root) as scratch:
            whole = Path(scratch) / "scene"
            whole.mkdir()
            for name, data in files.items():
                path = safe_join(whole, name)
                path.parent.mkdir(parents=True, exist_ok=True)
                path.write_bytes(data)
            os.replace(whole, folder)  # fails where another worker was quicker, which is as good
    except OSError as error:
        if not (folder / MARKER).is_file():
            raise storage_error(error, folder, "unpack a scene") from error
    return folder
