"""What is wrong with an imported world, and what was done about it, in one list."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

from gn0.errors import Gn0Error, SceneError

Tell = Callable[[str], None]  # takes one line for the person who imports
_LINES = 40


def no_tell(line: str) -> None:
    """The sink of whom nobody listens to."""


@dataclass(frozen=True)
class WorldDefect:
    """One thing that is not as it should be.

    Attributes:
        where: the file, model or address at fault.
        what: what is wrong, one clause.
        done: what the importer did: "left out", "read as …".
        error: what strict reading raises when this is the only defect.
    """

    where: str
    what: str
    done: str
    error: Gn0Error | None = field(default=None, compare=False)

    @property
    def left_out(self) -> bool:
        """Whether something of the world is missing from the scene for it."""
        return self.done.startswith("left out")

    def line(self) -> str:
        """The defect in one line."""
        return f"{self.where}: {self.what}; {self.done}"


def told_within(defects: Sequence[WorldDefect], root: Path) -> list[WorldDefect]:
    """The defects with files named as the world's folder has them: the same wherever it lies."""
    tops = tuple(f"{top}/" for top in (root, root.resolve()))
    out = []
    for defect in defects:
        where = defect.where
        for top in tops:
            where = where.removeprefix(top)
        out.append(replace(defect, where=where))
    return out


def defect_of(error: Gn0Error, where: str = "", done: str = "left out") -> WorldDefect:
    """A reader's error as a defect that the importer goes round."""
    return WorldDefect(str(error.where or where), error.what, done, error)


def defect_lines(defects: Sequence[WorldDefect]) -> list[str]:
    """The list: a heading, then a line per defect; equal ones are counted, and at most 40 shown."""
    if not defects:
        return []
    counted = Counter(defect.line() for defect in defects)
    lines = [text if n == 1 else f"{text} ({n} times)" for text, n in counted.items()]
    out = sum(defect.left_out for defect in defects)
    head = (
        f"{len(defects)} defect{'s' * (len(defects) > 1)} in this world: "
        f"{len(defects) - out} repaired, {out} left out; --strict refuses it instead"
    )
    more = [f"  … and {len(lines) - _LINES} more"] if len(lines) > _LINES else []
    return [head, *(f"  {line}" for line in lines[:_LINES]), *more]


def refuse_defects(defects: Sequence[WorldDefect], file: object) -> None:
    """Raise for a world that is to be without defects.

    Raises:
        Gn0Error: the reader's own error for a single defect, a `SceneError` with the list else.
    """
    if not defects:
        return
    first = defects[0]
    if len({defect.line() for defect in defects}) == 1 and first.error is not None:
        raise first.error
    lines = "; ".join(line.strip() for line in defect_lines(defects)[1:])
    raise SceneError(
        f"{len(defects)} defects in this world: {lines}",
        where=str(file),
        remedy="repair them, or import without --strict",
    )
