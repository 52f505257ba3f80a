"""The bytes behind a glTF: the binary chunk of a .glb, files beside it, or text inside the JSON.

All are read range by range, so that a buffer is never in memory whole; base64 text is decoded only
where it is wanted.
"""

from __future__ import annotations

import binascii
import re
from contextlib import ExitStack
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Protocol
from urllib.parse import unquote

import msgspec

from gn0.errors import StorageError
from gn0.gaussians.cloud_source import REFETCH, CloudSource, decode_json
from gn0.storage import safe_join, storage_error

_DATA = b"data:"


class GltfBuffer(Protocol):
    """One buffer of a glTF."""

    @property
    def length(self) -> int:
        """Its bytes."""
        ...

    def read(self, offset: int, count: int) -> bytes:
        """Exactly `count` bytes from `offset`, both within `length`."""
        ...


@dataclass(frozen=True)
class FileBuffer:
    """Bytes of a file from `start` on."""

    source: CloudSource
    start: int
    length: int

    def read(self, offset: int, count: int) -> bytes:
        """Bytes of the file.

        Raises:
            FormatError: the file ends before.
        """
        return self.source.read(self.start + offset, count, "a buffer")


@dataclass(frozen=True)
class TextBuffer:
    """Base64 text within the JSON."""

    source: CloudSource
    text: memoryview
    length: int

    def read(self, offset: int, count: int) -> bytes:
        """Decoded bytes.

        Raises:
            FormatError: this is no base64.
        """
        first, last = offset // 3, -(-(offset + count) // 3)
        try:
            data = binascii.a2b_base64(self.text[first * 4 : last * 4], strict_mode=True)
        except binascii.Error as error:
            raise self.source.refuse(
                f"a data URI is not base64: {error}", field="buffers.uri", remedy=REFETCH
            ) from error
        skip = offset - first * 3
        if len(data) < skip + count:
            raise self.source.refuse("a data URI is cut off", field="buffers.uri", remedy=REFETCH)
        return data[skip : skip + count]


def open_buffer(
    source: CloudSource, uri: msgspec.Raw, length: int, stack: ExitStack
) -> tuple[GltfBuffer, int]:
    """The buffer that a URI names, and how many bytes of other files it adds.

    Args:
        source: the .gltf or .glb.
        uri: its URI as JSON, quotes and all.
        length: the bytes that it should have.
        stack: closes the files that are opened.

    Raises:
        FormatError: a remote or unsafe address, no base64, a missing file, or fewer bytes.
    """
    field = "buffers.uri"
    text = memoryview(uri)
    head = bytes(text[:1024])
    if not head.startswith(b'"'):
        raise source.refuse("the URI of a buffer is not a text", field=field)
    if head[1:].lower().startswith(_DATA):
        comma = head.find(b",")
        if comma < 0 or b";base64" not in head[:comma].lower():
            raise source.refuse("a data URI is not base64", field=field)
        body = text[comma + 1 : -1]
        if re.search(rb"\\", text):  # some writers escape the slashes of base64
            body = memoryview(bytes(body).replace(b"\\/", b"/"))
        padding = sum(body[-i - 1] == 0x3D for i in range(min(2, len(body))))
        held = len(body) // 4 * 3 - padding
        if held < length:
            raise source.refuse(
                f"a data URI holds {held} bytes, not the {length} promised", field=field
            )
        return TextBuffer(source, body, length), 0
    name = unquote(decode_json(text, str, source.file, "the URI of a buffer"))
    if "://" in name:
        raise source.refuse(
            f"buffer {name!r} is a web address, which is never fetched",
            field=field,
            remedy="download it beside the .gltf and write its file name there",
        )
    try:
        path = safe_join(source.file.parent, name)
    except StorageError as error:
        raise source.refuse(f"buffer {error.what}", field=field) from error
    return _open_file(source, path, name, length, stack)


def _open_file(
    source: CloudSource, path: Path, name: str, length: int, stack: ExitStack
) -> tuple[GltfBuffer, int]:
    if not path.is_file():
        raise source.refuse(
            f"buffer file {name!r} is missing",
            field="buffers.uri",
            remedy="copy the whole folder, not the .gltf alone",
        )
    try:
        size = path.stat().st_size
        stream = stack.enter_context(path.open("rb", buffering=0))
    except OSError as error:
        raise storage_error(error, path, "read") from error
    if size < length:
        raise source.refuse(
            f"buffer file {name!r} has {size} bytes, not the {length} promised",
            field="buffers.byteLength",
            remedy=REFETCH,
        )
    return FileBuffer(replace(source, stream=stream, file=path, size=size), 0, length), size
