"""LeRobot v3.0: episodes joined into larger tables and videos.

Features, names, frames a second and codec are those of the data cache, `gn0.data.lerobot_schema`:
`data/chunk-000/file-000.parquet` holds the frames of many episodes, `videos/<key>/…` their pictures
joined without encoding again, `meta/episodes/…` where each begins. Missions of one path share its
frames; so do all who see the same map or goal.
"""

from __future__ import annotations

import contextlib
import json
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa

from gn0.data.cache_lerobot import scale_boxes
from gn0.data.cache_webdataset import DISC_RADIUS, draw_dots
from gn0.data.lerobot_schema import (
    DATA_MB,
    DEPTH_KEY,
    MOVING,
    STILLS,
    VIDEO_MB,
    VIDEOS,
    Film,
    PixelSums,
    Rate,
    Surroundings,
    describe_columns,
    fit_map,
    follow_nobody,
    followed_columns,
    frame_rate,
    label_columns,
    read_sensor,
)
from gn0.data.lerobot_tables import (
    EpisodeEntry,
    Span,
    add_followed,
    depth_column,
    divide,
    encode_meta,
    encode_table,
    file_path,
    label_table,
    number_table,
    number_tasks,
)
from gn0.data.lerobot_video import WalkWriter, encode_still
from gn0.data.picture_cache import encode_depth, encode_map
from gn0.errors import Gn0Error
from gn0.export.exporter import ExportSettings, Job, OwnPoses, Place, Record
from gn0.export.lerobot3_reader import check_folder, load_folder
from gn0.export.picture_files import encode_jpeg, load_picture
from gn0.export.trips import RGB, RGBD, Recovered, Trip
from gn0.geometry import U8
from gn0.missions.episode_files import read_table
from gn0.render.depth import to_millimetres
from gn0.render.video import join_videos
from gn0.sim.history import History
from gn0.storage import content_hash, read_bytes, write_bytes

PARTS = "parts"  # of episodes, until they are put together
CRF = 30  # constant rate factor of the videos


