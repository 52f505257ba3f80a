"""Tables of results for the terminal."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from gn0.bench.results import RunSummary

_COLUMNS = ("SR", "SPL", "OS", "NE_geo", "NE_euclid", "TL", "nDTW", "collision_rate", "steps")


def print_summaries(summaries: Sequence[RunSummary]) -> None:
    """A row a policy: means with half-widths of their 95 % intervals, and what did not run."""
    from rich.console import Console
    from rich.table import Table

    table = Table(header_style="bold")
    table.add_column("policy")
    table.add_column("episodes", justify="right")
    for name in _COLUMNS:
        table.add_column(name.replace("_", " "), justify="right")
    for summary in summaries:
        cells = []
        for name in _COLUMNS:
            estimate = summary.metrics.get(name)
            cells.append("–" if estimate is None else f"{estimate.mean:.3f}")
        count = f"{summary.valid}/{summary.expected}"
        table.add_row(summary.policy, count, *cells)
    Console(width=max(110, Console().width)).print(table)
    for summary in summaries:
        if summary.failed:
            print(f"{summary.policy}: {len(summary.failed)} episodes did not run:")
            for failure in summary.failed:
                print(f"  {failure}")
