"""A number agrees with its noun."""

from __future__ import annotations

from gn0.counted import counted


def test_one_is_one_and_the_rest_are_many() -> None:
    assert counted(1, "scene") == "1 scene" and counted(0, "scene") == "0 scenes"
    assert counted(12_000, "scene") == "12,000 scenes"
    assert counted(1, "person", "people") == "1 person"
    assert counted(2, "person", "people") == "2 people"
