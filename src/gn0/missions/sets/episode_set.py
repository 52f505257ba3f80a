"""A set of episodes as a third-party file has it: the tasks we understand, and all the rest.

`tasks` is the common reading of every format, in the floor plane of the file. `native` is the file
itself, decoded and untouched: writing a set gives back what was read, the fields nobody here knows
included. `place` turns tasks into episodes of scenes.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any, Literal, Protocol, runtime_checkable

import msgspec
import numpy as np

from gn0.errors import ConfigError, EpisodeError, FormatError
from gn0.geometry import F64
from gn0.maps.grid import OccupancyGrid
from gn0.missions.coordinate_frames import Placement
from gn0.missions.episode import (
    AgentSpec,
    Episode,
    MissionGoal,
    MissionInstruction,
    PathSource,
    check_episode,
)
from gn0.missions.paths import densify_path
from gn0.paper import SPACING
from gn0.plugins import get_plugin, plugin_names
from gn0.storage import check_contained, plain_path

Point = tuple[float, float]


class Task(msgspec.Struct, frozen=True, kw_only=True):
    """One task in the file's own floor plane (x, y) [m], yaw [rad] counter-clockwise.

    Attributes:
        id: name of the episode; unique in the set.
        scene: id of its scene.
        kind: "goal" (a semantic target) or "instruction" (a route in words).
        instruction: the text that the format gives to an agent.
        start: x, y [m], yaw [rad].
        goal: x, y [m]; None where the file keeps it secret.
        path: reference path [m] as the format gives it, start first.
        truth: dense ground truth [m] where the format has one, start first.
        heights: lowest and highest floor height [m] of start, goal and path.
        object_id, category: the target of a goal task.
        split: the file's own division, "" for none.
        number: 1-based place in the file.
    """

    id: str
    scene: str
    kind: Literal["goal", "instruction"]
    instruction: str
    start: tuple[float, float, float]
    goal: Point | None
    path: tuple[Point, ...]
    heights: tuple[float, float] = (0.0, 0.0)
    object_id: str = ""
    category: str = ""
    split: str = ""
    number: int = 0
    truth: tuple[Point, ...] = ()

    @property
    def points(self) -> np.ndarray:
        """Start, path and goal [N, 2] m."""
        ends = [self.start[:2]] + ([self.goal] if self.goal is not None else [])
        return np.array([*ends, *self.path], np.float64).reshape(-1, 2)


@dataclass(frozen=True, eq=False)
class EpisodeSet:
    """A file of episodes: what we understand of it, and the file itself.

    Attributes:
        format: exporter name: "gn-matrix", "gn-matrix-json", "vlnce" or a plug-in's.
        name: what people call it, usually the split.
        tasks: one a row, in the file's order.
        native: the decoded file, for its exporter alone.
        notes: what a reader should know (records that the format itself skips, …).
        camera: the preset of this set's own benchmark, where that is not its format's.
    """

    format: str
    name: str
    tasks: tuple[Task, ...]
    native: Any
    notes: tuple[str, ...] = ()
    camera: str = ""

    @cached_property
    def rows(self) -> dict[str, list[int]]:
        """Places of the tasks of each scene."""
        found: dict[str, list[int]] = {}
        for row, task in enumerate(self.tasks):
            found.setdefault(task.scene, []).append(row)
        return found

    @property
    def scenes(self) -> tuple[str, ...]:
        """Scene ids, sorted."""
        return tuple(sorted(self.rows))

    def of_scene(self, scene: str) -> list[Task]:
        """The tasks of a scene, in the file's order."""
        return [self.tasks[row] for row in self.rows.get(scene, [])]

    def select(self, ids: Sequence[str]) -> EpisodeSet:
        """The set of these tasks only, in the file's order.

        Raises:
            EpisodeError: an id that the set does not have.
        """
        wanted = set(ids)
        missing = sorted(wanted - {task.id for task in self.tasks})
        if missing:
            raise EpisodeError(f"no episode {missing[0]!r} in the set {self.name!r}")
        if len(wanted) == len(self.tasks):
            return self
        rows = [i for i, task in enumerate(self.tasks) if task.id in wanted]
        native = get_exporter(self.format).take(self.native, rows)
        return replace(self, tasks=tuple(self.tasks[i] for i in rows), native=native)


