"""The tables and `meta/` of LeRobot datasets, from episodes that both writers describe alike."""

from __future__ import annotations

import io
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from gn0.data.lerobot_schema import (
    COUNTERS,
    DATA_MB,
    DATA_PATH,
    DEPTH_KEY,
    EPISODES,
    FEATURES,
    FILES_A_CHUNK,
    FOLLOWED,
    INFO,
    LABELS,
    STATS,
    TASKS,
    TEXT,
    VERSION,
    VIDEO_MB,
    VIDEO_PATH,
    VIDEOS,
    Feature,
    Film,
    Rate,
    count_columns,
    describe_columns,
    describe_features,
    join_stats,
    tell_rate,
)

ARROW = {"float32": pa.float32(), "int64": pa.int64(), "bool": pa.bool_(), TEXT: pa.string()}
DEPTH_TYPE = pa.struct([("bytes", pa.binary()), ("path", pa.string())])  # as `datasets.Image`


@dataclass(frozen=True)
class Span:
    """Where an episode's frames are: number of the file, and of its first frame in there."""

    file: int
    first: int


@dataclass(frozen=True, eq=False)
class EpisodeEntry:
    """What `meta/` says of an episode.

    Attributes:
        id, scene, split, mission, task: of the episode; the task is its instruction.
        length: frames.
        data: number of its data file.
        videos: where its frames are, by the video's short name. Episodes may share frames.
        stats: statistics of its columns and pictures.
        map_size: (width, height) [px] of its exact maps.
        beside: paths of BEV, bare occupancy picture and goal picture; "" where there is none.
    """

    id: str
    scene: str
    split: str
    mission: str
    task: str
    length: int
    data: int
    videos: Mapping[str, Span]
    stats: Mapping[str, Any] = field(default_factory=dict)
    map_size: tuple[int, int] = (0, 0)
    beside: tuple[str, str, str] = ("", "", "")


def file_path(name: str, number: int) -> str:
    """A file by its number: name "data", or the short name of a video."""
    chunk, file = divmod(number, FILES_A_CHUNK)
    if name == "data":
        return DATA_PATH.format(chunk_index=chunk, file_index=file)
    return VIDEO_PATH.format(video_key=VIDEOS[name], chunk_index=chunk, file_index=file)


def number_tasks(texts: Sequence[str]) -> dict[str, int]:
    """Each text once, sorted, with its number."""
    return {text: number for number, text in enumerate(sorted(set(texts)))}


def column_type(feature: Feature) -> pa.DataType:
    """How a feature is stored."""
    kind = ARROW[feature.dtype]
    return kind if feature.size == 1 else pa.list_(kind, feature.size)


def label_table(columns: Mapping[str, Any], depth: Sequence[bytes] | None = None) -> pa.Table:
    """The frames of an episode, without the columns that count; `depth`: a PNG file each."""
    features = LABELS | {name: own for name, own in FOLLOWED.items() if name in columns}
    arrays = [_column(columns[name], feature) for name, feature in features.items()]
    names = list(features)
    if depth is not None:
        arrays.insert(0, depth_column(depth))
        names.insert(0, DEPTH_KEY)
    return pa.Table.from_arrays(arrays, names=names)


def add_followed(labels: pa.Table, columns: Mapping[str, Any]) -> pa.Table:
    """The frames of an episode with the columns of `FOLLOWED`, which other episodes have."""
    for name, feature in FOLLOWED.items():
        labels = labels.append_column(name, _column(columns[name], feature))
    return labels


def depth_column(files: Sequence[bytes]) -> pa.Array:
    """PNG files as a column of pictures."""
    return pa.array([{"bytes": data, "path": None} for data in files], DEPTH_TYPE)


def _column(values: Any, feature: Feature) -> pa.Array:
    kind = ARROW[feature.dtype]
    if feature.size == 1:
        return pa.array(values, kind)
    flat = pa.array(np.ascontiguousarray(values).reshape(-1), kind)
    return pa.FixedSizeListArray.from_arrays(flat, feature.size)


def number_table(labels: pa.Table, fps: Rate, episode: int, first: int, task: int) -> pa.Table:
    """The frames of an episode with the columns that count."""
    table = labels
    counted = count_columns(len(labels), fps, episode, first, task)
    for name, feature in COUNTERS.items():
        table = table.append_column(name, _column(counted[name], feature))
    return table


def encode_table(table: pa.Table) -> bytes:
    """A table as the bytes of a Parquet file."""
    stream = io.BytesIO()
    repeats = [name for name in table.column_names if name != DEPTH_KEY]
    pq.write_table(table, stream, compression="snappy", use_dictionary=repeats)
    return stream.getvalue()


def divide(sizes: Sequence[int], megabytes: int) -> list[list[int]]:
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


def encode_meta(entries: Sequence[EpisodeEntry], film: Film) -> dict[str, bytes]:
    """The files of `meta/`, by path."""
    tasks = number_tasks([entry.task for entry in entries])
    return {
        TASKS: encode_tasks(list(tasks)),
        EPISODES: encode_table(pa.Table.from_pylist(episode_rows(entries, film))),
        STATS: _json(_all_stats(entries, film)),
        INFO: _json(describe_info(entries, len(tasks), film)),
    }


