"""Temporary files and folders that say whether their writer still lives.

Each is held by a lock of the system (flock) as long as it is written; the lock goes with the
process, however it ends, and no later process of the same number can be mistaken for it. The next
writer in a folder removes what nobody holds. Where a file system knows no such locks, and on
Windows, nothing is removed.
"""

from __future__ import annotations

import contextlib
import hashlib
import os
import platform
import shutil
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

TEMPORARY_PREFIX = ".gn0-tmp-"
# of this machine: some network file systems keep the locks of each machine to itself
_HERE = hashlib.blake2b(platform.node().encode(), digest_size=4).hexdigest()
HELD_PREFIX = f"{TEMPORARY_PREFIX}held-{_HERE}-"
_ELSEWHERE_DAYS = 2.0  # of another machine: removed when nobody wrote for so long
_KNOWN_MOST = 4096
_swept: set[str] = set()  # folders that this process has looked through


def make_held_file(folder: Path) -> tuple[int, str, int | None]:
    """A new temporary file: descriptor to write to, path, and the hold to let go at the end."""
    sweep_dead(folder)
    descriptors: list[int] = []

    def make() -> str:
        descriptor, path = tempfile.mkstemp(prefix=HELD_PREFIX, dir=folder)
        descriptors.append(descriptor)
        return path

    path, hold = _make_held(make, lambda: os.close(descriptors.pop()))
    return descriptors.pop(), path, hold


def make_held_folder(folder: Path) -> tuple[str, int | None]:
    """A new temporary folder: path, and the hold to let go at the end."""
    sweep_dead(folder)
    return _make_held(lambda: tempfile.mkdtemp(prefix=HELD_PREFIX, dir=folder), lambda: None)


def _make_held(make: Callable[[], str], undo: Callable[[], object]) -> tuple[str, int | None]:
    while True:
        path = make()
        try:
            hold = _hold(path, wait=True)
        except FileNotFoundError:  # swept before it was held: once more
            undo()
            continue
        if hold is None or os.path.exists(path):
            return path, hold
        os.close(hold)
        undo()


def let_go(hold: int | None) -> None:
    """Give a hold up."""
    if hold is not None:
        with contextlib.suppress(OSError):
            os.close(hold)


def _hold(path: str, *, wait: bool) -> int | None:
    """A lock on a file or folder; None where the system has none, or another holds it.

    Raises:
        FileNotFoundError: it is gone.
    """
    try:
        import fcntl
    except ImportError:
        return None
    descriptor = os.open(path, os.O_RDONLY | os.O_CLOEXEC | os.O_NOFOLLOW)
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | (0 if wait else fcntl.LOCK_NB))
    except OSError:
        os.close(descriptor)
        return None
    return descriptor


def sweep_dead(folder: Path) -> None:
    """Remove what dead writers left in a folder; a process looks once through each folder."""
    name = os.path.abspath(folder)
    if name in _swept:
        return
    if len(_swept) >= _KNOWN_MOST:
        _swept.clear()
    _swept.add(name)
    with contextlib.suppress(OSError), os.scandir(name) as entries:
        found = [e.path for e in entries if e.name.startswith(f"{TEMPORARY_PREFIX}held-")]
        for path in found:
            remove_dead(path)


def remove_dead(path: str) -> bool:
    """Remove a temporary file or folder whose writer is dead; whether it is gone."""
    if not is_held_name(path):
        return False
    try:
        ours = os.path.basename(path).startswith(HELD_PREFIX)
        if not ours and time.time() - os.lstat(path).st_mtime < _ELSEWHERE_DAYS * 86400:
            return False
        hold = _hold(path, wait=False)
        if hold is None:
            return False
        try:
            if os.path.isdir(path):
                shutil.rmtree(path, ignore_errors=True)
            else:
                os.unlink(path)
        finally:
            os.close(hold)
    except FileNotFoundError:
        return True
    except OSError:
        return False
    return not os.path.exists(path)


def is_held_name(path: str) -> bool:
    """Whether a path is that of a temporary that its writer holds."""
    return os.path.basename(path).startswith(f"{TEMPORARY_PREFIX}held-")
