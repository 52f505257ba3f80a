"""Files of one episode: put down quickly, made safe together.

A file that the journal does not name yet may be lost to a power cut, it is written again then. So
pictures are renamed into place at once and synced when their episode is whole: one wait for the
disk instead of one a picture.
"""

from __future__ import annotations

import os
from pathlib import Path

from gn0.errors import StorageError
from gn0.leftovers import let_go, make_held_file
from gn0.storage import storage_error


class Shelf:
    """Keeps in mind what has been written and is not safe yet."""

    def __init__(self) -> None:
        self._loose: list[Path] = []
        self._folders: set[Path] = set()

    def put(self, path: Path, data: bytes) -> None:
        """Write a file, whole or not at all; safe after the next `sync`.

        Raises:
            StorageError: it cannot be written.
        """
        temporary = ""
        hold: int | None = None
        try:
            if path.parent not in self._folders:
                path.parent.mkdir(parents=True, exist_ok=True)
            descriptor, temporary, hold = make_held_file(path.parent)
            with os.fdopen(descriptor, "wb") as stream:
                stream.write(data)
            os.chmod(temporary, 0o644)
            os.replace(temporary, path)
            temporary = ""
        except OSError as error:
            raise storage_error(error, path, "write") from error
        finally:
            if temporary:
                Path(temporary).unlink(missing_ok=True)
            let_go(hold)
        self._loose.append(path)
        self._folders.add(path.parent)

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


def _lost(error: OSError, path: Path) -> StorageError:
    return storage_error(error, path, "make safe")
