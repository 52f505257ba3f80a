"""The page of a study as it stood: rows of runs whose folders are gone.

A page is made of walks. Where these are no more, as on a machine that was lent, what the command
wrote of them is: a row is taken over whole, found by its section, the words above its table and its
first cells.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

from gn0.errors import FormatError
from gn0.storage import read_bytes

NOT_RUN = "not run yet"
MISSIONS = "SR by missions, "  # begins the words above such a table
LIMIT = 16 << 20  # bytes of a page
_CELL = re.compile(r"(?<!\\)\|")
_REMEDY = "give a page that this command wrote of the same study, or none"


@dataclass(frozen=True)
class _Row:
    line: int
    titles: tuple[str, ...]
    cells: tuple[str, ...]


@dataclass
class PageBefore:
    """Rows of a page; without one there are none.

    Attributes:
        path: of the page.
        used: lines of the rows that were taken over.
    """

    path: Path | None = None
    used: set[int] = field(default_factory=set)
    _rows: dict[tuple[str, str], list[_Row]] = field(default_factory=dict)

    def find(
        self, section: str, caption: str, titles: Sequence[str], *key: str, more: int = 0
    ) -> tuple[str, ...] | None:
        """The cells of a row; None where there is none that says more than what is here.

        Args:
            section: the heading that it stands under.
            caption: the words right above its table, "" for none.
            titles: of the table's columns.
            key: its first cells.
            more: seeds that there are here; a row of as many or fewer is none. Rows of tables
                that do not count seeds are of one.

        Raises:
            FormatError: the table has other columns, or two such rows.
        """
        key = tuple(draw_cell(cell) for cell in key)
        rows = [r for r in self._rows.get((section, caption), ()) if r.cells[: len(key)] == key]
        if not rows:
            return None
        if len(rows) > 1:
            raise self._wrong(rows[1].line, f"a second row of {key[0]!r}")
        row = rows[0]
        if row.titles != tuple(titles):
            raise self._wrong(row.line, "a table of other columns than those of today")
        if _count_seeds(row) <= more:
            return None
        self.used.add(row.line)
        return row.cells

    def _wrong(self, line: int, what: str) -> FormatError:
        return FormatError(what, where=f"{self.path}, line {line}", remedy=_REMEDY)


def load_page(path: Path | str) -> PageBefore:
    """Read the tables of a page.

    Raises:
        FormatError: it is no text, or a row has more or fewer cells than its table has columns.
        StorageError: it cannot be read, or is larger than a page.
    """
    page = PageBefore(Path(path))
    try:
        lines = read_bytes(path, limit=LIMIT).decode().splitlines()
    except UnicodeDecodeError as error:
        raise FormatError(
            "this is not UTF-8 text", file=path, offset=error.start, remedy=_REMEDY
        ) from None
    section = caption = ""
    titles: tuple[str, ...] = ()
    for number, line in enumerate(lines, 1):
        if not line.startswith("| "):
            if not line.startswith("|"):
                titles = ()  # the table has ended
            if line.startswith("## "):
                section, caption = line[3:].strip(), ""
            elif line.startswith("### "):
                caption = line[4:].strip()
            elif line.startswith(MISSIONS):
                caption = line.strip().removesuffix(":")
            continue
        cells = tuple(cell.strip() for cell in _CELL.split(line.strip())[1:-1])
        if not titles:
            titles = cells
        elif len(cells) != len(titles):
            raise FormatError(
                f"a row of {len(cells)} cells in a table of {len(titles)} columns",
                where=f"{path}, line {number}",
                remedy=_REMEDY,
            )
        elif set("".join(cells)) - set("-: "):
            page._rows.setdefault((section, caption), []).append(_Row(number, titles, cells))
    return page


def _count_seeds(row: _Row) -> int:
    """As `2 of 3` or `2 seeds, 100 scenes, …` tells them."""
    told = dict(zip(row.titles, row.cells, strict=True))
    if NOT_RUN in " ".join(row.cells).lower() or told.get("verdict", "").strip("*") == "not run":
        return 0
    counted = told.get("seeds", told.get("of"))
    if counted is None:
        return 1
    number = re.match(r"(\d+) ", counted)
    return int(number[1]) if number else 0


def draw_cell(cell: str) -> str:
    """A cell as a page has it; of one that is drawn already, itself."""
    return re.sub(r"(?<!\\)\|", r"\\|", cell).replace("\n", " ").strip()
