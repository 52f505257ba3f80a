"""Suites that one process asks for several times: read once, as long as they are as they were."""

from __future__ import annotations

from functools import lru_cache
from pathlib import Path

from gn0.errors import Gn0Error
from gn0.suites.suite import EPISODE_FILE, SUITE_FILE, Suite, load_suite


def load_suite_kept(path: Path | str) -> Suite:
    """A suite; one that was opened before and is as it was is not read again.

    A stage of training asks for its lessons several times, the command line once before it, and
    tens of thousands of episodes take seconds each time.

    Raises:
        BenchError, StorageError, FormatError, EpisodeError, ConfigError: see `load_suite`.
    """
    try:
        folder = Path(path).resolve()
        looks = [(folder / name).stat() for name in (SUITE_FILE, EPISODE_FILE)]
    except (OSError, ValueError):
        return load_suite(path)  # says what is wrong; or it is a URL
    try:
        return _load_as_it_was(folder, *((one.st_mtime_ns, one.st_size) for one in looks))
    except Gn0Error:
        return load_suite(path)  # says it of the path that was given


@lru_cache(maxsize=16)
def _load_as_it_was(folder: Path, *stamps: tuple[int, int]) -> Suite:
    return load_suite(folder)
