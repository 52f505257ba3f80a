"""Untrusted XML: no document types, no entities, bounded size, depth and element count."""

from __future__ import annotations

from pathlib import Path
from xml.etree.ElementTree import (
    Element,
    TreeBuilder,
)
from xml.parsers import expat

from gn0.errors import FormatError
from gn0.storage import read_bytes

SIZE_MAX = 128 * 2**20  # bytes
_DEPTH_MAX = 200
_ELEMENTS_MAX = 2_000_000


def load_xml(path: Path, limit: int = SIZE_MAX) -> Element:
    """The root element of an XML file.

    Raises:
        StorageError: missing, unreadable or larger than `limit` bytes.
        FormatError: not well-formed, holds a document type, or is nested absurdly deep.
    """
    return parse_xml(read_bytes(path, limit), path)


def parse_xml(data: bytes, path: Path) -> Element:
    """The root element of XML bytes; see `load_xml`."""
    builder = TreeBuilder()
    _guarded(data, path, builder)
    return builder.close()


def check_xml(data: bytes, path: Path) -> None:
    """Refuse what `parse_xml` would refuse, without building a tree."""
    _guarded(data, path, None)


def _guarded(data: bytes, path: Path, builder: TreeBuilder | None) -> None:
    parser = expat.ParserCreate()
    parser.buffer_text = True
    depth = elements = 0

    def refuse(what: str, remedy: str) -> FormatError:
        return FormatError(what, file=path, offset=max(parser.CurrentByteIndex, 0), remedy=remedy)

    def doctype(*_: object) -> None:
        raise refuse("a document type is not allowed here", "remove <!DOCTYPE …> and its entities")

    def start(tag: str, attributes: dict[str, str]) -> None:
        nonlocal depth, elements
        depth, elements = depth + 1, elements + 1
        if depth > _DEPTH_MAX or elements > _ELEMENTS_MAX:
            raise refuse(
                f"more than {_DEPTH_MAX} levels or {_ELEMENTS_MAX} elements",
                "this is not a scene description",
            )
        if builder is not None:
            builder.start(tag, attributes)

    def end(tag: str) -> None:
        nonlocal depth
        depth -= 1
        if builder is not None:
            builder.end(tag)

    parser.StartDoctypeDeclHandler = doctype
    parser.EntityDeclHandler = doctype
    parser.StartElementHandler = start
    parser.EndElementHandler = end
    if builder is not None:
        parser.CharacterDataHandler = builder.data
    try:
        parser.Parse(data, True)
    except (expat.ExpatError, ValueError, LookupError) as error:
        raise refuse(f"not well-formed XML: {error}", "restore the file") from None
