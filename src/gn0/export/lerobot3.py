"""LeRobot v3.0: episodes put together in larger tables and videos.

`data/chunk-000/file-000.parquet` holds the frames of many episodes, `videos/<camera>/…` their
pictures joined without encoding again, `meta/episodes/…` where each begins. Actions are the motion
to the next frame in the agent's frame; the discrete action and the next six stand beside it.
"""

from __future__ import annotations

import io
import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from numpy.typing import NDArray

from gn0.export.cameras import cos_sin
from gn0.export.clips import encode_frames, join_clips
from gn0.export.exporter import ExportSettings, Job, OwnPoses, Place, Record
from gn0.export.lerobot3_reader import (
    ARROW,
    CAMERA,
    DATA_MB,
    DATA_PATH,
    EPISODES,
    FEATURES,
    FILES_A_CHUNK,
    FPS,
    LABELS,
    PARTS,
    TASKS,
    VERSION,
    VIDEO_MB,
    VIDEO_PATH,
    check_folder,
    load_folder,
)
from gn0.export.lerobot21 import column_stats, index_columns
from gn0.export.trips import RGB, Recovered, Trip
from gn0.geometry import U8, wrap_angle
from gn0.missions.files import read_table
from gn0.storage import read_bytes, write_bytes, write_json


class ExporterLeRobot3(OwnPoses):
    """See the module."""

    name = "lerobot-v3"
    title = "LeRobot dataset v3.0"
    reader = "LeRobot ≥ 0.4: `LeRobotDataset(repo_id, root=DIR)`"
    frame = (
        "state: world of the scene, z up, x, y [m] and yaw [rad]; action: motion to the next frame "
        "in the agent's frame, forward and left [m], yaw [rad]"
    )
    dagger = True
    scratch = PARTS
    has_splits = True

    def why_not(self, trip: Trip, settings: ExportSettings) -> str:
        """It takes every walk."""
        return ""

    def write(self, trip: Trip, place: Place, job: Job) -> Record:
        """A clip and the statistics of an episode."""
        fps = job.settings.fps or FPS
        sums = _PictureSums()
        preset = job.settings.preset(job.source)
        seen = job.source.frames(trip, preset, RGB)
        clip = encode_frames((sums.add(f.rgb) for f in seen if f.rgb is not None), fps)
        job.shelf.put(_part(job.folder, place.number, "mp4"), clip.mp4)
        columns = _columns(trip)
        table = _encode_table(columns, LABELS)
        job.shelf.put(_part(job.folder, place.number, "parquet"), _parquet(table))
        stats = column_stats({k: v for k, v in columns.items() if v.dtype.kind in "fi"})
        return {
            "number": place.number,
            "split": trip.episode.split,
            "id": trip.episode.id,
            "scene": trip.episode.scene_id,
            "task": trip.episode.instruction,
            "size": list(preset.picture_size),
            "length": trip.frames,
            "sizes": [table.nbytes, len(clip.mp4)],
            "stats": {**stats, CAMERA: sums.stats()},
        }

    def finish(self, records: Sequence[Record], job: Job) -> None:
        """Tables, videos and meta."""
        folder, fps = job.folder, job.settings.fps or FPS
        tasks = {task: n for n, task in enumerate(dict.fromkeys(r["task"] for r in records))}
        first = np.r_[0, np.cumsum([record["length"] for record in records])].tolist()
        data = _divide([record["sizes"][0] for record in records], DATA_MB)
        for file, rows in enumerate(data):
            chunk, number = divmod(file, FILES_A_CHUNK)
            joined = pa.concat_tables(
                _numbered(folder, records[n], fps, n, first[n], tasks) for n in rows
            ).combine_chunks()
            path = folder / DATA_PATH.format(chunk_index=chunk, file_index=number)
            write_bytes(path, _parquet(joined))
        video = _divide([record["sizes"][1] for record in records], VIDEO_MB)
        for file, rows in enumerate(video):
            chunk, number = divmod(file, FILES_A_CHUNK)
            clips = [read_bytes(_part(folder, records[n]["number"], "mp4")) for n in rows]
            path = folder / VIDEO_PATH.format(
                video_key=CAMERA, chunk_index=chunk, file_index=number
            )
            write_bytes(path, join_clips(clips, fps))
        rows_of = _episode_rows(records, data, video, fps)
        write_bytes(folder / EPISODES, _parquet(pa.Table.from_pylist(rows_of)))
        write_bytes(folder / TASKS, _parquet(_tasks_table(list(tasks))))
        write_json(folder / "meta/stats.json", _join_stats([r["stats"] for r in records]))
        write_json(folder / "meta/info.json", _info(records, len(tasks), fps))

    def check(self, folder: Path) -> list[str]:
        """Everything that LeRobot's own loader takes for granted."""
        return check_folder(folder)

    def load(self, folder: Path) -> list[Recovered]:
        """Read it back."""
        return load_folder(folder)


