"""Successes and failures of a run, drawn by seed: cases to look at that nobody has picked."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path

from gn0.bench.results import load_results
from gn0.errors import BenchError, FormatError, StorageError
from gn0.seeds import random_stream
from gn0.storage import check_contained, plain_path, read_bytes
from gn0.suites.run_files import RESULTS

WALKS = "walks.jsonl"
_LIMIT = 2**30  # bytes


def read_outcomes(path: Path | str) -> dict[str, bool]:
    """Whether each scored episode of a run was a success.

    Args:
        path: a run folder, a folder with walks.jsonl, or a file of JSON lines with `episode` and
            `success`; of several lines of an episode the first counts.

    Raises:
        StorageError: nothing there.
        FormatError: a line says neither; names it.
    """
    place = plain_path(path)
    if place.is_dir():
        check_contained(place)
    if (place / RESULTS).is_file():
        return {r.episode: bool(r.metrics.success) for r in load_results(place) if r.metrics}
    if (place / WALKS).is_file():
        place = place / WALKS
    if not place.is_file():
        raise StorageError(
            f"neither {RESULTS} nor {WALKS} there" if place.is_dir() else "no such run",
            where=place,
            remedy="give a folder of `gn0 bench run`, or a file of JSON lines",
        )
    found: dict[str, bool] = {}
    for number, line in enumerate(read_bytes(place, _LIMIT).splitlines(), 1):
        if not line.strip():
            continue
        try:
            entry = json.loads(line)
        except (ValueError, RecursionError):
            entry = None
        told = entry if isinstance(entry, dict) else {}
        episode, success = told.get("episode"), told.get("success")
        if not isinstance(episode, str) or not isinstance(success, bool | int | float):
            raise FormatError(
                f"line {number} does not say `episode` and `success`",
                file=place,
                remedy="give a folder of `gn0 bench run`, or a file of such JSON lines",
            )
        found.setdefault(episode, bool(success))
    return found


def pick_cases(outcomes: Mapping[str, bool], count: int, seed: int = 0) -> list[str]:
    """Ids of at most `count` successes and then of as many failures, in the order of the draw.

    Raises:
        BenchError: no episode was scored.
    """
    if not outcomes:
        raise BenchError("no episode was scored", remedy="choose another run")
    chosen: list[str] = []
    for wanted in (True, False):
        known = sorted(episode for episode, success in outcomes.items() if success == wanted)
        stream = random_stream(seed, "cases", "success" if wanted else "failure")
        chosen += [known[int(k)] for k in stream.permutation(len(known))[:count]]
    return chosen
