"""Files of one episode: written quickly, made durable together.

A file that the journal does not name yet may be lost to a power cut, it is written again then. So
pictures are renamed into place at once and synced when their episode is whole: one wait for the
disk instead of one a picture.

Missions of one path show the same frames. A file with the bytes of an earlier one becomes another
name of it (a hard link) where the file system knows such, so that equal frames are written once.
"""

from __future__ import annotations

import contextlib
import hashlib
import os
from collections import OrderedDict
from pathlib import Path

from gn0.errors import StorageError
from gn0.leftovers import TEMPORARY_PREFIX, let_go, make_held_file
from gn0.storage import storage_error

REMEMBERED = 65_536  # files: missions of one path follow one another in a dataset
SMALL = 512  # bytes: smaller files cost about what a link costs


class Shelf:
    """Keeps in mind what has been written and is not safe yet, and what bytes are there already."""

    def __init__(self) -> None:
        self._loose: list[Path] = []
        self._folders: set[Path] = set()
        self._known: OrderedDict[bytes, Path] = OrderedDict()

    def put(self, path: Path, data: bytes) -> None:
        """Write a file, whole or not at all; safe after the next `sync`.

        Raises:
            StorageError: it cannot be written.
        """
        digest = hashlib.blake2b(data, digest_size=16).digest() if len(data) >= SMALL else b""
        try:
            if path.parent not in self._folders:
                path.parent.mkdir(parents=True, exist_ok=True)
            if not self._link(digest, len(data), path):
                _write(path, data)
                self._remember(digest, path)
        except OSError as error:
            raise storage_error(error, path, "write") from error
        self._loose.append(path)
        self._folders.add(path.parent)

    def adopt(self, path: Path) -> None:
        """Take a file that was written elsewhere: it is made safe, and becomes a link to its twin.

        Raises:
            StorageError: it cannot be read.
        """
        try:
            with open(path, "rb") as stream:
                digest = hashlib.file_digest(stream, lambda: hashlib.blake2b(digest_size=16))
            if not self._link(digest.digest(), path.stat().st_size, path):
                self._remember(digest.digest(), path)
        except OSError as error:
            raise storage_error(error, path, "read") from error
        self._loose.append(path)
        self._folders.add(path.parent)

    def _remember(self, digest: bytes, path: Path) -> None:
        if digest:
            self._known[digest] = path
            self._known.move_to_end(digest)
            if len(self._known) > REMEMBERED:
                self._known.popitem(last=False)

    def _link(self, digest: bytes, size: int, path: Path) -> bool:
        """Make `path` another name of the file with these bytes, if there is one."""
        twin = self._known.get(digest)
        if twin is None or twin == path:
            return False
        temporary = path.with_name(f"{TEMPORARY_PREFIX}{path.name}")
        try:
            if twin.stat().st_size != size:  # somebody changed it since
                return False
            temporary.unlink(missing_ok=True)
            os.link(twin, temporary)
            os.replace(temporary, path)
        except OSError:  # no hard links here, or too many of one file
            return False
        finally:
            # a rename onto another name of the same file does nothing
            with contextlib.suppress(OSError):
                temporary.unlink(missing_ok=True)
        self._known.move_to_end(digest)
        return True

    def sync(self) -> None:
        """Wait until the disk has everything that was put.

        Raises:
            StorageError: the system cannot say that it has.
        """
        for path in (*self._loose, *sorted(self._folders)):
            try:
                descriptor = os.open(path, _SYNCABLE)
                try:
                    os.fsync(descriptor)
                finally:
                    os.close(descriptor)
            except OSError as error:
                if path in self._folders and not isinstance(error, FileNotFoundError):
                    continue  # not every file system lets a folder be synced
                raise _lost(error, path) from error
        self._loose.clear()
        self._folders.clear()


# Windows syncs only what is open for writing; folders cannot be opened for that elsewhere
_SYNCABLE = os.O_RDWR if os.name == "nt" else os.O_RDONLY


def _write(path: Path, data: bytes) -> None:
    descriptor, temporary, hold = make_held_file(path.parent)
    try:
        with os.fdopen(descriptor, "wb") as stream:
            stream.write(data)
        os.chmod(temporary, 0o644)
        os.replace(temporary, path)
        temporary = ""
    finally:
        if temporary:
            Path(temporary).unlink(missing_ok=True)
        let_go(hold)


def _lost(error: OSError, path: Path) -> StorageError:
    return storage_error(error, path, "make safe")