class _PictureSums:
    """Exact sums of pixels, for the statistics of pictures in 0..1."""

    def __init__(self) -> None:
        self.pixels = 0
        self.frames = 0
        self.sum = np.zeros(3, np.int64)
        self.squares = np.zeros(3, np.int64)
        self.least = np.full(3, 255, np.int64)
        self.most = np.zeros(3, np.int64)

    def add(self, rgb: U8) -> U8:
        flat = rgb.reshape(-1, 3)
        wide = flat.astype(np.int64)
        self.sum += wide.sum(axis=0)
        self.squares += (wide * wide).sum(axis=0)
        self.least = np.minimum(self.least, flat.min(axis=0))
        self.most = np.maximum(self.most, flat.max(axis=0))
        self.pixels += len(flat)
        self.frames += 1
        return rgb

    def stats(self) -> dict[str, Any]:
        mean = self.sum / self.pixels / 255.0
        spread = np.sqrt(np.maximum(self.squares / self.pixels / 255.0**2 - mean**2, 0.0))
        values = {"min": self.least / 255.0, "max": self.most / 255.0, "mean": mean, "std": spread}
        found: dict[str, Any] = {k: v.reshape(3, 1, 1).tolist() for k, v in values.items()}
        return {**found, "count": [self.frames]}


def _part(folder: Path, number: int, kind: str) -> Path:
    return folder / PARTS / f"{number:06d}.{kind}"


def _columns(trip: Trip) -> dict[str, NDArray[Any]]:
    poses = trip.poses
    step = np.diff(poses, axis=0, append=poses[-1:])
    c, s = cos_sin(poses[:, 2])
    motion = np.column_stack(
        [
            c * step[:, 0] + s * step[:, 1],
            -s * step[:, 0] + c * step[:, 1],
            [wrap_angle(float(turn)) for turn in step[:, 2]],
        ]
    )
    ahead = np.zeros((trip.frames, 6), np.int64)
    width = min(6, trip.ahead.shape[1])
    ahead[:, :width] = trip.ahead[:, :width]
    return {
        "observation.state": poses.astype(np.float32),
        "action": motion.astype(np.float32),
        "label.discrete": np.array([*trip.moves, 0], np.int64),
        "label.ahead": ahead,
        "next.done": np.arange(trip.frames) == trip.frames - 1,
    }


def _encode_table(columns: Mapping[str, NDArray[Any]], names: Sequence[str]) -> pa.Table:
    arrays = []
    for name in names:
        kind, shape, _ = FEATURES[name]
        flat = pa.array(columns[name].reshape(-1), ARROW[kind])
        arrays.append(flat if shape == [1] else pa.FixedSizeListArray.from_arrays(flat, shape[0]))
    return pa.Table.from_arrays(arrays, names=list(names))


def _numbered(
    folder: Path, record: Record, fps: int, number: int, first: int, tasks: Mapping[str, int]
) -> pa.Table:
    """The table of an episode with the columns that count."""
    labels = read_table(_part(folder, record["number"], "parquet"))
    counted = index_columns(record["length"], fps, number, first, tasks[record["task"]])
    table = _encode_table(counted, list(counted))
    for name in reversed(LABELS):
        table = table.add_column(0, name, labels.column(name))
    return table


def _parquet(table: pa.Table) -> bytes:
    stream = io.BytesIO()
    pq.write_table(table, stream, compression="snappy", use_dictionary=True)
    return stream.getvalue()


def _divide(sizes: Sequence[int], megabytes: int) -> list[list[int]]:
    """Items in files, in order: a file is closed before it grows over a size."""
    files: list[list[int]] = []
    total = 0
    for number, size in enumerate(sizes):
        if not files or total + size > megabytes * 2**20:
            files.append([])
            total = 0
        files[-1].append(number)
        total += size
    return files


