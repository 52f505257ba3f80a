"""Which source made something: the package's version and a digest of the files that decide it."""

from __future__ import annotations

import hashlib
from functools import cache
from pathlib import Path

import gn0

_SOURCES = {".py", ".cu", ".cuh"}


@cache
def source_version(deciding: tuple[str, ...]) -> str:
    """The package's version and a digest of some of its source.

    Args:
        deciding: files and folders of the package, relative to it.
    """
    root = Path(gn0.__file__).parent
    digest = hashlib.blake2b(digest_size=6)
    for name in deciding:
        path = root / name
        found = [file for file in path.rglob("*") if file.suffix in _SOURCES]
        for file in sorted(found) if path.is_dir() else [path]:
            digest.update(str(file.relative_to(root)).encode() + b"\0" + file.read_bytes() + b"\0")
    return f"{gn0.__version__}+{digest.hexdigest()}"
