"""Measures of following by the level of the others, and by how the person walks."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any, get_args

import msgspec

from gn0.bench.follow_metrics import FollowMetrics, summarize_following
from gn0.bench.intervals import Interval
from gn0.bench.results import EpisodeResult
from gn0.missions.episode import Episode, FollowCategory, FollowLevel, MissionFollow

FollowSplit = dict[str, dict[str, dict[str, Interval]]]
KINDS: dict[str, tuple[str, ...]] = {
    "level": tuple(word for word in get_args(FollowLevel) if word),
    "category": tuple(word for word in get_args(FollowCategory) if word),
}
UNKNOWN = "not told"  # of missions of before


def told_of(episode: Episode, kind: str) -> str:
    """The level or category of an episode's mission; "" where it follows nobody."""
    mission = episode.mission
    if not isinstance(mission, MissionFollow):
        return ""
    return str(getattr(mission, kind)) or UNKNOWN


def split_following(
    results: Iterable[EpisodeResult], episodes: Mapping[str, Episode], seed: int = 0
) -> FollowSplit | msgspec.UnsetType:
    """Measures by "level" and "category", then by the word of it; absent where nobody is followed.

    Args:
        results: of a run.
        episodes: of its suite, by id.
        seed: of the intervals' resampling.
    """
    scored: list[tuple[Episode, FollowMetrics]] = [
        (episodes[r.episode], r.follow)
        for r in results
        if r.status == "valid" and isinstance(r.follow, FollowMetrics) and r.episode in episodes
    ]
    if not scored:
        return msgspec.UNSET
    found: FollowSplit = {}
    for kind, order in KINDS.items():
        words = {told_of(episode, kind) for episode, _ in scored}
        found[kind] = {}
        for word in (*(w for w in order if w in words), *sorted(words - set(order))):
            own = [(e, m) for e, m in scored if told_of(e, kind) == word]
            found[kind][word or UNKNOWN] = summarize_following(
                [m for _, m in own], [e.scene_id for e, _ in own], seed=seed
            )
    return found


def split_tables(splits: list[FollowSplit | None]) -> list[dict[str, Any]]:
    """For a report: of each kind its words, each with the measures of every run or None."""
    tables = []
    for kind, order in KINDS.items():
        words = {word for split in splits if split for word in split.get(kind, {})}
        rows = [
            (word, [split.get(kind, {}).get(word) if split else None for split in splits])
            for word in (*(w for w in order if w in words), *sorted(words - set(order)))
        ]
        if rows:
            tables.append({"kind": kind, "rows": rows})
    return tables