def _episode_rows(
    records: Sequence[Record], data: list[list[int]], video: list[list[int]], fps: int
) -> list[dict[str, Any]]:
    data_of = {n: file for file, rows in enumerate(data) for n in rows}
    video_of = {n: file for file, rows in enumerate(video) for n in rows}
    done, first, rows = dict.fromkeys(range(len(video)), 0), 0, []
    for number, record in enumerate(records):
        length = record["length"]
        file = video_of[number]
        row: dict[str, Any] = {
            "episode_index": number,
            "tasks": [record["task"]],
            "length": length,
            "data/chunk_index": data_of[number] // FILES_A_CHUNK,
            "data/file_index": data_of[number] % FILES_A_CHUNK,
            "dataset_from_index": first,
            "dataset_to_index": first + length,
            f"videos/{CAMERA}/chunk_index": file // FILES_A_CHUNK,
            f"videos/{CAMERA}/file_index": file % FILES_A_CHUNK,
            f"videos/{CAMERA}/from_timestamp": done[file] / fps,
            f"videos/{CAMERA}/to_timestamp": (done[file] + length) / fps,
            "meta/episodes/chunk_index": 0,
            "meta/episodes/file_index": 0,
            "gn0_id": record["id"],
            "gn0_scene": record["scene"],
        }
        for name, stats in record["stats"].items():
            row |= {f"stats/{name}/{key}": value for key, value in stats.items()}
        rows.append(row)
        done[file] += length
        first += length
    return rows


def _tasks_table(tasks: list[str]) -> pa.Table:
    """Tasks as pandas writes a frame whose index is the text: readers look texts up by it."""
    table = pa.table({"task_index": pa.array(range(len(tasks)), pa.int64()), "task": tasks})
    described = {
        "index_columns": ["task"],
        "column_indexes": [
            {
                "name": None, "field_name": None, "pandas_type": "unicode", "numpy_type": "object",
                "metadata": {"encoding": "UTF-8"},
            }
        ],
        "columns": [
            {
                "name": "task_index", "field_name": "task_index", "pandas_type": "int64",
                "numpy_type": "int64", "metadata": None,
            },
            {
                "name": "task", "field_name": "task", "pandas_type": "unicode",
                "numpy_type": "object", "metadata": None,
            },
        ],
        "creator": {"library": "pyarrow", "version": "0"},
        "pandas_version": "2.0.0",
    }  # fmt: skip
    return table.replace_schema_metadata({"pandas": json.dumps(described)})


def _join_stats(parts: Sequence[dict[str, Any]]) -> dict[str, Any]:
    """Statistics of all frames from those of each episode."""
    found: dict[str, Any] = {}
    for name in parts[0]:
        own = [part[name] for part in parts]
        counts = np.array([s["count"][0] for s in own], np.float64)
        means = np.array([s["mean"] for s in own])
        weights = (counts / counts.sum()).reshape(-1, *[1] * (means.ndim - 1))
        mean = (weights * means).sum(axis=0)
        spread = (weights * (np.array([s["std"] for s in own]) ** 2 + (means - mean) ** 2)).sum(0)
        found[name] = {
            "min": np.array([s["min"] for s in own]).min(axis=0).tolist(),
            "max": np.array([s["max"] for s in own]).max(axis=0).tolist(),
            "mean": mean.tolist(),
            "std": np.sqrt(spread).tolist(),
            "count": [int(counts.sum())],
        }
    return found


def _info(records: Sequence[Record], tasks: int, fps: int) -> dict[str, Any]:
    width, height = records[0]["size"]
    features: dict[str, Any] = {
        CAMERA: {
            "dtype": "video",
            "shape": [height, width, 3],
            "names": ["height", "width", "channels"],
            "info": {
                "video.height": height,
                "video.width": width,
                "video.codec": "vp9",
                "video.pix_fmt": "yuv420p",
                "video.is_depth_map": False,
                "video.fps": fps,
                "video.channels": 3,
                "has_audio": False,
            },
        }
    }
    for name, (kind, shape, names) in FEATURES.items():
        features[name] = {"dtype": kind, "shape": shape, "names": names}
    splits: dict[str, str] = {}
    for split in dict.fromkeys(r["split"] for r in records):
        own = [n for n, r in enumerate(records) if r["split"] == split]
        splits[split] = f"{own[0]}:{own[-1] + 1}"
    return {
        "codebase_version": VERSION,
        "robot_type": "gn0",
        "total_episodes": len(records),
        "total_frames": sum(r["length"] for r in records),
        "total_tasks": tasks,
        "chunks_size": FILES_A_CHUNK,
        "data_files_size_in_mb": DATA_MB,
        "video_files_size_in_mb": VIDEO_MB,
        "fps": fps,
        "splits": splits,
        "data_path": DATA_PATH,
        "video_path": VIDEO_PATH,
        "features": features,
    }
