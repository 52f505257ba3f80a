"""The cache as a LeRobot v3.0 dataset: pictures as AV1 videos, labels as Parquet.

    videos/observation.images.{rgb,history}/chunk-000/file-000.mp4   a file a part
    data/chunk-000/file-000.parquet                                  a file a part
    meta/{info,stats}.json, meta/tasks.parquet, meta/episodes/chunk-000/file-000.parquet
    maps/<hash>.png, goals/<hash>.jpg                                BEV, bare occupancy, goals

Maps have the size of their scene, which a LeRobot feature cannot; so they lie beside as PNG, named
in `meta/episodes` (`map.bev`, `map.occupancy`, and `goal_picture` for goal missions); the dots'
pixels are the feature `observation.map`. Each video is encoded by one thread with fixed settings:
the same pictures are the same bytes.
"""

from __future__ import annotations

import io
import json
import os
from collections.abc import Iterable, Mapping, Sequence
from fractions import Fraction
from pathlib import Path
from typing import Any, cast

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from numpy.typing import NDArray

from gn0.data.cache import DrawnStep, cache_folder, write_goal, write_maps, write_recorded
from gn0.data.dataset import Dataset, FileRecord
from gn0.data.samples import ACTIONS_AHEAD, POINTS, EpisodeRows
from gn0.data.settings import PictureSettings
from gn0.errors import FormatError, RenderError
from gn0.geometry import U8
from gn0.jobs.priority import keep_priority
from gn0.sim.history import COLUMNS, ROWS, TILE_HEIGHT, TILE_WIDTH
from gn0.sim.presets import find_preset
from gn0.sim.simulator import STEP_SECONDS
from gn0.storage import safe_join

LAYOUT = "lerobot"
VERSION = "v3.0"
FPS = round(1 / STEP_SECONDS)
FILES_A_CHUNK = 1000
VIDEOS = {"rgb": "observation.images.rgb", "history": "observation.images.history"}
CODEC, PRESET, KEY_FRAMES = "libsvtav1", "12", "2"
_GRAIN = 4  # every fourth pixel each way tells the statistics of pictures
_VECTORS: dict[str, tuple[str, int]] = {
    "observation.state": ("float32", 3),
    "observation.map": ("int64", 4),
    "action": ("int64", 1),
    "actions_ahead": ("int64", ACTIONS_AHEAD),
    "waypoints": ("float32", 2 * POINTS),
    "pixels": ("int64", 2 * POINTS),
    "valid": ("int64", 1),
    "distance": ("float32", 1),
    "collided": ("bool", 1),
}
_COUNTERS = {
    "timestamp": "float32", "frame_index": "int64", "episode_index": "int64", "index": "int64",
    "task_index": "int64",
}  # fmt: skip


def place_of(number: int) -> tuple[int, int]:
    """(chunk, file) of a part's files."""
    return divmod(number, FILES_A_CHUNK)


def file_path(kind: str, number: int) -> str:
    """A part's file: kind "data", or the key of a video."""
    chunk, file = place_of(number)
    name = f"chunk-{chunk:03d}/file-{file:03d}"
    return f"data/{name}.parquet" if kind == "data" else f"videos/{kind}/{name}.mp4"


class VideoWriter:
    """Frames of one size as an AV1 video in memory.

    Raises:
        RenderError: this PyAV was built without AV1.
    """

    def __init__(self, size: tuple[int, int], crf: int) -> None:
        os.environ.setdefault("SVT_LOG", "1")  # errors only
        import av

        self._stream = io.BytesIO()
        options = {"crf": str(crf), "preset": PRESET, "g": KEY_FRAMES, "svtav1-params": "lp=1"}
        try:
            self._container = av.open(self._stream, "w", format="mp4")
            added = self._container.add_stream(CODEC, rate=FPS, options=options)
        except (av.codec.codec.UnknownCodecError, ValueError) as error:
            raise RenderError(
                f"cannot encode AV1: {error}", remedy="install PyAV from PyPI, or use webdataset"
            ) from None
        self._video = cast(av.VideoStream, added)
        self._video.width, self._video.height = size
        self._video.pix_fmt = "yuv420p"
        self._video.thread_count = 1
        with keep_priority():
            self._video.codec_context.open()
        self._count = 0

    def add(self, rgb: U8) -> None:
        """The next frame [H, W, 3]."""
        import av

        frame = av.VideoFrame.from_ndarray(np.ascontiguousarray(rgb), format="rgb24")
        frame.pts, frame.time_base = self._count, Fraction(1, FPS)
        self._container.mux(self._video.encode(frame))
        self._count += 1

    def finish(self) -> bytes:
        """The video's bytes."""
        if self._count:
            self._container.mux(self._video.encode())
        self._container.close()
        return self._stream.getvalue()


