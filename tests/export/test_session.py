"""Driving an export: what is refused, left out, told; killed with -9; a dataset of ours."""

from __future__ import annotations

import errno
import os
import signal
import subprocess
import sys
from pathlib import Path

import msgspec
import numpy as np
import pytest

from gn0.cli.main import main
from gn0.data.build import build_dataset
from gn0.data.settings import BuildSettings, PictureSettings
from gn0.errors import ConfigError, DataError, EpisodeError, FormatError, Gn0Error, StorageError
from gn0.export.dataset_source import build_trip, open_source
from gn0.export.export_file import load_export_file
from gn0.export.export_run import check_export, run_export
from gn0.export.exporter import ExportSettings
from gn0.export.staged_files import Shelf
from gn0.export.trips import RGBD, ExportSource, Trip, differing_fields
from gn0.maps.navigation import NavigationMap
from gn0.missions.goal import sample_goal_episodes
from gn0.render.light import LightCondition
from gn0.scenes.example import build_example_scene
from gn0.scenes.folder import load_scene, save_scene
from gn0.sim.presets import find_preset
from gn0.storage import Journal
from gn0.suites.suite import save_suite
from gn0.testing.dataset_exporter_check import read_tree
from gn0.testing.toy_trips import build_toy_source, build_toy_trips, toy_source


def _with(given: ExportSource, /, **changes: object) -> ExportSource:
    """The short source with its first trip changed."""
    import dataclasses

    trips = list(given.trips())
    trips[0] = dataclasses.replace(trips[0], **changes)  # type: ignore[arg-type]
    return dataclasses.replace(given, trips=lambda: iter(trips))


def test_a_strange_folder_is_left_alone(short_source: ExportSource, tmp_path: Path) -> None:
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine/thesis.tex").write_text("ten years")
    with pytest.raises(StorageError, match=r"no export.json"):
        run_export(short_source, "vlnce-r2r", tmp_path / "mine")
    assert (tmp_path / "mine/thesis.tex").read_text() == "ten years"


def test_two_exports_into_one_folder_are_refused(
    short_source: ExportSource, tmp_path: Path
) -> None:
    out = tmp_path / "out"
    run_export(short_source, "vlnce-r2r", out)
    before = read_tree(out)
    for format, settings, said in (
        ("vlnce-rxr", ExportSettings(), "not vlnce-rxr"),
        ("vlnce-r2r", ExportSettings(split="train"), "split is '' there and 'train' here"),
        ("vlnce-r2r", ExportSettings(limit=1), "limit is 0 there and 1 here"),
    ):
        with pytest.raises(StorageError, match="holds another export") as error:
            run_export(short_source, format, out, settings)
        assert said in str(error.value)
    assert read_tree(out) == before


def test_what_a_format_cannot_hold_is_counted(short_source: ExportSource, tmp_path: Path) -> None:
    short = next(iter(short_source.trips()))
    two = {"poses": short.poses[-2:], "moves": short.moves[-1:], "ahead": short.ahead[-2:]}
    done = run_export(_with(short_source, **two), "streamvln", tmp_path / "few")
    assert done.skipped == {"fewer than 4 actions: the loader ignores it": 1}
    many = {
        "poses": np.tile(short.poses[:1], (499, 1)),
        "moves": np.full(498, 2, np.int8),
        "ahead": np.zeros((499, 6), np.int8),
    }
    done = run_export(_with(short_source, **many), "streamvln", tmp_path / "many")
    assert done.skipped == {"more than 498 actions: the loader skips it": 1}
    done = run_export(_with(short_source, source="dagger"), "streamvln", tmp_path / "dagger")
    assert done.skipped == {"a walk of a policy, not of the expert": 1}
    done = run_export(_with(short_source, stopped=False), "navila", tmp_path / "cut")
    assert done.skipped == {"it did not end with STOP": 1}
    assert "1 × it did not end with STOP" in (tmp_path / "cut/README.md").read_text()


def test_nothing_left_is_an_error_that_says_why(short_source: ExportSource, tmp_path: Path) -> None:
    with pytest.raises(DataError, match="2 × not of the split 'nowhere'"):
        run_export(short_source, "vlnce-r2r", tmp_path / "out", ExportSettings(split="nowhere"))
    assert not (tmp_path / "out").exists()


