"""NavDP (vln_n1): smooth camera trajectories, depth, and the obstacles of each scene.

NavDP predicts 24 steps of at most 0.25 m, four frames apart, and has no turn on the spot: so the
way is walked again with a frame every 0.0625 m, looking 0.5 m ahead along it. `action` is the
camera in the world (Blender's camera axes, z up), `observation.camera_extrinsic` its mount (x
right, y forward, z up). Its loader reads one chunk a scene and finds pictures by sorted names, so
there is one chunk and names are padded.
"""

from __future__ import annotations

import contextlib
import io
import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import binary_dilation

from gn0.data.lerobot_schema import count_columns
from gn0.errors import FormatError, Gn0Error
from gn0.export.cameras import camera_height, from_mounted, intrinsics, mount, mounted_poses
from gn0.export.export_file import load_export_file
from gn0.export.exporter import ExportSettings, Job, OwnPoses, Place, Record
from gn0.export.faults import Faults, load_lines
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
from gn0.export.names import load_names, name_of, save_names
from gn0.export.picture_files import (
    encode_depth,
    encode_jpeg,
    load_depth,
    load_picture,
    picture_size,
)
from gn0.export.trips import RGBD, Frame, Recovered, Trip
from gn0.geometry import F32, F64
from gn0.maps.grid import OccupancyGrid
from gn0.storage import read_bytes, safe_join, write_bytes

ROOT, CHUNK = "vln_n1", 1_000_000
FPS = 30
DEPTH_UNIT = 1e-4  # m
LOOK_AHEAD = 0.5  # m
STRIDE, FARTHEST_STEP = 4, 0.25  # frames, m: labels are four times a step and clipped to 1
FARTHEST_FRAME = FARTHEST_STEP / STRIDE  # m
FEWEST = 4  # frames: its loader draws a start, a memory and a target from them
BETWEEN_STEPS = (
    "people are in its pictures, and between the steps of a walk nobody knows where: give "
    "--spacing 0, which keeps the steps; NavDP's decoder cuts those of a body whose forward_step "
    f"is more than {FARTHEST_FRAME} m"
)
OBSTACLE, FLOOR = (0, 0, 128), (200, 200, 200)  # the loader wants (0, 0, 0.5) ± 0.05
HEIGHT_OF_OBSTACLE = 0.5  # m
SHAPES: dict[str, tuple[int, ...]] = {
    "observation.camera_intrinsic": (3, 3),
    "observation.camera_extrinsic": (4, 4),
    "action": (4, 4),
}
RGB_FOLDER = "videos/chunk-000/observation.images.rgb"
DEPTH_FOLDER = "videos/chunk-000/observation.images.depth"


class Range(msgspec.Struct):
    """First and last picture of an episode, among the sorted pictures of its scene."""

    min: int
    max: int


class StatsLine(msgspec.Struct):
    """What we read of a line of `episodes_stats.jsonl`."""

    episode_index: int
    image_index: Range


