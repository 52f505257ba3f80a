"""Tables of results for the terminal."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from gn0.bench.results import RunSummary

_COLUMNS = {
    "SR": "SR",
    "SPL": "SPL",
    "OS": "OS",
    "NE_geo": "NE geo m",
    "NE_euclid": "NE euclid m",
    "TL": "TL m",
    "nDTW": "nDTW",
    "collision_rate": "collided",
    "steps": "steps",
}


def _short(value: float) -> str:
    """Three significant digits or so: enough for a terminal."""
    return f"{value:.1f}" if abs(value) >= 10 else f"{value:.2f}"


def print_summaries(summaries: Sequence[RunSummary]) -> None:
    """A row a policy: means and their 95 % intervals, and what did not run."""
    from rich.console import Console
    from rich.table import Table

    table = Table(header_style="bold")
    table.add_column("policy", no_wrap=True)
    table.add_column("episodes", justify="right")
    for title in _COLUMNS.values():
        table.add_column(title, justify="right")
    for summary in summaries:
        cells = []
        for name in _COLUMNS:
            estimate = summary.metrics.get(name)
            cells.append(
                "–"
                if estimate is None
                else f"{_short(estimate.mean)}\n[dim]{_short(estimate.low)}–{_short(estimate.high)}[/dim]"
            )
        count = f"{summary.valid}/{summary.expected}"
        table.add_row(summary.policy, count, *cells)
    Console(width=max(110, Console().width)).print(table)
    for summary in summaries:
        if summary.failed:
            print(f"{summary.policy}: {len(summary.failed)} episodes did not run:")
            for failure in summary.failed:
                print(f"  {failure}")
