"""LeRobot v2.1: the tables and `meta/` that InternNav's formats are built on.

A dataset folder holds `data/chunk-000/episode_000000.parquet` (a row a frame), and in `meta/`
`info.json`, `tasks.jsonl`, `episodes.jsonl` and `episodes_stats.jsonl`. InternNav adds keys of its
own to these lines and keeps pictures as plain files, which `info.json` does not list.
"""

from __future__ import annotations

import io
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from numpy.typing import NDArray

from gn0.data.lerobot_schema import count_columns
from gn0.errors import FormatError
from gn0.export.faults import Faults, encode_lines, load_lines, load_typed
from gn0.missions.episode_files import read_table
from gn0.storage import write_bytes, write_json

VERSION = "v2.1"
CHUNK = 1000  # episodes a chunk
DATA_PATH = "data/chunk-{episode_chunk:03d}/episode_{episode_index:06d}.parquet"
INDEX_COLUMNS = ("timestamp", "frame_index", "episode_index", "index", "task_index")
_TYPES = {"float32": pa.float32(), "float64": pa.float64(), "int64": pa.int64()}


class Info(msgspec.Struct):
    """What we read of `info.json`."""

    codebase_version: str
    total_episodes: int
    total_frames: int
    total_tasks: int
    chunks_size: int
    fps: float
    data_path: str
    features: dict[str, dict[str, Any]]


class EpisodeLine(msgspec.Struct):
    """What we read of a line of `episodes.jsonl`."""

    episode_index: int
    tasks: list[str]
    length: int


class TaskLine(msgspec.Struct):
    """What we read of a line of `tasks.jsonl`."""

    task_index: int
    task: str


@dataclass(frozen=True)
class MetaEpisode:
    """An episode as `meta/` tells it.

    Attributes:
        index: its number in the folder.
        length: frames.
        task: the instruction.
        stats: statistics of each numeric column, see `column_stats`.
        more: further keys of its line in `episodes.jsonl`.
        more_stats: further keys of its line in `episodes_stats.jsonl`.
        more_task: further keys of its line in `tasks.jsonl`.
    """

    index: int
    length: int
    task: str
    stats: Mapping[str, Any]
    more: Mapping[str, Any] = field(default_factory=dict)
    more_stats: Mapping[str, Any] = field(default_factory=dict)
    more_task: Mapping[str, Any] = field(default_factory=dict)


