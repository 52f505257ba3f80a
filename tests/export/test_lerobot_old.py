"""LeRobot exports of before, with one camera and few columns, are still read and checked."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from pathlib import Path

import pyarrow.parquet as pq

from gn0.data.lerobot_schema import DATA_PATH, EPISODES, VIDEOS
from gn0.export.exporter import get_dataset_exporter
from gn0.export.lerobot3_reader import OLD_CAMERA

COLUMNS = [
    "observation.state", "action", "label.discrete", "label.ahead", "next.done", "timestamp",
    "frame_index", "episode_index", "index", "task_index",
]  # fmt: skip


def _as_before(folder: Path) -> None:
    """Make an export what version 0 wrote: `observation.images.front`, and ten columns."""
    new = VIDEOS["rgb"]
    info = json.loads((folder / "meta/info.json").read_text())
    features = info["features"]
    info["features"] = {OLD_CAMERA: features[new], **{name: features[name] for name in COLUMNS}}
    (folder / "meta/info.json").write_text(json.dumps(info))
    data = folder / DATA_PATH.format(chunk_index=0, file_index=0)
    pq.write_table(pq.read_table(data).select(COLUMNS), data)
    table = pq.read_table(folder / EPISODES)
    kept = [n for n in table.column_names
            if not n.startswith(("map.", "goal", "gn0_split", "gn0_mission", "stats/"))
            and (not n.startswith("videos/") or n.startswith(f"videos/{new}/"))]  # fmt: skip
    table = table.select(kept).rename_columns([n.replace(new, OLD_CAMERA) for n in kept])
    pq.write_table(table, folder / EPISODES)
    stats = json.loads((folder / "meta/stats.json").read_text())
    stats[OLD_CAMERA] = stats.pop(new)
    (folder / "meta/stats.json").write_text(json.dumps(stats))
    for name, key in VIDEOS.items():
        if name == "rgb":
            (folder / "videos" / key).rename(folder / "videos" / OLD_CAMERA)
        else:
            shutil.rmtree(folder / "videos" / key, ignore_errors=True)
    shutil.rmtree(folder / "maps")


def test_an_export_with_one_camera_is_read(exported: Callable[[str], Path], tmp_path: Path) -> None:
    folder = Path(shutil.copytree(exported("lerobot-v3"), tmp_path / "old"))
    _as_before(folder)
    exporter = get_dataset_exporter("lerobot-v3")
    assert exporter.check(folder) == []
    now = {found.id: found for found in exporter.load(exported("lerobot-v3"))}
    before = exporter.load(folder)
    assert len(before) == len(now)
    for found in before:
        wanted = now[found.id]
        assert found.moves == wanted.moves and found.instruction == wanted.instruction
        assert found.poses is not None and (found.poses == wanted.poses).all()
        assert found.picture is not None and wanted.picture is not None
        assert (found.picture(3).rgb == wanted.picture(3).rgb).all()
