"""GN-Matrix's older layout: `<scene>/<digits>.json`, one file per trajectory.

A JSON file beside the scene folders may list trajectories as {"easy": {scene: {id: {}}}, …}; with
one, only those belong to the set, and their group becomes the split.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import msgspec

from gn0.errors import FormatError
from gn0.maps.grid import OccupancyGrid
from gn0.missions.coordinate_frames import Placement
from gn0.missions.episode import Episode
from gn0.missions.episode_files import check_unique
from gn0.missions.sets.episode_set import EpisodeSet, Task
from gn0.missions.sets.gn_matrix import build_row, nav_placements, nav_task
from gn0.missions.sets.json_file import load_exact, save_exact
from gn0.storage import check_replaceable, folder_atomic, plain_path, safe_join, storage_error

FILE_LIMIT = 64 << 20  # bytes of one trajectory
GROUPS = ("easy", "medium", "hard")
CONFIG = "config.json"  # our name for the list of trajectories


@dataclass(frozen=True)
class JsonFolder:
    """The decoded folder.

    Attributes:
        files: content by (scene, file name), in the order of the tasks; then those that are no
            task of the set.
        tasks: how many of them are tasks.
        configs: lists of trajectories by file name.
    """

    files: dict[tuple[str, str], Any]
    tasks: int
    configs: dict[str, Any]


class _World(msgspec.Struct):
    x: float
    y: float


class _Facing(msgspec.Struct):
    unit_dx: float
    unit_dy: float
    heading_degrees: float


class _Label(msgspec.Struct):
    ins_id: str | int
    label: str
    goal_pixel: tuple[int, int]


class _At(msgspec.Struct):
    world: _World


class _FacingAt(msgspec.Struct):
    world: _Facing


class _Path(msgspec.Struct):
    raster_world: list[_World]
    raster_pixel: list[tuple[int, int]]


class _Trajectory(msgspec.Struct):
    """What we read of a file; the rest is kept and not looked at."""

    label: _Label
    start: _At
    start_facing: _FacingAt
    goal: _At
    instruction: str
    grounded_instruction: str
    path: _Path


class ExporterGnMatrixJson:
    """GN-Matrix as a folder of JSON files; `native` is a `JsonFolder`."""

    name = "gn-matrix-json"
    title = "GN-Matrix, a folder of <scene>/<digits>.json"
    camera = "gn_bench"

    def recognises(self, path: Path) -> bool:
        """Whether some sub-folder holds a file named by digits."""
        try:
            return path.is_dir() and any(
                f.stem.isdigit() for d in path.iterdir() if d.is_dir() for f in d.glob("*.json")
            )
        except OSError:
            return False

    def load(self, path: Path) -> EpisodeSet:
        """Read a folder.

        Raises:
            StorageError: a file is unreadable.
            FormatError: a trajectory is damaged or lacks a field (names file and field), or there
                is none.
        """
        path = plain_path(path)
        try:
            found = {
                (folder.name, file.name): file
                for folder in sorted(path.iterdir())
                if folder.is_dir() and not folder.name.startswith(".")
                for file in sorted(folder.glob("*.json"))
                if file.stem.isdigit()
            }
        except OSError as error:
            raise storage_error(error, path, "read the folder") from error
        if not found:
            raise FormatError(
                "no <scene>/<digits>.json in it", file=path, remedy="give the folder above scenes"
            )
        configs = {f.name: load_exact(f, FILE_LIMIT) for f in sorted(path.glob("*.json"))}
        listed = _listed(configs)
        files = {key: load_exact(file, FILE_LIMIT) for key, file in found.items()}
        ours, others, notes = {}, {}, []
        tasks: list[Task] = []
        for key, content in files.items():
            scene, name = key
            stem = Path(name).stem
            group = listed.get((scene, stem), "") if listed is not None else ""
            if listed is not None and not group:
                others[key] = content
                continue
            if isinstance(content, dict) and not _has_heading(content):
                others[key] = content  # GN-Bench itself passes over these without a word
                continue
            ours[key] = content
            tasks.append(_task(content, scene, stem, len(tasks) + 1, group, found[key]))
        check_unique(tasks, path)
        if others:
            notes.append(
                f"{len(others)} files are not episodes: not in {', '.join(configs) or 'the list'}, "
                "or without start_facing"
            )
        native = JsonFolder({**ours, **others}, len(ours), configs)
        return EpisodeSet(self.name, path.name, tuple(tasks), native, tuple(notes))

    def save(self, episodes: EpisodeSet, path: Path) -> None:
        """Write the folder: value for value what was read.

        Raises:
            FormatError: the set is of another format.
            StorageError: the folder exists and is not empty, or cannot be written.
        """
        native = episodes.native
        if not isinstance(native, JsonFolder):
            raise FormatError(f"a set of format {episodes.format!r} is not a folder of JSON files")
        check_replaceable(path, overwrite=False, marker=CONFIG)
        with folder_atomic(path, overwrite=False, marker=CONFIG) as folder:
            for (scene, name), content in native.files.items():
                save_exact(safe_join(folder, f"{scene}/{name}"), content)
            for name, content in native.configs.items():
                save_exact(safe_join(folder, name), content)

    def build(
        self, episodes: Sequence[Episode], grids: Mapping[str, OccupancyGrid], name: str
    ) -> EpisodeSet:
        """Files of our episodes; a trajectory whose name is no number gets the next free one.

        Raises:
            EpisodeError: an episode makes no sense, or its scene has no grid.
        """
        files: dict[tuple[str, str], Any] = {}
        for episode in episodes:
            row = build_row(episode, grids)
            stem = str(row["trajectory_id"])
            number = 0
            while not stem.isdigit() or (row["scene"], f"{stem}.json") in files:
                stem, number = f"{number:04d}", number + 1
            files[row["scene"], f"{stem}.json"] = _content(row, episode.id)
        ordered = dict(sorted(files.items()))
        tasks = tuple(
            _task(content, scene, Path(file).stem, number, "", Path(scene) / file)
            for number, ((scene, file), content) in enumerate(ordered.items(), 1)
        )
        return EpisodeSet(self.name, name, tasks, JsonFolder(ordered, len(ordered), {}))

    def take(self, native: JsonFolder, rows: Sequence[int]) -> JsonFolder:
        """These trajectories, and the lists as they are."""
        keys = list(native.files)[: native.tasks]
        return replace(
            native, files={keys[i]: native.files[keys[i]] for i in rows}, tasks=len(rows)
        )

    def placements(self, grid: OccupancyGrid) -> tuple[Placement, ...]:
        """See `nav_placements`."""
        return nav_placements(grid)


def _has_heading(content: dict[str, Any]) -> bool:
    try:
        return content["start_facing"]["world"]["heading_degrees"] is not None
    except (KeyError, TypeError):
        return False


def _listed(configs: Mapping[str, Any]) -> dict[tuple[str, str], str] | None:
    """Group of each listed (scene, trajectory); None where no list is given."""
    listed: dict[tuple[str, str], str] = {}
    seen = False
    for content in configs.values():
        if not isinstance(content, dict) or not any(group in content for group in GROUPS):
            continue
        seen = True
        for group in GROUPS:
            scenes = content.get(group)
            for scene, trajectories in scenes.items() if isinstance(scenes, dict) else ():
                if isinstance(trajectories, dict):
                    listed.update({(scene.strip(), str(t).strip()): group for t in trajectories})
    return listed if seen else None


def _task(content: Any, scene: str, stem: str, number: int, split: str, file: Path) -> Task:
    try:
        t = msgspec.convert(content, _Trajectory)
    except msgspec.ValidationError as error:
        raise FormatError(
            str(error), file=file, remedy="see the episode formats in docs/formats.md"
        ) from None
    if len(t.path.raster_world) != len(t.path.raster_pixel):
        raise FormatError(
            f"{len(t.path.raster_world)} world points and {len(t.path.raster_pixel)} pixels",
            file=file,
            field="path",
            remedy="one pixel per point",
        )
    row = {
        "scene": scene,
        "trajectory_id": stem,
        "grounded_instruction": t.grounded_instruction,
        "label_ins_id": t.label.ins_id,
        "label_label": t.label.label,
        "start_world_x": t.start.world.x,
        "start_world_y": t.start.world.y,
        "start_facing_heading_degrees": t.start_facing.world.heading_degrees,
        "goal_world_x": t.goal.world.x,
        "goal_world_y": t.goal.world.y,
        "path_raster_world_x": [p.x for p in t.path.raster_world],
        "path_raster_world_y": [p.y for p in t.path.raster_world],
    }
    return nav_task(row, number, split)


def _content(row: Mapping[str, Any], episode_id: str) -> dict[str, Any]:
    """A trajectory file of a GN-Matrix row."""
    world = zip(row["path_raster_world_x"], row["path_raster_world_y"], strict=True)
    pixels = zip(row["path_raster_pixel_x"], row["path_raster_pixel_y"], strict=True)
    return {
        "scene": row["scene"],
        "label": {
            "ins_id": row["label_ins_id"],
            "label": row["label_label"],
            "goal_pixel": [row["label_goal_pixel_x"], row["label_goal_pixel_y"]],
        },
        "start": {"world": {"x": float(row["start_world_x"]), "y": float(row["start_world_y"])}},
        "start_facing": {
            "world": {
                "unit_dx": float(row["start_facing_unit_dx"]),
                "unit_dy": float(row["start_facing_unit_dy"]),
                "heading_degrees": float(row["start_facing_heading_degrees"]),
            }
        },
        "goal": {"world": {"x": float(row["goal_world_x"]), "y": float(row["goal_world_y"])}},
        "instruction": row["instruction"],
        "grounded_instruction": row["grounded_instruction"],
        "path": {
            "raster_world": [{"x": float(x), "y": float(y)} for x, y in world],
            "raster_pixel": [[int(x), int(y)] for x, y in pixels],
        },
        "episode_id": episode_id,
    }