class ExporterNavDp(OwnPoses):
    """See the module."""

    name = "navdp"
    title = "NavDP layout (InternData-N1 vln_n1)"
    reader = "InternNav, NavDP training: its LeRobot dataset with `root_dir` vln_n1"
    frame = (
        "world of the scene, z up [m]; action = camera to world (x right, y up, z back), "
        "camera_extrinsic = camera to body (x right, y forward, z up); depth: PNG in 0.1 mm, "
        "6.5535 m and more alike"
    )
    one_a_path = True

    def why_not(self, trip: Trip, settings: ExportSettings) -> str:
        """A way too short for its loader; people, where its frames are not steps of the walk."""
        if settings.spacing and trip.episode.people:
            return BETWEEN_STEPS
        if len(self.poses(trip, settings)) < FEWEST:
            return f"fewer than {FEWEST} frames along the way"
        return ""

    def poses(self, trip: Trip, settings: ExportSettings) -> F64:
        """Evenly spaced along the way; the trip's own with a spacing of 0."""
        return trace_way(trip.poses, settings.spacing) if settings.spacing else trip.poses

    def write(self, trip: Trip, place: Place, job: Job) -> Record:
        """Pictures and table of an episode."""
        source, settings = job.source, job.settings
        preset = settings.preset(source)
        folder = _scene_folder(job.folder, settings.name, trip.episode.scene_id)
        index, poses = place.scene_number, self.poses(trip, settings)
        frames = (
            source.eyes.look(trip, poses, preset, RGBD)
            if settings.spacing
            else source.frames(trip, preset, RGBD)
        )
        for number, frame in enumerate(frames):
            assert frame.rgb is not None and frame.depth is not None
            stem = f"episode_{index:06d}_{number:06d}"
            job.shelf.put(
                folder / RGB_FOLDER / f"{stem}.jpg", encode_jpeg(frame.rgb, settings.quality)
            )
            job.shelf.put(
                folder / DEPTH_FOLDER / f"{stem}.png", encode_depth(frame.depth, DEPTH_UNIT)
            )
        height = camera_height(preset, source.preset, trip.episode.agent)
        pitch = math.radians(preset.pitch_degrees)
        count = len(poses)
        columns: dict[str, NDArray[Any]] = {
            "observation.camera_intrinsic": np.tile(intrinsics(preset), (count, 1, 1)),
            "observation.camera_extrinsic": np.tile(mount(height, pitch), (count, 1, 1)),
            "action": mounted_poses(poses, height, pitch),
        }
        columns |= count_columns(count, settings.fps or FPS, index, place.scene_first_frame, index)
        job.shelf.put(episode_path(folder, index, CHUNK), encode_columns(columns))
        return {
            "gn0": name_of(trip),
            "scene": trip.episode.scene_id,
            "index": index,
            "first": place.scene_first_frame,
            "length": count,
            "task": trip.episode.instruction,
            "stats": column_stats(columns),
            "features": describe_features(columns),
        }

    def finish(self, records: Sequence[Record], job: Job) -> None:
        """`meta/` and the obstacles of each scene."""
        by_scene: dict[str, list[Record]] = {}
        for record in records:
            by_scene.setdefault(record["scene"], []).append(record)
        for scene, own in by_scene.items():
            folder = _scene_folder(job.folder, job.settings.name, scene)
            episodes = [
                MetaEpisode(
                    r["index"],
                    r["length"],
                    r["task"],
                    r["stats"],
                    more_stats={
                        "image_index": {"min": r["first"], "max": r["first"] + r["length"] - 1}
                    },
                )
                for r in own
            ]
            write_meta(folder, episodes, own[0]["features"], job.settings.fps or FPS, CHUNK)
            write_bytes(folder / "meta/pointcloud.ply", encode_obstacles(job.source.grid(scene)))
        save_names(job.folder, records)

    def check(self, folder: Path) -> list[str]:
        """Everything its loader touches."""
        faults = Faults()
        groups = sorted(p for p in (folder / ROOT).glob("*") if p.is_dir())
        faults.expect(bool(groups), f"{folder / ROOT}: no groups of scenes")
        strays = [p for p in (folder / ROOT).glob("*") if not p.is_dir()]
        faults.expect(not strays, f"{folder / ROOT}: the loader takes every entry for a folder")
        for scene in sorted(p for group in groups for p in group.iterdir()):
            if faults.expect(scene.is_dir(), f"{scene}: the loader takes it for a scene"):
                with faults.guard():
                    _check_scene(scene, faults)
        return faults.told()

    def remarks(self, folder: Path) -> list[str]:
        """Where a step of four frames is longer than its decoder can say."""
        longest = 0.0
        with contextlib.suppress(Gn0Error):
            for scene in sorted((folder / ROOT).glob("*/*")):
                for _, poses, _, _ in _load_scene(scene):
                    places = poses[:, :2]
                    steps = np.hypot(*(places[STRIDE:] - places[:-STRIDE]).T)
                    longest = max(longest, float(steps.max(initial=0.0)))
        if longest <= FARTHEST_STEP + 1e-6:
            return []
        advice = f"--spacing {FARTHEST_FRAME} or less"
        if _keeps_steps(folder):  # with people there is no other spacing
            advice += (
                " for walks without people. Those with people keep the steps of their body: only "
                f"data of a body with a forward_step of {FARTHEST_FRAME} m or less is not cut"
            )
        return [
            f"steps of {longest:.2f} m in {STRIDE} frames; NavDP's decoder says at most "
            f"{FARTHEST_STEP} m and cuts the rest: {advice}"
        ]

    def load(self, folder: Path) -> list[Recovered]:
        """Read it back, as the loader finds its pictures."""
        scenes = {p.name: p for p in sorted((folder / ROOT).glob("*/*"))}
        loaded = {name: _load_scene(path) for name, path in scenes.items()}
        names = load_names(folder, sum(map(len, loaded.values())))
        done: dict[str, int] = {}
        found = []
        for name in names:
            index = done[name.scene] = done.get(name.scene, -1) + 1
            if index >= len(loaded.get(name.scene, [])):
                raise FormatError(f"no episode {name.id!r:.80}", file=folder)
            task, poses, colour, grey = loaded[name.scene][index]

            def picture(pose: int, rgb: list[Path] = colour, depth: list[Path] = grey) -> Frame:
                return Frame(load_picture(rgb[pose]), load_depth(depth[pose], DEPTH_UNIT))

            found.append(
                Recovered(
                    id=name.id,
                    scene=name.scene,
                    instruction=task,
                    frames=len(colour),
                    poses=poses,
                    picture=picture,
                )
            )
        return found


