"""LeRobot's own reader over the data cache and the export: every field, with a DataLoader."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from gn0.data.dataset import Dataset
from gn0.data.episode_frames import read_frames
from gn0.data.lerobot_schema import DEPTH_KEY, FEATURES, FPS, VIDEOS, motions
from gn0.export.dataset_source import open_source
from gn0.export.export_run import run_export
from gn0.export.exporter import ExportSettings

module = pytest.importorskip("lerobot.datasets.lerobot_dataset", exc_type=ImportError)
pytestmark = pytest.mark.filterwarnings("ignore")
NEAR = 12.0  # of 255, root mean square: what AV1 at crf 30 may lose


@pytest.fixture(scope="module", params=["cache", "export"])
def folder(request: pytest.FixtureRequest, walks: Dataset, tmp_path_factory: Any) -> Path:
    """The same samples, as the cache has them and as they are exported."""
    if request.param == "cache":
        return walks.folder / "pictures/lerobot"
    out = Path(tmp_path_factory.mktemp("export")) / "lerobot"
    run_export(open_source(walks.folder, exact=True), "lerobot-v3", out, ExportSettings())
    return out


@pytest.fixture(scope="module")
def data(folder: Path) -> Any:
    return module.LeRobotDataset("gn0/walks", root=folder)


def test_cache_and_export_have_one_schema(data: Any) -> None:
    assert data.fps == FPS == 2
    assert set(data.features) == {*FEATURES, *VIDEOS.values(), DEPTH_KEY}
    assert {f["info"]["video.codec"] for f in data.features.values() if f["dtype"] == "video"} == {
        "av1"
    }


def test_every_field_of_every_sample(data: Any, walks: Dataset) -> None:
    assert data.num_episodes == len(walks.sampled) and len(data) == walks.about.rows
    names = [row["gn0_id"] for row in data.meta.episodes]
    index = 0
    kinds = ("rgb", "history", "bev", "occupancy", "depth", "goal_picture")
    for name in names:
        rows, episode = walks.rows(name), walks.episode(name)
        goal = bool(name != "words")
        frames = read_frames(walks, name, kinds if goal else kinds[:-1], exact=True)
        for t, frame in enumerate(frames):
            item = data[index]
            assert item["task"] == episode.instruction
            assert np.allclose(item["observation.state"], rows.poses[t], atol=1e-5)
            assert np.array_equal(item["action"], motions(rows.poses)[t])
            assert int(item["label.discrete"]) == rows.executed[t]
            assert item["label.ahead"].tolist() == rows.actions[t].tolist()
            assert np.array_equal(item["label.waypoints"].reshape(13, 2), rows.waypoints[t])
            assert np.array_equal(item["label.tokens_xy"].reshape(13, 2), rows.pixels[t])
            assert int(item["label.valid"]) == rows.valid[t]
            assert item["label.distance"] == rows.distance[t]
            assert item["label.source"] == "expert" and item["label.policy"] == ""
            assert bool(item["next.done"]) == (t == len(rows) - 1)
            assert bool(item["goal.shown"]) == goal
            depth = item[DEPTH_KEY].numpy()[0] / 1000
            assert np.abs(depth - frame["depth"]).max() <= 0.00051
            for sensor in ("rgb", "history"):
                assert _rms(item, sensor, frame[sensor]) < NEAR
            width, height = (int(v) for v in item["map.size_xy"])
            for sensor in ("bev", "occupancy"):
                assert frame[sensor].shape[:2] == (height, width)
                assert _rms(item, sensor, frame[sensor]) < NEAR
            x, y = (int(v) for v in item["map.here_xy"])
            assert frame["occupancy"][y, x].tolist() == [255, 0, 0]
            if goal:
                assert _rms(item, "goal", frame["goal_picture"]) < NEAR
            else:
                assert item[VIDEOS["goal"]].max() < 0.05
            index += 1
    assert index == len(data)


def _rms(item: Any, name: str, wanted: Any) -> float:
    height, width = wanted.shape[:2]
    shown = item[VIDEOS[name]].numpy().transpose(1, 2, 0)[:height, :width] * 255
    return float(np.sqrt(((shown - wanted) ** 2).mean()))


def test_a_data_loader_takes_batches_and_windows(folder: Path) -> None:
    import torch

    data = module.LeRobotDataset(
        "gn0/walks",
        root=folder,
        delta_timestamps={VIDEOS["rgb"]: [-1.0, -0.5, 0.0], "action": [0.0, 0.5, 1.0, 1.5]},
    )
    seen = 0
    for batch in torch.utils.data.DataLoader(data, batch_size=4, shuffle=True):
        count = len(batch["index"])
        assert batch[VIDEOS["rgb"]].shape == (count, 3, 3, 224, 224)
        assert batch["action"].shape == (count, 4, 3)
        assert batch[DEPTH_KEY].shape == (count, 1, 224, 224)
        assert len(batch["task"]) == count
        seen += count
    assert seen == len(data)


def test_statistics_and_policy_features_are_there(data: Any) -> None:
    from lerobot.datasets.utils import dataset_to_policy_features

    features = dataset_to_policy_features(data.features)
    assert features["action"].shape == (3,) and features["action"].type.value == "ACTION"
    assert [n for n, f in features.items() if f.type.value == "ACTION"] == ["action"]
    assert [n for n, f in features.items() if f.type.value == "STATE"] == ["observation.state"]
    for name in ("action", "observation.state"):
        assert data.meta.stats[name]["mean"].shape == (3,)
    assert data.meta.stats[VIDEOS["rgb"]]["std"].shape == (3, 1, 1)
