"""Cases to look at are drawn by seed, from whatever says which episodes were successes."""

from __future__ import annotations

from pathlib import Path

import pytest

from gn0.bench.cases import pick_cases, read_outcomes
from gn0.errors import BenchError, FormatError, StorageError

OUTCOMES = {f"e{k}": k % 3 == 0 for k in range(30)}  # ten successes


def test_successes_come_first_and_the_seed_alone_decides() -> None:
    chosen = pick_cases(OUTCOMES, 3, seed=1)
    assert [OUTCOMES[one] for one in chosen] == [True] * 3 + [False] * 3
    assert len(set(chosen)) == 6
    assert pick_cases(dict(reversed(OUTCOMES.items())), 3, seed=1) == chosen
    assert pick_cases(OUTCOMES, 2, seed=1) == [*chosen[:2], *chosen[3:5]]
    assert any(pick_cases(OUTCOMES, 3, seed=k) != chosen for k in range(2, 5))


def test_what_there_is_too_little_of_is_taken_whole() -> None:
    assert sorted(pick_cases({"a": False, "b": False}, 3)) == ["a", "b"]
    with pytest.raises(BenchError, match="no episode was scored"):
        pick_cases({}, 3)


def test_walks_are_read_from_a_file_or_its_folder(tmp_path: Path) -> None:
    file = tmp_path / "walks.jsonl"
    file.write_text(
        '{"episode": "a", "success": true, "steps": 3}\n\n{"episode":"b","success":0}\n'
    )
    assert read_outcomes(file) == read_outcomes(tmp_path) == {"a": True, "b": False}
    file.write_text('{"episode": "a", "success": true}\n[1]\n')
    with pytest.raises(FormatError, match="line 2 does not say"):
        read_outcomes(file)
    for place in (tmp_path / "nowhere", tmp_path / "empty"):
        (tmp_path / "empty").mkdir(exist_ok=True)
        with pytest.raises(StorageError, match=r"no such run|neither"):
            read_outcomes(place)
