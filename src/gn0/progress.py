"""Progress, reported by any layer and drawn only by the CLI."""

from __future__ import annotations

from collections.abc import Callable, Iterator

# (stage, done, total): called from long loops; total 0 means unknown
Progress = Callable[[str, int, int], None]


def no_progress(stage: str, done: int, total: int) -> None:
    """The silent progress sink."""


def told_parts(
    stage: str, count: int, step: int, progress: Progress = no_progress
) -> Iterator[slice]:
    """Slices of at most `step` that cover `count` things, each told before its work begins.

    For loops in kernels and arrays that would else be silent until all is done.
    """
    for low in range(0, count, step):
        progress(stage, low, count)
        yield slice(low, min(low + step, count))
    if count:
        progress(stage, count, count)
