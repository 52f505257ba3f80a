"""VLN-PE: a LeRobot v2.1 folder for each trajectory, with frames as .npy stacks, z up.

`traj_data/<scan>/<trajectory>/` holds the table (`observation.` camera and robot position,
orientation and yaw, progress, step, action), `rgb.npy` and `depth.npy`, and in `meta/` the
instruction with its tokens and how the walk ended. `raw_data/<name>/` holds the same episodes as
VLN-CE files, which InternNav turns z up itself. Quaternions are (w, x, y, z), body axes (x forward,
z up).
"""

from __future__ import annotations

import contextlib
import math
import os
import shutil
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
from numpy.typing import NDArray

from gn0.errors import FormatError
from gn0.export.cameras import camera_height, cos_sin
from gn0.export.exporter import ExportSettings, Job, OwnPoses, Place, Record
from gn0.export.faults import Faults, load_lines
from gn0.export.lerobot21 import (
    MetaEpisode,
    check_meta,
    column_stats,
    describe_features,
    encode_columns,
    episode_path,
    index_columns,
    load_columns,
    write_meta,
)
from gn0.export.names import load_names, name_of, save_names
from gn0.export.pictures import load_stack, save_stack
from gn0.export.trips import RGBD, Frame, Recovered, Trip
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
from gn0.storage import safe_join

ROOT, RAW = "traj_data", "raw_data"
FPS = 30
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
VIDEOS = "videos/chunk-000"
STACKS = {"rgb": f"{VIDEOS}/observation.images.rgb", "depth": f"{VIDEOS}/observation.images.depth"}


class PeEpisode(msgspec.Struct):
    """What we read of a line of `episodes.jsonl`."""

    episode_index: int
    tasks: list[str]
    length: int
    instruction_text: str
    instruction_tokens: list[int]
    finish_status: str
    fail_reason: str


class ExporterVlnPe(OwnPoses):
    """See the module."""

    name = "vln-pe"
    title = "VLN-PE trajectories (LeRobot v2.1) and episodes"
    reader = (
        "InternNav, training of CMA, Seq2Seq and RDP: `lerobot_features_dir` traj_data; episodes "
        "from raw_data"
    )
    frame = (
        "world of the scene, z up [m], yaw [rad]; quaternions (w, x, y, z), body axes x forward, "
        "z up; depth float32 [m]; raw_data in Habitat's frame"
    )

    def why_not(self, trip: Trip, settings: ExportSettings) -> str:
        """A walk that never stopped has no finish status of theirs."""
        if not cut_words(trip.episode.instruction):
            return "an instruction without words"
        return "" if trip.stopped else "it did not end with STOP"

    def reads(self, settings: ExportSettings) -> str:
        """R2R's vocabulary."""
        return "R2R" if read_words(settings) else ""

    def write(self, trip: Trip, place: Place, job: Job) -> Record:
        """Stacks and table of a trajectory."""
        source, settings = job.source, job.settings
        preset = settings.preset(source)
        key = f"{place.number:06d}"
        folder = safe_join(job.folder, f"{ROOT}/{trip.episode.scene_id}/{key}")
        depths: list[F32] = []

        def colours() -> Iterator[U8]:
            for frame in source.frames(trip, preset, RGBD):
                assert frame.rgb is not None and frame.depth is not None
                depths.append(frame.depth[..., None])
                yield frame.rgb

        save_stack(folder / STACKS["rgb"] / "rgb.npy", colours(), trip.frames)
        save_stack(folder / STACKS["depth"] / "depth.npy", depths, trip.frames)
        for name, stack in STACKS.items():  # newer readers look for the second name
            _link(folder / stack / f"{name}.npy", folder / stack / "episode_000000.npy")
        height = camera_height(preset, source.preset, trip.episode.agent)
        columns = _columns(trip, height, math.radians(preset.pitch_degrees))
        columns |= index_columns(trip.frames, settings.fps or FPS, 0, 0, 0)
        job.shelf.put(episode_path(folder, 0), encode_columns(columns))
        return {
            **remember(trip, settings),
            "gn0": name_of(trip),
            "key": key,
            "length": trip.frames,
            "stats": column_stats(columns),
            "features": describe_features(columns),
        }

    def finish(self, records: Sequence[Record], job: Job) -> None:
        """`meta/` of every trajectory, and the episodes."""
        write_splits(records, job, safe_join(job.folder, f"{RAW}/{job.settings.name}"))
        words = read_words(job.settings)
        tokens = instruction_tokens([record["episode"] for record in records], words)
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
            episode = MetaEpisode(
                0, record["length"], text, record["stats"], more=more,
                more_stats={"task_index": {"min": 0, "max": 0}}, more_task=more,
            )  # fmt: skip
            folder = safe_join(job.folder, f"{ROOT}/{scene}/{record['key']}")
            write_meta(folder, [episode], record["features"], job.settings.fps or FPS)
        save_names(job.folder, records)

    def check(self, folder: Path) -> list[str]:
        """Tables, stacks and meta against one another; the episodes as VLN-CE."""
        faults = Faults()
        found = _trajectories(folder)
        faults.expect(bool(found), f"{folder / ROOT}: no trajectories")
        faults.expect(
            len({path.name for path in found}) == len(found),
            f"{folder / ROOT}: two trajectories of one name; the reader takes the first for both",
        )
        for path in found:
            check_meta(path, faults)
            with faults.guard():
                _check_trajectory(path, faults)
        for name in sorted(p for p in (folder / RAW).glob("*") if p.is_dir()):
            check_splits(name, faults)
        return faults.told()

    def remarks(self, folder: Path) -> list[str]:
        """What CMA and Seq2Seq would misread: they look tokens up as VLN-CE's models do."""
        found = sorted(p for p in (folder / RAW).glob("*") if p.is_dir())
        return [remark for path in found for remark in remark_splits(path)]

    def load(self, folder: Path) -> list[Recovered]:
        """Read it back."""
        found = sorted(_trajectories(folder), key=lambda path: path.name)
        names = load_names(folder, len(found))
        return [
            _recover(path, name.id, name.scene) for path, name in zip(found, names, strict=True)
        ]


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