def episode_path(folder: Path, index: int, chunk: int = CHUNK) -> Path:
    """The table of an episode."""
    return folder / DATA_PATH.format(episode_chunk=index // chunk, episode_index=index)


def describe_features(columns: Mapping[str, NDArray[Any]]) -> dict[str, dict[str, Any]]:
    """The `features` of `info.json` for columns [frames, …]."""
    return {
        name: {"dtype": str(values.dtype), "shape": list(values.shape[1:]) or [1], "names": None}
        for name, values in columns.items()
    }


def encode_columns(columns: Mapping[str, NDArray[Any]]) -> bytes:
    """Columns [frames, …] as Parquet: numbers, lists of numbers, or lists of lists.

    The same values give the same bytes.
    """
    arrays = {name: _nested(np.ascontiguousarray(values)) for name, values in columns.items()}
    stream = io.BytesIO()
    pq.write_table(pa.table(arrays), stream, compression="zstd", write_statistics=False)
    return stream.getvalue()


def _nested(values: NDArray[Any]) -> pa.Array:
    array = pa.array(values.reshape(-1), _TYPES[str(values.dtype)])
    for width in values.shape[:0:-1]:
        offsets = np.arange(0, len(array) + 1, width, dtype=np.int32)
        array = pa.ListArray.from_arrays(pa.array(offsets), array)
    return array


def load_columns(path: Path, shapes: Mapping[str, tuple[int, ...]]) -> dict[str, NDArray[Any]]:
    """Columns of a table as arrays [frames, *shape], float64 or int64.

    Raises:
        StorageError, FormatError: missing, not Parquet, or a column absent or of another shape.
    """
    table = read_table(path)
    found = {}
    for name, shape in shapes.items():
        if name not in table.column_names:
            raise FormatError("column is missing", file=path, field=name, remedy="export it again")
        array = table.column(name).combine_chunks()
        if isinstance(array, pa.ChunkedArray):
            array = pa.concat_arrays(array.chunks)
        count = len(array)
        while pa.types.is_list(array.type) or pa.types.is_fixed_size_list(array.type):
            array = array.flatten()
        if not (pa.types.is_floating(array.type) or pa.types.is_integer(array.type)):
            raise FormatError(f"column is {array.type}", file=path, field=name)
        values = np.asarray(array.to_numpy(zero_copy_only=False))
        if array.null_count or values.size != count * int(np.prod(shape, dtype=np.int64)):
            raise FormatError(
                f"not {list(shape)} numbers per frame", file=path, field=name,
                remedy="export it again",
            )  # fmt: skip
        kind = np.float64 if values.dtype.kind == "f" else np.int64
        found[name] = values.astype(kind).reshape(count, *shape)
    return found


def column_stats(columns: Mapping[str, NDArray[Any]]) -> dict[str, dict[str, Any]]:
    """min, max, mean, std and count of each column, as `episodes_stats.jsonl` has them."""
    found = {}
    for name, values in columns.items():
        flat = values.reshape(len(values), -1).astype(np.float64)
        shape = values.shape[1:] or (1,)
        whole = values.dtype.kind == "i"
        found[name] = {
            "min": _shaped(flat.min(axis=0), shape, whole),
            "max": _shaped(flat.max(axis=0), shape, whole),
            "mean": _shaped(flat.mean(axis=0), shape, False),
            "std": _shaped(flat.std(axis=0), shape, False),
            "count": [len(values)],
        }
    return found


def _shaped(values: NDArray[Any], shape: tuple[int, ...], whole: bool) -> list[Any]:
    array = values.reshape(shape)
    return (array.astype(np.int64) if whole else array).tolist()


def write_meta(
    folder: Path,
    episodes: Sequence[MetaEpisode],
    features: Mapping[str, Any],
    fps: float,
    chunk: int = CHUNK,
) -> None:
    """Write `meta/` of a dataset folder.

    Raises:
        StorageError: a file cannot be written.
    """
    meta = folder / "meta"
    frames = sum(episode.length for episode in episodes)
    info = {
        "codebase_version": VERSION,
        "robot_type": "gn0",
        "total_episodes": len(episodes),
        "total_frames": frames,
        "total_tasks": len(episodes),
        "total_videos": 0,
        "total_chunks": (len(episodes) + chunk - 1) // chunk,
        "chunks_size": chunk,
        "fps": fps,
        "splits": {"train": f"0:{len(episodes)}"},
        "data_path": DATA_PATH,
        "video_path": None,
        "features": dict(features),
    }
    write_json(meta / "info.json", info)
    tasks = [{"task_index": e.index, "task": e.task, **e.more_task} for e in episodes]
    lines = [
        {"episode_index": e.index, "tasks": [e.task], "length": e.length, **e.more}
        for e in episodes
    ]
    stats = [{"episode_index": e.index, "stats": e.stats, **e.more_stats} for e in episodes]
    write_bytes(meta / "tasks.jsonl", encode_lines(tasks))
    write_bytes(meta / "episodes.jsonl", encode_lines(lines))
    write_bytes(meta / "episodes_stats.jsonl", encode_lines(stats))


def load_episode_lines(folder: Path) -> list[EpisodeLine]:
    """The lines of `episodes.jsonl`.

    Raises:
        StorageError, FormatError: missing or damaged.
    """
    path = folder / "meta/episodes.jsonl"
    lines = load_lines(path, EpisodeLine)
    if [line.episode_index for line in lines] != list(range(len(lines))):
        raise FormatError("episodes are not numbered 0, 1, 2, …", file=path)
    if not all(line.tasks for line in lines):
        raise FormatError("an episode without a task", file=path, field="tasks")
    return lines


def check_meta(folder: Path, faults: Faults) -> list[EpisodeLine]:
    """Check `meta/` and the tables against one another; the episodes found."""
    lines: list[EpisodeLine] = []
    with faults.guard():
        lines = load_episode_lines(folder)
    with faults.guard():
        info = load_typed(folder / "meta/info.json", Info)
        told = (info.codebase_version, info.total_episodes, info.total_frames, info.data_path)
        wanted = (VERSION, len(lines), sum(line.length for line in lines), DATA_PATH)
        faults.expect(told == wanted, f"{folder}/meta/info.json says {told}, found {wanted}")
        tasks = load_lines(folder / "meta/tasks.jsonl", TaskLine)
        faults.expect(
            info.total_tasks == len(tasks) and len({t.task_index for t in tasks}) == len(tasks),
            f"{folder}/meta/tasks.jsonl: tasks are missing or numbered twice",
        )
        stats = load_lines(folder / "meta/episodes_stats.jsonl", dict[str, Any])
        faults.expect(
            [s.get("episode_index") for s in stats] == [e.episode_index for e in lines],
            f"{folder}/meta/episodes_stats.jsonl: not one line per episode",
        )
        first = 0
        for line in lines:
            _check_table(folder, line, info, first, faults)
            first += line.length
    return lines


def _check_table(folder: Path, line: EpisodeLine, info: Info, first: int, faults: Faults) -> None:
    path = episode_path(folder, line.episode_index, max(info.chunks_size, 1))
    with faults.guard():
        shapes = {}
        for name, feature in info.features.items():
            shape = feature.get("shape")
            if not (isinstance(shape, list) and all(isinstance(v, int) for v in shape)):
                faults.add(f"{folder}/meta/info.json: feature {name!r} has no shape")
                continue
            shapes[name] = () if shape == [1] else tuple(shape)
        columns = load_columns(path, shapes)
        faults.expect(
            set(INDEX_COLUMNS) <= set(columns), f"{path}: lacks one of {', '.join(INDEX_COLUMNS)}"
        )
        if not set(INDEX_COLUMNS) <= set(columns):
            return
        count = len(columns["index"])
        faults.expect(
            count == line.length, f"{path}: {count} frames, episodes.jsonl says {line.length}"
        )
        wanted = count_columns(count, info.fps, line.episode_index, first, 0)
        for name in ("timestamp", "frame_index", "episode_index", "index"):
            same = np.allclose(columns[name], wanted[name], rtol=0, atol=1e-4)
            faults.expect(bool(same), f"{path}: column {name!r} does not count on")
        for name, values in columns.items():
            if values.dtype.kind == "f":
                faults.expect(
                    bool(np.isfinite(values).all()), f"{path}: {name!r} holds NaN or infinity"
                )
