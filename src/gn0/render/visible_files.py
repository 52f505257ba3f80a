"""Visible sets on disk: one small file per cell, checked when read, with a limit on bytes.

A damaged file is found again by looking; a cache that cannot be written costs a warning.
"""

from __future__ import annotations

import contextlib
import hashlib
import json
import logging
import os
import shutil
import zlib
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from gn0.errors import StorageError
from gn0.storage import cache_dir, read_bytes, write_bytes

_MAGIC = b"GN0SET1\n"
_FILE_LIMIT = 2**28  # bytes
_SUFFIX = ".set"
_SWEEP_EVERY = 64  # files written between looks at the size of the cache
_log = logging.getLogger(__name__)


class VisibleFiles:
    """The sets of one scene in the cache folder.

    Args:
        key: digest of all that the sets depend on.
        splats: size of the cloud.
        limit: bytes that the sets of all scenes may take; the oldest go first.
    """

    def __init__(self, key: str, splats: int, limit: int) -> None:
        self.folder = cache_dir() / "visible" / key
        self._splats = splats
        self._limit = limit
        self._written = 0

    @property
    def nbytes(self) -> int:
        """Bytes of this scene's sets on disk."""
        return sum(path.stat().st_size for path in self.folder.glob(f"*{_SUFFIX}"))

    def clear(self) -> None:
        """Remove this scene's sets."""
        shutil.rmtree(self.folder, ignore_errors=True)

    def path(self, cell: tuple[int, int]) -> Path:
        """The file of a cell (column, row)."""
        return self.folder / f"{cell[0]}_{cell[1]}{_SUFFIX}"

    def save(
        self, cell: tuple[int, int], marks: NDArray[np.uint8], *, strict: bool = False
    ) -> None:
        """Keep the set of a cell: `marks` uint8 [N], 1 for its splats.

        Raises:
            StorageError: with `strict`, if the cache cannot be written.
        """
        self.save_bits(cell, np.packbits(marks), strict=strict)

    def save_bits(
        self, cell: tuple[int, int], bits: NDArray[np.uint8], *, strict: bool = False
    ) -> None:
        """Keep the set of a cell: `bits` uint8 [⌈N/8⌉], packed as `np.packbits` does.

        Raises:
            StorageError: with `strict`, if the cache cannot be written.
        """
        body = zlib.compress(bits.tobytes(), 1)
        digest = hashlib.blake2b(body, digest_size=16).hexdigest()
        head = {"cell": cell, "splats": self._splats, "digest": digest}
        try:
            write_bytes(self.path(cell), _MAGIC + json.dumps(head).encode() + b"\n" + body)
        except StorageError as error:
            if strict:
                raise
            _log.warning("the visible set is not cached: %s", error)
            return
        if self._written % _SWEEP_EVERY == 0:
            self._sweep()
        self._written += 1

    def load(self, cell: tuple[int, int]) -> NDArray[np.uint8] | None:
        """The set of a cell as uint8 [N]; None when it is absent or damaged."""
        bits = self.load_bits(cell)
        return None if bits is None else np.unpackbits(bits, count=self._splats)

    def load_bits(self, cell: tuple[int, int]) -> NDArray[np.uint8] | None:
        """The set of a cell as packed bits [⌈N/8⌉]; None when it is absent or damaged."""
        path = self.path(cell)
        if not path.exists():
            return None
        try:
            magic, head, body = read_bytes(path, _FILE_LIMIT).split(b"\n", 2)
            fields = json.loads(head)
            digest = hashlib.blake2b(body, digest_size=16).hexdigest()
            if (
                magic + b"\n" != _MAGIC
                or fields["digest"] != digest
                or fields["splats"] != self._splats
                or fields["cell"] != [*cell]
            ):
                raise ValueError("digest, cell or size differs")
            size = -(-self._splats // 8)
            bits = zlib.decompressobj().decompress(body, size + 1)
            if len(bits) != size:
                raise ValueError(f"{len(bits)} bytes instead of {size}")
            return np.frombuffer(bits, np.uint8)
        except (StorageError, ValueError, KeyError, TypeError, zlib.error) as error:
            _log.warning("%s: damaged visible set is computed again: %s", path, error)
            return None

    def _sweep(self) -> None:
        """Remove the oldest sets of all scenes until the cache is within its limit."""
        with contextlib.suppress(OSError):
            files = []
            for path in self.folder.parent.glob(f"*/*{_SUFFIX}"):
                status = path.stat()
                files.append((status.st_mtime, str(path), status.st_size))
            total = sum(size for *_, size in files)
            for _, name, size in sorted(files):
                if total <= self._limit:
                    break
                with contextlib.suppress(OSError):
                    os.unlink(name)
                total -= size
