"""LeRobot v3.0, reading: the layout, what its own loader takes for granted, and reading it back.

Reads what `gn0.data.lerobot_schema` names, and what versions before it wrote: one camera, fewer
columns.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pyarrow as pa

from gn0.data.lerobot_schema import (
    DATA_PATH,
    DEPTH_KEY,
    EPISODES,
    FEATURES,
    FOLLOWED,
    STATS,
    TASKS,
    TEXT,
    VERSION,
    VIDEO_PATH,
    VIDEOS,
)
from gn0.data.lerobot_tables import frame_columns
from gn0.data.picture_cache import decode_depth
from gn0.errors import FormatError
from gn0.export.clips import inspect_clip, read_clip
from gn0.export.faults import Faults, load_typed
from gn0.export.picture_files import picture_size
from gn0.export.trips import Frame, Recovered
from gn0.missions.episode_files import read_table
from gn0.storage import safe_join

OLD_CAMERA = "observation.images.front"  # of exports before there was one schema
_OLD = (
    "observation.state", "action", "label.discrete", "label.ahead", "next.done", "timestamp",
    "frame_index", "episode_index", "index", "task_index",
)  # fmt: skip


class Info(msgspec.Struct):
    """What we read of `info.json`."""

    codebase_version: str
    total_episodes: int
    total_frames: int
    total_tasks: int
    fps: float
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
    videos: dict[str, Span]
    id: str
    scene: str
    beside: tuple[str, ...]
    map_size: tuple[int, int]


@dataclass(frozen=True)
class Span:
    """Where an episode is in a video: chunk and file, and the seconds."""

    file: tuple[int, int]
    begin: float
    end: float


def check_folder(folder: Path) -> list[str]:
    """Faults of a LeRobot v3.0 folder of ours."""
    faults = Faults()
    with faults.guard():
        info = load_typed(folder / "meta/info.json", Info)
        rows = _load_rows(folder, _videos(info))
        _check_info(info, rows, folder, faults)
        _check_tasks(info, rows, folder, faults)
        _check_data(info, rows, folder, faults)
        for key in _videos(info):
            _check_video(key, info, rows, folder, faults)
        _check_beside(rows, folder, faults)
        _check_stats(info, folder, faults)
    return faults.told()


def load_folder(folder: Path) -> list[Recovered]:
    """The episodes of a LeRobot v3.0 folder of ours.

    Raises:
        StorageError, FormatError: missing or damaged.
    """
    info = load_typed(folder / "meta/info.json", Info)
    return [_recover(row, info, folder) for row in _load_rows(folder, _videos(info))]


def _is_old(info: Info) -> bool:
    """Whether an earlier version wrote it, with one camera."""
    return OLD_CAMERA in info.features


def _videos(info: Info) -> list[str]:
    """Names of the features that are videos."""
    found = [name for name, own in info.features.items() if own.get("dtype") == "video"]
    wanted = OLD_CAMERA if _is_old(info) else VIDEOS["rgb"]
    if wanted not in found:
        raise FormatError(
            f"no video {wanted!r} among the features", field="features", remedy="export it again"
        )
    return found


def _load_rows(folder: Path, videos: list[str]) -> list[EpisodeRow]:
    path = folder / EPISODES
    table = read_table(path)
    extra: dict[str, type | tuple[type, ...]] = {}
    if OLD_CAMERA not in videos:
        extra = {
            "map.width": int, "map.height": int, "map.bev": str, "map.occupancy": str,
            "goal_picture": str,
        }  # fmt: skip
    for key in videos:
        extra |= {
            f"videos/{key}/chunk_index": int, f"videos/{key}/file_index": int,
            f"videos/{key}/from_timestamp": float, f"videos/{key}/to_timestamp": float,
        }  # fmt: skip
    kinds: dict[str, type | tuple[type, ...]] = {
        "episode_index": int, "tasks": list, "length": int, "dataset_from_index": int,
        "dataset_to_index": int, "data/chunk_index": int, "data/file_index": int,
        "meta/episodes/chunk_index": int, "meta/episodes/file_index": int,
        "gn0_id": str, "gn0_scene": str, **extra,
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
                {key: _span(row, f"videos/{key}") for key in videos},
                row["gn0_id"], row["gn0_scene"],
                tuple(row.get(k, "") for k in ("map.bev", "map.occupancy", "goal_picture")),
                (row.get("map.width", 0), row.get("map.height", 0)),
            )
        )  # fmt: skip
    return rows


def _span(row: dict[str, Any], key: str) -> Span:
    return Span(
        (row[f"{key}/chunk_index"], row[f"{key}/file_index"]),
        row[f"{key}/from_timestamp"], row[f"{key}/to_timestamp"],
    )  # fmt: skip


def _columns(info: Info) -> dict[str, pa.DataType]:
    """Name and type of each column of a data file."""
    columns = frame_columns(
        DEPTH_KEY in info.features, not FOLLOWED.keys().isdisjoint(info.features)
    )
    return {name: columns[name] for name in _OLD} if _is_old(info) else columns


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
    faults.expect(
        set(info.features) == {*_columns(info), *_videos(info)},
        f"{where}: features are {list(info.features)}",
    )
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


def _data(folder: Path, file: tuple[int, int], info: Info) -> pa.Table:
    path = folder / DATA_PATH.format(chunk_index=file[0], file_index=file[1])
    table = read_table(path)
    for name, wanted in _columns(info).items():
        if name not in table.column_names or table.schema.field(name).type != wanted:
            raise FormatError(f"column is missing or not {wanted}", file=path, field=name)
        if table.column(name).null_count:
            raise FormatError("a cell is null", file=path, field=name)
    return table


def _check_data(info: Info, rows: list[EpisodeRow], folder: Path, faults: Faults) -> None:
    for file in dict.fromkeys(row.data for row in rows):
        own = [row for row in rows if row.data == file]
        table = _data(folder, file, info)
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
        if DEPTH_KEY in info.features:
            shape = info.features[DEPTH_KEY].get("shape")
            for cell in table.column(DEPTH_KEY):
                depth = decode_depth(cell.as_py()["bytes"] or b"", where, DEPTH_KEY)
                if not faults.expect(
                    [*depth.shape, 1] == shape, f"{where}: a depth picture of {depth.shape}"
                ):
                    break


def _check_video(
    key: str, info: Info, rows: list[EpisodeRow], folder: Path, faults: Faults
) -> None:
    """Episodes may share frames, so their spans are looked at, and not a sum of lengths."""
    shape = info.features[key].get("shape")
    for file in dict.fromkeys(row.videos[key].file for row in rows):
        own = [row for row in rows if row.videos[key].file == file]
        path = folder / VIDEO_PATH.format(video_key=key, chunk_index=file[0], file_index=file[1])
        facts = inspect_clip(path)
        faults.expect(
            abs(facts.fps - info.fps) < 1e-6 and [facts.height, facts.width, 3] == shape,
            f"{path}: {facts.width}x{facts.height} at {facts.fps:g}, info.json says otherwise",
        )
        spans: list[tuple[int, int]] = []
        for row in own:
            span = row.videos[key]
            first = round(span.begin * info.fps)
            off = abs(span.begin - first / info.fps)
            off += abs(span.end - (first + row.length) / info.fps)
            faults.expect(off < 1e-6, f"{folder / EPISODES}: times of episode {row.index} are off")
            spans.append((first, first + row.length))
        reached = 0
        for first, end in sorted(spans):  # a picture that stands still is as long as it ever stands
            faults.expect(
                0 <= first <= reached, f"{path}: frames {reached} to {first} belong to nobody"
            )
            reached = max(reached, end)
        faults.expect(
            facts.frames == reached, f"{path}: {facts.frames} frames for {reached} in the tables"
        )


def _check_beside(rows: list[EpisodeRow], folder: Path, faults: Faults) -> None:
    """The exact maps and goal pictures that rows name."""
    sizes: dict[str, tuple[int, int] | None] = {}
    for row in rows:
        for number, path in enumerate(row.beside):
            if path:
                sizes[path] = row.map_size if number < 2 else None
    for path, size in sizes.items():
        with faults.guard():
            found = picture_size(safe_join(folder, path))
            faults.expect(size in (None, found), f"{folder / path}: {found}, its row says {size}")


def _check_stats(info: Info, folder: Path, faults: Faults) -> None:
    stats = load_typed(folder / STATS, dict[str, dict[str, Any]])
    texts = {name for name, own in FEATURES.items() if own.dtype == TEXT}
    missing = set(info.features) - texts - set(stats) - ({"next.done"} if _is_old(info) else set())
    faults.expect(not missing, f"{folder / STATS}: lacks {', '.join(sorted(missing))}")


def _recover(row: EpisodeRow, info: Info, folder: Path) -> Recovered:
    table = _data(folder, row.data, info)
    mask = np.asarray(table.column("episode_index").to_numpy()) == row.index
    if int(mask.sum()) != row.length or row.length < 1 or info.fps <= 0:
        raise FormatError(f"frames of episode {row.index} are missing", file=folder)
    own = table.filter(pa.array(mask)).combine_chunks()
    state = pa.concat_arrays([c.flatten() for c in own.column("observation.state").chunks])
    actions = np.asarray(own.column("label.discrete").to_numpy())
    camera = OLD_CAMERA if _is_old(info) else VIDEOS["rgb"]
    span = row.videos[camera]
    path = folder / VIDEO_PATH.format(
        video_key=camera, chunk_index=span.file[0], file_index=span.file[1]
    )
    first = round(span.begin * info.fps)
    deep = own.column(DEPTH_KEY) if DEPTH_KEY in own.column_names else None

    def picture(pose: int) -> Frame:
        depth = None
        if deep is not None:
            data = deep[pose].as_py()["bytes"]
            depth = decode_depth(data, folder, DEPTH_KEY).astype(np.float32) / np.float32(1000)
        return Frame(read_clip(path, first + pose, 1)[0], depth)

    return Recovered(
        id=row.id,
        scene=row.scene,
        instruction=row.tasks[0],
        frames=row.length,
        moves=tuple(int(a) for a in actions[:-1]),
        poses=np.asarray(state.to_numpy(), np.float64).reshape(-1, 3),
        picture=picture,
    )
