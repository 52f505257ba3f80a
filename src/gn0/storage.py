"""Files that can be trusted: atomic writes, journals, hashes, caches, and paths that stay inside.

Every write is a temporary file in the same folder, fsync, rename, fsync of the folder; what a dead
process left half-written the next writer there removes (`gn0.leftovers`). A journal
line counts only when its checksum is right, so what a journal names survived a power cut.
"""

from __future__ import annotations

import contextlib
import hashlib
import json
import os
import re
import shutil
import tempfile
import unicodedata
import zlib
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from typing import IO, Any

import numpy as np
from numpy.typing import NDArray

from gn0.errors import StorageError, brief
from gn0.leftovers import TEMPORARY_PREFIX, let_go, make_held_file, make_held_folder


def cache_dir() -> Path:
    """GN0's cache folder: `$GN0_CACHE`, else `$XDG_CACHE_HOME/gn0`, else `~/.cache/gn0`."""
    explicit = os.environ.get("GN0_CACHE")
    if explicit:
        return Path(explicit)
    base = os.environ.get("XDG_CACHE_HOME")
    return (Path(base) if base else Path.home() / ".cache") / "gn0"


def storage_error(error: OSError, path: Path | str, doing: str) -> StorageError:
    """A `StorageError` that says in plain words why the system refused."""
    import errno

    remedies = {
        errno.ENOSPC: "the disk is full: free some space or choose another --out",
        errno.EDQUOT: "the disk quota is used up: free some space or choose another --out",
        errno.EACCES: "no permission: choose a folder you may use",
        errno.EPERM: "no permission: choose a folder you may use",
        errno.EROFS: "the file system is read-only: choose another --out",
        errno.ENOENT: "check that the path exists",
        errno.ENOTDIR: "part of the path is a file, not a folder",
        errno.EISDIR: "this is a folder, not a file",
        errno.EEXIST: "a file is in the way: choose another --out",
        errno.EIO: "the disk itself failed: check the disk, and use another --out meanwhile",
        errno.ENAMETOOLONG: "the name is too long for this file system",
    }
    reason = error.strerror or str(error)
    return StorageError(
        f"cannot {doing}: {reason}",
        where=path,
        remedy=remedies.get(error.errno or 0, "see the system's message"),
    )


def plain_path(path: Path | str) -> Path:
    """A path as somebody hands it in, of characters that a file system has.

    The system's own functions answer others with a bare ValueError, or say that nothing is there.

    Raises:
        StorageError: it holds a NUL, at which names end, or half of a character.
    """
    text = str(path)
    try:
        whole = b"\0" not in os.fsencode(text)
    except UnicodeEncodeError:
        whole = False
    if not whole:
        raise StorageError(
            "path holds a NUL or is not proper Unicode",
            where=brief(text),
            remedy="give a path of printable characters",
        )
    return Path(path)


def _fsync_dir(folder: Path) -> None:
    with contextlib.suppress(OSError):  # not every file system lets a folder be synced
        fd = os.open(folder, os.O_RDONLY)
        try:
            os.fsync(fd)
        finally:
            os.close(fd)


def write_atomic(path: Path | str, write: Callable[[IO[bytes]], None]) -> None:
    """Write a file through `write(stream)` so that it is whole or absent, never half.

    Raises:
        StorageError: the folder is missing, unwritable or full.
    """
    path = plain_path(path)
    temporary: str | None = None
    hold: int | None = None
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        fd, temporary, hold = make_held_file(path.parent)
        with os.fdopen(fd, "wb") as stream:
            write(stream)
            stream.flush()
            os.fsync(stream.fileno())
        os.chmod(temporary, 0o644)
        os.replace(temporary, path)
        temporary = None
        _fsync_dir(path.parent)
    except OSError as error:
        raise storage_error(error, path, "write") from error
    finally:
        if temporary is not None:
            with contextlib.suppress(OSError):
                os.unlink(temporary)
        let_go(hold)


def write_bytes(path: Path | str, data: bytes) -> None:
    """Atomically write bytes."""
    write_atomic(path, lambda stream: (stream.write(data), None)[1])


def write_text(path: Path | str, text: str) -> None:
    """Atomically write UTF-8 text with Unix line ends."""
    write_bytes(path, text.encode("utf-8"))


def write_json(path: Path | str, value: Any) -> None:
    """Atomically write JSON: sorted keys, two-space indent, no NaN, trailing newline."""
    text = json.dumps(value, indent=2, sort_keys=True, ensure_ascii=False, allow_nan=False)
    write_text(path, text + "\n")


