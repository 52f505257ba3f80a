"""Figures of the tests themselves: faults that they notice, branches that they take.

Both take long and need the repository, so commands of their own measure them (`make faults`,
`make coverage`) and leave their rows under `out/`; here they are put on the board.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from gn0_figures.board import Figure, FigureContext, FigureRow, FigureSkipped, load_board


def rows_of(figure: str, target: str) -> Callable[[FigureContext], list[FigureRow]]:
    """A measurement that reads what `make TARGET` wrote below the current folder."""

    def measure(ctx: FigureContext) -> list[FigureRow]:
        entry = load_board(Path("out") / target / "figures.json").get(figure)
        if entry is None:
            raise FigureSkipped(f"it is measured by `make {target}` in a checkout")
        return entry.rows

    return measure


FIGURES: list[Figure] = [
    Figure("trust.faults", "Faults put into the code", rows_of("trust.faults", "faults"), 120.0),
    Figure(
        "trust.coverage",
        "Branches that the tests take",
        rows_of("trust.coverage", "coverage"),
        40.0,
    ),
]
