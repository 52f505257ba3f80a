"""The LeRobot cache is a LeRobot v3.0 dataset, by the fields that its readers look up."""

from __future__ import annotations

import json

import numpy as np
import pyarrow.parquet as pq
import pytest

from gn0.data.cache_lerobot import write_tables
from gn0.data.episode_frames import read_frames
from gn0.data.lerobot_schema import FPS, TEXT, VIDEOS, motions
from gn0.errors import DataError
from gn0.export.export_run import check_export


def load(dataset, path: str):
    return pq.read_table(dataset.folder / "pictures" / "lerobot" / path)


def info_of(dataset) -> dict:
    text = (dataset.folder / "pictures" / "lerobot" / "meta" / "info.json").read_text()
    return json.loads(text)


def test_info_describes_every_column_and_video(lerobot) -> None:
    info = info_of(lerobot)
    assert info["codebase_version"] == "v3.0" and info["fps"] == FPS == 2
    assert info["total_frames"] == lerobot.about.rows
    assert info["total_episodes"] == len(lerobot.sampled)
    videos = {name for name, f in info["features"].items() if f["dtype"] == "video"}
    assert videos == set(VIDEOS.values())
    for number in range(len(lerobot.about.parts)):
        table = load(lerobot, info["data_path"].format(chunk_index=0, file_index=number))
        assert set(table.column_names) == set(info["features"]) - videos
        for name in table.column_names:
            size = info["features"][name]["shape"][0]
            first = table.column(name)[0].as_py()
            assert size == (len(first) if isinstance(first, list) else 1), name
    for key in videos:
        path = info["video_path"].format(video_key=key, chunk_index=0, file_index=0)
        assert (lerobot.folder / "pictures" / "lerobot" / path).is_file()


def test_episodes_point_at_their_frames_and_seconds(lerobot) -> None:
    info, episodes = info_of(lerobot), load(lerobot, "meta/episodes/chunk-000/file-000.parquet")
    tasks = load(lerobot, "meta/tasks.parquet").to_pylist()
    index = 0
    for row in episodes.to_pylist():
        rows = lerobot.rows(row["gn0_id"])
        assert row["length"] == len(rows)
        assert (row["dataset_from_index"], row["dataset_to_index"]) == (index, index + len(rows))
        place = {"chunk_index": row["data/chunk_index"], "file_index": row["data/file_index"]}
        data = load(lerobot, info["data_path"].format(**place)).to_pydict()
        own = [i for i, e in enumerate(data["episode_index"]) if e == row["episode_index"]]
        assert [data["index"][i] for i in own] == list(range(index, index + len(rows)))
        assert [data["label.discrete"][i] for i in own] == rows.executed.tolist()
        assert [data["label.ahead"][i] for i in own] == rows.actions.tolist()
        waypoints = np.array([data["label.waypoints"][i] for i in own])
        assert np.array_equal(waypoints.reshape(-1, 13, 2), rows.waypoints)
        tokens = np.array([data["label.tokens_xy"][i] for i in own])
        assert np.array_equal(tokens.reshape(-1, 13, 2), rows.pixels)
        assert np.array_equal([data["action"][i] for i in own], motions(rows.poses))
        np.testing.assert_allclose(
            [data["timestamp"][i] for i in own], np.arange(len(rows)) / FPS, atol=1e-6
        )
        instruction = lerobot.episode(row["gn0_id"]).instruction
        assert row["tasks"] == [instruction]
        assert tasks[data["task_index"][own[0]]]["task"] == instruction
        for key in VIDEOS.values():
            begin, end = (row[f"videos/{key}/{side}_timestamp"] for side in ("from", "to"))
            assert end - begin == len(rows) / FPS
        maps = lerobot.folder / "pictures" / "lerobot"
        assert (maps / row["map.bev"]).is_file() and (maps / row["map.occupancy"]).is_file()
        assert (maps / row["goal_picture"]).is_file()
        index += len(rows)
    assert index == lerobot.about.rows


def test_tasks_are_indexed_by_their_text_for_pandas(lerobot) -> None:
    table = load(lerobot, "meta/tasks.parquet")
    about = json.loads(table.schema.metadata[b"pandas"])
    assert about["index_columns"] == ["task"]


def test_statistics_are_finite_and_of_the_right_shape(lerobot) -> None:
    path = lerobot.folder / "pictures" / "lerobot" / "meta" / "stats.json"
    stats, info = json.loads(path.read_text()), info_of(lerobot)
    texts = {name for name, f in info["features"].items() if f["dtype"] == TEXT}
    assert set(stats) == set(info["features"]) - texts and len(texts) == 2
    for name, own in stats.items():
        shape = (3, 1, 1) if name in VIDEOS.values() else tuple(info["features"][name]["shape"])
        for what in ("min", "max", "mean", "std"):
            values = np.array(own[what], float)
            assert values.shape == shape and np.isfinite(values).all(), name
        assert own["count"] == [lerobot.about.rows]
    frames = [
        f["rgb"] for e in lerobot.sampled for f in read_frames(lerobot, e, ("rgb",), exact=True)
    ]
    mean = np.mean([f.mean(axis=(0, 1)) for f in frames], axis=0) / 255
    np.testing.assert_allclose(np.ravel(stats[VIDEOS["rgb"]]["mean"]), mean, atol=0.01)


def test_missions_of_one_path_share_their_frames(lerobot) -> None:
    rows = load(lerobot, "meta/episodes/chunk-000/file-000.parquet").to_pylist()
    twin = next(row for row in rows if row["gn0_id"] == "zwilling")
    rollout = lerobot.rollout("zwilling")
    part = lerobot.part_of("zwilling")
    same = next(
        row for row in rows
        if row["gn0_id"] != "zwilling" and row["gn0_id"] in part.episodes
        and np.array_equal(lerobot.rollout(row["gn0_id"]).poses, rollout.poses)
    )  # fmt: skip
    spans = {k: v for k, v in twin.items() if k.startswith("videos/") and "goal" not in k}
    assert len(spans) == 16 and all(same[key] == value for key, value in spans.items())
    frames = read_frames(lerobot, "zwilling", ("rgb",))
    others = read_frames(lerobot, same["gn0_id"], ("rgb",))
    assert all(np.array_equal(a["rgb"], b["rgb"]) for a, b in zip(frames, others, strict=True))


def test_the_cache_passes_the_checks_of_an_export(lerobot) -> None:
    folder = lerobot.folder / "pictures" / "lerobot"
    assert check_export(folder, "lerobot-v3") == []


def test_a_part_of_an_earlier_version_is_named(lerobot) -> None:
    notes = {part.name: {"sums": {}, "places": [], "maps": {}} for part in lerobot.about.parts}
    with pytest.raises(DataError, match="earlier version") as caught:
        write_tables(lerobot, notes, lerobot.about.settings.pictures)
    assert "gn0 data render --layout lerobot" in caught.value.remedy