def read_bytes(path: Path | str, limit: int | None = None) -> bytes:
    """Read a whole file, refusing one larger than `limit` bytes before reading it.

    Raises:
        StorageError: missing, unreadable, or larger than `limit`.
    """
    path = plain_path(path)
    try:
        size = path.stat().st_size
        if limit is not None and size > limit:
            raise StorageError(
                f"file has {size} bytes, more than the {limit} allowed here",
                where=path,
                remedy="check that this is the right file",
            )
        return path.read_bytes()
    except OSError as error:
        raise storage_error(error, path, "read") from error


def check_writable(path: Path | str) -> None:
    """Make sure, before any work, that a file or folder can be written at `path`.

    Raises:
        StorageError: the system refuses; with its reason.
    """
    path = plain_path(path)
    try:
        folder = path.absolute().parent
        while not folder.exists():
            folder = folder.parent
        os.rmdir(tempfile.mkdtemp(prefix=TEMPORARY_PREFIX, dir=folder))
    except OSError as error:
        raise storage_error(error, path, "write") from error


def check_replaceable(path: Path | str, *, overwrite: bool, marker: str) -> None:
    """Make sure that the folder `path` can be written and destroys but an earlier one of its kind.

    Raises:
        StorageError: it is a file; it is not empty and `overwrite` is off, or it has no file named
            `marker`; or the system refuses to write there.
    """
    path = plain_path(path)
    check_writable(path)
    try:
        free = not path.exists() or (path.is_dir() and not any(path.iterdir()))
    except OSError as error:
        raise storage_error(error, path, "read") from error
    if free:
        return
    if not path.is_dir():
        raise StorageError(
            "is a file, not a folder", where=path, remedy="choose another --out, or remove the file"
        )
    if not overwrite:
        raise StorageError(
            "the output folder exists and is not empty",
            where=path,
            remedy="choose another --out, or pass --overwrite",
        )
    if not (path / marker).is_file():
        raise StorageError(
            f"the output folder holds something else: it has no {marker}, so it is not replaced",
            where=path,
            remedy="choose another --out",
        )


@contextlib.contextmanager
def folder_atomic(path: Path | str, *, overwrite: bool = False, marker: str = "") -> Iterator[Path]:
    """Fill a temporary folder that becomes `path` only when the block ends well.

    With `overwrite` an earlier folder is replaced, if it has a file named `marker`.

    Raises:
        StorageError: see `check_replaceable`; or `path` cannot be written.
    """
    path = plain_path(path)
    temporary: Path | None = None
    holds: list[int | None] = []

    def make() -> Path:
        made, hold = make_held_folder(path.parent)
        holds.append(hold)
        return Path(made)

    try:
        check_replaceable(path, overwrite=overwrite, marker=marker)
        path.parent.mkdir(parents=True, exist_ok=True)
        temporary = make()
        os.chmod(temporary, 0o755)  # noqa: S103 (a scene is meant to be read)
        yield temporary
        old: Path | None = None
        if path.exists():
            old = make()
            os.replace(path, old / "old")
        try:
            os.replace(temporary, path)
        except OSError:
            if old is not None:
                os.replace(old / "old", path)
                shutil.rmtree(old, ignore_errors=True)
            raise
        temporary = None
        _fsync_dir(path.parent)
        if old is not None:
            shutil.rmtree(old, ignore_errors=True)
    except OSError as error:
        raise storage_error(error, path, "write") from error
    finally:
        if temporary is not None:
            shutil.rmtree(temporary, ignore_errors=True)
        for hold in holds:
            let_go(hold)


# names that Windows gives to devices, whatever their extension
_DEVICES = frozenset(
    ["con", "prn", "aux", "nul", "conin$", "conout$", "clock$"]
    + [f"{port}{digit}" for port in ("com", "lpt") for digit in "0123456789¹²³"]
)
_NAME_BYTES, _PATH_BYTES = 255, 4096  # what file systems take


def safe_join(root: Path | str, relative: str) -> Path:
    """Join a path from untrusted data to `root`, refusing whatever would leave `root`.

    The rules are those of all systems at once, so that what is safe here is safe elsewhere:
    refused are absolute paths, `..` (also percent-encoded, in full-width or other letters that
    stand for it, or padded with dots and blanks), backslashes, drive letters and other colons,
    device names, control characters, names too long, symbolic links that lead outside, and pipes
    and devices.

    Raises:
        StorageError: the path climbs out of its folder, or is no plain relative path.
    """
    root = plain_path(root)
    shown = relative if len(relative) <= 200 else f"{relative[:199]}…"
    why = find_path_fault(relative)
    if why:
        raise StorageError(
            f"path {shown!r} {why}", where=root, remedy="use a plain name inside the folder"
        )
    joined = root / relative
    try:
        inside = joined.resolve().is_relative_to(root.resolve())
        why = "" if inside else "leads out of its folder through a link"
        if inside and joined.exists() and not (joined.is_file() or joined.is_dir()):
            why = "is not a plain file"  # reading a pipe may never end
    except (OSError, RuntimeError) as error:
        why = f"cannot be resolved: {error}"
    if why:
        raise StorageError(
            f"path {shown!r} {why}", where=root, remedy="use a plain name inside the folder"
        )
    return joined