def _keeps_steps(folder: Path) -> bool:
    """Whether an export's frames are the steps of its walks."""
    with contextlib.suppress(Gn0Error):
        return load_export_file(folder).settings.spacing == 0
    return False


def trace_way(poses: F64, spacing: float) -> F64:
    """Poses [K, 3] every `spacing` m along a walk, looking 0.5 m ahead along it; its end included.

    A walk that never moves gives the first pose alone.
    """
    steps = np.hypot(*np.diff(poses[:, :2], axis=0).T)
    kept = np.r_[True, steps > 1e-9]
    points = poses[kept, :2]
    if len(points) < 2:
        return poses[:1].copy()
    along = np.r_[0.0, np.cumsum(np.hypot(*np.diff(points, axis=0).T))]
    count = max(2, math.ceil(along[-1] / spacing - 1e-9) + 1)
    at = np.linspace(0.0, along[-1], count)
    here = _sample(points, along, at)
    ahead = _sample(points, along, np.minimum(at + LOOK_AHEAD, along[-1])) - here
    ahead[-1] = points[-1] - points[-2]
    near = np.hypot(*ahead.T) < 1e-6  # a way that comes back to where it was
    yaw = np.array([math.atan2(y, x) for x, y in ahead.tolist()])
    for number in np.flatnonzero(near).tolist():
        yaw[number] = yaw[number - 1] if number else poses[0, 2]
    return np.column_stack([here, yaw])


def _sample(points: F64, along: F64, at: F64) -> F64:
    return np.column_stack([np.interp(at, along, points[:, axis]) for axis in (0, 1)])


def encode_obstacles(grid: OccupancyGrid) -> bytes:
    """A PLY of a map: rims of what blocks, in the colour its loader looks for, and the floor."""
    blocked = grid.blocked
    rim = blocked & binary_dilation(~blocked, np.ones((3, 3), bool))
    parts = []
    for mask, height, colour in ((rim, HEIGHT_OF_OBSTACLE, OBSTACLE), (~blocked, 0.0, FLOOR)):
        cells = np.argwhere(mask)
        points = np.zeros(len(cells), _VERTEX)
        centres = (cells[:, ::-1] + 0.5) * grid.resolution + grid.origin
        points["x"], points["y"], points["z"] = centres[:, 0], centres[:, 1], height
        points["red"], points["green"], points["blue"] = colour
        parts.append(points)
    vertices = np.concatenate(parts)
    return _ply_head(len(vertices)) + vertices.tobytes()


_VERTEX = np.dtype([(c, "<f4") for c in "xyz"] + [(c, "u1") for c in ("red", "green", "blue")])


def _ply_head(count: int) -> bytes:
    lines = ["ply", "format binary_little_endian 1.0", f"element vertex {count}"]
    lines += [f"property float {c}" for c in "xyz"]
    lines += [f"property uchar {c}" for c in ("red", "green", "blue")]
    return ("\n".join([*lines, "end_header"]) + "\n").encode()


