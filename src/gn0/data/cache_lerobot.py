"""The cache as a LeRobot v3.0 dataset: pictures as AV1 videos, depth and labels as Parquet.

    videos/observation.images.*/chunk-000/file-000.mp4   a file a part
    data/chunk-000/file-000.parquet                      a file a part
    meta/{info,stats}.json, meta/tasks.parquet, meta/episodes/chunk-000/file-000.parquet
    maps/<hash>.png, goals/<hash>.jpg                    BEV, bare occupancy, goals, exactly

Features and files are those of `gn0.data.lerobot_schema`, which exports share. Depth waits in the
data file of its part until the labels of all parts are known; where it is gone, it is drawn again.
"""

from __future__ import annotations

import contextlib
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from gn0.data.dataset import Dataset, DatasetPart, FileRecord
from gn0.data.lerobot_schema import (
    DEPTH_KEY,
    EPISODES,
    MOVING,
    STILLS,
    VIDEOS,
    Film,
    PixelSums,
    Surroundings,
    describe_columns,
    fit_map,
    followed_columns,
    frame_rate,
    label_columns,
    read_sensor,
)
from gn0.data.lerobot_tables import (
    EpisodeEntry,
    Span,
    depth_column,
    encode_meta,
    encode_table,
    file_path,
    label_table,
    number_table,
    number_tasks,
)
from gn0.data.lerobot_video import WalkWriter, encode_still
from gn0.data.picture_cache import (
    DrawnStep,
    cache_folder,
    decode_depth,
    encode_depth,
    write_goal,
    write_maps,
    write_recorded,
)
from gn0.data.sample_table import DEPTH, EpisodeRows
from gn0.data.settings import PictureSettings
from gn0.errors import DataError, FormatError, Gn0Error
from gn0.geometry import U8
from gn0.missions.episode import Episode, MissionFollow, MissionGoal
from gn0.missions.episode_files import read_table
from gn0.render.depth import to_metres
from gn0.render.video import join_videos
from gn0.sim.presets import CameraPreset, find_preset
from gn0.storage import content_hash, safe_join, write_bytes

LAYOUT = "lerobot"
SCHEMA = 2  # of the notes of a part; 1 had other features


def film_of(dataset: Dataset, settings: PictureSettings) -> Film:
    """What the cache's pictures are like."""
    preset = find_preset(dataset.about.camera)
    return Film.of(
        preset.picture_size,
        maps=settings.maps == "every",
        goals=any(isinstance(episode.mission, MissionGoal) for episode in dataset.episodes),
        depth=(preset.depth.width, preset.depth.height) if settings.depth else None,
        fps=frame_rate(dataset.about.agent.step_seconds),
        tile=preset.history_tile,
        follows=any(isinstance(episode.mission, MissionFollow) for episode in dataset.episodes),
    )


def scale_boxes(preset: CameraPreset) -> tuple[float, float]:
    """Pixels of the view across and down for one of the camera's, in which boxes are."""
    width, height = preset.picture_size
    return width / preset.rgb.width, height / preset.rgb.height


def write_videos(
    dataset: Dataset, number: int, steps: Iterable[DrawnStep], settings: PictureSettings
) -> tuple[list[FileRecord], dict[str, Any]]:
    """Write the videos and maps of part `number`; also what `write_tables` must know of them.

    Raises:
        StorageError: the disk refuses.
    """
    reel = PartReel(dataset, number, settings)
    for step in steps:
        reel.add(step)
    return reel.finish()