def check_contained(folder: Path | str) -> None:
    """Refuse a folder, perhaps a stranger's, with a way out of it: a link that leads elsewhere.

    Pipes, sockets and devices are refused as well: reading one may never end.

    Raises:
        StorageError: it holds such a thing; names it.
    """
    root = plain_path(folder)
    waiting = [root]
    try:
        real = root.resolve()
        while waiting:
            with os.scandir(waiting.pop()) as entries:
                for entry in entries:
                    if entry.is_symlink():
                        if not Path(entry.path).resolve().is_relative_to(real):
                            raise StorageError(
                                "is a link that leads out of its folder",
                                where=entry.path,
                                remedy="put what it points to in its place, or remove it",
                            )
                    elif entry.is_dir():
                        waiting.append(Path(entry.path))
                    elif not entry.is_file():
                        raise StorageError(
                            "is not a plain file",
                            where=entry.path,
                            remedy=f"move it out of {root}, or give another folder",
                        )
    except (FileNotFoundError, NotADirectoryError):
        return  # whoever reads it says so in better words, and names may come and go
    except (OSError, RuntimeError) as error:
        raise StorageError(f"cannot be read: {error}", where=root, remedy="check it") from error


def find_path_fault(relative: str) -> str:
    """Why a relative path from data is refused wherever it leads; "" when it is not."""
    if not relative or "\0" in relative:
        return "is empty or holds a NUL"
    try:
        size = len(relative.encode())
    except UnicodeEncodeError:
        return "is not proper Unicode"
    # what compatibility forms stand for: full-width dots and slashes, one-dot leaders
    plain = unicodedata.normalize("NFKC", relative).translate(_SLASHES)
    for text in (relative, plain):
        if any(unicodedata.category(c) in ("Cc", "Cf", "Zl", "Zp") for c in text):
            return "holds characters that are not seen"
        if re.search("%(25)*(2e|2f|5c|00)", text.lower()):
            return "is percent-encoded"
        if "\\" in text or ":" in text:
            return "is not a plain relative path"
        parts = text.split("/")
        if text.startswith(("/", "~")) or any(
            set(part) <= {".", " "} and part not in ("", ".") for part in parts
        ):
            return "climbs out of its folder"
        if any(part.split(".")[0].rstrip(" ").lower() in _DEVICES for part in parts):
            return "names a device of Windows"
    if size > _PATH_BYTES or any(len(part.encode()) > _NAME_BYTES for part in relative.split("/")):
        return "is too long"
    return ""


# letters that look like a slash; NFKC leaves them alone
_SLASHES = str.maketrans(dict.fromkeys("\u2044\u2215\u29f8\u27cb", "/") | {"\u29f5": "\\"})


_STRIDE = 16  # rows between the places that a `RowDigest` can go on from


def content_hash(*arrays: NDArray[Any] | str | bytes | int | float) -> str:
    """A hex digest of decoded values (shape, dtype and bytes), never of file bytes."""
    digest = hashlib.blake2b(digest_size=16)
    for value in arrays:
        if isinstance(value, np.ndarray):
            data = np.asarray(value, order="C")
            little = data.astype(data.dtype.newbyteorder("<"), copy=False)
            digest.update(array_head(little.dtype, little.shape))
            digest.update(little.reshape(-1).view(np.uint8).data)
        else:
            raw = value if isinstance(value, bytes) else repr(value).encode()
            digest.update(b"v" + len(raw).to_bytes(8, "little") + raw)
    return digest.hexdigest()


def hash_file(path: Path | str) -> str:
    """A hex digest of a file's bytes.

    Raises:
        StorageError: it cannot be read.
    """
    path = plain_path(path)
    try:
        with path.open("rb") as file:
            return hashlib.file_digest(file, lambda: hashlib.blake2b(digest_size=16)).hexdigest()
    except OSError as error:
        raise storage_error(error, path, "read") from error


