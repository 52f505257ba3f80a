"""VLN-PE: a LeRobot v2.1 folder for each scene, with frames as .npy stacks, z up.

As InternNav's loader finds it (InternRobotics/InternNav @7a5c624, `internnav/utils/loader.py` 120
to 256): `traj_data/r2r/<scene>/` holds a table an episode (`observation.` camera and robot
position, orientation and yaw, progress, step, action), stacks of pictures, and in `meta/` the
instruction with its tokens and how the walk ended. It scans `r2r` alone, and cuts its keys at `_`,
so names of scenes have none. Depth is a share of 10 m and 256 by 256, as its models take it
(`norm_depth`, `internnav/evaluator/utils/common.py` 193; `cma_policy.py` 131 to 136).
`raw_data/r2r/` holds the same episodes as VLN-CE files, which InternNav turns z up itself.
Quaternions are (w, x, y, z), body axes (x forward, z up).
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
from numpy.typing import NDArray

from gn0.data.lerobot_schema import count_columns
from gn0.errors import ConfigError, FormatError
from gn0.export.cameras import camera_height, cos_sin
from gn0.export.exporter import ExportSettings, Job, OwnPoses, Place, Record
from gn0.export.faults import Faults, load_lines
from gn0.export.lerobot21 import (
    CHUNK,
    MetaEpisode,
    check_meta,
    column_stats,
    describe_features,
    encode_columns,
    episode_path,
    load_columns,
    write_meta,
)
from gn0.export.names import Name, load_names, save_names
from gn0.export.picture_files import load_stack, save_stack
from gn0.export.trips import RGBD, ExportSource, Frame, Recovered, Trip
from gn0.export.vlnce import (
    TOKENS,
    check_splits,
    instruction_tokens,
    read_words,
    remark_splits,
    remember,
    write_splits,
)
from gn0.geometry import F32, F64, U8, quaternion_from_rotation
from gn0.missions.sets.vocabulary import cut_words
from gn0.sim.presets import CameraPreset, find_preset
from gn0.storage import safe_join

ROOT, RAW = "traj_data/r2r", "raw_data/r2r"
FPS = 30
DEPTH_REACH = 10.0  # m
DEPTH_SIZE = (256, 256)  # px
CAMERA = "vlnce_r2r"  # where the dataset's own depth has another size
MOST_STEPS = 200  # `max_step` of its models: the loader cuts what is beyond
LONG = f"walk of more than {MOST_STEPS} steps, which the loader cuts"
# InternNav moves starts of R2R's trajectories by number (`dataset_utils.py`, up to 7,289)
FIRST_TRAJECTORY = 100_000
STRANGE = ("flash", "aliengo")  # scenes that its keys take for a robot
SHAPES: dict[str, tuple[int, ...]] = {
    "observation.camera_position": (3,),
    "observation.camera_orientation": (4,),
    "observation.camera_yaw": (),
    "observation.robot_position": (3,),
    "observation.robot_orientation": (4,),
    "observation.robot_yaw": (),
    "observation.progress": (),
    "observation.step": (),
    "observation.action": (),
}
STACKS = {
    name: f"videos/chunk-{{chunk:03d}}/observation.images.{name}/episode_{{index:06d}}.npy"
    for name in ("rgb", "depth")
}


class PeEpisode(msgspec.Struct):
    """What we read of a line of `tasks.jsonl`."""

    task_index: int
    instruction_text: str
    instruction_tokens: list[int]
    finish_status: str
    fail_reason: str
    scan: str


class Range(msgspec.Struct):
    """Tasks of an episode, first and last."""

    min: int
    max: int


class StatsLine(msgspec.Struct):
    """What we read of a line of `episodes_stats.jsonl`."""

    episode_index: int
    task_index: Range


class ExporterVlnPe(OwnPoses):
    """See the module."""

    name = "vln-pe"
    title = "VLN-PE trajectories (LeRobot v2.1) and episodes"
    reader = (
        "InternNav, training of CMA, Seq2Seq and RDP: `lerobot_features_dir` traj_data; episodes "
        "from raw_data/r2r"
    )
    frame = (
        "world of the scene, z up [m], yaw [rad]; quaternions (w, x, y, z), body axes x forward, "
        "z up; depth float32, share of 10 m; raw_data in Habitat's frame"
    )

    def cameras(self, source: ExportSource, settings: ExportSettings) -> tuple[CameraPreset, ...]:
        """One whose depth has the size that its models take."""
        preset = settings.preset(source)
        size = (preset.depth.width, preset.depth.height)
        if size == DEPTH_SIZE:
            return (preset,)
        if settings.camera:
            raise ConfigError(
                f"depth of {size[0]}×{size[1]}, and InternNav's models take 256×256",
                where=f"--camera {settings.camera}",
                remedy=f"--camera {CAMERA}, or leave it out",
            )
        return (find_preset(CAMERA),)

    def why_not(self, trip: Trip, settings: ExportSettings) -> str:
        """A walk that never stopped has no finish status of theirs."""
        if not cut_words(trip.episode.instruction):
            return "an instruction without words"
        return "" if trip.stopped else "it did not end with STOP"

    def reads(self, settings: ExportSettings) -> str:
        """R2R's vocabulary."""
        return "R2R" if read_words(settings) else ""

    def write(self, trip: Trip, place: Place, job: Job) -> Record:
        """Stacks and table of an episode."""
        source, settings = job.source, job.settings
        preset = self.cameras(source, settings)[0]
        folder = self._scene_folder(job, trip.episode.scene_id)
        index = place.scene_number
        depths: list[F32] = []

        def colours() -> Iterator[U8]:
            for frame in source.frames(trip, preset, RGBD):
                assert frame.rgb is not None and frame.depth is not None
                depths.append(_share(frame.depth))
                yield frame.rgb

        save_stack(_stack_path(folder, "rgb", index), colours(), trip.frames)
        save_stack(_stack_path(folder, "depth", index), depths, trip.frames)
        for name in ("rgb", "depth"):
            job.shelf.adopt(_stack_path(folder, name, index))
        height = camera_height(preset, source.preset, trip.episode.agent)
        columns = _columns(trip, height, math.radians(preset.pitch_degrees))
        columns |= count_columns(
            trip.frames, settings.fps or FPS, index, place.scene_first_frame, index
        )
        job.shelf.put(episode_path(folder, index), encode_columns(columns))
        remembered = remember(trip, settings)
        if trip.frames > MOST_STEPS:
            remembered["notes"] = {**remembered["notes"], LONG: 1}
        return {
            **remembered,
            "index": index,
            "length": trip.frames,
            "stats": column_stats(columns),
            "features": describe_features(columns),
        }

    def _scene_folder(self, job: Job, scene: str) -> Path:
        return safe_join(job.folder, f"{ROOT}/{plain_names(job.source.scenes)[scene]}")

    def finish(self, records: Sequence[Record], job: Job) -> None:
        """`meta/` of every scene, and the episodes."""
        write_splits(records, job, safe_join(job.folder, RAW), first_trajectory=FIRST_TRAJECTORY)
        words = read_words(job.settings)
        tokens = instruction_tokens([record["episode"] for record in records], words)
        by_scene: dict[str, list[MetaEpisode]] = {}
        features = records[0]["features"]
        for number, record in enumerate(records, 1):
            text = record["episode"]["mission"]["instruction"]
            scene = record["episode"]["scene_id"]
            more = {
                "instruction_text": text,
                "instruction_tokens": tokens[number - 1],
                "finish_status": "success",
                "fail_reason": "",
                "episode_id": number,
                "scan": scene,
            }
            index = record["index"]
            episode = MetaEpisode(
                index, record["length"], text, record["stats"], more=more,
                more_stats={"task_index": {"min": index, "max": index}}, more_task=more,
            )  # fmt: skip
            by_scene.setdefault(scene, []).append(episode)
        for scene, episodes in by_scene.items():
            folder = self._scene_folder(job, scene)
            write_meta(folder, episodes, features, job.settings.fps or FPS)
        save_names(job.folder, records)

    def check(self, folder: Path) -> list[str]:
        """What the loader finds and takes for granted; the episodes as VLN-CE."""
        faults = Faults()
        scenes = _scenes(folder)
        faults.expect(bool(scenes), f"{folder / ROOT}: no scenes; the loader looks nowhere else")
        for path in scenes:
            faults.expect(
                "_" not in path.name and path.name not in STRANGE,
                f"{path}: a name that the loader's keys cut up; it may have no _",
            )
            for line in check_meta(path, faults):
                with faults.guard():
                    _check_episode(path, line.episode_index, faults)
        check_splits(folder / RAW, faults)
        return faults.told()

    def remarks(self, folder: Path) -> list[str]:
        """What CMA and Seq2Seq would misread: they look tokens up as VLN-CE's models do."""
        remarks = remark_splits(folder / RAW)
        if "3dgs" in str(folder.resolve()):
            remarks.append(
                "the loader swaps colour channels and takes other depths where its path has 3dgs "
                "in it: rename the folder"
            )
        return remarks

    def load(self, folder: Path) -> list[Recovered]:
        """Read it back."""
        scenes = {}
        for path in _scenes(folder):
            lines = _episodes(path)
            if lines:
                scenes[lines[0].scan] = (path, lines)
        names = load_names(folder, sum(len(lines) for _, lines in scenes.values()))
        done: dict[str, int] = {}
        found = []
        for name in names:
            index = done[name.scene] = done.get(name.scene, -1) + 1
            path, lines = scenes.get(name.scene, (folder, []))
            if index >= len(lines):
                raise FormatError(f"no episode {name.id!r:.80}", file=folder)
            found.append(_recover(path, lines[index], name))
        return found