def load_obstacles(path: Path) -> F32:
    """The obstacle points [N, 3] m, chosen by colour as the loader does.

    Raises:
        StorageError, FormatError: missing, or not the file that we write.
    """
    data = read_bytes(path)
    head, _, body = data.partition(b"end_header\n")
    for line in head.decode("ascii", "replace").splitlines():
        if line.startswith("element vertex ") and line[15:].isdigit():
            count = int(line[15:])
            break
    else:
        raise FormatError("no PLY with vertices", file=path, remedy="export it again")
    if head + b"end_header\n" != _ply_head(count) or len(body) != count * _VERTEX.itemsize:
        raise FormatError("not a whole point cloud", file=path, remedy="export it again")
    points = np.frombuffer(io.BytesIO(body).getvalue(), _VERTEX)
    colour = np.column_stack([points[c] for c in ("red", "green", "blue")]) / 255.0
    chosen = np.abs(colour - (0, 0, 0.5)).sum(axis=1) < 0.05
    return np.column_stack([points[c][chosen] for c in "xyz"])


def _scene_folder(root: Path, name: str, scene: str) -> Path:
    return safe_join(root, f"{ROOT}/{name}/{scene}")


def _load_scene(scene: Path) -> list[tuple[str, F64, list[Path], list[Path]]]:
    lines = load_episode_lines(scene)
    stats = load_lines(scene / "meta/episodes_stats.jsonl", StatsLine)
    colour = sorted((scene / RGB_FOLDER).glob("*"))
    grey = sorted((scene / DEPTH_FOLDER).glob("*"))
    if len(stats) != len(lines) or len(colour) != len(grey):
        raise FormatError("episodes or pictures are missing", file=scene)
    found = []
    for line, stat in zip(lines, stats, strict=True):
        columns = load_columns(episode_path(scene, line.episode_index, CHUNK), SHAPES)
        if not len(columns["action"]):
            raise FormatError("an episode without frames", file=scene)
        poses = from_mounted(columns["action"], columns["observation.camera_extrinsic"][0])
        span = slice(max(stat.image_index.min, 0), max(stat.image_index.max + 1, 0))
        found.append((line.tasks[0], poses, colour[span], grey[span]))
    return found


def _check_scene(scene: Path, faults: Faults) -> None:
    lines = check_meta(scene, faults)
    chunks = sorted(p.name for p in (scene / "data").glob("*"))
    faults.expect(chunks == ["chunk-000"], f"{scene}/data: chunks {chunks}, the loader reads one")
    obstacles = load_obstacles(scene / "meta/pointcloud.ply")
    faults.expect(len(obstacles) > 0, f"{scene}/meta/pointcloud.ply: no obstacle points")
    sizes, number = set(), 0
    for line, (_, _, colour, grey) in zip(lines, _load_scene(scene), strict=True):
        name = f"{scene}, episode {line.episode_index}"
        faults.expect(
            len(colour) == len(grey) == line.length >= FEWEST,
            f"{name}: {len(colour)} pictures and {len(grey)} depths for {line.length} frames",
        )
        for rgb, depth in zip(colour, grey, strict=False):
            sizes.add(picture_size(rgb))
            load_depth(depth, DEPTH_UNIT)
            stem = f"episode_{line.episode_index:06d}_"
            faults.expect(
                rgb.stem == depth.stem and rgb.stem.startswith(stem),
                f"{name}: picture {rgb.name} beside depth {depth.name}",
            )
        columns = load_columns(episode_path(scene, line.episode_index, CHUNK), SHAPES)
        turn = columns["action"][:, :3, :3]
        off = np.abs(turn @ turn.transpose(0, 2, 1) - np.eye(3)).max(initial=0.0)
        faults.expect(bool(off < 1e-6), f"{name}: action is not a rigid motion")
        number += line.length
    faults.expect(len(sizes) <= 1, f"{scene}: pictures of several sizes")
    found = len(list((scene / RGB_FOLDER).glob("*")))
    faults.expect(found == number, f"{scene}: {found} pictures for {number} frames")
