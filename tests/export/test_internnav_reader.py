"""What InternNav's loaders and models make of our VLN-PE files, by their own rules.

The rules are written down from InternRobotics/InternNav @7a5c62400ac45b313d9b709c740b64191556a242
(`internnav/utils/loader.py`, `internnav/dataset/cma_lerobot_dataset.py` and `base.py`,
`internnav/evaluator/utils/common.py`, `internnav/env/utils/internutopia_extension/tasks/
vln_eval_task.py`, `internnav/model/basemodel/cma/cma_policy.py`,
`internnav/env/utils/episode_loader/dataset_utils.py`) and share nothing with the exporter.
"""

from __future__ import annotations

import dataclasses
import gzip
import json
import os
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow.parquet as pq
import pytest
from msgspec.structs import replace

from gn0.errors import ConfigError
from gn0.export.export_run import check_export, remark_export, run_export
from gn0.export.exporter import ExportSettings, get_dataset_exporter
from gn0.export.trips import RGBD, ExportSource, Trip
from gn0.export.vlnpe import plain_names
from gn0.sim.presets import find_preset
from gn0.testing.toy_trips import ToyEyes, build_toy_source, build_toy_trips, toy_source

ALLOWED = ["r2r"]  # cma_lerobot_dataset.py 41, rdp_lerobot_dataset.py 106
OBSERVED = (256, 256, 1)  # cma_policy.py 131 to 136: Box(0, 1, (256, 256, 1))
MAX_DEPTH = 10  # common.py 193: m that `norm_depth` makes 1, vln_eval_task.py 113
MAX_STEP = 200  # internnav/configs/model/cma.py 12
MOVED = range(
    8000
)  # dataset_utils.py 15 to 335: trajectories whose starts it moves are below 7,290
FIELDS = ("camera_position", "camera_orientation", "camera_yaw", "robot_position",
          "robot_orientation", "robot_yaw", "progress", "step", "action")  # fmt: skip


def all_keys(root: Path) -> list[str]:
    """`get_all_keys`, loader.py 124 to 154."""
    keys = []
    for scan in os.listdir(root):
        if not (root / scan).is_dir() or scan not in ALLOWED:
            continue
        for scene in os.listdir(root / scan):
            data = root / scan / scene / "data"
            if not (root / scan / scene).is_dir():
                continue
            assert data.exists()  # the other branch formats a text as a number, and fails
            for chunk in os.listdir(data):
                for file in os.listdir(data / chunk):
                    if file.startswith("episode_") and file.endswith(".parquet"):
                        number = int(file.split("_")[1].split(".")[0])
                        keys.append(f"{scan}_{scene}_{int(chunk.split('-')[1]):03d}_{number:06d}")
    return sorted(keys)


def data_of(root: Path, key: str) -> dict[str, Any]:
    """`get_data_by_key`, loader.py 156 to 256."""
    parts = key.split("_")
    assert parts[1] not in ("flash", "aliengo")
    base = root / parts[0] / parts[1]
    chunk, index = f"chunk-{int(parts[-2]):03d}", int(parts[-1])
    table = pq.ParquetFile(base / f"data/{chunk}/episode_{index:06d}.parquet").read(
        use_threads=False
    )
    first = last = 0
    for line in (base / "meta/episodes_stats.jsonl").read_text().splitlines():
        stats = json.loads(line)
        if stats.get("episode_index") == index:
            told = stats.get("task_index", {})
            first, last = told.get("min", 0), told.get("max", 0)
            break
    tasks = [
        task
        for task in map(json.loads, (base / "meta/tasks.jsonl").read_text().splitlines())
        if first <= task["task_index"] <= last
    ]
    found = {name: np.array(table.column(f"observation.{name}").to_pylist()) for name in FIELDS}
    for name in ("rgb", "depth"):
        found[name] = np.load(
            base / f"videos/{chunk}/observation.images.{name}/episode_{index:06d}.npy"
        )
    return {**found, "tasks": tasks, "status": [task["finish_status"] for task in tasks]}