def array_head(dtype: np.dtype[Any], shape: tuple[int, ...]) -> bytes:
    """What `content_hash` says of an array before its bytes; `dtype` is little-endian."""
    head = f"a{dtype.str}{shape}".encode()
    return len(head).to_bytes(4, "little") + head


class RowDigest:
    """`content_hash` of uint8 arrays of one shape that begin with rows of the one before.

    It goes on from the last row that both have, so it costs the rows below.
    """

    def __init__(self) -> None:
        self._shape: tuple[int, ...] = ()
        self._states: list[Any] = []  # after 0, 1, … times `_STRIDE` rows

    def of(self, array: NDArray[np.uint8], same: int) -> str:
        """The hash of an array whose first `same` rows are those of the array before."""
        data = np.ascontiguousarray(array, np.uint8)
        if data.shape != self._shape:
            self._shape = data.shape
            self._states = [hashlib.blake2b(array_head(data.dtype, data.shape), digest_size=16)]
        kept = min(max(same, 0) // _STRIDE, len(self._states) - 1)
        del self._states[kept + 1 :]
        digest = self._states[kept].copy()
        for row in range(kept * _STRIDE, len(data), _STRIDE):
            digest.update(data[row : row + _STRIDE].data)
            if row + _STRIDE <= len(data):
                self._states.append(digest.copy())
        found: str = digest.hexdigest()
        return found


def journal_line(record: Any) -> bytes:
    """A record as the line that a journal holds: JSON, its checksum, a line feed."""
    body = json.dumps(record, sort_keys=True, allow_nan=False).encode()
    return body + b"\t" + f"{zlib.crc32(body):08x}".encode() + b"\n"


def _line_body(line: bytes) -> bytes | None:
    """The JSON of a journal's line; None when the line is cut or damaged."""
    body, _, check = line.rpartition(b"\t")
    return body if body and check == f"{zlib.crc32(body):08x}\n".encode() else None


class Journal:
    """An append-only file of JSON lines, each with its own checksum and synced to disk.

    A line that was cut by a crash is ignored on reading and cut away before the next append.
    """

    def __init__(self, path: Path | str) -> None:
        self.path = plain_path(path)
        self._stream: IO[bytes] | None = None

    def read(self) -> list[Any]:
        """All whole records, in order.

        Raises:
            StorageError: the journal cannot be read.
        """
        return [record for _, record in self.scan()]

    def scan(self) -> Iterator[tuple[int, Any]]:
        """All whole records one by one, in order, each with the byte at which its line begins.

        Raises:
            StorageError: the journal cannot be read.
        """
        return ((place, json.loads(body)) for place, body, _ in self._lines())

    def read_bodies(self, places: Iterable[int]) -> Iterator[bytes]:
        """The JSON of the records whose lines begin at these bytes, in the order given.

        Raises:
            StorageError: the journal cannot be read, or no whole line begins there.
        """
        try:
            with open(self.path, "rb") as stream:
                for place in places:
                    stream.seek(place)
                    body = _line_body(stream.readline())
                    if body is None:
                        raise StorageError(
                            f"the line at byte {place} was changed after it was written",
                            where=self.path,
                            remedy="leave the journal alone while something writes to it",
                        )
                    yield body
        except OSError as error:
            raise storage_error(error, self.path, "read") from error

    def _lines(self) -> Iterator[tuple[int, bytes, int]]:
        """Where each whole line begins, its JSON, and where it ends."""
        try:
            if not self.path.exists():
                return
            end = 0
            with open(self.path, "rb") as stream:
                for line in stream:
                    body = _line_body(line)
                    if body is None:
                        return
                    begin, end = end, end + len(line)
                    yield begin, body, end
        except OSError as error:
            raise storage_error(error, self.path, "read") from error

    def append(self, record: Any) -> int:
        """Append one record, wait until the disk has it, and tell at which byte its line begins.

        Raises:
            StorageError: the journal cannot be written.
        """
        try:
            if self._stream is None:
                self.path.parent.mkdir(parents=True, exist_ok=True)
                whole = 0
                for _, _, end in self._lines():
                    whole = end
                self._stream = open(self.path, "ab")  # noqa: SIM115
                if self._stream.tell() != whole:
                    self._stream.truncate(whole)
                    self._stream.seek(whole)
            place = self._stream.tell()
            self._stream.write(journal_line(record))
            self._stream.flush()
            os.fsync(self._stream.fileno())
        except OSError as error:
            raise storage_error(error, self.path, "append to the journal") from error
        return place

    def close(self) -> None:
        """Close the file; a later append opens it again."""
        if self._stream is not None:
            self._stream.close()
            self._stream = None

    def __enter__(self) -> Journal:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()
