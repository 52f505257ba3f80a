"""What the peers' own readers make of an export; each is skipped where its package is not here.

pip install lerobot && pytest tests/export/test_official_readers.py
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from gn0.export.trips import ExportSource


@pytest.mark.filterwarnings("ignore")
def test_lerobot_opens_the_dataset(
    exported: Callable[[str], Path], short_source: ExportSource
) -> None:
    module = pytest.importorskip("lerobot.datasets.lerobot_dataset", exc_type=ImportError)
    data = module.LeRobotDataset("gn0/toy", root=exported("lerobot-v3"))
    trips = sorted(short_source.trips(), key=lambda trip: trip.episode.split)
    assert data.num_episodes == len(trips) and len(data) == sum(t.frames for t in trips)
    states = np.array([row["observation.state"].numpy() for row in data.hf_dataset])
    assert np.allclose(states, np.vstack([t.poses for t in trips]), atol=1e-5)
    first = data[len(trips[0].poses)]
    assert first["task"] == trips[1].episode.instruction
    assert tuple(first["observation.images.front"].shape) == (3, 72, 96)


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
