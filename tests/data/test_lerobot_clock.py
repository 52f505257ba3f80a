"""LeRobot's frames come as fast as the body acts: cache and export, read back with real times."""

from __future__ import annotations

import dataclasses
import json
from fractions import Fraction
from pathlib import Path

import msgspec
import numpy as np
import pyarrow.parquet as pq
import pytest

from gn0.data.build import build_dataset
from gn0.data.dataset import Dataset
from gn0.data.episode_frames import read_frames
from gn0.data.lerobot_schema import VIDEOS, frame_rate
from gn0.data.verify import verify_dataset
from gn0.export.clips import inspect_clip
from gn0.export.dataset_source import open_source
from gn0.export.export_run import check_export, run_export
from gn0.export.exporter import ExportSettings, get_dataset_exporter
from gn0.maps.navigation import NavigationMap
from gn0.missions.goal import sample_goal_episodes
from gn0.scenes.folder import load_scene
from gn0.sim.presets import find_preset
from gn0.suites.suite import save_suite
from gn0.testing.toy_trips import build_toy_source, build_toy_trips

FOLLOWER = find_preset("follower").agent


@pytest.fixture(scope="module")
def walks(data_suite, settings_of, tmp_path_factory) -> Dataset:
    """Two walks of the follower, with a LeRobot cache."""
    root = tmp_path_factory.mktemp("quick")
    scene = load_scene(data_suite.scene_folder("example-flat"))
    navigation = NavigationMap(scene.grid, FOLLOWER.radius)
    lengths = {"minimum_length": 1.5, "maximum_length": 2.5}
    episodes = sample_goal_episodes(scene, navigation, 2, 0, agent=FOLLOWER, **lengths)
    suite = save_suite(root / "suite", [scene], episodes, name="quick", camera="follower")
    assert suite.about.agent == FOLLOWER
    return build_dataset(suite, root / "data", settings_of("lerobot"))


def check_times(folder: Path, seconds: float) -> None:
    """Every frame at the time of its action, in tables and videos."""
    info = json.loads((folder / "meta/info.json").read_text())
    assert info["fps"] == pytest.approx(1 / seconds) and check_export(folder, "lerobot-v3") == []
    for path in sorted(folder.glob("data/*/*.parquet")):
        table = pq.read_table(path)
        times = table.column("timestamp").to_numpy()
        frames = table.column("frame_index").to_numpy()
        assert times.dtype == np.float32 and len(times)
        np.testing.assert_allclose(times, frames * seconds, rtol=1e-6)
    rows = pq.read_table(folder / "meta/episodes/chunk-000/file-000.parquet").to_pylist()
    for key in sorted(set(VIDEOS.values()) & set(info["features"])):
        for row in rows:
            begin, end = (row[f"videos/{key}/{side}_timestamp"] for side in ("from", "to"))
            assert end - begin == pytest.approx(row["length"] * seconds)
    for path in sorted(folder.glob("videos/*/*/*.mp4")):
        facts = inspect_clip(path)  # its frames are evenly spaced
        assert facts.fps == pytest.approx(1 / seconds)
        feature = info["features"][path.parent.parent.name]
        assert feature["info"]["video.fps"] == info["fps"]


def test_the_cache_of_a_quick_body_has_five_frames_a_second(walks: Dataset) -> None:
    folder = walks.folder / "pictures/lerobot"
    check_times(folder, 0.2)
    assert json.loads((folder / "meta/info.json").read_text())["fps"] == 5
    assert verify_dataset(walks.folder).ok
    for name in walks.sampled:
        drawn = list(read_frames(walks, name, ("rgb",), exact=True))
        stored = list(read_frames(walks, name, ("rgb",)))
        assert len(drawn) == len(stored) == len(walks.rows(name))
        for one, other in zip(drawn, stored, strict=True):  # each at its own place in the video
            gap = one["rgb"].astype(float) - other["rgb"]
            assert np.sqrt((gap**2).mean()) < 12


def test_so_has_its_export_unless_another_rate_is_asked_for(walks: Dataset, tmp_path: Path) -> None:
    source = open_source(walks.folder)
    run_export(source, "lerobot-v3", tmp_path / "own")
    check_times(tmp_path / "own", 0.2)
    assert "0.2 s an action" in (tmp_path / "own/README.md").read_text()
    run_export(source, "lerobot-v3", tmp_path / "asked", ExportSettings(fps=10))
    check_times(tmp_path / "asked", 0.1)


@pytest.mark.parametrize("seconds", [0.1, 0.3, 0.4, 0.7, 1.0, 60.0])
def test_rates_that_are_no_whole_number_keep_their_times(seconds: float, tmp_path: Path) -> None:
    trips, grids = build_toy_trips(2, longest=9)
    body = msgspec.structs.replace(trips[0].episode.agent, step_seconds=seconds)
    quick = [
        dataclasses.replace(trip, episode=msgspec.structs.replace(trip.episode, agent=body))
        for trip in trips
    ]
    run_export(build_toy_source(quick, grids), "lerobot-v3", tmp_path / "out")
    check_times(tmp_path / "out", seconds)
    for found in get_dataset_exporter("lerobot-v3").load(tmp_path / "out"):
        assert found.picture is not None and found.picture(found.frames - 1).rgb is not None


def test_a_frame_rate_is_exact() -> None:
    assert (frame_rate(0.5), frame_rate(0.2), frame_rate(1.0)) == (2, 5, 1)
    assert frame_rate(0.3) == Fraction(10, 3) and frame_rate(0.4) == Fraction(5, 2)
