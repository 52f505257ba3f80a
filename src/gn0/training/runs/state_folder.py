"""The folder that holds the last states of a training run, one folder a step."""

from __future__ import annotations

import os
import re
import shutil
from pathlib import Path

from gn0.errors import StorageError
from gn0.leftovers import let_go, make_held_folder
from gn0.storage import storage_error

STATE = "state.json"  # written last: a folder without it is no state
_NAME = re.compile(r"step-(\d{9,})")


def name_state(step: int) -> str:
    """Name of the folder of a step's state."""
    return f"step-{step:09d}"


def read_step(folder: Path) -> int:
    """The step of a state, by the name of its folder.

    Raises:
        StorageError: the name is not one of `name_state`.
    """
    found = _NAME.fullmatch(folder.name)
    if found is None:
        raise StorageError("not named after a step", where=folder, remedy="name it step-000000100")
    return int(found[1])


def list_states(folder: Path) -> list[Path]:
    """The states in a folder, by step; whether they are whole is checked when one is loaded.

    Raises:
        StorageError: the folder cannot be read.
    """
    try:
        found = list(folder.iterdir()) if folder.is_dir() else []
    except OSError as error:
        raise storage_error(error, folder, "read") from error
    named = [path for path in found if _NAME.fullmatch(path.name) and (path / STATE).is_file()]
    return sorted(named, key=read_step)


def find_latest(folder: Path) -> Path | None:
    """The state of the last step in a folder; None where there is none.

    Raises:
        StorageError: the folder cannot be read.
    """
    return next(iter(reversed(list_states(folder))), None)


def keep_last_states(folder: Path, keep: int) -> None:
    """Remove all states but the last ones.

    Raises:
        StorageError: the system refuses.
    """
    for path in list_states(folder)[:-keep]:
        _remove(path)


def discard_states_after(folder: Path, step: int) -> None:
    """Remove the states of later steps: whoever resumes from an earlier one gives them up.

    Raises:
        StorageError: the system refuses.
    """
    for path in reversed(list_states(folder)):
        if read_step(path) > step:
            _remove(path)


def _remove(path: Path) -> None:
    """Away under its name at once, so that a kill leaves no state of which a part is gone."""
    hold: int | None = None
    try:
        away, hold = make_held_folder(path.parent)
        os.replace(path, Path(away) / "old")
        shutil.rmtree(away)
    except OSError as error:
        raise storage_error(error, path, "remove") from error
    finally:
        let_go(hold)
