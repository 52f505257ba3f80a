"""Whether a set fits a scene's map: the share of its points on free ground, in words.

A wrong frame is the usual fault: a mirrored map, a half turn, a shift left out. Each such reading
is tried beside the documented one, and a better one is named together with the option that asks
for it. Nothing is ever corrected silently.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from gn0.errors import EpisodeError
from gn0.maps.grid import OccupancyGrid
from gn0.maps.navigation import NavigationMap
from gn0.missions.coordinate_frames import NavFrame, Placement
from gn0.missions.episode import Episode
from gn0.missions.goal import check_episode_fits
from gn0.missions.sets.episode_set import EpisodeSet, Exporter, Task

LOW_SHARE = 0.99  # fewer points than this on free cells look wrong: paths keep off walls
FEWER_MISSES = 5.0  # another frame is named if it leaves so many times fewer points off the floor
STOREY = 0.75  # m between the lowest and the highest point: more is another storey


@dataclass(frozen=True)
class FrameCheck:
    """How a set lies in one scene.

    Attributes:
        scene: scene id.
        episodes: how many tasks it has there.
        points: start, path and goal points of all of them.
        free: share of the points in free cells of the raw map, by placement name.
        used: name of the placement in use.
        pixels: share of path points whose pixel is the one the file gives; None where the format
            has no pixels.
    """

    scene: str
    episodes: int
    points: int
    free: dict[str, float]
    used: str
    pixels: float | None = None

    @property
    def better(self) -> str:
        """Name of a placement that fits clearly better than the one in use, or ""."""
        best = max(self.free, key=lambda name: self.free[name])
        missed = 1.0 - self.free[self.used]
        found = missed > 1.0 - LOW_SHARE and (1.0 - self.free[best]) * FEWER_MISSES <= missed
        return best if found else ""

    @property
    def ok(self) -> bool:
        """Whether nothing looks wrong."""
        return self.free[self.used] >= LOW_SHARE and (self.pixels is None or self.pixels >= 0.999)

    def __str__(self) -> str:
        share = self.free[self.used]
        text = (
            f"{self.scene}: {share:.1%} of {self.points:,} points of {self.episodes} episodes lie "
            "on free cells"
        )
        if self.pixels is not None:
            text += f", {self.pixels:.1%} of the path on the pixels that the file names"
        if self.better:
            text += (
                f". The frame looks wrong: read as {self.better!r} it would be "
                f"{self.free[self.better]:.1%}; if the picture agrees, "
                + (
                    "leave --frame out"
                    if self.better == "documented"
                    else f"give --frame {self.better}"
                )
            )
        elif share < LOW_SHARE:
            text += (
                ". A reference path should not leave the floor: look at the picture; is this the "
                "scene that the episodes were made for?"
            )
        return text


def check_frame(
    episodes: EpisodeSet, exporter: Exporter, grid: OccupancyGrid, scene: str, used: Placement
) -> FrameCheck:
    """How the tasks of one scene lie in its map, by every placement of the format."""
    tasks = episodes.of_scene(scene)
    points = np.concatenate([task.points for task in tasks]) if tasks else np.zeros((0, 2))
    placements = {p.name: p for p in (*exporter.placements(grid), used)}
    return FrameCheck(
        scene=scene,
        episodes=len(tasks),
        points=len(points),
        free={name: _share(grid, p.points(points)) for name, p in placements.items()},
        used=used.name,
        pixels=_pixels(episodes, grid, scene),
    )


def _share(grid: OccupancyGrid, points: np.ndarray) -> float:
    if not len(points):
        return 1.0
    finite = np.isfinite(points).all(axis=1)
    cells = grid.cells_of(np.where(finite[:, None], np.clip(points, -1e8, 1e8), 0.0))
    inside = finite & (cells >= 0).all(axis=1) & (cells < grid.shape).all(axis=1)
    rows, cols = np.where(inside[:, None], cells, 0).T
    return float((inside & ~grid.blocked[rows, cols]).mean())


def _pixels(episodes: EpisodeSet, grid: OccupancyGrid, scene: str) -> float | None:
    """Share of GN-Matrix path points whose pixel follows from their place in metres."""
    table = episodes.native
    if episodes.format != "gn-matrix":
        return None
    frame = NavFrame.from_grid(grid)
    hits = total = 0
    columns = [table.column(f"path_raster_{kind}") for kind in
               ("world_x", "world_y", "pixel_x", "pixel_y")]  # fmt: skip
    for row in episodes.rows.get(scene, []):
        wx, wy, px, py = (np.array(column[row].as_py(), np.float64) for column in columns)
        if not np.isfinite(wx + wy).all():
            total += len(wx)
            continue
        told = np.column_stack([px, py]).reshape(-1, 2)
        hits += int((frame.nav_to_pixels(np.column_stack([wx, wy])) == told).all(axis=1).sum())
        total += len(told)
    return hits / total if total else 1.0


def why_unfit(episode: Episode, navigation: NavigationMap) -> str:
    """Why an episode cannot be done in its scene, in a few words that can be counted; "" if it can.

    One of: "its values make no sense", "start is not walkable", "goal is not walkable", "goal
    cannot be reached".
    """
    try:
        check_episode_fits(episode, episode.scene_id, navigation)
    except EpisodeError as error:
        for part, reason in (
            ("start (", "start is not walkable"),
            ("goal (", "goal is not walkable"),
            ("goal cannot be reached", "goal cannot be reached"),
        ):
            if error.what.startswith(part):
                return reason
        return "its values make no sense"
    return ""


@dataclass(frozen=True)
class SetStatistics:
    """What a set holds, told without any scene.

    Attributes:
        episodes, scenes: how many.
        path_length: (least, median, greatest) length of the reference paths [m].
        straight: the same of the straight distance from start to goal [m].
        words: the same of the words of an instruction.
        no_goal: tasks without a goal.
        storeys: tasks whose floor heights differ by more than 0.75 m.
    """

    episodes: int
    scenes: int
    path_length: tuple[float, float, float]
    straight: tuple[float, float, float]
    words: tuple[float, float, float]
    no_goal: int
    storeys: int


def summarise(tasks: Sequence[Task]) -> SetStatistics:
    """What a set holds."""
    lengths, straight = [], []
    for task in tasks:
        if len(task.path) > 1:
            steps = np.diff(np.array(task.path), axis=0)
            lengths.append(float(np.hypot(steps[:, 0], steps[:, 1]).sum()))
        if task.goal is not None:
            straight.append(
                float(np.hypot(task.goal[0] - task.start[0], task.goal[1] - task.start[1]))
            )
    return SetStatistics(
        episodes=len(tasks),
        scenes=len({task.scene for task in tasks}),
        path_length=_spread(lengths),
        straight=_spread(straight),
        words=_spread([float(len(task.instruction.split())) for task in tasks]),
        no_goal=sum(task.goal is None for task in tasks),
        storeys=sum(task.heights[1] - task.heights[0] > STOREY for task in tasks),
    )


def _spread(values: Sequence[float]) -> tuple[float, float, float]:
    finite = [v for v in values if np.isfinite(v)]
    if not finite:
        return 0.0, 0.0, 0.0
    return min(finite), float(np.median(finite)), max(finite)
