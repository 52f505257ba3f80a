"""Goals of several places and areas, in files that have no place for them: it is said."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import msgspec
import pytest

from gn0.export.export_run import check_export, remark_export, run_export
from gn0.export.trips import ExportSource, Trip
from gn0.maps.goal_places import GoalSet
from gn0.missions.sets.json_file import load_exact
from gn0.missions.sets.lost_goals import AREA_LOST, OTHERS_LOST
from gn0.testing.toy_trips import toy_source


@pytest.fixture(scope="module")
def source() -> ExportSource:
    """Four walks: to one of two places, into an area, and two to one place."""
    plain = toy_source(2, longest=9)
    trips = list(plain.trips())

    def told(trip: Trip, goals: GoalSet) -> Trip:
        return replace(trip, episode=msgspec.structs.replace(trip.episode, goal_set=goals))

    (x, y), start = trips[1].episode.goal, trips[0].episode.start[:2]
    square = ((x - 0.5, y - 0.5), (x + 0.5, y - 0.5), (x + 0.5, y + 0.5), (x - 0.5, y + 0.5))
    trips[0] = told(trips[0], GoalSet(points=(trips[0].episode.goal, start)))
    trips[1] = told(trips[1], GoalSet(areas=(square,)))
    return replace(plain, trips=lambda: trips)


@pytest.mark.parametrize(
    ("format", "lost"),
    [
        ("gn-matrix", {OTHERS_LOST: 1, AREA_LOST: 1}),
        ("gn-matrix-json", {OTHERS_LOST: 1, AREA_LOST: 1}),
        ("vlnce-r2r", {AREA_LOST: 1}),
        ("vlnce-rxr", {AREA_LOST: 1}),
        ("navila", {}),  # walks to train on: nobody asks where they end
    ],
)
def test_card_and_check_say_which_goals_a_format_loses(
    source: ExportSource, tmp_path: Path, format: str, lost: dict[str, int]
) -> None:
    folder = tmp_path / format
    about = run_export(source, format, folder)
    for what in (OTHERS_LOST, AREA_LOST):
        assert about.notes.get(what, 0) == lost.get(what, 0)
        line = f"{lost.get(what, 0)} × {what}"
        assert (line in (folder / "README.md").read_text()) == (what in lost)
        assert (line in remark_export(folder)) == (what in lost)
    assert not check_export(folder)


def test_vlnces_files_name_every_place_of_a_set(source: ExportSource, tmp_path: Path) -> None:
    """Habitat measures to the nearest of an episode's goals."""
    run_export(source, "vlnce-r2r", tmp_path / "out")
    counts = [
        len(episode["goals"])
        for path in sorted(tmp_path.glob("out/*/*.json.gz"))
        if "_gt" not in path.name
        for episode in load_exact(path)["episodes"]
    ]
    assert sorted(counts) == [1, 1, 1, 2]
