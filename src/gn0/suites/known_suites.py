"""Where this user's suites are, so that a run's own record need not be trusted for it.

A results folder may be a stranger's. The path that it names is shown and never opened; what is
opened was named on this machine before, by a command line, and is found again by its hash.
"""

from __future__ import annotations

import contextlib
import re
from pathlib import Path

from gn0.cache import find_strangers
from gn0.config import load_json
from gn0.errors import Gn0Error
from gn0.storage import cache_dir, write_json

_KEPT = 8  # places of one suite


def remember_suite(suite_hash: str, folder: Path) -> None:
    """Note where a suite is that a person has named; failing costs them a --suite later."""
    place = str(folder.resolve())
    known = [str(other) for other in known_suites(suite_hash)]
    if known[:1] == [place]:
        return
    with contextlib.suppress(Gn0Error):
        write_json(_note_of(suite_hash), [place, *(k for k in known if k != place)][:_KEPT])


def known_suites(suite_hash: str) -> list[Path]:
    """Folders that held a suite of that hash, the last one first."""
    if not re.fullmatch("[0-9a-f]{8,64}", suite_hash):
        return []
    note = _note_of(suite_hash)
    with contextlib.suppress(Gn0Error):
        if note.is_file() and not find_strangers(note.parent):
            return [Path(place) for place in load_json(note, list[str])]
    return []


def _note_of(suite_hash: str) -> Path:
    return cache_dir() / "suites" / f"{suite_hash}.json"
