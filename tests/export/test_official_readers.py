"""What the peers' own readers make of an export; each is skipped where its package is not here.

pip install lerobot && pytest tests/export/test_official_readers.py
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from gn0.export.trips import RGB, ExportSource


@pytest.fixture
def lerobot_dataset(exported: Callable[[str], Path]) -> Any:
    """The export as LeRobot opens it."""
    module = pytest.importorskip("lerobot.datasets.lerobot_dataset", exc_type=ImportError)
    return module.LeRobotDataset("gn0/toy", root=exported("lerobot-v3"))


@pytest.mark.filterwarnings("ignore")
def test_lerobot_opens_the_tables(lerobot_dataset: Any, short_source: ExportSource) -> None:
    trips = sorted(short_source.trips(), key=lambda trip: trip.episode.split)
    assert lerobot_dataset.num_episodes == len(trips)
    assert len(lerobot_dataset) == sum(trip.frames for trip in trips)
    states = np.array([row["observation.state"].numpy() for row in lerobot_dataset.hf_dataset])
    assert np.allclose(states, np.vstack([trip.poses for trip in trips]), atol=1e-5)
    assert set(lerobot_dataset.meta.tasks.index) == {t.episode.instruction for t in trips}
    assert lerobot_dataset.meta.stats["action"]["mean"].shape == (3,)


@pytest.mark.filterwarnings("ignore")
def test_lerobot_decodes_the_frame_of_each_step(
    lerobot_dataset: Any, short_source: ExportSource
) -> None:
    trips = sorted(short_source.trips(), key=lambda trip: trip.episode.split)
    first = lerobot_dataset[trips[0].frames]
    assert first["task"] == trips[1].episode.instruction
    seen = next(short_source.eyes.frames(trips[1], RGB)).rgb
    shown = first["observation.images.front"].numpy().transpose(1, 2, 0) * 255
    assert seen is not None and np.abs(shown - seen).mean() < 8


@pytest.mark.filterwarnings("ignore")
def test_pandas_reads_the_tables_as_internnav_does(
    exported: Callable[[str], Path], short_source: ExportSource
) -> None:
    pandas = pytest.importorskip("pandas")
    folder = exported("navdp") / "vln_n1/gn0/plan-0"
    frame = pandas.read_parquet(folder / "data/chunk-000/episode_000000.parquet")
    extrinsic = np.vstack(frame["observation.camera_extrinsic"].tolist()[0]).reshape(4, 4)
    actions = np.array([np.stack(row) for row in frame["action"]]).reshape(-1, 4, 4)
    assert np.allclose(extrinsic[2, 3], actions[:, 2, 3])
    tasks = pandas.read_parquet(exported("lerobot-v3") / "meta/tasks.parquet")
    assert set(tasks.index) == {t.episode.instruction for t in short_source.trips()}
