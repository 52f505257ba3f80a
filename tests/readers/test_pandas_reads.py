"""pandas over exported tables, as InternNav and LeRobot read them."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from gn0.export.export_run import run_export
from gn0.export.exporter import ExportSettings
from gn0.testing.toy_trips import toy_source


def test_pandas_reads_the_tables_as_internnav_does(tmp_path: Path) -> None:
    pandas = pytest.importorskip("pandas")
    source = toy_source(1, longest=9)
    for name in ("navdp", "lerobot-v3"):
        run_export(source, name, tmp_path / name, ExportSettings(spacing=0.2))
    folder = tmp_path / "navdp/vln_n1/gn0/plan-0"
    frame = pandas.read_parquet(folder / "data/chunk-000/episode_000000.parquet")
    extrinsic = np.vstack(frame["observation.camera_extrinsic"].tolist()[0]).reshape(4, 4)
    actions = np.array([np.stack(row) for row in frame["action"]]).reshape(-1, 4, 4)
    assert np.allclose(extrinsic[2, 3], actions[:, 2, 3])
    tasks = pandas.read_parquet(tmp_path / "lerobot-v3/meta/tasks.parquet")
    assert set(tasks.index) == {trip.episode.instruction for trip in source.trips()}