class PartReel:
    """The pictures of a part, episode by episode."""

    def __init__(self, dataset: Dataset, number: int, settings: PictureSettings) -> None:
        self._dataset, self._number, self._settings = dataset, number, settings
        self._film = film_of(dataset, settings)
        self._reach = find_preset(dataset.about.camera).depth_range
        self._folder = cache_folder(dataset.folder, LAYOUT)
        self._moving = [name for name in MOVING if name in self._film.sizes]
        self._clips: dict[str, list[bytes]] = {name: [] for name in self._moving}
        self._frames = 0  # of each moving video
        self._walks: dict[str, tuple[int, dict[str, Any]]] = {}  # first frame and statistics
        self._stills: dict[str, dict[str, tuple[U8, int]]] = {name: {} for name in STILLS}
        self._shared: dict[str, FileRecord] = {}
        self._episodes: list[dict[str, Any]] = []
        self._depth: list[bytes] = []
        self._walk: WalkWriter | None = None
        self._deep = PixelSums(1)

    def add(self, step: DrawnStep) -> None:
        """The next step."""
        if step.step == 0:
            self._begin(step)
        own = self._episodes[-1]
        own["here"].append(list(step.places[1][::-1]))
        if self._walk is not None:
            assert step.pictures.rgb is not None
            pictures = {"rgb": step.pictures.rgb, "history": step.pictures.history}
            if "occupancy" in self._moving:
                pictures["occupancy"] = fit_map(step.pictures.occupancy)
            self._walk.add(pictures)
        if self._film.depth is not None:
            assert step.pictures.depth is not None
            reading = read_sensor(step.pictures.depth, self._reach)
            self._deep.add(reading)
            self._depth.append(encode_depth(reading))
        if step.step == len(step.block) - 1:
            self._end(own)

    def _begin(self, step: DrawnStep) -> None:
        episode, block = step.episode, step.block
        goal = write_goal(self._folder, step, self._shared, self._settings)
        maps = write_maps(self._folder, step, self._shared)
        height, width = step.base[0].shape[:2]
        way = content_hash(episode.scene_id, repr(episode.light), block.poses, repr(episode.start))
        own: dict[str, Any] = {
            "id": episode.id, "way": way, "length": len(block), "map": [width, height],
            "start": list(step.places[0][::-1]), "here": [], "beside": [*maps, goal],
            "still": {},
        }  # fmt: skip
        self._episodes.append(own)
        for name in STILLS:
            if name not in self._film.sizes:
                continue
            picture, key = self._still(name, step)
            known = self._stills[name].get(key, (picture, 0))
            self._stills[name][key] = (known[0], max(known[1], len(block)))
            own["still"][name] = key
        self._deep = PixelSums(1)
        self._walk = None if way in self._walks else WalkWriter(
            self._film, self._moving, self._settings.crf
        )  # fmt: skip

    def _still(self, name: str, step: DrawnStep) -> tuple[U8, str]:
        if name == "bev":
            return fit_map(step.pictures.bev), step.hashes["bev"]
        if step.goal is not None:
            return step.goal
        width, height = self._film.sizes["goal"]
        return np.zeros((height, width, 3), np.uint8), ""

    def _end(self, own: dict[str, Any]) -> None:
        if self._walk is not None:
            for name, data in self._walk.finish().items():
                self._clips[name].append(data)
            stats = {VIDEOS[name]: sums.describe() for name, sums in self._walk.sums.items()}
            self._walks[own["way"]] = (self._frames, stats)
            self._frames += own["length"]
        own["first"], own["stats"] = self._walks[own["way"]]
        if self._film.depth is not None:
            own["stats"] = {**own["stats"], DEPTH_KEY: self._deep.describe(1.0)}

    def finish(self) -> tuple[list[FileRecord], dict[str, Any]]:
        """Write the videos, and depth where it is stored."""
        records = list(self._shared.values())
        fps = self._film.fps
        for name in self._moving if self._episodes else ():
            records.append(self._put(name, join_videos(self._clips[name], fps)))
        for name, stills in self._stills.items():
            if not stills:
                continue
            clips, places, first = [], {}, 0
            for key, (picture, frames) in stills.items():
                clips.append(encode_still(picture, frames, self._film, self._settings.crf))
                places[key], first = first, first + frames
            records.append(self._put(name, join_videos(clips, fps)))
            for own in self._episodes:
                key = own["still"][name]
                sums = PixelSums()
                sums.add(stills[key][0], own["length"])
                own["still"][name] = places[key]
                own["stats"] = {**own["stats"], VIDEOS[name]: sums.describe()}
        if self._film.depth is not None and self._episodes:
            column = pa.table({DEPTH_KEY: depth_column(self._depth)})
            path = safe_join(self._folder, file_path("data", self._number))
            write_bytes(path, encode_table(column))
        for own in self._episodes:
            del own["way"]
        return records, {"schema": SCHEMA, "episodes": self._episodes}

    def _put(self, name: str, data: bytes) -> FileRecord:
        return _put(self._folder, file_path(name, self._number), data)