def _link(old: Path, new: Path) -> None:
    with contextlib.suppress(FileNotFoundError):
        new.unlink()
    try:
        os.link(old, new)
    except OSError:
        shutil.copyfile(old, new)


def _trajectories(folder: Path) -> list[Path]:
    return sorted(p.parent.parent for p in (folder / ROOT).glob("*/*/meta/info.json"))


def _episode(path: Path) -> PeEpisode:
    lines = load_lines(path / "meta/episodes.jsonl", PeEpisode)
    if len(lines) != 1:
        raise FormatError(f"{len(lines)} episodes, expected one", file=path / "meta/episodes.jsonl")
    return lines[0]


def _check_trajectory(path: Path, faults: Faults) -> None:
    episode = _episode(path)
    columns = load_columns(episode_path(path, 0), SHAPES)
    action = columns["observation.action"]
    faults.expect(
        bool(np.isin(action, (0, 1, 2, 3)).all()) and bool((action[-1:] == 0).all()),
        f"{path}: actions are not 1, 2, 3 with a STOP at the end",
    )
    faults.expect(
        len(episode.instruction_tokens) == TOKENS, f"{path}: instruction_tokens are not {TOKENS}"
    )
    for name in ("camera", "robot"):
        length = np.linalg.norm(columns[f"observation.{name}_orientation"], axis=1)
        faults.expect(
            bool((np.abs(length - 1) < 1e-6).all()), f"{path}: {name}_orientation is not a rotation"
        )
    progress = columns["observation.progress"]
    faults.expect(
        bool(((progress >= 0) & (progress <= 1)).all() and (np.diff(progress) >= 0).all()),
        f"{path}: progress does not rise from 0 to 1",
    )
    for name, stack in STACKS.items():
        for file in (f"{name}.npy", "episode_000000.npy"):
            frames = load_stack(path / stack / file)
            kind, last = (np.uint8, 3) if name == "rgb" else (np.float32, 1)
            faults.expect(
                frames.dtype == kind and frames.ndim == 4 and frames.shape[-1] == last
                and len(frames) == len(action),
                f"{path / stack / file}: {frames.dtype}{list(frames.shape)} for {len(action)} "
                "steps",
            )  # fmt: skip


def _recover(path: Path, name: str, scene: str) -> Recovered:
    episode = _episode(path)
    columns = load_columns(episode_path(path, 0), SHAPES)
    rgb = load_stack(path / STACKS["rgb"] / "rgb.npy")
    depth = load_stack(path / STACKS["depth"] / "depth.npy")
    return Recovered(
        id=name,
        scene=scene,
        instruction=episode.instruction_text,
        frames=len(rgb),
        moves=tuple(columns["observation.action"][:-1].tolist()),
        poses=np.column_stack(
            [columns["observation.robot_position"][:, :2], columns["observation.robot_yaw"]]
        ),
        picture=lambda pose: Frame(np.array(rgb[pose]), np.array(depth[pose, ..., 0])),
    )
