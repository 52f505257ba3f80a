"""A file of bodies, motions or arrays on its way to a reader."""

from __future__ import annotations

import io
from pathlib import Path

from gn0.errors import FormatError
from gn0.gaussians.cloud_source import CloudSource

REWRITE = "write the file again"


class FileSource(CloudSource):
    """A file as the careful readers of the house take it, with our own advice."""

    def refuse(
        self, what: str, offset: int | None = 0, *, field: str = "", remedy: str = REWRITE
    ) -> FormatError:
        """An error about this file, to be raised."""
        if "splat" in remedy:  # what readers of splats advise
            remedy = REWRITE
        return super().refuse(what, offset, field=field, remedy=remedy)


def open_source(data: bytes, file: Path | str) -> FileSource:
    """The bytes of a file as the readers of the house take them."""
    return FileSource(io.BytesIO(data), Path(file), len(data))