def _put(folder: Path, path: str, data: bytes) -> FileRecord:
    return write_recorded(folder, path, lambda put: (put(data), None)[1])


def write_tables(
    dataset: Dataset, notes: Mapping[str, Mapping[str, Any]], settings: PictureSettings
) -> list[FileRecord]:
    """Write data, meta and statistics, once all videos are there.

    Args:
        dataset: with its sample tables.
        notes: notes of each part by name, from `write_videos`.
        settings: settings of the cache.

    Raises:
        DataError: a part was drawn by an earlier version, with other features.
        StorageError: the disk refuses.
    """
    folder = cache_folder(dataset.folder, LAYOUT)
    if any(own.get("schema") != SCHEMA for own in notes.values()):
        raise DataError(
            "its videos were drawn by an earlier version, with other features", where=folder,
            remedy="delete that folder and run `gn0 data render --layout lerobot`",
        )  # fmt: skip
    film, preset = film_of(dataset, settings), find_preset(dataset.about.camera)
    scale = scale_boxes(preset)
    tasks = number_tasks([dataset.episode(name).instruction for name in dataset.sampled])
    records: list[FileRecord] = []
    entries: list[EpisodeEntry] = []
    index = 0
    for number, part in enumerate(dataset.about.parts):
        tables: list[pa.Table] = []
        drawn = notes[part.name]["episodes"]
        depth = iter(_part_depth(dataset, number, part, settings)) if film.depth else None
        for rows, own in zip(dataset.part_rows(part), drawn, strict=True):
            episode = dataset.episode(rows.episode_id)
            around = Surroundings(
                tuple(own["map"]), tuple(own["start"]), np.array(own["here"], np.int64),
                isinstance(episode.mission, MissionGoal),
            )  # fmt: skip
            columns = label_columns(rows, around)
            if film.follows:
                columns |= followed_columns(rows, episode, scale)
            files = None if depth is None else [next(depth) for _ in range(len(rows))]
            labels = label_table(columns, files)
            task = tasks[episode.instruction]
            tables.append(number_table(labels, film.fps, len(entries), index, task))
            stats = {**own["stats"], **describe_columns(columns)}
            entries.append(describe_entry(episode, rows, number, own, stats))
            index += len(rows)
        if tables:
            data = encode_table(pa.concat_tables(tables).combine_chunks())
            records.append(_put(folder, file_path("data", number), data))
    for path, data in encode_meta(entries, film).items():
        records.append(_put(folder, path, data))
    return records


def describe_entry(
    episode: Episode,
    rows: EpisodeRows,
    number: int,
    own: Mapping[str, Any],
    stats: Mapping[str, Any],
) -> EpisodeEntry:
    """What `meta/` says of an episode, by the notes of part `number`."""
    videos = {name: Span(number, own["first"]) for name in MOVING}
    videos |= {name: Span(number, first) for name, first in own["still"].items()}
    bev, occupancy, goal = own["beside"]
    width, height = own["map"]
    return EpisodeEntry(
        id=episode.id,
        scene=episode.scene_id,
        split=episode.split,
        mission=str(episode.mission.__struct_config__.tag),
        task=episode.instruction,
        length=len(rows),
        data=number,
        videos=videos,
        stats=stats,
        map_size=(width, height),
        beside=(bev, occupancy, goal),
    )


def _part_depth(
    dataset: Dataset, number: int, part: DatasetPart, settings: PictureSettings
) -> Sequence[bytes]:
    """The depth pictures of a part: where they wait, else drawn again."""
    path = safe_join(cache_folder(dataset.folder, LAYOUT), file_path("data", number))
    with contextlib.suppress(Gn0Error, KeyError):
        column = read_table(path).column(DEPTH_KEY).combine_chunks()
        files: list[bytes] = [cell["bytes"] for cell in column.to_pylist()]
        if len(files) == part.rows and all(files):
            return files
    return list(_draw_depth(dataset, part, settings))