def plain_names(scenes: Iterable[str]) -> dict[str, str]:
    """A name without `_` for each scene id, no two alike."""
    found: dict[str, str] = {}
    for scene in sorted(scenes, key=lambda name: ("_" in name, name)):
        plain = scene.replace("_", "-")
        while plain in found.values() or plain in STRANGE:
            plain += "-x"
        found[scene] = plain
    return found


def _share(depth: F32) -> F32:
    """Depth [H, W] m as shares [H, W, 1] of 10 m."""
    return (np.clip(depth, 0.0, DEPTH_REACH) / np.float32(DEPTH_REACH)).astype(np.float32)[
        ..., None
    ]


def _stack_path(folder: Path, name: str, index: int) -> Path:
    return folder / STACKS[name].format(chunk=index // CHUNK, index=index)


def _columns(trip: Trip, height: float, pitch: float) -> dict[str, NDArray[Any]]:
    poses, count = trip.poses, trip.frames
    steps = np.r_[0.0, np.hypot(*np.diff(poses[:, :2], axis=0).T)].cumsum()
    whole = steps[-1]
    progress = steps / whole if whole > 0 else np.linspace(0.0, 1.0, count)
    return {
        "observation.camera_position": np.column_stack([poses[:, :2], np.full(count, height)]),
        "observation.camera_orientation": _orientations(poses[:, 2], pitch),
        "observation.camera_yaw": poses[:, 2].copy(),
        "observation.robot_position": np.column_stack([poses[:, :2], np.zeros(count)]),
        "observation.robot_orientation": _orientations(poses[:, 2], 0.0),
        "observation.robot_yaw": poses[:, 2].copy(),
        "observation.progress": progress,
        "observation.step": np.arange(count, dtype=np.int64),
        "observation.action": np.array([*trip.moves, 0], np.int64),
    }


def _orientations(yaws: F64, pitch: float) -> F64:
    """(w, x, y, z) [N, 4] of body axes turned by yaw and then up by pitch."""
    (c, s), p, q = cos_sin(yaws), math.cos(pitch), math.sin(pitch)
    turns = np.zeros((len(yaws), 3, 3))
    turns[:, :, 0] = np.column_stack([c * p, s * p, np.full(len(yaws), q)])
    turns[:, :, 1] = np.column_stack([-s, c, np.zeros(len(yaws))])
    turns[:, :, 2] = np.column_stack([-c * q, -s * q, np.full(len(yaws), p)])
    return quaternion_from_rotation(turns)


def _scenes(folder: Path) -> list[Path]:
    return sorted(p.parent for p in (folder / ROOT).glob("*/data") if p.is_dir())


def _episodes(path: Path) -> list[PeEpisode]:
    return load_lines(path / "meta/tasks.jsonl", PeEpisode)


def _check_episode(path: Path, index: int, faults: Faults) -> None:
    where = f"{path}, episode {index}"
    lines = [line for line in _episodes(path) if line.task_index == index]
    stats = load_lines(path / "meta/episodes_stats.jsonl", StatsLine)
    own = [s.task_index for s in stats if s.episode_index == index]
    faults.expect(
        own == [Range(index, index)] and len(lines) == 1,
        f"{where}: meta does not lead the loader to one instruction",
    )
    columns = load_columns(episode_path(path, index), SHAPES)
    action = columns["observation.action"]
    faults.expect(
        bool(np.isin(action, (0, 1, 2, 3)).all()) and bool((action[-1:] == 0).all()),
        f"{where}: actions are not 1, 2, 3 with a STOP at the end",
    )
    for line in lines:
        faults.expect(
            len(line.instruction_tokens) == TOKENS, f"{where}: instruction_tokens are not {TOKENS}"
        )
        faults.expect(
            line.finish_status == "success", f"{where}: it ended with {line.finish_status!r:.40}"
        )
    for name in ("camera", "robot"):
        length = np.linalg.norm(columns[f"observation.{name}_orientation"], axis=1)
        faults.expect(
            bool((np.abs(length - 1) < 1e-6).all()),
            f"{where}: {name}_orientation is not a rotation",
        )
    progress = columns["observation.progress"]
    faults.expect(
        bool(((progress >= 0) & (progress <= 1)).all() and (np.diff(progress) >= 0).all()),
        f"{where}: progress does not rise from 0 to 1",
    )
    for name, kind, last in (("rgb", np.uint8, 3), ("depth", np.float32, 1)):
        file = _stack_path(path, name, index)
        frames = load_stack(file)
        told = f"{file}: {frames.dtype}{list(frames.shape)}"
        faults.expect(
            frames.dtype == kind and frames.ndim == 4 and frames.shape[-1] == last
            and len(frames) == len(action),
            f"{told} for {len(action)} steps",
        )  # fmt: skip
        if name == "depth" and frames.dtype == kind:
            faults.expect(
                frames.shape[1:3] == DEPTH_SIZE, f"{told}, and its models take 256×256 pixels"
            )
            faults.expect(
                frames.min(initial=0.0) >= 0.0 and frames.max(initial=0.0) <= 1.0,
                f"{file}: depth is not a share of 10 m",
            )


def _recover(path: Path, line: PeEpisode, name: Name) -> Recovered:
    columns = load_columns(episode_path(path, line.task_index), SHAPES)
    rgb = load_stack(_stack_path(path, "rgb", line.task_index))
    depth = load_stack(_stack_path(path, "depth", line.task_index))
    return Recovered(
        id=name.id,
        scene=name.scene,
        instruction=line.instruction_text,
        frames=len(rgb),
        moves=tuple(columns["observation.action"][:-1].tolist()),
        poses=np.column_stack(
            [columns["observation.robot_position"][:, :2], columns["observation.robot_yaw"]]
        ),
        picture=lambda pose: Frame(
            np.array(rgb[pose]), np.array(depth[pose, ..., 0]) * np.float32(DEPTH_REACH)
        ),
    )
