"""Results as one CSV table: one row per episode of a run, numbers in full precision."""

from __future__ import annotations

import csv
import io
from collections.abc import Mapping, Sequence

import msgspec

from gn0.bench.breakdown import category_of
from gn0.bench.follow_metrics import FollowMetrics
from gn0.bench.follow_split import KINDS, told_of
from gn0.bench.metrics import EpisodeMetrics
from gn0.bench.results import EpisodeResult
from gn0.missions.episode import Episode, mission_name

_FIELDS = EpisodeMetrics.__struct_fields__
COLUMNS = (
    *("policy", "episode", "scene", "mission", "category", "tier", "instruction"),
    *("status", "stopped", "reason", *_FIELDS),
)
_FOLLOW_FIELDS = FollowMetrics.__struct_fields__
FOLLOW_COLUMNS = tuple(f"follow_{name}" for name in (*KINDS, *_FOLLOW_FIELDS))
_FORMULA = ("=", "+", "-", "@", "\t", "\r")  # what a spreadsheet takes for a formula


def render_csv(
    runs: Sequence[tuple[str, Sequence[EpisodeResult]]], episodes: Mapping[str, Episode]
) -> bytes:
    """A CSV file (RFC 4180, UTF-8) of runs, each with its name; columns are `COLUMNS`.

    Lengths are in metres, success is 1 or 0, SPL and the like are from 0 to 1; an episode without
    a score has empty cells. Where somebody was followed, `FOLLOW_COLUMNS`
    come after them. Words that a spreadsheet would run as a formula begin with a quote.
    """
    stream = io.StringIO(newline="")
    writer = csv.writer(stream)
    following = any(isinstance(r.follow, FollowMetrics) for _, results in runs for r in results)
    writer.writerow([*COLUMNS, *(FOLLOW_COLUMNS if following else ())])
    for name, results in runs:
        for result in results:
            episode = episodes[result.episode]
            words = (
                name,
                result.episode,
                result.scene,
                mission_name(episode.mission),
                category_of(episode),
                episode.tier,
                episode.instruction,
                result.status,
            )
            scores = [""] * len(_FIELDS)
            if result.metrics is not None:
                scores = [_number(getattr(result.metrics, field)) for field in _FIELDS]
            if following:
                scores += [
                    *(told_of(episode, kind) for kind in KINDS),
                    *_follow_cells(result.follow),
                ]
            writer.writerow(
                [*map(_word, words), _number(result.stopped), _word(result.reason), *scores]
            )
    return stream.getvalue().encode("utf-8", "replace")


def _follow_cells(follow: FollowMetrics | msgspec.UnsetType) -> list[str]:
    if not isinstance(follow, FollowMetrics):
        return [""] * len(_FOLLOW_FIELDS)
    values = [getattr(follow, name) for name in _FOLLOW_FIELDS]
    return ["" if v is None else v if isinstance(v, str) else _number(v) for v in values]


def _word(text: str) -> str:
    return f"'{text}" if text.startswith(_FORMULA) else text


def _number(value: float) -> str:
    return repr(int(value)) if isinstance(value, bool) else repr(value)
