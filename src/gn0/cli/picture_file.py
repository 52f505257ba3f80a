"""Pictures as files of the kind that their name says."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from gn0.errors import ConfigError

if TYPE_CHECKING:
    from PIL import Image

_KINDS = {".png": "PNG", ".jpg": "JPEG", ".jpeg": "JPEG"}


def is_picture(out: str) -> bool:
    """Whether a file's name asks for a picture."""
    return Path(out).suffix.lower() in _KINDS


def check_picture(out: str) -> str:
    """The kind of picture that a file's name asks for; asked before any work.

    Raises:
        ConfigError: the name ends with neither .png nor .jpg.
    """
    kind = _KINDS.get(Path(out).suffix.lower())
    if kind is None:
        raise ConfigError(
            f"cannot write {out[:80]!r}", where="--out", remedy="end it with .png or .jpg"
        )
    return kind


def write_picture(out: str, picture: Image.Image) -> None:
    """Write a picture, whole or not at all.

    Raises:
        ConfigError: see `check_picture`.
        StorageError: it cannot be written.
    """
    from gn0.storage import write_atomic

    kind = check_picture(out)
    options = {"quality": 88} if kind == "JPEG" else {"optimize": True}
    write_atomic(out, lambda stream: picture.save(stream, kind, **options))