class PixelSums:
    """Exact sums over a grain of pixels, for the statistics of pictures."""

    def __init__(self) -> None:
        self.count = 0
        self.low, self.high = [255] * 3, [0] * 3
        self.total, self.square = [0] * 3, [0] * 3

    def add(self, rgb: U8) -> None:
        """Add a picture [H, W, 3]."""
        grain = rgb[::_GRAIN, ::_GRAIN].reshape(-1, 3).astype(np.int64)
        self.count += len(grain)
        for c in range(3):
            self.low[c] = min(self.low[c], int(grain[:, c].min()))
            self.high[c] = max(self.high[c], int(grain[:, c].max()))
            self.total[c] += int(grain[:, c].sum())
            self.square[c] += int((grain[:, c] ** 2).sum())

    def values(self) -> dict[str, Any]:
        """The sums as plain values, for the journal."""
        return {
            "count": self.count, "low": self.low, "high": self.high, "total": self.total,
            "square": self.square,
        }  # fmt: skip


def write_videos(
    dataset: Dataset, number: int, steps: Iterable[DrawnStep], settings: PictureSettings
) -> tuple[list[FileRecord], dict[str, Any]]:
    """Write the videos and maps of part `number`; also what `write_tables` must know of them.

    Raises:
        StorageError: the disk refuses.
    """
    folder = cache_folder(dataset.folder, LAYOUT)
    width, height = find_preset(dataset.about.camera).picture_size
    sizes = {"rgb": (width, height), "history": (COLUMNS * TILE_WIDTH, ROWS * TILE_HEIGHT)}
    writers = {name: VideoWriter(size, settings.crf) for name, size in sizes.items()}
    sums = {name: PixelSums() for name in VIDEOS}
    shared: dict[str, FileRecord] = {}
    places: list[list[int]] = []
    named: dict[str, list[str]] = {}
    for step in steps:
        for name, writer in writers.items():
            picture = getattr(step.pictures, name)
            writer.add(picture)
            sums[name].add(picture)
        places.append([*step.places[0], *step.places[1]])
        if step.step == 0:
            goal = write_goal(folder, step, shared, settings)
            named[step.episode.id] = [*write_maps(folder, step, shared), goal]
    records = list(shared.values())
    for name, writer in writers.items():
        records.append(_put(folder, file_path(VIDEOS[name], number), writer.finish()))
    notes = {
        "sums": {name: sums[name].values() for name in VIDEOS},
        "places": places,
        "maps": named,
    }
    return records, notes


def write_tables(
    dataset: Dataset, notes: Mapping[str, Mapping[str, Any]], settings: PictureSettings
) -> list[FileRecord]:
    """Write data, meta and statistics, once all videos are there.

    Args:
        dataset: with its sample tables.
        notes: of each part by name, from `write_videos`.
        settings: of the cache.

    Raises:
        StorageError: the disk refuses.
    """
    folder = cache_folder(dataset.folder, LAYOUT)
    texts = sorted({dataset.episode(name).instruction for name in dataset.sampled})
    tasks = {text: index for index, text in enumerate(texts)}
    records: list[FileRecord] = []
    episodes: dict[str, list[Any]] = {}
    columns: dict[str, list[NDArray[Any]]] = {}
    index = 0
    for number, part in enumerate(dataset.about.parts):
        blocks = dataset.part_rows(part)
        own = notes[part.name]
        places = np.array(own["places"], np.int64).reshape(-1, 4)
        chunk, file = place_of(number)
        tables, begin = [], 0
        for block in blocks:
            end = begin + len(block)
            task = dataset.episode(block.episode_id).instruction
            values = frame_values(block, places[begin:end], index + begin, tasks[task])
            values["episode_index"][:] = len(episodes.get("length", ()))
            tables.append(values)
            _add_episode(
                episodes,
                block,
                task,
                (chunk, file),
                (index + begin, index + end),
                begin,
                own["maps"][block.episode_id],
                values,
            )
            begin = end
        if tables:
            joined = {name: np.concatenate([t[name] for t in tables]) for name in tables[0]}
            data = encode_frames(joined)
            records.append(_put(folder, file_path("data", number), data))
            for name, array in joined.items():
                columns.setdefault(name, []).append(array)
        index += begin
    records.append(_put(folder, "meta/tasks.parquet", encode_tasks(texts)))
    records.append(
        _put(folder, "meta/episodes/chunk-000/file-000.parquet", _encode_episodes(episodes))
    )
    info = describe_features(dataset, len(episodes.get("length", ())), index, len(texts), settings)
    stats = {name: describe_array(np.concatenate(arrays)) for name, arrays in columns.items()}
    for name, key in VIDEOS.items():
        stats[key] = describe_pixels([own["sums"][name] for own in notes.values()], index)
    records.append(_put(folder, "meta/info.json", _json(info)))
    records.append(_put(folder, "meta/stats.json", _json(stats)))
    return records