class ExporterLeRobot3(OwnPoses):
    """See the module."""

    name = "lerobot-v3"
    title = "LeRobot dataset v3.0"
    reader = "LeRobot ≥ 0.4: `LeRobotDataset(repo_id, root=DIR)`"
    frame = (
        "state: world of the scene, z up, x, y [m] and yaw [rad]; action: motion to the next frame "
        "in the agent's frame, forward and left [m], yaw [rad]; waypoints: x forward, y left [m] "
        "in the agent's frame; depth: camera z in mm; pixels are (x, y) of the map pictures"
    )
    dagger = True
    follows = True
    scratch = PARTS
    has_splits = True

    def why_not(self, trip: Trip, settings: ExportSettings) -> str:
        """It takes every walk whose labels are known."""
        return "" if trip.rows is not None else "no samples: waypoints and distances are not known"

    def write(self, trip: Trip, place: Place, job: Job) -> Record:
        """The pictures of a walk, unless they are there; its columns and their statistics."""
        rows, preset, episode = trip.rows, job.settings.preset(job.source), trip.episode
        assert rows is not None
        eyes = job.source.eyes
        view, goal = eyes.maps(trip), eyes.goal(trip)
        size = (view.frame.width, view.frame.height)
        start, *here = (
            view.frame.pixel_of(float(x), float(y))
            for x, y in np.vstack([trip.poses[:1, :2], trip.poses[:, :2]])
        )
        beside = [
            _keep(job, f"maps/{content_hash(view.bev)}.png", lambda: encode_map(view.bev)),
            _keep(job, f"maps/{content_hash(view.bare)}.png", lambda: encode_map(view.bare)),
            "",
        ]
        if goal is not None:
            quality = job.settings.quality
            path = f"goals/{content_hash(goal)}.jpg"
            beside[2] = _keep(job, path, lambda: encode_jpeg(goal, quality))
        way = trip.way
        walk = _known_walk(job, way)
        if walk is None:
            maps = (fit_map(draw_dots(view.bare, start, spot, DISC_RADIUS)) for spot in here)
            walk = _film_walk(trip, job, way, maps)
        spots = np.array([spot[::-1] for spot in here], np.int64)
        columns = label_columns(
            rows, Surroundings(size, (start[1], start[0]), spots, goal is not None)
        )
        if rows.person:
            same = preset.name == job.source.preset.name
            columns |= followed_columns(rows, episode, scale_boxes(preset) if same else None)
        files = _depth_files(job, way) if _deep(job) else None
        data = encode_table(label_table(columns, files))
        job.shelf.put(_part(job.folder, f"{place.number:06d}.parquet"), data)
        return {
            "number": place.number,
            "split": episode.split,
            "id": episode.id,
            "scene": episode.scene_id,
            "mission": str(episode.mission.__struct_config__.tag),
            "task": episode.instruction,
            "length": trip.frames,
            "way": way,
            "size": len(data),
            "sizes": walk["sizes"],
            "stats": {**walk["stats"], **describe_columns(columns)},
            "map": list(size),
            "beside": beside,
            "picture": list(preset.picture_size),
            "depth": [preset.depth.width, preset.depth.height] if _deep(job) else None,
            **({"follows": True} if rows.person else {}),
        }

    def finish(self, records: Sequence[Record], job: Job) -> None:
        """Tables, videos and meta."""
        head, folder = records[0], job.folder
        film = Film.of(
            (head["picture"][0], head["picture"][1]),
            goals=any(record["beside"][2] for record in records),
            depth=None if head["depth"] is None else (head["depth"][0], head["depth"][1]),
            fps=_rate(job),
            tile=job.settings.preset(job.source).history_tile,
            follows=any("follows" in record for record in records),
        )
        spans: list[dict[str, Span]] = [{} for _ in records]
        stats: list[dict[str, Any]] = [dict(record["stats"]) for record in records]
        for name in MOVING:
            _join_walks(records, name, film, folder, spans)
        for name in STILLS:
            if name in film.sizes:
                _join_stills(records, name, film, folder, spans, stats)
        entries = []
        tasks = number_tasks([record["task"] for record in records])
        index = 0
        for file, rows in enumerate(divide([record["size"] for record in records], DATA_MB)):
            tables = []
            for number in rows:
                record = records[number]
                labels = read_table(_part(folder, f"{record['number']:06d}.parquet"))
                if film.follows and "follows" not in record:
                    nobody = follow_nobody(record["length"])
                    labels = add_followed(labels, nobody)
                    stats[number] |= describe_columns(nobody)
                task = tasks[record["task"]]
                tables.append(number_table(labels, film.fps, number, index, task))
                index += record["length"]
                entries.append(_entry(record, file, spans[number], stats[number]))
            table = pa.concat_tables(tables).combine_chunks()
            write_bytes(folder / file_path("data", file), encode_table(table))
        for path, data in encode_meta(entries, film).items():
            write_bytes(folder / path, data)

    def check(self, folder: Path) -> list[str]:
        """Everything that LeRobot's own loader takes for granted."""
        return check_folder(folder)

    def load(self, folder: Path) -> list[Recovered]:
        """Read it back."""
        return load_folder(folder)


def _rate(job: Job) -> Rate:
    """Frames a second: those asked for, else a frame an action of the body that walked."""
    return job.settings.fps or frame_rate(job.source.step_seconds)


def _part(folder: Path, name: str) -> Path:
    return folder / PARTS / name


def _deep(job: Job) -> bool:
    """Whether depth is written: where the dataset stores it, or it is asked for."""
    return job.settings.depth or job.source.depth


def _keep(job: Job, path: str, encode: Callable[[], bytes]) -> str:
    """Write a file that is named by its content, unless it is there; its path."""
    target = job.folder / path
    if not (target.is_file() and target.stat().st_size):
        job.shelf.put(target, encode())
    return path


def _known_walk(job: Job, way: str) -> dict[str, Any] | None:
    """What `_film_walk` said of a walk, if all of its files are there."""
    with contextlib.suppress(Gn0Error, OSError, ValueError):
        walk: dict[str, Any] = json.loads(read_bytes(_part(job.folder, f"{way}.json")))
        if all(_part(job.folder, name).stat().st_size == n for name, n in walk["files"].items()):
            return walk
    return None