def turned(item: dict[str, Any]) -> tuple[list[float], list[float], list[list[float]]]:
    """`load_data` for mp3d: start, rotation (w, x, y, z) and path with z up."""
    x, z, y = item["start_position"]
    r1, r2, r3, r4 = item["start_rotation"]
    w1, x1, y1, z1 = -r4, r1, r3, -r2
    w2, z2 = np.cos(np.pi / 4), np.sin(np.pi / 4)
    rotation = [w1 * w2 - z1 * z2, x1 * w2 + y1 * z2, y1 * w2 - x1 * z2, w1 * z2 + z1 * w2]
    return [x, -y, z], rotation, [[a, -c, b] for a, b, c in item["reference_path"]]


@pytest.fixture(scope="module")
def odd_source() -> ExportSource:
    """Short trips in two scenes whose names would be cut up and meet each other."""
    trips, grids = build_toy_trips(2, longest=9)
    names = {"plan-0": "flat_01", "plan-1": "flat-01"}
    renamed = [
        dataclasses.replace(t, episode=replace(t.episode, scene_id=names[t.episode.scene_id]))
        for t in trips
    ]
    return build_toy_source(renamed, {names[name]: grid for name, grid in grids.items()})


@pytest.fixture(scope="module")
def odd_export(odd_source: ExportSource, tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("pe") / "out"
    run_export(odd_source, "vln-pe", out)
    return out


def _trips(source: ExportSource) -> list[Trip]:
    return sorted(source.trips(), key=lambda trip: trip.episode.split)


def test_the_loader_finds_every_episode_with_all_its_fields(
    odd_source: ExportSource, odd_export: Path
) -> None:
    keys = all_keys(odd_export / "traj_data")
    trips = {(t.episode.instruction, *t.poses[0, :2].round(6)): t for t in _trips(odd_source)}
    assert len(keys) == 4 and len({key.split("_")[1] for key in keys}) == 2
    starts = []
    for key in keys:
        data = data_of(odd_export / "traj_data", key)
        (task,) = data["tasks"]
        assert data["status"] == ["success"] and len(task["instruction_tokens"]) == 200
        trip = trips[(task["instruction_text"], *data["robot_position"][0, :2].round(6))]
        assert task["task"] == task["instruction_text"]
        assert data["action"].tolist() == trip.actions  # CMA: gt_actions, shifted to prev_actions
        assert len(data["action"]) == len(data["rgb"]) == len(data["depth"]) <= MAX_STEP
        assert data["rgb"].dtype == np.uint8 and data["rgb"].shape[-1] == 3
        assert data["robot_yaw"].shape == data["step"].shape == data["progress"].shape
        starts.append(tuple(data["robot_position"][0]))
    wanted = sorted((*trip.poses[0, :2], 0.0) for trip in _trips(odd_source))
    assert np.allclose(sorted(starts), wanted)


def test_depth_is_what_its_models_see_when_they_are_evaluated(
    odd_source: ExportSource, odd_export: Path
) -> None:
    """`norm_depth` of the metres, in the size of the depth encoder's space."""
    root = odd_export / "traj_data"
    by_start = {tuple(np.round(t.poses[0, :2], 6)): t for t in _trips(odd_source)}
    camera = find_preset("vlnce_r2r")
    for key in all_keys(root):
        data = data_of(root, key)
        assert data["depth"].shape[1:] == OBSERVED
        assert data["depth"].min() >= 0 and data["depth"].max() <= 1
        trip = by_start[tuple(np.round(data["robot_position"][0, :2], 6))]
        eyes = odd_source.eyes
        assert isinstance(eyes, ToyEyes)
        seen = next(eyes.look(trip, trip.poses[:1], camera, RGBD)).depth
        assert seen is not None
        metres = np.minimum(seen, MAX_DEPTH)
        assert np.abs(data["depth"][0, ..., 0] * MAX_DEPTH - metres).max() < 1e-4


def test_raw_episodes_begin_where_the_trajectories_begin(
    odd_source: ExportSource, odd_export: Path
) -> None:
    for split in ("train", "test"):
        path = odd_export / f"raw_data/r2r/{split}/{split}.json.gz"  # load_data: root/split
        episodes = json.loads(gzip.decompress(path.read_bytes()))["episodes"]
        trips = [trip for trip in _trips(odd_source) if trip.episode.split == split]
        for item, trip in zip(episodes, trips, strict=True):
            place, (w, x, y, z), nodes = turned(item)
            assert np.allclose(place[:2], trip.poses[0, :2], atol=1e-9)
            yaw = np.arctan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z))
            assert abs(np.angle(np.exp(1j * (yaw - trip.poses[0, 2])))) < 1e-9
            assert np.allclose(nodes[0][:2], trip.episode.path[0])
            assert item["trajectory_id"] not in MOVED
            assert item["scene_id"].split("/")[1] == trip.episode.scene_id


