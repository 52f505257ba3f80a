"""Missions to follow somebody in the formats of others: what is written, and what is refused."""

from __future__ import annotations

import dataclasses
import gzip
import json
import re
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest

from gn0.errors import EpisodeError
from gn0.export.export_run import check_export, remark_export, run_export
from gn0.export.exporter import ExportSettings, dataset_exporter_names, get_dataset_exporter
from gn0.export.trips import ExportSource, Trip
from gn0.missions.episode import MissionFollow
from gn0.people.person import EpisodePerson
from gn0.testing.dataset_exporter_check import check_round_trip
from gn0.testing.toy_trips import build_toy_source, build_toy_trips

TAKERS = {"gn-matrix", "gn-matrix-json", "vlnce-r2r", "vlnce-rxr", "navid", "uninavid"}
TAKERS |= {"lerobot-v3"}
WORDS = "Follow the woman in the red coat."


def _stay(trip: Trip, at: list[int]) -> Trip:
    """The trip as one that follows somebody, standing still before some of its moves."""
    rows, episode = trip.rows, trip.episode
    assert rows is not None
    row = np.sort(np.r_[np.arange(len(rows)), at])
    first = np.r_[True, np.diff(row) > 0]  # of equal rows all but the last stand still
    last = np.r_[first[1:], True]
    executed = np.where(last, rows.executed[row], 0).astype(np.int8)
    ahead = np.r_[executed, np.zeros(5, np.int8)]
    cut = {
        field.name: getattr(rows, field.name)[row]
        for field in dataclasses.fields(rows)
        if isinstance(getattr(rows, field.name), np.ndarray)
    }
    cut |= {"executed": executed, "actions": np.lib.stride_tricks.sliding_window_view(ahead, 6)}
    person = EpisodePerson(number=3, identity="drawn:0:3", path=(episode.goal, episode.start[:2]))
    mission = MissionFollow(goal=episode.goal, instruction=WORDS, human="drawn:0:3", person=3)
    return Trip(
        episode=msgspec.structs.replace(episode, mission=mission, people=(person,), path_id=""),
        poses=cut["poses"],
        moves=executed[:-1],
        ahead=cut["actions"],
        stopped=False,
        rows=dataclasses.replace(rows, **cut),
    )


@pytest.fixture(scope="module")
def source() -> ExportSource:
    """One walk of nine poses, which stands still twice at its third and once at its sixth."""
    trips, grids = build_toy_trips(1, scenes=1, longest=9, turn=30.0)
    return build_toy_source([_stay(trips[0], [2, 2, 5])], grids)


def _done(source: ExportSource) -> list[int]:
    (trip,) = source.trips()
    assert trip.rows is not None
    return [int(code) for code in trip.rows.executed]


def _talks(folder: Path) -> list[dict[str, Any]]:
    found: list[dict[str, Any]] = json.loads((folder / "annotations.json").read_bytes())
    return found


def test_navid_stands_still_by_saying_stop(source: ExportSource, tmp_path: Path) -> None:
    done = run_export(source, "navid", tmp_path)
    assert not check_export(tmp_path)
    said = [talk["conversations"][1]["value"] for talk in _talks(tmp_path)]
    walked: list[int] = []
    for answer in said:  # `navid_agent.py` 333 to 349, where STOP stands still
        amount = re.search(r"\d+", answer)
        if "stop" in answer:
            walked.append(0)
        elif "forward" in answer:
            walked += [1] * int(int(amount[0]) / 25)  # type: ignore[index]
        else:
            walked += [2 if "left" in answer else 3] * int(int(amount[0]) / 30)  # type: ignore[index]
    assert walked == _done(source)
    waits = walked.count(0)
    assert [count for what, count in done.notes.items() if "stands still" in what] == [waits]
    assert all(WORDS in talk["conversations"][0]["value"] for talk in _talks(tmp_path))


def test_uninavid_tells_the_next_four_whatever_they_are(
    source: ExportSource, tmp_path: Path
) -> None:
    run_export(source, "uninavid", tmp_path)
    words = [["stop", "forward", "left", "right"][code] for code in _done(source)] + ["stop"] * 4
    said = [talk["conversations"][1]["value"] for talk in _talks(tmp_path)]
    assert said == [" ".join(words[n : n + 4]) for n in range(len(words) - 4)]


@pytest.mark.parametrize("name", ["navid", "uninavid", "lerobot-v3"])
def test_what_follows_comes_back(name: str, source: ExportSource, tmp_path: Path) -> None:
    check_round_trip(get_dataset_exporter(name), source, tmp_path / "out", ExportSettings())


@pytest.mark.parametrize("name", ["vlnce-r2r", "vlnce-rxr"])
def test_ground_truth_of_vlnce_has_no_waits(
    name: str, source: ExportSource, tmp_path: Path
) -> None:
    run_export(source, name, tmp_path)
    assert not check_export(tmp_path)
    (path,) = tmp_path.glob("train/*_gt.json.gz")
    (truth,) = json.loads(gzip.decompress(path.read_bytes())).values()
    moves = [code for code in _done(source) if code]
    assert truth["actions"] == [*moves, 0]
    assert len(truth["locations"]) == 1 + moves.count(1) == 1 + truth["forward_steps"]
    (trip,) = source.trips()
    end = trip.poses[-1, :2]
    assert np.allclose([truth["locations"][-1][0], -truth["locations"][-1][2]], end)
    assert any("person to follow" in remark for remark in remark_export(tmp_path))


@pytest.mark.parametrize("name", sorted(set(dataset_exporter_names()) - TAKERS))
def test_formats_that_cannot_stand_still_refuse_it_by_name(
    name: str, source: ExportSource, tmp_path: Path
) -> None:
    (followed,) = source.trips()
    trips, grids = build_toy_trips(1, scenes=1)
    plain = dataclasses.replace(
        trips[0], episode=msgspec.structs.replace(trips[0].episode, id="plain")
    )
    both = build_toy_source([plain, followed], grids)
    done = run_export(both, name, tmp_path, ExportSettings(views=("n1_60cm_30deg",), spacing=0.3))
    assert done.written == 1
    ((why, count),) = done.skipped.items()
    assert count == 1 and "stands still" in why


def test_navdp_shows_people_at_steps_alone(tmp_path: Path) -> None:
    trips, grids = build_toy_trips(1, scenes=1, longest=9)
    person = EpisodePerson(number=1, identity="drawn:0:1", path=((0.5, 0.5), (1.5, 0.5)))
    episode = msgspec.structs.replace(trips[0].episode, people=(person,), id="peopled", path_id="")
    peopled = dataclasses.replace(trips[0], episode=episode)
    source = build_toy_source([trips[0], peopled], grids)
    done = run_export(source, "navdp", tmp_path / "even", ExportSettings(spacing=0.3))
    assert done.written == 1 and any("--spacing 0" in why for why in done.skipped)
    exporter = get_dataset_exporter("navdp")
    assert not exporter.why_not(peopled, ExportSettings(spacing=0))


def test_only_who_follows_may_stand_still() -> None:
    trips, _ = build_toy_trips(1, scenes=1, longest=9)
    with pytest.raises(EpisodeError, match="not 1, 2 or 3"):
        dataclasses.replace(trips[0], moves=np.zeros(trips[0].frames - 1, np.int8))