def _film_walk(trip: Trip, job: Job, way: str, maps: Iterator[U8]) -> dict[str, Any]:
    """Write the clips of a walk, and its depth; sizes and statistics."""
    preset = job.settings.preset(job.source)
    film = Film.of(preset.picture_size, fps=_rate(job), tile=preset.history_tile)
    writer, history = WalkWriter(film, MOVING, CRF), History(size=preset.history_tile)
    deep, sums, depth = _deep(job), PixelSums(1), []
    for seen, plan in zip(
        job.source.frames(trip, preset, RGBD if deep else RGB), maps, strict=True
    ):
        assert seen.rgb is not None
        writer.add({"rgb": seen.rgb, "history": history.mosaic(), "occupancy": plan})
        history.add(seen.rgb)
        if seen.depth is not None:
            reading = read_sensor(to_millimetres(seen.depth), preset.depth_range)
            sums.add(reading)
            depth.append(encode_depth(reading))
    clips = writer.finish()
    files = {f"{way}.{name}.mp4": data for name, data in clips.items()}
    stats = {VIDEOS[name]: own.describe() for name, own in writer.sums.items()}
    if deep:
        files[f"{way}.parquet"] = encode_table(pa.table({DEPTH_KEY: depth_column(depth)}))
        stats[DEPTH_KEY] = sums.describe(1.0)
    for name, data in files.items():
        job.shelf.put(_part(job.folder, name), data)
    walk = {
        "files": {name: len(data) for name, data in files.items()},
        "sizes": {name: len(data) for name, data in clips.items()},
        "stats": stats,
    }
    job.shelf.put(_part(job.folder, f"{way}.json"), json.dumps(walk).encode())
    return walk


def _depth_files(job: Job, way: str) -> list[bytes]:
    column = read_table(_part(job.folder, f"{way}.parquet")).column(DEPTH_KEY)
    return [cell["bytes"] for cell in column.to_pylist()]


def _join_walks(
    records: Sequence[Record], name: str, film: Film, folder: Path, spans: list[dict[str, Span]]
) -> None:
    """Write the files of a video; every walk once, however many missions it has."""
    walks = {record["way"]: record for record in records}  # the last of its missions will do
    order = list(walks)
    places: dict[str, Span] = {}
    sizes = [walks[way]["sizes"][name] for way in order]
    for file, rows in enumerate(divide(sizes, VIDEO_MB)):
        clips, first = [], 0
        for way in (order[n] for n in rows):
            clips.append(read_bytes(_part(folder, f"{way}.{name}.mp4")))
            places[way] = Span(file, first)
            first += walks[way]["length"]
        write_bytes(folder / file_path(name, file), join_videos(clips, film.fps))
    for record, own in zip(records, spans, strict=True):
        own[name] = places[record["way"]]


def _join_stills(
    records: Sequence[Record],
    name: str,
    film: Film,
    folder: Path,
    spans: list[dict[str, Span]],
    stats: list[dict[str, Any]],
) -> None:
    """Write the files of a video that stands still: every picture once, for its longest walk."""
    kind = 0 if name == "bev" else 2
    longest: dict[str, int] = {}
    for record in records:
        path = record["beside"][kind]
        longest[path] = max(longest.get(path, 0), record["length"])
    width, height = film.sizes[name]
    places: dict[str, Span] = {}
    pictures: dict[str, PixelSums] = {}
    clips: list[bytes] = []
    file = first = 0

    def close() -> None:
        write_bytes(folder / file_path(name, file), join_videos(clips, film.fps))

    for path, frames in longest.items():
        if not path:
            picture = np.zeros((height, width, 3), np.uint8)
        else:
            picture = load_picture(folder / path)
            picture = fit_map(picture) if name == "bev" else picture
        pictures[path] = PixelSums()
        pictures[path].add(picture)
        clip = encode_still(picture, frames, film, CRF)
        if clips and sum(map(len, clips)) + len(clip) > VIDEO_MB * 2**20:
            close()
            clips, file, first = [], file + 1, 0
        clips.append(clip)
        places[path] = Span(file, first)
        first += frames
    close()
    for record, own, told in zip(records, spans, stats, strict=True):
        path = record["beside"][kind]
        own[name] = places[path]
        told[VIDEOS[name]] = {**pictures[path].describe(), "count": [record["length"]]}


def _entry(
    record: Record, file: int, spans: dict[str, Span], stats: dict[str, Any]
) -> EpisodeEntry:
    bev, occupancy, goal = record["beside"]
    return EpisodeEntry(
        id=record["id"],
        scene=record["scene"],
        split=record["split"],
        mission=record["mission"],
        task=record["task"],
        length=record["length"],
        data=file,
        videos=spans,
        stats=stats,
        map_size=(record["map"][0], record["map"][1]),
        beside=(bev, occupancy, goal),
    )
