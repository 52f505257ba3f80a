"""InternData-N1, its vln_ce part: LeRobot v2.1 with poses, actions and pixel goals for each camera.

A scene is a dataset folder. For every camera "{height}cm_{pitch}deg": `pose` is the camera in the
frame of the first step (x forward, y left, z up; OpenCV camera axes), `goal` the pixel (x, y) of a
place ahead on the floor, and `relative_goal_frame_id` how many frames ahead it is reached; −1 where
none is in sight. We mark the farthest pose of the way that is in the picture and not hidden by
anything in the depth picture; the source does not document its own rule.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
from numpy.typing import NDArray

from gn0.data.lerobot_schema import count_columns
from gn0.errors import ConfigError, FormatError
from gn0.export.cameras import (
    camera_height,
    camera_poses,
    from_start_frame,
    intrinsics,
    project,
    to_start_frame,
)
from gn0.export.exporter import ExportSettings, Job, OwnPoses, Place, Record
from gn0.export.faults import Faults, load_typed
from gn0.export.lerobot21 import (
    MetaEpisode,
    check_meta,
    column_stats,
    describe_features,
    encode_columns,
    episode_path,
    load_columns,
    load_episode_lines,
    write_meta,
)
from gn0.export.names import Name, load_names, name_of, save_names
from gn0.export.picture_files import (
    encode_depth,
    encode_jpeg,
    load_depth,
    load_picture,
    picture_size,
)
from gn0.export.trips import RGBD, ExportSource, Frame, Recovered, Trip
from gn0.geometry import F32, F64
from gn0.sim.presets import CameraPreset, find_preset
from gn0.storage import safe_join, write_bytes

ROOT = "traj_data"
SEPARATOR = "<INSTRUCTION_SEP>"
FPS = 30
FEWEST = 4  # its loader skips shorter ones
MILLIMETRE = 0.001
HIDDEN = 0.15  # m: a place is hidden when something is nearer than it by so much and 5 %
ABOUT = "gn0_views.json"


class About(msgspec.Struct):
    """What is needed to read poses back: the cameras, and where each episode starts."""

    views: list[str]
    starts: dict[str, list[list[float]]]  # by scene, in the order of its episodes


def view_name(preset: CameraPreset, height: float) -> str:
    """Name of a camera in their columns: 1.25 m high, looking 30° down: "125cm_30deg"."""
    return f"{round(height * 100)}cm_{round(-preset.pitch_degrees)}deg"


class ExporterInternData(OwnPoses):
    """See the module."""

    name = "interndata-n1"
    title = "InternData-N1 vln_ce (LeRobot v2.1)"
    reader = (
        "InternNav, InternVLA-N1 training: a vln dataset whose data_path is traj_data/<name>, with "
        "its height and the two pitches"
    )
    frame = (
        "poses: camera in the frame of the first step, x forward, y left, z up [m], OpenCV camera "
        "axes; goals: pixels (x, y); depth: PNG in mm"
    )

    def why_not(self, trip: Trip, settings: ExportSettings) -> str:
        """Its loader's own limit."""
        if not trip.stopped:
            return "it did not end with STOP"
        if SEPARATOR in trip.episode.instruction:
            return f"its instruction holds {SEPARATOR}"
        return "" if trip.frames >= FEWEST else f"fewer than {FEWEST} frames: the loader skips it"

    def cameras(self, source: ExportSource, settings: ExportSettings) -> tuple[CameraPreset, ...]:
        """Those of `--views`."""
        if not settings.views:
            raise ConfigError("no camera", where="--views", remedy="for example n1_125cm_0deg")
        return tuple(find_preset(name) for name in settings.views)

    def write(self, trip: Trip, place: Place, job: Job) -> Record:
        """Pictures and table of an episode."""
        folder = _scene_folder(job.folder, job.settings.name, trip.episode.scene_id)
        index, length = place.scene_number, trip.frames
        videos = folder / f"videos/chunk-{index // 1000:03d}"
        columns: dict[str, NDArray[Any]] = {
            "action": np.array([-1, *trip.moves], np.int64),
        }
        views, seen = [], 0
        for view in self.cameras(job.source, job.settings):
            height = camera_height(view, job.source.preset, trip.episode.agent)
            name = view_name(view, height)
            views.append(name)
            depths: list[F32] = []
            for number, frame in enumerate(job.source.frames(trip, view, RGBD)):
                assert frame.rgb is not None and frame.depth is not None
                stem = f"episode_{index:06d}_{number}"
                colour = videos / f"observation.images.rgb.{name}/{stem}.jpg"
                job.shelf.put(colour, encode_jpeg(frame.rgb, job.settings.quality))
                grey = videos / f"observation.images.depth.{name}/{stem}.png"
                job.shelf.put(grey, encode_depth(frame.depth, MILLIMETRE))
                depths.append(frame.depth)
            pitch = math.radians(view.pitch_degrees)
            goals, ahead = find_pixel_goals(trip.poses, depths, view, height)
            columns[f"pose.{name}"] = to_start_frame(trip.poses, height, pitch)
            columns[f"goal.{name}"] = goals
            columns[f"relative_goal_frame_id.{name}"] = ahead
            seen += int((ahead >= 0).sum())
        columns |= count_columns(
            length, job.settings.fps or FPS, index, place.scene_first_frame, index
        )
        job.shelf.put(episode_path(folder, index), encode_columns(columns))
        return {
            "gn0": name_of(trip),
            "scene": trip.episode.scene_id,
            "views": views,
            "index": index,
            "length": length,
            "task": trip.episode.instruction,
            "start": trip.poses[0].tolist(),
            "stats": column_stats(columns),
            "features": describe_features(columns),
            "notes": {"pixel goals": seen},
        }

    def finish(self, records: Sequence[Record], job: Job) -> None:
        """`meta/` of each scene."""
        starts: dict[str, list[list[float]]] = {}
        for scene, own in _by_scene(records).items():
            episodes = [MetaEpisode(r["index"], r["length"], r["task"], r["stats"]) for r in own]
            folder = _scene_folder(job.folder, job.settings.name, scene)
            write_meta(folder, episodes, own[0]["features"], job.settings.fps or FPS)
            starts[scene] = [r["start"] for r in own]
        about = About(list(records[0]["views"]), starts)
        write_bytes(job.folder / ABOUT, msgspec.json.encode(about) + b"\n")
        save_names(job.folder, records)

    def check(self, folder: Path) -> list[str]:
        """Tables, meta, pictures and pixel goals against one another."""
        faults = Faults()
        with faults.guard():
            about = load_typed(folder / ABOUT, About)
            for scene_folder in _scene_folders(folder, faults):
                lines = check_meta(scene_folder, faults)
                for line in lines:
                    with faults.guard():
                        _check_episode(scene_folder, line.episode_index, about.views, faults)
        return faults.told()

    def remarks(self, folder: Path) -> list[str]:
        """Where its loader would look for depth in vain.

        It replaces "rgb" in the whole path of a picture (InternRobotics/InternNav @7a5c624,
        `internnav/dataset/internvla_n1_lerobot_dataset.py` 1021).
        """
        whole = [folder.resolve(), *(folder / ROOT).glob("*/*")]
        if not any("rgb" in str(path) or ".jpg" in str(path) for path in whole):
            return []
        return [
            "the loader replaces rgb and .jpg in the whole path of a picture to find its depth: "
            "rename the folder, the scene or the data that has one in its name"
        ]

    def load(self, folder: Path) -> list[Recovered]:
        """Read it back, with the poses of the first camera."""
        about = load_typed(folder / ABOUT, About)
        if not about.views:
            raise FormatError("names no camera", file=folder / ABOUT, field="views")
        total = sum(len(starts) for starts in about.starts.values())
        names = load_names(folder, total)
        roots = {path.name: path for path in _scene_folders(folder, Faults())}
        done: dict[str, int] = {}
        found = []
        for name in names:
            index = done[name.scene] = done.get(name.scene, -1) + 1
            starts = about.starts.get(name.scene, [])
            if name.scene not in roots or index >= len(starts) or len(starts[index]) != 3:
                raise FormatError(f"no episode {name.id!r:.80}", file=folder / ABOUT)
            start = np.array(starts[index])
            found.append(_recover(name, roots[name.scene], index, start, about.views[0]))
        return found


