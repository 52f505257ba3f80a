"""Progress, told by any layer and drawn only by the CLI."""

from __future__ import annotations

from collections.abc import Callable

# (stage, done, total): called from long loops; total 0 means unknown
Progress = Callable[[str, int, int], None]


def no_progress(stage: str, done: int, total: int) -> None:
    """The silent progress sink."""