def _draw_depth(dataset: Dataset, part: DatasetPart, settings: PictureSettings) -> Iterator[bytes]:
    from gn0.data.part_pictures import PartDrawer

    reach = find_preset(dataset.about.camera).depth_range
    for step in PartDrawer(dataset, dataset.part_rows(part), settings).steps():
        assert step.pictures.depth is not None
        yield encode_depth(read_sensor(step.pictures.depth, reach))


def _episode_row(dataset: Dataset, episode_id: str) -> dict[str, Any]:
    """The row of `meta/episodes` of an episode, whichever version wrote it.

    Raises:
        FormatError: there is none.
    """
    path = safe_join(cache_folder(dataset.folder, LAYOUT), EPISODES)
    if dataset.kept.get("lerobot") is None:
        table = read_table(path)
        wanted = [
            name for name in table.column_names
            if name in ("gn0_id", "gn0.episode_id", "length", "dataset_from_index")
            or name.startswith(("videos/", "data/"))
        ]  # fmt: skip
        rows = table.select(wanted).to_pylist()
        dataset.kept["lerobot"] = {r.get("gn0_id", r.get("gn0.episode_id")): r for r in rows}
    row: dict[str, Any] | None = dataset.kept["lerobot"].get(episode_id)
    if row is None:
        raise FormatError(
            f"no row of episode {episode_id!r}", file=path, remedy="run `gn0 data repair`"
        )
    return row


def read_video(dataset: Dataset, episode_id: str, name: str) -> list[U8]:
    """An episode's frames of a video, as stored (AV1 loses some).

    Raises:
        FormatError: it is missing or damaged.
    """
    import av

    fps = frame_rate(dataset.about.agent.step_seconds)
    row, key = _episode_row(dataset, episode_id), f"videos/{VIDEOS[name]}"
    number = row[f"{key}/chunk_index"] * 1000 + row[f"{key}/file_index"]
    path = safe_join(cache_folder(dataset.folder, LAYOUT), file_path(name, number))
    first = round(row[f"{key}/from_timestamp"] * fps)
    last = first + row["length"]
    frames: list[U8] = []
    try:
        with av.open(str(path)) as container:
            container.streams.video[0].thread_count = 1
            for count, frame in enumerate(container.decode(video=0)):
                if count >= last:
                    break
                if count >= first:
                    frames.append(np.asarray(frame.to_ndarray(format="rgb24"), np.uint8))
    except (av.error.FFmpegError, OSError, IndexError) as error:
        raise FormatError(
            f"video cannot be read: {error}", file=path, remedy="run `gn0 data repair`"
        ) from None
    if len(frames) != last - first:
        raise FormatError(
            f"video has {first + len(frames)} frames, expected {last} or more", file=path,
            remedy="run `gn0 data repair`",
        )  # fmt: skip
    return frames


def read_depth(dataset: Dataset, episode_id: str) -> Iterator[NDArray[np.float32]]:
    """What the depth sensor read at an episode's steps [H, W] m, as stored.

    Raises:
        FormatError: it is missing or damaged.
    """
    row = _episode_row(dataset, episode_id)
    number = row["data/chunk_index"] * 1000 + row["data/file_index"]
    path = safe_join(cache_folder(dataset.folder, LAYOUT), file_path("data", number))
    table = read_table(path)
    reach = find_preset(dataset.about.camera).depth_range
    if not {DEPTH_KEY, "index"} <= set(table.column_names):
        raise FormatError("no depth in it", file=path, remedy="run `gn0 data repair`")
    begin = row["dataset_from_index"] - int(table.column("index")[0].as_py())
    for cell in table.column(DEPTH_KEY).slice(begin, row["length"]).to_pylist():
        yield to_metres(decode_depth(cell["bytes"], path, DEPTH), reach)
