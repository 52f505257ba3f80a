"""A folder while it is written: one writer at a time, nothing half-written left behind."""

from __future__ import annotations

import contextlib
import os
import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import IO, Any

from gn0.errors import ConfigError, Gn0Error, StorageError
from gn0.leftovers import TEMPORARY_PREFIX, is_held_name, remove_dead
from gn0.storage import Journal, check_contained, plain_path, storage_error

LOCK = ".lock"
PROBE = ".gn0-probe"  # what `check_room` writes, and takes away
_PROBE_BYTES = 1 << 20


@contextlib.contextmanager
def lock_folder(
    folder: Path,
    *,
    refuse: type[Gn0Error] = StorageError,
    writer: str = "run",
    name: str = LOCK,
) -> Iterator[None]:
    """One writer at a time in a folder; the lock goes with the process, however it ends.

    Args:
        folder: it must be there.
        refuse: the error that says that somebody else is writing.
        writer: what that somebody is, in words.
        name: name of the lock's file, in the folder.

    Raises:
        Gn0Error: `refuse`, where somebody else is writing.
        StorageError: the folder cannot be written.
    """
    try:
        import fcntl
    except ImportError:  # no such lock on this system
        yield
        return
    check_contained(folder)
    path = folder / name
    try:
        stream: IO[bytes] = open(path, "ab")  # noqa: SIM115
    except OSError as error:
        raise storage_error(error, path, "lock the folder") from error
    with stream:
        try:
            fcntl.flock(stream, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError:
            raise refuse(
                f"another {writer} is writing to this folder",
                where=folder,
                remedy="wait for it, or choose another --out",
            ) from None
        yield


def sweep_folder(folder: Path) -> None:
    """Remove what a killed writer left half-written; call it with the folder locked.

    What a living process holds stays: a worker may outlive the parent that was killed.
    """
    for path in sorted(folder.rglob(f"{TEMPORARY_PREFIX}*")):
        if is_held_name(str(path)):
            remove_dead(str(path))
            continue
        with contextlib.suppress(OSError):
            shutil.rmtree(path) if path.is_dir() else path.unlink()


def holds_leftovers_only(folder: Path) -> bool:
    """Whether a folder holds nothing but what a killed writer leaves before its first file."""
    return folder.is_dir() and all(
        path.name == LOCK or path.name.startswith(TEMPORARY_PREFIX) for path in folder.iterdir()
    )


def forget_folder(folder: Path | str, marker: str) -> None:
    """Empty a folder that an earlier job of one kind filled; its writer must be gone.

    Args:
        folder: may be absent or empty.
        marker: the file, in the folder, by which that kind is known.

    Raises:
        StorageError: it holds something else, somebody is writing there, or the system refuses.
    """
    folder = plain_path(folder)
    if not folder.is_dir() or not any(folder.iterdir()) or holds_leftovers_only(folder):
        return
    if not (folder / marker).is_file():
        raise StorageError(
            f"the folder holds something else: it has no {marker}, so it is not emptied",
            where=folder,
            remedy="choose another --out",
        )
    with lock_folder(folder):
        # the marker goes last: a folder that is half emptied can still be told
        for path in sorted(folder.iterdir(), key=lambda path: path.name == marker):
            if path.name == LOCK:
                continue
            try:
                shutil.rmtree(path) if path.is_dir() and not path.is_symlink() else path.unlink()
            except OSError as error:
                raise storage_error(error, path, "remove") from error


def check_folder(folder: Path) -> None:
    """Make sure that an output folder is not a file.

    Raises:
        StorageError: it is one.
    """
    if folder.exists() and not folder.is_dir():
        raise StorageError(
            "is a file, not a folder",
            where=folder,
            remedy="choose another --out, or remove the file",
        )


def check_room(out: Path, needed: int) -> None:
    """Make a folder and prove that it can be written and has room, before any long work.

    Args:
        out: the folder.
        needed: bytes that the work may write.

    Raises:
        StorageError: unwritable, or too little space.
    """
    check_contained(out)
    probe = out / PROBE
    try:
        out.mkdir(parents=True, exist_ok=True)
        try:
            with open(probe, "wb") as stream:
                stream.write(bytes(_PROBE_BYTES))
                stream.flush()
                os.fsync(stream.fileno())
        finally:
            with contextlib.suppress(OSError):
                probe.unlink()
        free = shutil.disk_usage(out).free
    except OSError as error:
        raise storage_error(error, out, "write results") from error
    if free < needed:
        raise storage_error(
            OSError(28, f"{free / 1e6:.0f} MB free, {needed / 1e6:.0f} MB may be needed"),
            out,
            "write results",
        )


def read_begun(
    folder: Path, journal: str, kind: str, digest: str, settings: str
) -> list[dict[str, Any]]:
    """What earlier runs noted in a folder that is made bit by bit, after its first line.

    Args:
        folder: may be absent or empty.
        journal: its journal, whose first line tells what is made: `{kind: digest}`.
        kind: what is made there, in a word.
        digest: of all that decides it.
        settings: what has to be the same again, in words.

    Raises:
        StorageError: the folder holds something else, is a file, or cannot be read.
        ConfigError: another of its kind was begun there.
    """
    check_folder(folder)
    records = Journal(folder / journal).read()
    if not records:
        if folder.exists() and any(p.name not in (journal, LOCK) for p in folder.iterdir()):
            raise StorageError(
                "the folder holds something else", where=folder, remedy="choose another --out"
            )
        return []
    if records[0].get(kind) != digest:
        raise ConfigError(
            f"the folder holds another {kind}",
            where=folder,
            remedy=f"choose another --out, or give the {settings} that it was begun with",
        )
    return [dict(record) for record in records[1:]]