def _json(value: Any) -> bytes:
    return (json.dumps(value, indent=2, sort_keys=True, allow_nan=False) + "\n").encode()


def _all_stats(entries: Sequence[EpisodeEntry], film: Film) -> dict[str, Any]:
    """Statistics of all frames, those of the columns that count among them."""
    parts: list[dict[str, Any]] = []
    tasks, first = number_tasks([entry.task for entry in entries]), 0
    for number, entry in enumerate(entries):
        own = count_columns(entry.length, film.fps, number, first, tasks[entry.task])
        parts.append({**entry.stats, **describe_columns(own)})
        first += entry.length
    return join_stats(parts)


def episode_rows(entries: Sequence[EpisodeEntry], film: Film) -> list[dict[str, Any]]:
    """The rows of `meta/episodes`."""
    first, rows = 0, []
    for number, entry in enumerate(entries):
        row: dict[str, Any] = {
            "episode_index": number,
            "tasks": [entry.task],
            "length": entry.length,
            "data/chunk_index": entry.data // FILES_A_CHUNK,
            "data/file_index": entry.data % FILES_A_CHUNK,
            "dataset_from_index": first,
            "dataset_to_index": first + entry.length,
            "meta/episodes/chunk_index": 0,
            "meta/episodes/file_index": 0,
            "gn0_id": entry.id,
            "gn0_scene": entry.scene,
            "gn0_split": entry.split,
            "gn0_mission": entry.mission,
            "map.width": entry.map_size[0],
            "map.height": entry.map_size[1],
            "map.bev": entry.beside[0],
            "map.occupancy": entry.beside[1],
            "goal_picture": entry.beside[2],
        }
        for name in film.sizes:
            span, key = entry.videos[name], f"videos/{VIDEOS[name]}"
            row |= {
                f"{key}/chunk_index": span.file // FILES_A_CHUNK,
                f"{key}/file_index": span.file % FILES_A_CHUNK,
                f"{key}/from_timestamp": float(span.first / film.fps),
                f"{key}/to_timestamp": float((span.first + entry.length) / film.fps),
            }
        for name, stats in sorted(entry.stats.items()):  # notes of a part come back in any order
            row |= {f"stats/{name}/{what}": value for what, value in sorted(stats.items())}
        rows.append(row)
        first += entry.length
    return rows


def describe_splits(entries: Sequence[EpisodeEntry]) -> dict[str, str]:
    """Which episodes are of which split; all of them as one where splits are not in one piece."""
    runs: list[tuple[str, int]] = []
    for number, entry in enumerate(entries):
        if not runs or runs[-1][0] != entry.split:
            runs.append((entry.split, number))
    if len({split for split, _ in runs}) < len(runs) or not runs:
        return {"all": f"0:{len(entries)}"}
    ends = [begin for _, begin in runs[1:]] + [len(entries)]
    return {split: f"{begin}:{end}" for (split, begin), end in zip(runs, ends, strict=True)}


def describe_info(entries: Sequence[EpisodeEntry], tasks: int, film: Film) -> dict[str, Any]:
    """The content of `meta/info.json`."""
    return {
        "codebase_version": VERSION,
        "robot_type": "gn0",
        "fps": tell_rate(film.fps),
        "total_episodes": len(entries),
        "total_frames": sum(entry.length for entry in entries),
        "total_tasks": tasks,
        "chunks_size": FILES_A_CHUNK,
        "data_files_size_in_mb": DATA_MB,
        "video_files_size_in_mb": VIDEO_MB,
        "data_path": DATA_PATH,
        "video_path": VIDEO_PATH,
        "splits": describe_splits(entries),
        "features": describe_features(film),
    }


def encode_tasks(texts: Sequence[str]) -> bytes:
    """`meta/tasks.parquet` as pandas writes a frame whose index is the text of the task."""
    table = pa.table(
        {
            "task_index": pa.array(range(len(texts)), pa.int64()),
            "task": pa.array(list(texts), pa.string()),
        }
    )
    about = {
        "index_columns": ["task"],
        "column_indexes": [
            {"name": None, "field_name": None, "pandas_type": "unicode", "numpy_type": "object",
             "metadata": {"encoding": "UTF-8"}}
        ],
        "columns": [
            {"name": "task_index", "field_name": "task_index", "pandas_type": "int64",
             "numpy_type": "int64", "metadata": None},
            {"name": "task", "field_name": "task", "pandas_type": "unicode",
             "numpy_type": "object", "metadata": None},
        ],
        "creator": {"library": "pyarrow", "version": "0"},
        "pandas_version": "2.0.0",
    }  # fmt: skip
    return encode_table(
        table.replace_schema_metadata({"pandas": json.dumps(about, sort_keys=True)})
    )


def frame_columns(depth: bool, follows: bool = False) -> dict[str, pa.DataType]:
    """Name and type of each column of a data file."""
    features = FEATURES | FOLLOWED if follows else FEATURES
    columns = {name: column_type(feature) for name, feature in features.items()}
    return {DEPTH_KEY: DEPTH_TYPE, **columns} if depth else columns
