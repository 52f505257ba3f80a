"""Success and SPL of runs by path length, goal category and tier, for the report's histograms."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from typing import TypeVar

import msgspec

from gn0.bench.results import EpisodeResult
from gn0.missions.episode import Episode, MissionFollow

BINS = 8  # of length, at most
CATEGORIES = 12  # told by name; rarer ones are told together
_Label = TypeVar("_Label", int, str)


class Share(msgspec.Struct, frozen=True):
    """What a run scored in one bar: scored episodes, success and mean SPL of 0 to 1."""

    count: int
    success: float
    spl: float


class Bar(msgspec.Struct, frozen=True):
    """One bar of a histogram: its label, and the share of each run; None where it has none."""

    label: str
    shares: tuple[Share | None, ...]


def split_lengths(runs: Sequence[Sequence[EpisodeResult]]) -> list[Bar]:
    """Scores by the shortest way from start to goal, in at most `BINS` bins of a round width."""
    lengths = [r.metrics.shortest_length for run in runs for r in run if r.metrics is not None]
    if not lengths:
        return []
    width = _round_width(max(lengths))
    digits = 0 if width >= 1 else 1

    def label(result: EpisodeResult) -> int:
        assert result.metrics is not None
        return math.floor(result.metrics.shortest_length / width)

    found = _split(runs, label)
    places = range(min(found), max(found) + 1)
    return [
        Bar(f"{k * width:.{digits}f}–{(k + 1) * width:.{digits}f} m", _shares(found.get(k), runs))
        for k in places
    ]


def split_categories(
    runs: Sequence[Sequence[EpisodeResult]], episodes: Mapping[str, Episode]
) -> list[Bar]:
    """Scores by what the goal is, the most frequent first; rare ones are put together."""

    def label(result: EpisodeResult) -> str:
        return category_of(episodes[result.episode])

    names = {r.episode: label(r) for run in runs for r in run if r.metrics is not None}
    counts = Counter(names.values())
    order = sorted(counts, key=lambda name: (-counts[name], name))
    named, rest = order, []
    if len(order) > CATEGORIES:
        named, rest = order[: CATEGORIES - 1], order[CATEGORIES - 1 :]
    found = _split(runs, label)
    bars = [Bar(name, _shares(found[name], runs)) for name in named]
    if rest:
        together = [[r for own in rest for r in found[own][i]] for i in range(len(runs))]
        bars.append(Bar(f"{len(rest)} others", _shares(together, runs)))
    return bars


def split_tiers(
    runs: Sequence[Sequence[EpisodeResult]], episodes: Mapping[str, Episode]
) -> list[Bar]:
    """Scores of goals that the bird's-eye view shows, and of the others; none without tiers."""
    if not any(episodes[r.episode].tier for run in runs for r in run):
        return []
    found = _split(runs, lambda result: episodes[result.episode].tier or "others")
    order = sorted(found, key=lambda name: (name == "others", name))
    return [Bar(name, _shares(found[name], runs)) for name in order]


def category_of(episode: Episode) -> str:
    """What the goal of an episode is, in a word."""
    mission = episode.mission
    if isinstance(mission, MissionFollow):
        return "a person"
    return mission.category or "not named"


def _round_width(longest: float) -> float:
    """The least width [m] of 1, 2 or 5 by a power of ten that gives at most `BINS` bins."""
    power = 10.0 ** math.floor(math.log10(max(longest, 0.1) / BINS))
    widths = (step * power * more for more in (1.0, 10.0) for step in (1.0, 2.0, 5.0))
    return next(w for w in widths if math.floor(longest / w) + 1 <= BINS)


def _split(
    runs: Sequence[Sequence[EpisodeResult]], label: Callable[[EpisodeResult], _Label]
) -> dict[_Label, list[list[EpisodeResult]]]:
    found: dict[_Label, list[list[EpisodeResult]]] = {}
    for number, run in enumerate(runs):
        for result in run:
            if result.metrics is not None:
                own = found.setdefault(label(result), [[] for _ in runs])
                own[number].append(result)
    return found


def _shares(
    split: Sequence[Sequence[EpisodeResult]] | None, runs: Sequence[object]
) -> tuple[Share | None, ...]:
    return tuple(_share(own) for own in split) if split else (None,) * len(runs)


def _share(results: Sequence[EpisodeResult]) -> Share | None:
    scores = [r.metrics for r in results if r.metrics is not None]
    if not scores:
        return None
    n = len(scores)
    return Share(n, sum(m.success for m in scores) / n, math.fsum(m.spl for m in scores) / n)
