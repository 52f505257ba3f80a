"""Cached code is executed, so it is loaded only from folders that nobody else can write to.

The index of Numba's cache is a pickle, and compiled kernels are machine code: whoever can put a
file there runs code as us. So such a folder, and each one above it, must belong to us or to the
system, and no one else may write there. On Windows the system's own rules for home folders hold.
"""

from __future__ import annotations

import contextlib
import logging
import os
import stat
from collections.abc import Iterator
from pathlib import Path

_TOLD = "GN0_CACHE_REFUSED"  # in the environment: what this process or its parent has said already
_log = logging.getLogger(__name__)


def trust_folder(folder: Path) -> bool:
    """Whether code may be kept in and taken from a folder, which is made if need be."""
    why = find_strangers(folder)
    if not why and not folder.is_dir():
        make_private(folder)
        why = find_strangers(folder)  # somebody may have been quicker
    if why and os.environ.get(_TOLD) != str(folder):
        os.environ[_TOLD] = str(folder)
        _log.warning("compiled kernels are not cached: %s; %s", why, remedy_of(folder))
    return not why


def remedy_of(folder: Path) -> str:
    """What to do about a folder that cannot be trusted."""
    return (
        f"take the rights of others away and remove {folder}, or set GN0_CACHE to a folder that "
        "only you can write: docs/install.md"
    )


def make_private(folder: Path) -> None:
    """Make a folder and those above it that are missing, for us alone; failing is no error."""
    with contextlib.suppress(OSError):
        for level in (*reversed(folder.parents), folder):
            if not level.exists():
                level.mkdir(mode=0o700, exist_ok=True)


def find_strangers(folder: Path) -> str:
    """Who else could have put files into a folder, in words; "" when nobody could.

    Looks at the folder, at what lies in it, and at every folder above it, links resolved.
    """
    if not hasattr(os, "geteuid"):  # Windows: rights are no mode bits
        return ""
    try:
        real = folder.resolve()
        for level in (real, *real.parents):
            if level.exists() and (why := _fault_of(level, own=level == real)):
                return why
        for path, owner in _walk_owners(real):
            if owner not in (os.geteuid(), 0):
                return f"{path} belongs to {_name_user(owner)}"
    except FileNotFoundError:
        return ""  # a file that another process of ours has just replaced
    except (OSError, RuntimeError) as error:
        return f"{folder} cannot be looked at: {error}"
    return ""


def _walk_owners(folder: Path) -> Iterator[tuple[str, int]]:
    """Each thing below a folder with its owner: every process looks, so without a `Path` each."""
    left: list[str] = [str(folder)] if folder.is_dir() else []
    while left:
        with contextlib.suppress(PermissionError), os.scandir(left.pop()) as entries:
            for entry in entries:
                yield entry.path, entry.stat(follow_symlinks=False).st_uid
                if entry.is_dir(follow_symlinks=False):
                    left.append(entry.path)


def _fault_of(folder: Path, *, own: bool) -> str:
    """Why a folder is not safe from others; `own` for the cache itself, else one above it."""
    about = folder.stat()
    if about.st_uid not in (os.geteuid(), 0) and (own or about.st_uid != _unmapped()):
        return f"{folder} belongs to {_name_user(about.st_uid)}"
    if about.st_mode & stat.S_ISVTX and not own:
        return ""  # as /tmp: all may write, but nobody may touch what is another's
    if about.st_mode & stat.S_IWOTH:
        return f"everybody may write to {folder}"
    if about.st_mode & stat.S_IWGRP and not _is_private(about.st_gid):
        return f"group {_name_group(about.st_gid)} may write to {folder}"
    return ""


def _is_private(group: int) -> bool:
    """Whether a group has us as its only member, as many systems give each user one."""
    import grp
    import pwd

    try:
        me, own = pwd.getpwuid(os.geteuid()), grp.getgrgid(group)
    except KeyError:
        return False
    return group == me.pw_gid and own.gr_name == me.pw_name and set(own.gr_mem) <= {me.pw_name}


def _unmapped() -> int:
    """The user that stands for all whom a container does not know, the real root among them."""
    try:
        whole = Path("/proc/self/uid_map").read_text().split() == ["0", "0", "4294967295"]
        return -1 if whole else int(Path("/proc/sys/kernel/overflowuid").read_text())
    except (OSError, ValueError):
        return -1


def _name_user(user: int) -> str:
    import pwd

    with contextlib.suppress(KeyError):
        return pwd.getpwuid(user).pw_name
    return f"user {user}"


def _name_group(group: int) -> str:
    import grp

    with contextlib.suppress(KeyError):
        return grp.getgrgid(group).gr_name
    return str(group)
