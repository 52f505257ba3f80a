"""Tables of results for the terminal."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

from gn0.cli.console import plain_text

if TYPE_CHECKING:
    from gn0.bench.results import RunSummary

# metric -> (title, factor, decimals)
_TOUCHED = {"CR": ("CR %", 100, 1)}  # where there are people
_COLUMNS = {
    "SR": ("SR %", 100, 0),
    "SPL": ("SPL %", 100, 1),
    "OS": ("OS %", 100, 0),
    "NE_geo": ("NE geo", 1, 1),
    "NE_euclid": ("NE eucl", 1, 1),
    "TL": ("TL m", 1, 1),
    "nDTW": ("nDTW", 100, 0),
    "collision_rate": ("coll %", 100, 0),
    "steps": ("steps", 1, 0),
}


def print_summaries(summaries: Sequence[RunSummary]) -> None:
    """A row a policy: means, their 95 % intervals below, and what did not run.

    Policies that were told more than others stand in tables of their own.
    """
    from gn0.bench.standing import group_runs

    groups = group_runs(summaries)
    for group in groups:
        told = len(groups) > 1 or group.rank or summaries[group.members[0]].track
        members = [summaries[i] for i in group.members]
        followed = [summary for summary in members if isinstance(summary.following, dict)]
        if not followed or any(summary.metrics for summary in members):
            _print_table(members, group.title if told else "")
        if followed:
            _print_following(followed, group.title if told else "")
    for summary in summaries:
        if summary.release is not None:
            _print_release(summary)
    for summary in summaries:
        if summary.failed:
            policy = plain_text(summary.label)
            count = len(summary.failed)
            print(f"{policy}: {count} episode{'' if count == 1 else 's'} did not run:")
            for failure in summary.failed:
                print(f"  {plain_text(str(failure))}")


def _print_table(summaries: Sequence[RunSummary], title: str) -> None:
    """One table of policies that were told alike."""
    from rich import box
    from rich.console import Console
    from rich.markup import escape
    from rich.table import Table

    table = Table(box=box.SIMPLE_HEAD, header_style="bold", padding=(0, 1))
    table.add_column("policy", no_wrap=True)
    table.add_column("scored", justify="right", no_wrap=True)
    among = any(name in summary.metrics for summary in summaries for name in _TOUCHED)
    columns = _COLUMNS | _TOUCHED if among else _COLUMNS
    for column, _, _ in columns.values():
        table.add_column(column, justify="right", no_wrap=True)
    for summary in summaries:
        cells = []
        for name, (_, factor, decimals) in columns.items():
            found = summary.metrics.get(name)
            if found is None:
                cells.append("–")
                continue
            mean, low, high = (
                f"{factor * value:.{decimals}f}" for value in (found.mean, found.low, found.high)
            )
            cells.append(f"{mean}\n[dim]{low}–{high}[/dim]")
        where = f"\n[dim]{summary.isolation}[/dim]" if summary.isolation else ""
        table.add_row(
            escape(plain_text(summary.label)) + where,
            f"{summary.valid}/{summary.expected}",
            *cells,
        )
    if title:
        print(f"\n  {plain_text(title)}")
    Console(width=max(128 if among else 116, Console().width), highlight=False).print(table)


def _print_following(summaries: Sequence[RunSummary], title: str) -> None:
    """The measures of following, a row each: so that thirteen of them fit any window."""
    from rich import box
    from rich.console import Console
    from rich.markup import escape
    from rich.table import Table

    from gn0.bench.follow_metrics import FOLLOW_METRICS

    table = Table(box=box.SIMPLE_HEAD, header_style="bold", padding=(0, 1))
    table.add_column("following")
    for summary in summaries:
        table.add_column(escape(plain_text(summary.label)), justify="right")
    for info in FOLLOW_METRICS:
        cells = []
        for summary in summaries:
            found = summary.following.get(info.key) if isinstance(summary.following, dict) else None
            if found is None:
                cells.append("–")
                continue
            scale, decimals = (100.0, 1) if info.unit == "%" else (1.0, 2)
            mean, low, high = (
                f"{scale * value:.{decimals}f}" for value in (found.mean, found.low, found.high)
            )
            cells.append(f"{mean} [dim]{low}–{high}[/dim]")
        unit = f" [dim]{escape(info.unit)}[/dim]" if info.unit else ""
        table.add_row(f"{info.key}{unit}", *cells)
    if title:
        print(f"\n  {plain_text(title)}")
    Console(width=max(80, Console().width), highlight=False).print(table)


def _print_release(summary: RunSummary) -> None:
    """The official harness's numbers beside ours, on the same trajectories."""
    from rich import box
    from rich.console import Console
    from rich.markup import escape
    from rich.table import Table

    from gn0.bench.release_score import SIDE_BY_SIDE

    theirs = summary.release
    assert theirs is not None
    table = Table(box=box.SIMPLE_HEAD, header_style="bold", padding=(0, 1))
    table.add_column(f"{escape(plain_text(summary.label))}, same trajectories")
    table.add_column("gn0-release", justify="right")
    table.add_column("ours", justify="right")
    for key, title, ours, factor, unit in SIDE_BY_SIDE:
        mean = summary.metrics.get(ours)
        table.add_row(
            f"{title} [{unit}]".replace("[", "\\["),
            f"{getattr(theirs, key) * factor:.2f}",
            "–" if mean is None else f"{mean.mean * factor:.2f}",
        )
    table.add_row("episodes averaged", str(theirs.episodes), str(summary.valid))
    Console(width=max(80, Console().width), highlight=False).print(table)
    print(
        f"the harness stopped {theirs.forced_stops} episodes itself "
        f"({theirs.forced_successes} of them as successes), failed {theirs.in_goal_pixel} in the "
        f"goal's own pixel, and counts {theirs.zeroed} unreachable goals as NE 0"
    )