def test_a_full_disk_is_told_and_the_export_goes_on(
    short_source: ExportSource, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    out, whole = tmp_path / "a/out", tmp_path / "b/out"
    real, put = Shelf.put, []

    def full(shelf: Shelf, path: Path, data: bytes) -> None:
        if len(put) == 12:
            from gn0.storage import storage_error

            raise storage_error(OSError(errno.ENOSPC, "No space left on device"), path, "write")
        put.append(path)
        real(shelf, path, data)

    monkeypatch.setattr(Shelf, "put", full)
    with pytest.raises(StorageError, match="disk is full"):
        run_export(short_source, "streamvln", out)
    monkeypatch.undo()
    assert not load_export_file(out).complete
    assert any("has not ended" in fault or "missing" in fault for fault in check_export(out))
    run_export(short_source, "streamvln", out)
    run_export(short_source, "streamvln", whole)
    assert read_tree(out) == read_tree(whole)


_CHILD = """
import os, sys
from gn0.export.export_run import run_export
from gn0.testing.toy_trips import toy_source
def progress(stage, done, total):
    if stage == "episodes" and done == 1:
        print("one", flush=True)
        sys.stdin.read(1)
run_export(toy_source(1, longest=9), "lerobot-v3", sys.argv[1], progress=progress)
"""


def test_killed_with_9_and_gone_on_gives_the_same_bytes(tmp_path: Path) -> None:
    out, whole = tmp_path / "a/out", tmp_path / "b/out"
    child = subprocess.Popen(
        [sys.executable, "-c", _CHILD, str(out)], stdout=subprocess.PIPE, stdin=subprocess.PIPE
    )
    assert child.stdout is not None and child.stdin is not None
    with child:
        assert child.stdout.readline() == b"one\n"
        os.kill(child.pid, signal.SIGKILL)
    assert len(Journal(out / "journal.jsonl").read()) == 1
    for name in ("parts/.gn0-tmp-left", "README.md"):
        (out / name).write_bytes(b"of the run that was killed")
    source = toy_source(1, longest=9)
    run_export(source, "lerobot-v3", out)
    run_export(source, "lerobot-v3", whole)
    assert read_tree(out) == read_tree(whole)


@pytest.mark.slow
@pytest.mark.parametrize("format", ["gn-matrix", "vlnce-r2r", "streamvln", "lerobot-v3"])
def test_a_kill_after_any_write_loses_nothing(format: str, cut_after_writes) -> None:
    source = toy_source(1, longest=9)

    def make(out: Path) -> None:
        run_export(source, format, out)

    whole, cuts = cut_after_writes(make)
    assert len(cuts) > 8
    for left in cuts:
        make(left)
        assert read_tree(left) == read_tree(whole), left


def test_a_trip_that_makes_no_sense_is_refused(short_source: ExportSource) -> None:
    trip = next(iter(short_source.trips()))
    for wrong in (
        {"moves": np.append(trip.moves, np.int8(1))},
        {"moves": np.zeros_like(trip.moves)},
        {"poses": trip.poses * np.nan},
    ):
        with pytest.raises(EpisodeError):
            _with(short_source, **wrong)


def test_every_difference_has_a_name(short_source: ExportSource) -> None:
    from gn0.export.trips import Recovered

    trip = next(iter(short_source.trips()))
    episode = trip.episode
    good = Recovered(
        episode.id, episode.scene_id, episode.instruction, trip.frames,
        tuple(trip.moves.tolist()), trip.poses,
    )  # fmt: skip
    assert differing_fields(trip, good, trip.poses) == []
    import dataclasses

    for name, value in (
        ("id", "x"), ("scene", "x"), ("instruction", "x"), ("frames", 1), ("moves", (1,)),
        ("poses", trip.poses + 1e-4), ("goal", np.zeros((1, 3))), ("path", np.zeros((2, 3))),
    ):  # fmt: skip
        other = dataclasses.replace(good, **{name: value})
        assert differing_fields(trip, other, trip.poses) == [name]


@pytest.fixture(scope="module")
def dataset(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Three episodes in the small flat, one in evening light; labels only."""
    root = tmp_path_factory.mktemp("walks")
    save_scene(build_example_scene(), root / "flat")
    scene = load_scene(root / "flat")
    episodes = sample_goal_episodes(scene, NavigationMap(scene.grid, 0.2), 3, 0)
    evening = LightCondition(name="evening", exposure=-1.0, kelvin=3200.0)
    episodes[1] = msgspec.structs.replace(episodes[1], light=evening, split="train")
    suite = save_suite(root / "suite", [scene], episodes, name="walks", max_steps=60)
    build_dataset(suite, root / "data", BuildSettings(pictures=PictureSettings(layout="none")))
    return root / "data"


def test_a_dataset_of_ours_is_a_source(dataset: Path) -> None:
    source = open_source(dataset)
    trips = list(source.trips())
    assert [t.episode.id for t in trips] == [t.episode.id for t in source.trips()]
    assert len(trips) == 3 and source.name == "walks"
    (card,) = source.scenes.values()
    assert card.licence == "CC0-1.0" and card.source == "example"
    trip: Trip = trips[0]
    assert trip.stopped and trip.ahead[0, 0] == trip.moves[0] and trip.ahead[-1, 0] == 0
    frames = [next(source.eyes.frames(t, RGBD)) for t in trips[:2]]
    other = find_preset("n1_60cm_30deg")
    low = next(source.frames(trip, other, RGBD))
    assert frames[0].rgb is not None and frames[0].rgb.shape == (360, 480, 3)
    assert low.rgb is not None and low.rgb.shape == (480, 640, 3)
    assert low.depth is not None and frames[0].depth is not None
    assert low.depth.max() < frames[0].depth.max()  # looks at the floor from nearer
    own = next(source.eyes.look(trip, trip.poses[:1], source.preset, RGBD))
    assert np.array_equal(own.rgb, frames[0].rgb) and np.array_equal(own.depth, frames[0].depth)


def test_the_light_of_an_episode_is_in_pictures_drawn_again(dataset: Path) -> None:
    source = open_source(dataset)
    lit = [t for t in source.trips() if t.episode.light is not None]
    assert len(lit) == 1
    seen = next(source.eyes.frames(lit[0], RGBD))
    again = next(source.eyes.look(lit[0], lit[0].poses[:1], source.preset, RGBD))
    assert np.array_equal(seen.rgb, again.rgb)


def test_pictures_drawn_after_those_of_another_light_are_in_their_own(dataset: Path) -> None:
    source = open_source(dataset)
    day, evening = sorted(source.trips(), key=lambda t: t.episode.light is not None)[-2:]
    next(source.eyes.look(day, day.poses[:1], source.preset, RGBD))
    after = next(source.eyes.look(evening, evening.poses[:1], source.preset, RGBD))
    assert np.array_equal(after.rgb, next(source.eyes.frames(evening, RGBD)).rgb)


def test_another_camera_stands_at_its_own_height(dataset: Path) -> None:
    """60 cm up and 15° down, the lowest row sees the floor at 0.6 / (y cos 15° + sin 15°)."""
    source = open_source(dataset)
    trip = next(iter(source.trips()))
    low = find_preset("n1_60cm_15deg")
    seen = next(source.eyes.look(trip, trip.poses[:1], low, RGBD))
    assert seen.depth is not None
    lens = low.depth
    y, down = (lens.height - 0.5 - lens.cy) / lens.fy, np.radians(15.0)
    floor = 0.60 / (y * np.cos(down) + np.sin(down))
    assert float(np.median(seen.depth[-1])) == pytest.approx(floor, rel=0.1)


def test_a_walk_that_was_cut_off_has_no_stop(dataset: Path) -> None:
    import dataclasses

    from gn0.data.dataset import open_dataset

    data = open_dataset(dataset)
    rows = data.rows(data.sampled[0])
    assert build_trip(data.episode(rows.episode_id), rows).stopped
    executed = rows.executed.copy()
    executed[-1] = 1
    cut = build_trip(data.episode(rows.episode_id), dataclasses.replace(rows, executed=executed))
    assert not cut.stopped and cut.actions == executed[:-1].tolist()


def test_the_verb_exports_checks_and_tells(
    dataset: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "out"
    assert main(["export", "vlnce-r2r", str(dataset), "--out", str(out), "--split", "train"]) == 0
    said = capsys.readouterr().out
    assert "1 episode (train 1)" in said and "left out: 2 × not of the split 'train'" in said
    assert main(["export", "check", str(out)]) == 0
    assert "no faults" in capsys.readouterr().out
    (out / "train/train_gt.json.gz").unlink()
    assert main(["export", "check", str(out)]) == 1
    assert "fault:" in capsys.readouterr().out
    assert main(["export", "nosuch", str(dataset), "--out", str(out)]) == 2
    assert "known: gn-matrix" in capsys.readouterr().err
    assert main(["export", "vlnce-r2r", str(tmp_path), "--out", str(out)]) == 2
    assert "no dataset.json" in capsys.readouterr().err


def test_a_folder_of_another_is_checked_by_name(short_source: ExportSource, tmp_path: Path) -> None:
    run_export(short_source, "streamvln", tmp_path / "out")
    (tmp_path / "out/export.json").unlink()
    assert check_export(tmp_path / "out", "streamvln") == []
    with pytest.raises(Gn0Error):
        check_export(tmp_path / "out")
    with pytest.raises(StorageError, match="no such folder"):
        check_export(tmp_path / "absent", "streamvln")


def test_an_export_of_another_layout_is_refused(short_source: ExportSource, tmp_path: Path) -> None:
    import json

    out = tmp_path / "out"
    run_export(short_source, "vlnce-r2r", out)
    about = json.loads((out / "export.json").read_text())
    (out / "export.json").write_text(json.dumps({**about, "layout": 99}))
    with pytest.raises(FormatError, match="layout 99"):
        load_export_file(out)


def test_the_order_of_trips_is_splits_and_then_the_datasets(tmp_path: Path) -> None:
    trips, grids = build_toy_trips(2, longest=9)
    trips.reverse()
    source = build_toy_source(trips, grids)
    run_export(source, "vlnce-r2r", tmp_path / "out")
    import json

    names = json.loads((tmp_path / "out/gn0_ids.json").read_text())
    expected = sorted(trips, key=lambda t: t.episode.split)
    assert [n["id"] for n in names] == [t.episode.id for t in expected]


def test_two_runs_at_once_into_one_folder_are_refused(
    short_source: ExportSource, tmp_path: Path
) -> None:
    def another(stage: str, done: int, total: int) -> None:
        if stage == "episodes" and done == 1:
            with pytest.raises(DataError, match="another run is writing"):
                run_export(short_source, "vlnce-r2r", tmp_path / "out")

    run_export(short_source, "vlnce-r2r", tmp_path / "out", progress=another)
    assert check_export(tmp_path / "out") == []
    assert not (tmp_path / "out/.lock").exists()


def test_an_export_that_died_at_its_very_end_is_finished(
    short_source: ExportSource, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Killed after the last file, or after export.json and before the tidying up."""
    from gn0.export import export_run

    whole = tmp_path / "whole/out"
    run_export(short_source, "lerobot-v3", whole)
    for name in ("write_card", "_tidy"):
        out = tmp_path / name / "out"

        def die(*_: object) -> None:
            raise KeyboardInterrupt

        monkeypatch.setattr(export_run, name, die)
        with pytest.raises(KeyboardInterrupt):
            run_export(short_source, "lerobot-v3", out)
        monkeypatch.undo()
        run_export(short_source, "lerobot-v3", out)
        assert read_tree(out) == read_tree(whole)


def test_a_format_without_words_takes_a_path_once(tmp_path: Path) -> None:
    from gn0.export.export_run import SAME_PATH

    done = run_export(
        toy_source(2, longest=9), "navdp", tmp_path / "out", ExportSettings(spacing=0.3)
    )
    assert done.written == 2 and done.skipped == {SAME_PATH: 2}


@pytest.mark.parametrize("name", ["", "../x", "a/b", "-x", "ä", "a b", "x" * 65])
def test_a_name_that_is_no_name_is_refused(name: str) -> None:
    with pytest.raises(ConfigError, match="cannot be used in ids"):
        ExportSettings(name=name)


def test_the_bar_moves_within_an_episode(short_source: ExportSource, tmp_path: Path) -> None:
    said: list[tuple[str, int, int]] = []
    done = run_export(
        short_source, "streamvln", tmp_path / "out", progress=lambda *step: said.append(step)
    )
    pictures = [count for stage, count, _ in said if stage == "pictures"]
    assert pictures == list(range(1, len(pictures) + 1)) and len(pictures) >= done.frames > 2


def test_a_folder_that_is_no_export_is_named_as_such(tmp_path: Path) -> None:
    with pytest.raises(StorageError, match=r"not an export of ours.*--format"):
        load_export_file(tmp_path)