def find_pixel_goals(
    poses: F64, depths: Sequence[F32], view: CameraPreset, height: float
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Pixel goals [N, 2] and how many frames ahead [N] they lie; −1 where none is in sight."""
    width, tall = view.picture_size
    k = intrinsics(view)
    cameras = camera_poses(poses, height, math.radians(view.pitch_degrees))
    floor = np.column_stack([poses[:, :2], np.zeros(len(poses))])
    goals = np.full((len(poses), 2), -1, np.int64)
    ahead = np.full(len(poses), -1, np.int64)
    for now in range(len(poses) - 1):
        pixels, far = project(floor[now + 1 :], cameras[now], k)
        inside = (far > 0.1) & (pixels >= 0).all(axis=1) & (pixels < (width, tall)).all(axis=1)
        chosen = np.floor(np.where(inside[:, None], pixels, 0)).astype(np.int64)
        seen = depths[now]
        rows = chosen[:, 1] * seen.shape[0] // tall
        cols = chosen[:, 0] * seen.shape[1] // width
        limit = float(seen.max(initial=0.0))
        nearest = seen[rows, cols]
        clear = (far <= limit) & (nearest >= far - (HIDDEN + 0.05 * far))
        good = np.flatnonzero(inside & clear)
        if len(good):
            last = int(good[-1])
            goals[now], ahead[now] = chosen[last], last + 1
    return goals, ahead


def _scene_folder(root: Path, name: str, scene: str) -> Path:
    return safe_join(root, f"{ROOT}/{name}/{scene}")


def _scene_folders(root: Path, faults: Faults) -> list[Path]:
    found = sorted(p.parent.parent for p in (root / ROOT).glob("*/*/meta/info.json"))
    faults.expect(bool(found), f"{root / ROOT}: no scene with meta/info.json")
    return found


def _by_scene(records: Sequence[Record]) -> dict[str, list[Record]]:
    found: dict[str, list[Record]] = {}
    for record in records:
        found.setdefault(record["scene"], []).append(record)
    return found


def _shapes(views: Sequence[str]) -> dict[str, tuple[int, ...]]:
    shapes: dict[str, tuple[int, ...]] = {"action": ()}
    for view in views:
        shapes |= {
            f"pose.{view}": (4, 4), f"goal.{view}": (2,), f"relative_goal_frame_id.{view}": (),
        }  # fmt: skip
    return shapes


def _check_episode(folder: Path, index: int, views: Sequence[str], faults: Faults) -> None:
    path = episode_path(folder, index)
    columns = load_columns(path, _shapes(views))
    action = columns["action"]
    faults.expect(len(action) > 0 and action[0] == -1, f"{path}: the first action is not -1")
    faults.expect(bool(np.isin(action[1:], (1, 2, 3)).all()), f"{path}: an action not in 1, 2, 3")
    for view in views:
        pose, goal = columns[f"pose.{view}"], columns[f"goal.{view}"]
        ahead = columns[f"relative_goal_frame_id.{view}"]
        turn = pose[:, :3, :3]
        straight = np.abs(turn @ turn.transpose(0, 2, 1) - np.eye(3)).max(initial=0.0)
        faults.expect(bool(straight < 1e-6), f"{path}: pose.{view} is not a rigid motion")
        faults.expect(
            bool(np.abs(pose[:1, :2, 3]).max(initial=0.0) < 1e-9),
            f"{path}: pose.{view} does not begin over the origin",
        )
        none = ahead == -1
        faults.expect(
            bool(((goal == -1).all(axis=1) == none).all()),
            f"{path}: goal.{view} and relative_goal_frame_id.{view} disagree on where none is",
        )
        reach = np.arange(len(ahead)) + ahead
        faults.expect(
            bool(((reach < len(ahead)) & (none | (ahead > 0))).all()),
            f"{path}: relative_goal_frame_id.{view} leads out of the episode",
        )
        sizes = set()
        videos = folder / f"videos/chunk-{index // 1000:03d}"
        for number in range(len(action)):
            stem = f"episode_{index:06d}_{number}"
            sizes.add(picture_size(safe_join(videos, f"observation.images.rgb.{view}/{stem}.jpg")))
            load_depth(safe_join(videos, f"observation.images.depth.{view}/{stem}.png"), MILLIMETRE)
        if faults.expect(len(sizes) == 1, f"{path}: pictures of several sizes, or none"):
            (size,) = sizes
            outside = ~none & ~((goal >= 0) & (goal < size)).all(axis=1)
            faults.expect(not outside.any(), f"{path}: goal.{view} lies outside the picture")


def _recover(name: Name, folder: Path, index: int, start: F64, view: str) -> Recovered:
    lines = load_episode_lines(folder)
    if index >= len(lines):
        raise FormatError(f"no episode {index}", file=folder / "meta/episodes.jsonl")
    columns = load_columns(episode_path(folder, index), _shapes([view]))
    videos = folder / f"videos/chunk-{index // 1000:03d}"

    def picture(pose: int) -> Frame:
        stem = f"episode_{index:06d}_{pose}"
        return Frame(
            load_picture(safe_join(videos, f"observation.images.rgb.{view}/{stem}.jpg")),
            load_depth(
                safe_join(videos, f"observation.images.depth.{view}/{stem}.png"), MILLIMETRE
            ),
        )

    return Recovered(
        id=name.id,
        scene=name.scene,
        instruction=lines[index].tasks[0],
        frames=lines[index].length,
        moves=tuple(columns["action"][1:].tolist()),
        poses=from_start_frame(columns[f"pose.{view}"], start),
        picture=picture,
    )
