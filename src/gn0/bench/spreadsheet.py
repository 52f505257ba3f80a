"""Results as one CSV table: one row per episode of a run, numbers in full precision."""

from __future__ import annotations

import csv
import io
from collections.abc import Mapping, Sequence

from gn0.bench.breakdown import category_of
from gn0.bench.metrics import EpisodeMetrics
from gn0.bench.results import EpisodeResult
from gn0.missions.episode import Episode, mission_name

_FIELDS = EpisodeMetrics.__struct_fields__
COLUMNS = (
    *("policy", "episode", "scene", "mission", "category", "tier", "instruction"),
    *("status", "stopped", "reason", *_FIELDS),
)
_FORMULA = ("=", "+", "-", "@", "\t", "\r")  # what a spreadsheet takes for a formula


def render_csv(
    runs: Sequence[tuple[str, Sequence[EpisodeResult]]], episodes: Mapping[str, Episode]
) -> bytes:
    """A CSV file (RFC 4180, UTF-8) of runs, each with its name; columns are `COLUMNS`.

    Lengths are in metres, success is 1 or 0, SPL and the like are from 0 to 1; an episode without
    a score has empty cells. Words that a spreadsheet would run as a formula begin with a quote.
    """
    stream = io.StringIO(newline="")
    writer = csv.writer(stream)
    writer.writerow(COLUMNS)
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
            writer.writerow(
                [*map(_word, words), _number(result.stopped), _word(result.reason), *scores]
            )
    return stream.getvalue().encode("utf-8", "replace")


def _word(text: str) -> str:
    return f"'{text}" if text.startswith(_FORMULA) else text


def _number(value: float) -> str:
    return repr(int(value)) if isinstance(value, bool) else repr(value)