def _put(folder: Path, path: str, data: bytes) -> FileRecord:
    return write_recorded(folder, path, lambda put: (put(data), None)[1])


def _json(value: Any) -> bytes:
    return (json.dumps(value, indent=2, sort_keys=True, allow_nan=False) + "\n").encode()


def frame_values(
    block: EpisodeRows, places: NDArray[np.int64], index: int, task: int
) -> dict[str, NDArray[Any]]:
    """The columns of an episode's frames; `index` is the first one's, over all episodes."""
    n = len(block)
    frames = np.arange(n, dtype=np.int64)
    # an unreachable goal has no distance; LeRobot's statistics must stay finite
    distance = np.where(np.isfinite(block.distance), block.distance, np.float32(-1))
    return {
        "observation.state": block.poses.astype(np.float32),
        "observation.map": places,
        "action": block.executed.astype(np.int64)[:, None],
        "actions_ahead": block.actions.astype(np.int64),
        "waypoints": block.waypoints.reshape(n, -1).astype(np.float32),
        "pixels": block.pixels.reshape(n, -1).astype(np.int64),
        "valid": block.valid.astype(np.int64)[:, None],
        "distance": distance.astype(np.float32)[:, None],
        "collided": block.collided.astype(bool)[:, None],
        "timestamp": (frames / FPS).astype(np.float32),
        "frame_index": frames,
        "episode_index": np.zeros(n, np.int64),
        "index": index + frames,
        "task_index": np.full(n, task, np.int64),
    }


def encode_frames(values: Mapping[str, NDArray[Any]]) -> bytes:
    """A data file: vectors as lists, single numbers as themselves."""
    arrays, fields = [], []
    for name, array in values.items():
        kind = pa.from_numpy_dtype(array.dtype)
        if array.ndim == 2 and array.shape[1] > 1:
            items = pa.array(np.ascontiguousarray(array).reshape(-1), kind)
            array_ = pa.FixedSizeListArray.from_arrays(items, array.shape[1])
        else:
            array_ = pa.array(array.reshape(-1), kind)
        arrays.append(array_)
        fields.append(pa.field(name, array_.type))
    stream = io.BytesIO()
    table = pa.Table.from_arrays(arrays, schema=pa.schema(fields))
    pq.write_table(table, stream, compression="snappy")
    return stream.getvalue()


def encode_tasks(texts: Sequence[str]) -> bytes:
    """`meta/tasks.parquet`: a pandas table whose index is the text of the task."""
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
    table = table.replace_schema_metadata({"pandas": json.dumps(about, sort_keys=True)})
    stream = io.BytesIO()
    pq.write_table(table, stream, compression="snappy")
    return stream.getvalue()


def _add_episode(
    episodes: dict[str, list[Any]],
    block: EpisodeRows,
    task: str,
    place: tuple[int, int],
    span: tuple[int, int],
    begin: int,
    maps: Sequence[str],
    values: Mapping[str, NDArray[Any]],
) -> None:
    row: dict[str, Any] = {
        "episode_index": len(episodes.get("length", ())),
        "tasks": [task],
        "length": len(block),
        "data/chunk_index": place[0],
        "data/file_index": place[1],
        "dataset_from_index": span[0],
        "dataset_to_index": span[1],
        "meta/episodes/chunk_index": 0,
        "meta/episodes/file_index": 0,
        "gn0.episode_id": block.episode_id,
        "map.bev": maps[0],
        "map.occupancy": maps[1],
        "goal_picture": maps[2],
    }
    for key in VIDEOS.values():
        row |= {
            f"videos/{key}/chunk_index": place[0],
            f"videos/{key}/file_index": place[1],
            f"videos/{key}/from_timestamp": begin / FPS,
            f"videos/{key}/to_timestamp": (begin + len(block)) / FPS,
        }
    for name, array in values.items():
        for what, numbers in describe_array(array).items():
            row[f"stats/{name}/{what}"] = numbers
    for name, value in row.items():
        episodes.setdefault(name, []).append(value)


def _encode_episodes(episodes: Mapping[str, list[Any]]) -> bytes:
    stream = io.BytesIO()
    pq.write_table(pa.table(dict(episodes)), stream, compression="snappy")
    return stream.getvalue()


