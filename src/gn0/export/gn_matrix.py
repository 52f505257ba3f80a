"""GN-Matrix: the episodes as its Parquet file, or as its older folder of JSON files.

Positions are in GN-Matrix's nav frame, paths are the cells of the map that they cross. Where a
scene's nav frame lies in the world is kept beside the files, so that they can be read back.
"""

from __future__ import annotations

import shutil
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import msgspec
import numpy as np

from gn0.errors import FormatError
from gn0.export.exporter import ExportSettings, Job, OwnPoses, Place, Record
from gn0.export.faults import Faults, load_typed
from gn0.export.names import load_names, name_of, save_names
from gn0.export.trips import Recovered, Trip
from gn0.missions.coordinate_frames import NavFrame, Placement
from gn0.missions.episode import Episode
from gn0.missions.sets.episode_set import EpisodeSet, Exporter, get_exporter
from gn0.missions.sets.lost_goals import find_lost
from gn0.storage import safe_join, write_bytes

ABOUT = "gn0_gn_matrix.json"


class About(msgspec.Struct):
    """Files by split, and the shift (x, y) [m] from nav to world by scene."""

    files: dict[str, str]
    shifts: dict[str, tuple[float, float]]


class ExporterGnMatrixParquet(OwnPoses):
    """See the module."""

    name = "gn-matrix"
    title = "GN-Matrix episodes (Parquet)"
    reader = "GN-Bench: `data/datasets/GN_Matrix/…/*.parquet` beside the scene folders"
    frame = "GN-Matrix nav frame: world − (lower + upper) of each map [m]; pixels of occupancy.png"
    follows = True
    pictures = False
    has_splits = True
    episodes_format, suffix = "gn-matrix", ".parquet"

    def why_not(self, trip: Trip, settings: ExportSettings) -> str:
        """It takes every episode."""
        return ""

    def write(self, trip: Trip, place: Place, job: Job) -> Record:
        """Nothing yet: a file holds all episodes of a split."""
        return {
            "episode": msgspec.to_builtins(trip.episode),
            "gn0": name_of(trip),
            "notes": find_lost(trip.episode, several=False),
        }

    def finish(self, records: Sequence[Record], job: Job) -> None:
        """All files."""
        episodes = [msgspec.convert(record["episode"], Episode) for record in records]
        grids = {e.scene_id: job.source.grid(e.scene_id) for e in episodes}
        about = About({}, {s: NavFrame.from_grid(grid).shift for s, grid in grids.items()})
        exporter = get_exporter(self.episodes_format)
        for split in dict.fromkeys(episode.split for episode in episodes):
            own = [episode for episode in episodes if episode.split == split]
            about.files[split] = f"{job.settings.name}_{split}{self.suffix}"
            path = safe_join(job.folder, about.files[split])
            if path.is_dir():  # of a run that was stopped
                shutil.rmtree(path)
            exporter.save(exporter.build(own, grids, split), path)
        write_bytes(job.folder / ABOUT, msgspec.json.encode(about) + b"\n")
        save_names(job.folder, records)

    def check(self, folder: Path) -> list[str]:
        """Whether each file reads strictly, and what its episodes hold."""
        faults = Faults()
        with faults.guard():
            about = load_typed(folder / ABOUT, About)
            for file in about.files.values():
                with faults.guard():
                    self._check_set(self._exporter().load(safe_join(folder, file)), faults)
        return faults.told()

    def _check_set(self, episodes: EpisodeSet, faults: Faults) -> None:
        for task in episodes.tasks:
            where = f"{episodes.name}, {task.id!r}"
            values = np.array([*task.start, *(task.goal or (np.nan,))])
            faults.expect(bool(np.isfinite(values).all()), f"{where}: start or goal is not finite")
            faults.expect(bool(task.instruction.strip()), f"{where}: grounded_instruction is empty")
            faults.expect(len(task.path) > 0, f"{where}: the path is empty")

    def _exporter(self) -> Exporter:
        return get_exporter(self.episodes_format)

    def load(self, folder: Path) -> list[Recovered]:
        """Read it back, in the world frame."""
        about = load_typed(folder / ABOUT, About)
        found: list[Recovered] = []
        for file in about.files.values():
            episodes = self._exporter().load(safe_join(folder, file))
            found += [_recover(episodes, n, about) for n in range(len(episodes.tasks))]
        names = load_names(folder, len(found))
        return [recovered.named(name.id) for name, recovered in zip(names, found, strict=True)]


class ExporterGnMatrixFolder(ExporterGnMatrixParquet):
    """See the module; files of a scene are numbered, and name our episode."""

    name = "gn-matrix-json"
    title = "GN-Matrix episodes (JSON files)"
    reader = (
        "GN-Bench of July 2026 (first version) and its tools: `DATA_PATH` the folder of a split"
    )
    episodes_format, suffix = "gn-matrix-json", ""

    def load(self, folder: Path) -> list[Recovered]:
        """Read it back, in the world frame, by the episode that each file names."""
        about = load_typed(folder / ABOUT, About)
        found: dict[str, Recovered] = {}
        for file in about.files.values():
            episodes = self._exporter().load(safe_join(folder, file))
            contents: list[Any] = list(episodes.native.files.values())
            for number, content in enumerate(contents[: len(episodes.tasks)]):
                name = str(content.get("episode_id", number))
                found[name] = _recover(episodes, number, about).named(name)
        names = load_names(folder, len(found))
        if {name.id for name in names} != set(found):
            raise FormatError("files of other episodes than it names", file=folder)
        return [found[name.id] for name in names]


def _recover(episodes: EpisodeSet, number: int, about: About) -> Recovered:
    task = episodes.tasks[number]
    shift = about.shifts.get(task.scene)
    if shift is None or task.goal is None:
        raise FormatError(
            f"no frame of scene {task.scene!r:.80}", file=ABOUT, remedy="export it again"
        )
    placement = Placement("documented", (1, 1), shift)
    (x, y), (gx, gy) = placement.points([task.start[:2], task.goal]).tolist()
    return Recovered(
        id=task.id,
        scene=task.scene,
        instruction=task.instruction,
        start=np.array([[x, y, task.start[2]]]),
        goal=np.array([[gx, gy, 0.0]]),
    )
