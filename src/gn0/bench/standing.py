"""Which runs may be compared in one table: those of one track that keep to it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from gn0.bench.results import RunSummary
from gn0.suites.track import read_track, tell_track


@dataclass(frozen=True)
class Group:
    """Runs that were told alike.

    Attributes:
        title: what they were told.
        members: their places in the list that was grouped.
        rank: 0 within the rules, 1 beyond them, 2 oracles.
    """

    title: str
    members: tuple[int, ...]
    rank: int


def group_runs(summaries: Sequence[RunSummary]) -> list[Group]:
    """Runs in tables of their own: those that keep to their track first, oracles last."""
    found: dict[tuple[int, str], list[int]] = {}
    for place, summary in enumerate(summaries):
        found.setdefault(_place(summary), []).append(place)
    keys = sorted(found, key=lambda key: key[0])
    return [Group(title, tuple(found[rank, title]), rank) for rank, title in keys]


def _place(summary: RunSummary) -> tuple[int, str]:
    if summary.standing == "oracle":
        return 2, "oracle: handed the simulator itself, outside any track"
    track = read_track(summary.track)
    where = tell_track(track, summary.map_mode)
    if summary.standing == "off the track":
        return 1, f"off the track ({where}): also told {', '.join(summary.beyond)}"
    return 0, where if track else "no track: the suite does not say what a policy may be told"


def tell_standings(a: RunSummary, b: RunSummary) -> str:
    """What two runs were told differently, or how differently they ran; "" when it is the same."""
    groups = group_runs([a, b])
    lines = []
    if len(groups) > 1 and (a.track or b.track or "oracle" in (a.standing, b.standing)):
        titles = {place: group.title for group in groups for place in group.members}
        lines.append(f"not told alike: A is {_brief(titles[0])}, B is {_brief(titles[1])}")
    if a.isolation != b.isolation and a.isolation and b.isolation:
        lines.append(f"A ran {_ran(a)}, B {_ran(b)}")
    return "; ".join(lines)


def _brief(title: str) -> str:
    known = title.startswith(("oracle", "off the track"))
    head = title.partition(":")[0]
    return f"an {head}" if head == "oracle" else title if known else f"on the track ({title})"


def _ran(summary: RunSummary) -> str:
    return {
        "in-process": "in-process",
        "own process": "in a process of its own",
        "a person": "by hand",
    }.get(summary.isolation, "at its server")
