"""The parent of a run keeps where results stand, and no results."""

from __future__ import annotations

import gc
import json
from pathlib import Path

import pytest

from gn0.bench.results import EpisodeResult, EpisodeTrace, load_results, load_traces
from gn0.errors import StorageError
from gn0.storage import Journal
from gn0.suites.suite import Suite
from gn0_trials.instant_workers import STEPS, crowd_suite, run_instantly

COUNT = 60


def held() -> int:
    """Traces and results that are alive."""
    gc.collect()
    # by type: asking a weak reference of somebody else for its class may find nothing there
    return sum(type(thing) in (EpisodeTrace, EpisodeResult) for thing in gc.get_objects())


def test_the_parent_of_a_long_run_holds_no_trajectories(flats_suite: Suite, tmp_path: Path) -> None:
    seen: list[int] = []

    def look(what: str, done: int, count: int) -> None:
        if what == "episodes" and done in (COUNT // 2, COUNT):
            seen.append(held())

    before = held()
    suite = crowd_suite(flats_suite, COUNT)
    assert run_instantly(suite, tmp_path / "run", progress=look).ok
    assert len(seen) == 2 and max(seen) - before <= 4, "the one that is being told, no others"
    assert [r.episode for r in load_results(tmp_path / "run")] == [e.id for e in suite.episodes]
    assert {len(t.actions) for t in load_traces(tmp_path / "run").values()} == {STEPS}


def test_a_run_resumed_from_half_its_journal_writes_the_same_bytes(
    flats_suite: Suite, tmp_path: Path
) -> None:
    suite = crowd_suite(flats_suite, COUNT)
    run_instantly(suite, tmp_path / "whole")
    lines = (tmp_path / "whole/journal.jsonl").read_bytes().splitlines(keepends=True)
    (tmp_path / "half").mkdir()
    (tmp_path / "half/journal.jsonl").write_bytes(b"".join(lines[: len(lines) // 2]) + b'{"ty')
    run_instantly(suite, tmp_path / "half", shuffle_seed=1)
    for name in ("results.jsonl", "trajectories.jsonl", "summary.json"):
        assert (tmp_path / "half" / name).read_bytes() == (tmp_path / "whole" / name).read_bytes()


def test_run_json_is_written_as_it_always_was(flats_suite: Suite, tmp_path: Path) -> None:
    run_instantly(crowd_suite(flats_suite, COUNT), tmp_path)
    text = (tmp_path / "run.json").read_text()
    run = json.loads(text)
    assert text == json.dumps(run, indent=2, sort_keys=True, ensure_ascii=False) + "\n"
    seconds = sum(e["seconds"] for e in run["episodes"].values())
    assert run["seconds"] == pytest.approx(seconds, abs=1e-3)
    assert list(run["episodes"]) == [r.episode for r in load_results(tmp_path)]


def test_a_line_changed_after_it_was_written_is_refused(tmp_path: Path) -> None:
    with Journal(tmp_path / "j") as journal:
        places = [journal.append({"n": n}) for n in range(3)]
        assert [place for place, _ in journal.scan()] == places
        assert list(journal.read_bodies(reversed(places))) == [
            b'{"n": 2}',
            b'{"n": 1}',
            b'{"n": 0}',
        ]
        (tmp_path / "j").write_bytes((tmp_path / "j").read_bytes().replace(b'"n": 1', b'"n": 7'))
        with pytest.raises(StorageError, match=f"at byte {places[1]} was changed"):
            list(journal.read_bodies(places))
