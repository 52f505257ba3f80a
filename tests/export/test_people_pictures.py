"""Exports that hold pictures show the people of each step, as a simulator plays them."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import msgspec
import numpy as np
import pytest

from gn0.data.build import build_dataset
from gn0.data.dataset import Dataset
from gn0.data.settings import BuildSettings, PictureSettings
from gn0.errors import DataError
from gn0.export.dataset_source import episode_digest, open_source
from gn0.export.export_run import remark_export, run_export
from gn0.export.exporter import ExportSettings, dataset_exporter_names, get_dataset_exporter
from gn0.export.trips import RGB, ExportSource, Trip
from gn0.geometry import U8
from gn0.missions.episode import AgentSpec
from gn0.sim.open import open_simulator
from gn0.sim.presets import find_preset
from gn0.suites.suite import save_suite
from gn0_trials.people_samples import (
    crossed_episode,
    follow_episode,
    save_bank,
    save_flat,
    save_peopled,
)

HOLD_PICTURES = [name for name in dataset_exporter_names() if get_dataset_exporter(name).pictures]
TAKE_FOLLOWING = {"navid", "uninavid", "lerobot-v3"}
HERE = {"views": ("tiny_128",), "spacing": 0.0, "merge_turns": True}


@pytest.fixture(scope="module")
def bank(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return save_bank(tmp_path_factory.mktemp("bank"))


@pytest.fixture(scope="module")
def dataset(bank: Path, tmp_path_factory: pytest.TempPathFactory) -> Dataset:
    """Nobody about; somebody who crosses; somebody to follow. Nothing is drawn yet."""
    root = tmp_path_factory.mktemp("peopled")
    none = BuildSettings(pictures=PictureSettings(layout="none"))
    return build_dataset(save_peopled(root / "suite", bank), root / "data", none, bank=bank)


@pytest.fixture(scope="module")
def source(dataset: Dataset) -> ExportSource:
    return open_source(dataset.folder)


def _play(dataset: Dataset, bank: Path, name: str, camera: str) -> list[U8]:
    """What a simulator shows along the walk of an episode, through a camera."""
    rows, episode = dataset.rows(name), dataset.episode(name)
    agent = dataset.about.agent
    if camera != dataset.about.camera:  # a camera of a robot's own is as high as it says
        height = find_preset(camera).agent.camera_height
        agent = msgspec.structs.replace(agent, camera_height=height)
    simulator = open_simulator(
        dataset.scene("flat"), camera, "cpu", {"rgb"}, agent, bank=bank,
        navigation=dataset.navigation("flat"), light=episode.light,
    )  # fmt: skip
    seen = [simulator.reset(episode)]
    for code in rows.executed[:-1].tolist():
        seen.append(simulator.step(code).observation)
    assert all(one.rgb is not None for one in seen)
    return [np.asarray(one.rgb) for one in seen]


def _off(a: U8, b: U8) -> float:
    return float(np.abs(a.astype(float) - b.astype(float)).mean())


@pytest.mark.parametrize("format", HOLD_PICTURES)
def test_people_are_in_the_pictures_where_they_were_then(
    format: str, dataset: Dataset, source: ExportSource, bank: Path, tmp_path: Path
) -> None:
    """Each picture is nearer to the simulator's of its step than to those of an empty room."""
    settings, exporter = ExportSettings(**HERE), get_dataset_exporter(format)  # type: ignore[arg-type]
    done = run_export(source, format, tmp_path, settings)
    found = {one.id: one for one in exporter.load(tmp_path)}
    names = {"a-alone", "b-crossed", "c-follow"}
    if format not in TAKE_FOLLOWING:
        names -= {"c-follow"}
        assert any("stands still" in why for why in done.skipped)
    assert found.keys() == names
    trips = {trip.episode.id: trip for trip in source.trips()}
    camera = exporter.cameras(source, settings)[0].name
    for name in sorted(names - {"a-alone"}):
        trip, read = trips[name], found[name].picture
        assert read is not None
        played = _play(dataset, bank, name, camera)
        kept = exporter.poses(trip, settings)
        step = [*range(len(kept))]
        if len(kept) < trip.frames:  # those at which a coarser move of theirs begins
            step = exporter.shown(trip)  # type: ignore[attr-defined]
        empty = _look_without(source, trip, camera)
        shown = 0
        for number in range(0, len(kept), 3):
            picture = read(number).rgb
            assert picture is not None
            truth, nobody = played[step[number]], empty[step[number]]
            height, width = picture.shape[:2]
            truth, nobody = truth[:height, :width], nobody[:height, :width]
            person = np.abs(truth.astype(int) - nobody).max(2) > 40
            if person.mean() < 0.01:  # nobody is in view
                continue
            shown += 1
            assert _off(picture[person], truth[person]) < _off(picture[person], nobody[person]) / 8
        assert shown


def _look_without(source: ExportSource, trip: Trip, camera: str) -> list[U8]:
    """What is seen along a trip as if nobody were there."""
    alone = msgspec.structs.replace(trip.episode, people=())
    trip = dataclasses.replace(trip, episode=alone)
    seen = source.eyes.look(trip, trip.poses, find_preset(camera), RGB)
    return [np.asarray(frame.rgb) for frame in seen]


def test_navdp_s_advice_for_steps_among_people_can_be_taken(
    dataset: Dataset, bank: Path, tmp_path: Path
) -> None:
    """The advised spacing is none that people refuse, and data of the advised body is not cut."""
    settings = ExportSettings(**HERE)  # type: ignore[arg-type]
    run_export(open_source(dataset.folder), "navdp", tmp_path / "long", settings)
    (told,) = remark_export(tmp_path / "long")
    assert "steps of 1.00 m" in told and "forward_step of 0.0625 m" in told
    assert "without people" in told
    close = msgspec.structs.replace(settings, spacing=0.0625)
    done = run_export(open_source(dataset.folder), "navdp", tmp_path / "close", close)
    assert any("--spacing 0" in why and "forward_step" in why for why in done.skipped)
    body = AgentSpec(radius=0.25, step_seconds=0.2, forward_step=0.0625)
    short = msgspec.structs.replace(crossed_episode(), agent=body)
    suite = save_suite(
        tmp_path / "suite", [save_flat(tmp_path / "scene")], [short], name="short", max_steps=60,
        camera="tiny_128", agent=body,
    )  # fmt: skip
    none = BuildSettings(pictures=PictureSettings(layout="none"))
    built = build_dataset(suite, tmp_path / "data", none, bank=bank)
    done = run_export(open_source(built.folder), "navdp", tmp_path / "short", settings)
    assert done.written == 1 and remark_export(tmp_path / "short") == []


def test_people_are_known_at_steps_alone(source: ExportSource) -> None:
    trip = next(trip for trip in source.trips() if trip.episode.people)
    between = (trip.poses[:-1] + trip.poses[1:]) / 2
    with pytest.raises(DataError, match="at its own steps"):
        list(source.eyes.look(trip, between, source.preset, RGB))


def test_other_people_are_another_export(source: ExportSource) -> None:
    episode = follow_episode()
    one, *others = episode.people
    moved = msgspec.structs.replace(one, yaw=one.yaw + 0.5)
    other = msgspec.structs.replace(episode, people=(moved, *others))
    assert episode_digest(episode) != episode_digest(other)
    trip = next(trip for trip in source.trips() if trip.follows)
    assert dataclasses.replace(trip, episode=other).way != trip.way