@runtime_checkable
class Exporter(Protocol):
    """Reads and writes one format of episode sets; run `gn0.testing.check_exporter` on yours.

    Attributes:
        name: plug-in name.
        title: one line for people.
        camera: preset that the format's own benchmark uses.
    """

    name: str
    title: str
    camera: str

    def recognises(self, path: Path) -> bool:
        """Whether a file or folder looks like this format; never raises for what it cannot read."""
        ...

    def load(self, path: Path) -> EpisodeSet:
        """Read a set.

        Raises:
            StorageError, FormatError: missing or damaged; names file, row and field.
        """
        ...

    def save(self, episodes: EpisodeSet, path: Path) -> None:
        """Write a set of this format, so that `load` reads back the same."""
        ...

    def build(
        self, episodes: Sequence[Episode], grids: Mapping[str, OccupancyGrid], name: str
    ) -> EpisodeSet:
        """A set of this format from our episodes, given the raw grid of each scene."""
        ...

    def take(self, native: Any, rows: Sequence[int]) -> Any:
        """The native content of these tasks only (0-based places among the tasks)."""
        ...

    def placements(self, grid: OccupancyGrid) -> tuple[Placement, ...]:
        """Ways to lay the file's floor plane into a scene: the documented one first."""
        ...


def get_exporter(name: str) -> Exporter:
    """The exporter of that name.

    Raises:
        ConfigError: no such exporter; lists those that exist.
    """
    exporter: Exporter = get_plugin("exporter", name)()
    return exporter


def load_set(path: Path | str, format: str = "") -> EpisodeSet:
    """Read an episode set of any known format.

    Args:
        path: a file or folder.
        format: exporter name; detected from the content when empty.

    Raises:
        StorageError, FormatError: missing, damaged, or of no known format.
        ConfigError: no such exporter.
    """
    path = plain_path(path)
    check_contained(path)
    if format:
        return get_exporter(format).load(path)
    exporters = [get_exporter(name) for name in plugin_names("exporter")]
    if not path.exists():
        from gn0.errors import StorageError

        raise StorageError("no such file or folder", where=path, remedy="check the path")
    for exporter in exporters:
        if exporter.recognises(path):
            return exporter.load(path)
    raise FormatError(
        "no known episode format",
        file=path,
        remedy="known: " + "; ".join(f"{e.name} ({e.title})" for e in exporters),
    )


def find_placement(exporter: Exporter, grid: OccupancyGrid, name: str) -> Placement:
    """The placement of that name; "" means the documented one.

    Raises:
        ConfigError: no such placement; lists those that exist.
    """
    known = exporter.placements(grid)
    for placement in known:
        if placement.name == (name or known[0].name):
            return placement
    raise ConfigError(
        f"no frame {name!r} for {exporter.name}",
        where="--frame",
        remedy="known: " + ", ".join(p.name for p in known),
    )


LONGEST_PATH = 10_000.0  # m of a path that is resampled


def place_task(task: Task, placement: Placement, agent: AgentSpec, split: str = "") -> Episode:
    """The task as an episode of its scene, in the world frame.

    Its path, which nDTW and SDTW score, is the dense ground truth as it stands where the format has
    one; else the format's path, with points at most 0.25 m apart.

    Raises:
        EpisodeError: no goal is known, the instruction is empty, a value is not finite, or the path
            is absurdly long.
    """
    where = f"episode {task.id!r}"
    if task.goal is None:
        raise EpisodeError("has no goal: it cannot be scored", where=where)
    (x, y), goal = placement.points([task.start[:2], task.goal]).tolist()
    path, source = _scored_path(task, placement, [[x, y], goal])
    mission: MissionGoal | MissionInstruction
    place = (goal[0], goal[1])
    if task.kind == "goal":
        mission = MissionGoal(
            goal=place,
            object_id=task.object_id,
            category=task.category,
            instruction=task.instruction,
        )
    else:
        mission = MissionInstruction(goal=place, instruction=task.instruction)
    return check_episode(
        Episode(
            id=task.id,
            scene_id=task.scene,
            mission=mission,
            start=(x, y, placement.yaw(task.start[2])),
            path=tuple((px, py) for px, py in path.tolist()),
            split=split or task.split or "test",
            seed=task.number,
            agent=agent,
            path_source=source,
        )
    )


def _scored_path(
    task: Task, placement: Placement, ends: list[list[float]]
) -> tuple[F64, PathSource]:
    """The path [N, 2] m of an episode, and where it comes from."""
    if task.truth:
        return placement.points(task.truth), "truth"
    path = placement.points(task.path) if task.path else np.array(ends, np.float64)
    gaps = np.hypot(*np.diff(path, axis=0).T) if len(path) > 1 else np.zeros(0)
    # what is not finite is refused with the episode
    if not np.isfinite(gaps).all() or gaps.max(initial=0.0) <= SPACING + 1e-6:
        return path, "file"
    # 40,000 points; a damaged number would ask for billions
    if gaps.max() > LONGEST_PATH or gaps.sum() > LONGEST_PATH:
        raise EpisodeError(
            f"its path is more than {LONGEST_PATH:g} m long",
            where=f"episode {task.id!r}",
            remedy="correct the path, or leave the episode out",
        )
    return densify_path(path), "resampled"