def describe_array(array: NDArray[Any]) -> dict[str, list[Any]]:
    """min, max, mean, std of each column of an array [T] or [T, D], and the count."""
    values = array.reshape(len(array), -1).astype(np.float64)
    return {
        "min": values.min(axis=0).tolist(),
        "max": values.max(axis=0).tolist(),
        "mean": values.mean(axis=0).tolist(),
        "std": values.std(axis=0).tolist(),
        "count": [len(array)],
    }


def describe_pixels(sums: Sequence[Mapping[str, Any]], frames: int) -> dict[str, Any]:
    """The statistics of a picture feature, in 0..1, each [3, 1, 1]."""
    count = sum(own["count"] for own in sums)
    nested: dict[str, Any] = {}
    lows = [min((own["low"][c] for own in sums), default=0) / 255 for c in range(3)]
    highs = [max((own["high"][c] for own in sums), default=0) / 255 for c in range(3)]
    means = [sum(own["total"][c] for own in sums) / max(count, 1) for c in range(3)]
    squares = [sum(own["square"][c] for own in sums) / max(count, 1) for c in range(3)]
    spreads = [max(s - m * m, 0.0) ** 0.5 / 255 for s, m in zip(squares, means, strict=True)]
    for name, values in (
        ("min", lows), ("max", highs), ("mean", [m / 255 for m in means]), ("std", spreads),
    ):  # fmt: skip
        nested[name] = [[[value]] for value in values]
    nested["count"] = [frames]
    return nested


def describe_features(
    dataset: Dataset, episodes: int, frames: int, tasks: int, settings: PictureSettings
) -> dict[str, Any]:
    """The content of `meta/info.json`."""
    width, height = find_preset(dataset.about.camera).picture_size
    sizes = {"rgb": (width, height), "history": (COLUMNS * TILE_WIDTH, ROWS * TILE_HEIGHT)}
    features: dict[str, Any] = {
        VIDEOS[name]: {
            "dtype": "video",
            "shape": [size[1], size[0], 3],
            "names": ["height", "width", "channels"],
            "info": {
                "video.height": size[1], "video.width": size[0], "video.codec": "av1",
                "video.pix_fmt": "yuv420p", "video.is_depth_map": False, "video.fps": FPS,
                "video.channels": 3, "has_audio": False,
            },
        }
        for name, size in sizes.items()
    }  # fmt: skip
    names: dict[str, list[str]] = {
        "observation.state": ["x", "y", "yaw"],
        "observation.map": ["start_row", "start_column", "row", "column"],
    }
    for name, (dtype, size) in _VECTORS.items():
        features[name] = {"dtype": dtype, "shape": [size], "names": names.get(name)}
    for name, dtype in _COUNTERS.items():
        features[name] = {"dtype": dtype, "shape": [1], "names": None}
    return {
        "codebase_version": VERSION,
        "robot_type": "gn0",
        "fps": FPS,
        "total_episodes": episodes,
        "total_frames": frames,
        "total_tasks": tasks,
        "chunks_size": FILES_A_CHUNK,
        "data_files_size_in_mb": 100,
        "video_files_size_in_mb": 200,
        "data_path": "data/chunk-{chunk_index:03d}/file-{file_index:03d}.parquet",
        "video_path": "videos/{video_key}/chunk-{chunk_index:03d}/file-{file_index:03d}.mp4",
        "splits": {"train": f"0:{episodes}"},
        "features": features,
    }


def read_video(dataset: Dataset, number: int, name: str, span: tuple[int, int]) -> list[U8]:
    """Frames `span` of a part's video, as stored (AV1 loses some).

    Raises:
        FormatError: it is missing or damaged.
    """
    import av

    path = safe_join(cache_folder(dataset.folder, LAYOUT), file_path(VIDEOS[name], number))
    frames: list[U8] = []
    try:
        with av.open(str(path)) as container:
            container.streams.video[0].thread_count = 1
            for count, frame in enumerate(container.decode(video=0)):
                if count >= span[1]:
                    break
                if count >= span[0]:
                    frames.append(np.asarray(frame.to_ndarray(format="rgb24"), np.uint8))
    except (av.error.FFmpegError, OSError, IndexError) as error:
        raise FormatError(
            f"video cannot be read: {error}", file=path, remedy="run `gn0 data repair`"
        ) from None
    if len(frames) != span[1] - span[0]:
        raise FormatError(
            f"video has {span[0] + len(frames)} frames, expected {span[1]} or more", file=path,
            remedy="run `gn0 data repair`",
        )  # fmt: skip
    return frames
