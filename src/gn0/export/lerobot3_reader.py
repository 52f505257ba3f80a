"""LeRobot v3.0, reading: the layout, what its own loader takes for granted, and the way back."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pyarrow as pa

from gn0.errors import FormatError
from gn0.export.clips import inspect_clip, read_clip
from gn0.export.faults import Faults, load_typed
from gn0.export.trips import Frame, Recovered
from gn0.missions.files import read_table

VERSION = "v3.0"
CAMERA = "observation.images.front"
FPS = 10
DATA_MB, VIDEO_MB = 100, 200  # a file is closed before it grows over this
PARTS = "parts"  # of episodes, until they are put together
DATA_PATH = "data/chunk-{chunk_index:03d}/file-{file_index:03d}.parquet"
VIDEO_PATH = "videos/{video_key}/chunk-{chunk_index:03d}/file-{file_index:03d}.mp4"
EPISODES, TASKS = "meta/episodes/chunk-000/file-000.parquet", "meta/tasks.parquet"
FILES_A_CHUNK = 1000
FEATURES: dict[str, tuple[str, list[int], list[str] | None]] = {
    "observation.state": ("float32", [3], ["x", "y", "yaw"]),
    "action": ("float32", [3], ["forward", "left", "yaw"]),
    "label.discrete": ("int64", [1], None),
    "label.ahead": ("int64", [6], None),
    "next.done": ("bool", [1], None),
    "timestamp": ("float32", [1], None),
    "frame_index": ("int64", [1], None),
    "episode_index": ("int64", [1], None),
    "index": ("int64", [1], None),
    "task_index": ("int64", [1], None),
}
LABELS = ("observation.state", "action", "label.discrete", "label.ahead", "next.done")
ARROW = {"float32": pa.float32(), "int64": pa.int64(), "bool": pa.bool_()}


class Info(msgspec.Struct):
    """What we read of `info.json`."""

    codebase_version: str
    total_episodes: int
    total_frames: int
    total_tasks: int
    fps: int
    data_path: str
    video_path: str
    features: dict[str, dict[str, Any]]
    splits: dict[str, str]


@dataclass(frozen=True)
class EpisodeRow:
    """What we read of a row of `meta/episodes`."""

    index: int
    tasks: list[str]
    length: int
    first: int
    data: tuple[int, int]
    video: tuple[int, int]
    begin: float
    end: float
    id: str
    scene: str


def check_folder(folder: Path) -> list[str]:
    """Faults of a LeRobot v3.0 folder of ours."""
    faults = Faults()
    with faults.guard():
        info = load_typed(folder / "meta/info.json", Info)
        rows = _load_rows(folder)
        _check_info(info, rows, folder, faults)
        _check_tasks(info, rows, folder, faults)
        _check_data(info, rows, folder, faults)
        _check_videos(info, rows, folder, faults)
        load_typed(folder / "meta/stats.json", dict[str, dict[str, Any]])
    return faults.told()


def load_folder(folder: Path) -> list[Recovered]:
    """The episodes of a LeRobot v3.0 folder of ours.

    Raises:
        StorageError, FormatError: missing or damaged.
    """
    info = load_typed(folder / "meta/info.json", Info)
    return [_recover(row, info, folder) for row in _load_rows(folder)]


def _load_rows(folder: Path) -> list[EpisodeRow]:
    path = folder / EPISODES
    table = read_table(path)
    video = f"videos/{CAMERA}"
    kinds: dict[str, type | tuple[type, ...]] = {
        "episode_index": int, "tasks": list, "length": int, "dataset_from_index": int,
        "dataset_to_index": int, "data/chunk_index": int, "data/file_index": int,
        f"{video}/chunk_index": int, f"{video}/file_index": int,
        f"{video}/from_timestamp": float, f"{video}/to_timestamp": float,
        "meta/episodes/chunk_index": int, "meta/episodes/file_index": int,
        "gn0_id": str, "gn0_scene": str,
    }  # fmt: skip
    missing = [name for name in kinds if name not in table.column_names]
    if missing:
        raise FormatError(
            "column is missing", file=path, field=missing[0], remedy="export it again"
        )
    rows = []
    for number, row in enumerate(table.select(list(kinds)).to_pylist()):
        for name, kind in kinds.items():
            if not isinstance(row[name], kind):
                raise FormatError(f"row {number + 1} is {row[name]!r:.40}", file=path, field=name)
        if not row["tasks"] or not all(isinstance(task, str) for task in row["tasks"]):
            raise FormatError(f"row {number + 1} has no task", file=path, field="tasks")
        rows.append(
            EpisodeRow(
                row["episode_index"], row["tasks"], row["length"], row["dataset_from_index"],
                (row["data/chunk_index"], row["data/file_index"]),
                (row[f"{video}/chunk_index"], row[f"{video}/file_index"]),
                row[f"{video}/from_timestamp"], row[f"{video}/to_timestamp"],
                row["gn0_id"], row["gn0_scene"],
            )
        )  # fmt: skip
    return rows


def _check_info(info: Info, rows: list[EpisodeRow], folder: Path, faults: Faults) -> None:
    where = folder / "meta/info.json"
    frames = sum(row.length for row in rows)
    told = (info.codebase_version, info.total_episodes, info.total_frames)
    faults.expect(
        told == (VERSION, len(rows), frames), f"{where} says {told}, found {len(rows)}, {frames}"
    )
    faults.expect(
        (info.data_path, info.video_path) == (DATA_PATH, VIDEO_PATH), f"{where}: other paths"
    )
    wanted = [CAMERA, *FEATURES]
    faults.expect(set(info.features) == set(wanted), f"{where}: features are {list(info.features)}")
    first = 0
    for number, row in enumerate(rows):
        faults.expect(
            row.index == number and row.first == first,
            f"{folder / EPISODES}: row {number + 1} does not count on",
        )
        first += row.length
    spans = sorted(info.splits.values(), key=lambda span: int(span.split(":")[0] or 0)
                   if span.split(":")[0].isdigit() else -1)  # fmt: skip
    ends = ["0", *(span.split(":")[-1] for span in spans)]
    good = [span.split(":")[0] for span in spans] == ends[:-1] and ends[-1] == str(len(rows))
    faults.expect(good, f"{where}: splits do not cover 0 to {len(rows)}")


def _check_tasks(info: Info, rows: list[EpisodeRow], folder: Path, faults: Faults) -> None:
    table = read_table(folder / TASKS)
    pandas = (table.schema.metadata or {}).get(b"pandas", b"")
    faults.expect(
        set(table.column_names) == {"task", "task_index"}
        and b'"index_columns": ["task"]' in pandas,
        f"{folder / TASKS}: not a table of pandas whose index is the task",
    )
    if set(table.column_names) == {"task", "task_index"}:
        texts = table.column("task").to_pylist()
        faults.expect(
            len(texts) == info.total_tasks
            and table.column("task_index").to_pylist() == list(range(len(texts))),
            f"{folder / TASKS}: tasks are missing or out of order",
        )
        faults.expect(
            {task for row in rows for task in row.tasks} <= set(texts),
            f"{folder / TASKS}: an episode's task is missing",
        )


def _data(folder: Path, file: tuple[int, int]) -> pa.Table:
    path = folder / DATA_PATH.format(chunk_index=file[0], file_index=file[1])
    table = read_table(path)
    for name, (kind, shape, _) in FEATURES.items():
        wanted = ARROW[kind] if shape == [1] else pa.list_(ARROW[kind], shape[0])
        if name not in table.column_names or table.schema.field(name).type != wanted:
            raise FormatError(f"column is missing or not {wanted}", file=path, field=name)
        if table.column(name).null_count:
            raise FormatError("a cell is null", file=path, field=name)
    return table


def _check_data(info: Info, rows: list[EpisodeRow], folder: Path, faults: Faults) -> None:
    for file in dict.fromkeys(row.data for row in rows):
        own = [row for row in rows if row.data == file]
        table = _data(folder, file)
        where = folder / DATA_PATH.format(chunk_index=file[0], file_index=file[1])
        wanted = np.concatenate([np.full(row.length, row.index) for row in own])
        found = np.asarray(table.column("episode_index").to_numpy())
        if not faults.expect(
            np.array_equal(found, wanted), f"{where}: not the frames that meta/episodes names"
        ):
            continue
        frames = np.concatenate([np.arange(row.length) for row in own])
        times = np.asarray(table.column("timestamp").to_numpy(), np.float64)
        faults.expect(
            np.array_equal(table.column("frame_index").to_numpy(), frames)
            and bool((np.abs(times - frames / info.fps) < 1e-4).all()),
            f"{where}: frame_index or timestamp does not count on",
        )
        faults.expect(
            np.array_equal(table.column("index").to_numpy(), np.arange(len(found)) + own[0].first),
            f"{where}: index does not count on",
        )


def _check_videos(info: Info, rows: list[EpisodeRow], folder: Path, faults: Faults) -> None:
    shape = info.features.get(CAMERA, {}).get("shape")
    for file in dict.fromkeys(row.video for row in rows):
        own = [row for row in rows if row.video == file]
        path = folder / VIDEO_PATH.format(video_key=CAMERA, chunk_index=file[0], file_index=file[1])
        facts = inspect_clip(path)
        faults.expect(
            facts.frames == sum(row.length for row in own),
            f"{path}: {facts.frames} frames for {sum(row.length for row in own)} in the tables",
        )
        faults.expect(
            abs(facts.fps - info.fps) < 1e-6 and [facts.height, facts.width, 3] == shape,
            f"{path}: {facts.width}x{facts.height} at {facts.fps:g}, info.json says otherwise",
        )
        done = 0
        for row in own:
            off = abs(row.begin - done / info.fps) + abs(row.end - (done + row.length) / info.fps)
            faults.expect(off < 1e-6, f"{folder / EPISODES}: times of episode {row.index} are off")
            done += row.length


def _recover(row: EpisodeRow, info: Info, folder: Path) -> Recovered:
    table = _data(folder, row.data)
    mask = np.asarray(table.column("episode_index").to_numpy()) == row.index
    if int(mask.sum()) != row.length or row.length < 1 or info.fps < 1:
        raise FormatError(f"frames of episode {row.index} are missing", file=folder)
    own = table.filter(pa.array(mask))
    state = own.column("observation.state").combine_chunks()
    actions = np.asarray(own.column("label.discrete").to_numpy())
    path = folder / VIDEO_PATH.format(
        video_key=CAMERA, chunk_index=row.video[0], file_index=row.video[1]
    )
    first = round(row.begin * info.fps)
    flat = state.flatten() if isinstance(state, pa.Array) else pa.concat_arrays(
        [chunk.flatten() for chunk in state.chunks]
    )  # fmt: skip
    return Recovered(
        id=row.id,
        scene=row.scene,
        instruction=row.tasks[0],
        frames=row.length,
        moves=tuple(int(a) for a in actions[:-1]),
        poses=np.asarray(flat.to_numpy(), np.float64).reshape(-1, 3),
        picture=lambda pose: Frame(read_clip(path, first + pose, 1)[0], None),
    )