def test_names_of_scenes_stay_apart_without_an_underscore() -> None:
    names = ["a_b", "a-b", "a_b_", "flash", "0001_839920", "plain"]
    plain = plain_names(names)
    assert len(set(plain.values())) == len(names) and plain["plain"] == "plain"
    assert plain["a-b"] == "a-b" and not any("_" in name for name in plain.values())
    assert plain["flash"] != "flash"


def test_a_camera_that_its_models_cannot_take_is_refused(
    short_source: ExportSource, tmp_path: Path
) -> None:
    with pytest.raises(ConfigError, match="256×256"):
        run_export(short_source, "vln-pe", tmp_path / "out", ExportSettings(camera="streamvln"))
    assert not (tmp_path / "out").exists()


def test_the_check_names_what_the_loader_would_not_find(odd_export: Path, tmp_path: Path) -> None:
    exporter = get_dataset_exporter("vln-pe")
    assert check_export(odd_export) == []
    for change, told in (
        (("traj_data/r2r", "traj_data/apartment"), "looks nowhere else"),
        (("traj_data/r2r/flat-01", "traj_data/r2r/flat_01"), "may have no _"),
    ):
        folder = shutil.copytree(odd_export, tmp_path / change[1].replace("/", "-"))
        (folder / change[0]).rename(folder / change[1])
        assert any(told in fault for fault in exporter.check(folder))
        if "apartment" in change[1]:
            assert all_keys(folder / "traj_data") == []
    folder = shutil.copytree(odd_export, tmp_path / "metres")
    stack = next(folder.rglob("observation.images.depth/*.npy"))
    np.save(stack, np.load(stack) * np.float32(MAX_DEPTH))
    assert any("not a share of 10 m" in fault for fault in exporter.check(folder))
    wrong = shutil.copytree(odd_export, tmp_path / "of-3dgs")
    assert any("3dgs" in remark for remark in remark_export(wrong))  # cma_lerobot_dataset.py 57


@pytest.mark.parametrize("many", [MAX_STEP, MAX_STEP + 1])
def test_a_walk_that_the_loader_cuts_is_counted(tmp_path: Path, many: int) -> None:
    trip = next(iter(toy_source(1).trips()))
    long = dataclasses.replace(
        trip,
        poses=np.tile(trip.poses[:1], (many, 1)),
        moves=np.full(many - 1, 2, np.int8),
        ahead=np.zeros((many, 6), np.int8),
    )
    eyes = ToyEyes({trip.episode.scene_id: toy_source(1).grid(trip.episode.scene_id)})
    small = replace(find_preset("vlnce_r2r"), name="small")
    source = dataclasses.replace(
        toy_source(1), trips=lambda: iter([long]), preset=small, eyes=_Blind(eyes)
    )
    done = run_export(source, "vln-pe", tmp_path / "out")
    cut = {"walk of more than 200 steps, which the loader cuts": 1}
    assert done.notes == (cut if many > MAX_STEP else {})


class _Blind:
    """Sees the same picture everywhere, quickly."""

    def __init__(self, eyes: ToyEyes) -> None:
        self._eyes = eyes

    def frames(self, trip: Trip, sensors: Any) -> Any:
        camera = find_preset("vlnce_r2r")
        frame = next(self._eyes.look(trip, trip.poses[:1], camera, sensors))
        for _ in range(trip.frames):
            yield frame

    look = None
