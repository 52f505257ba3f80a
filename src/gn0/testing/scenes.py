"""Scenes and episodes for tests: small, in code, the same for the same seed.

`build_room_scene` has splats and objects. `build_map_scene(build_floor_plan(seed))` is a map only,
for whatever moves and plans without looking.
"""

from __future__ import annotations

from dataclasses import replace

import msgspec
import numpy as np

from gn0.errors import EpisodeError
from gn0.gaussians.cloud import GaussianCloud
from gn0.maps.goal_places import GoalSet
from gn0.maps.grid import FREE, OCCUPIED, UNKNOWN, OccupancyGrid
from gn0.maps.navigation import NavigationMap
from gn0.missions.episode import AgentSpec, Episode, MissionInstruction
from gn0.scenes.example import build_example_scene as build_room_scene
from gn0.scenes.scene import Scene, SceneSourceInfo, name_categories
from gn0.seeds import random_stream

__all__ = [
    "build_floor_plan", "build_labelled_scene", "build_map_scene", "build_point_episodes",
    "build_room_scene", "with_goal_sets",
]  # fmt: skip

_ROOM = 2.2  # m, a room is not split below twice this
_DOOR = 0.9  # m
_TRIES = 4000


def build_floor_plan(
    seed: int,
    *,
    width: float = 12.0,
    depth: float = 9.0,
    clutter: int = 14,
    resolution: float = 0.05,
) -> OccupancyGrid:
    """A furnished floor plan: rooms by halving, a door in each wall, boxes, an unknown corner.

    Args:
        seed: which plan.
        width: size along x [m].
        depth: size along y [m].
        clutter: boxes and posts strewn about.
        resolution: cell size [m].
    """
    rng = random_stream(seed, "floor plan")
    rows, cols = round(depth / resolution), round(width / resolution)
    cells = np.full((rows, cols), FREE, np.uint8)
    cells[:2], cells[-2:], cells[:, :2], cells[:, -2:] = (OCCUPIED,) * 4
    door, least = round(_DOOR / resolution), round(_ROOM / resolution)
    stack = [(0, rows, 0, cols)]
    while stack:
        top, bottom, left, right = stack.pop()
        along_x = right - left > bottom - top
        low, high = (left, right) if along_x else (top, bottom)
        if high - low < 2 * least:
            continue
        cut = int(rng.integers(low + least, high - least + 1))
        first, last = (top, bottom) if along_x else (left, right)
        gap = int(rng.integers(first + 4, max(last - door - 4, first + 5)))
        wall = np.full(last - first, OCCUPIED, np.uint8)
        wall[gap - first : gap - first + door] = FREE
        if along_x:
            cells[top:bottom, cut : cut + 2] = wall[:, None]
            stack += [(top, bottom, left, cut), (top, bottom, cut + 2, right)]
        else:
            cells[cut : cut + 2, left:right] = wall[None, :]
            stack += [(top, cut, left, right), (cut + 2, bottom, left, right)]
    for _ in range(clutter):
        h, w = rng.integers(1, round(1.0 / resolution), 2)
        r, c = int(rng.integers(2, rows - h - 2)), int(rng.integers(2, cols - w - 2))
        cells[r : r + h, c : c + w] = OCCUPIED
    cells[: round(0.6 / resolution), : round(0.6 / resolution)] = UNKNOWN
    return OccupancyGrid(cells, resolution, (-width / 2, -depth / 3))


def build_labelled_scene(spacing: float = 0.1) -> Scene:
    """The example flat, whose splats know which piece of furniture they belong to."""
    scene = build_room_scene(spacing)
    cloud = scene.gaussians
    label = np.full(len(cloud), -1, np.int32)
    for number, thing in enumerate(scene.objects):
        gap = np.abs(cloud.means - np.array(thing.box.centre)) - np.array(thing.box.size) / 2
        label[(gap < 1e-3).all(axis=1)] = number
    labelled = name_categories(replace(cloud, label=label), scene.objects)
    return replace(scene, load_cloud=lambda: labelled)


def build_map_scene(grid: OccupancyGrid, id: str = "plan") -> Scene:
    """A scene that is its grid: one invisible splat, no objects."""
    cloud = GaussianCloud(
        means=np.zeros((1, 3), np.float32),
        quats=np.array([[1, 0, 0, 0]], np.float32),
        scales=np.full((1, 3), 0.01, np.float32),
        opacities=np.zeros(1, np.float32),
        sh=np.zeros((1, 1, 3), np.float32),
    )
    x0, y0, x1, y1 = grid.bounds
    return Scene(
        id=id,
        source=SceneSourceInfo(kind="example", detail="a map in code"),
        grid=grid,
        objects=(),
        rooms=(),
        bounds=np.array([[x0, y0, 0.0], [x1, y1, 2.5]]),
        load_cloud=lambda: cloud,
        cloud_hash=cloud.content_hash,
    )


def build_point_episodes(
    scene: Scene,
    navigation: NavigationMap,
    count: int,
    seed: int = 0,
    *,
    minimum: float = 1.0,
    agent: AgentSpec | None = None,
) -> list[Episode]:
    """Episodes between any two free points of one region, at least `minimum` [m] of walk apart.

    Raises:
        EpisodeError: the map has no such pairs.
    """
    rng = random_stream(seed, "point episodes", scene.id)
    free = np.argwhere(navigation.regions >= 0)
    s = navigation.grid.resolution
    episodes: list[Episode] = []
    for _ in range(_TRIES * count):
        if len(episodes) == count or not len(free):
            break
        a, b = free[rng.integers(len(free), size=2)]
        # anywhere in their cells, not only in the middle
        x, y = np.array(navigation.grid.centre_of(*a)) + rng.uniform(-0.49, 0.49, 2) * s
        goal = np.array(navigation.grid.centre_of(*b)) + rng.uniform(-0.49, 0.49, 2) * s
        if np.hypot(x - goal[0], y - goal[1]) < minimum / 3:
            continue  # not worth a field
        field = navigation.geodesic((float(goal[0]), float(goal[1])))
        if not minimum <= field.distance_at(float(x), float(y)) < np.inf:
            continue
        path = field.path(float(x), float(y))
        episodes.append(
            Episode(
                id=f"{scene.id}-{len(episodes):04d}",
                scene_id=scene.id,
                mission=MissionInstruction(
                    goal=(float(goal[0]), float(goal[1])), instruction="Walk to the mark."
                ),
                start=(float(x), float(y), float(rng.uniform(-np.pi, np.pi))),
                path=tuple((float(px), float(py)) for px, py in path),
                seed=seed,
                agent=agent or AgentSpec(radius=navigation.radius),
            )
        )
    if len(episodes) < count:
        raise EpisodeError(
            f"only {len(episodes)} of {count} episodes of {minimum:g} m exist",
            where=scene.id,
            remedy="ask for fewer or shorter ones",
        )
    return episodes


def with_goal_sets(episodes: list[Episode]) -> list[Episode]:
    """Episodes of which some accept the start of the next as well, and some a square of ground.

    Of those that accept two places, every other one does within 0.3 m only.
    """
    changed = []
    for number, episode in enumerate(episodes):
        x, y = episode.goal
        goals: GoalSet | None = None
        if number % 3 == 1:
            others = [e.start[:2] for e in episodes if e.scene_id == episode.scene_id]
            both = (episode.goal, others[(number + 1) % len(others)])
            goals = GoalSet(points=both, radius=0.3) if number % 2 else GoalSet(points=both)
        elif number % 3 == 2:
            square = (
                (x - 0.7, y - 0.7),
                (x + 0.7, y - 0.7),
                (x + 0.7, y + 0.7),
                (x - 0.7, y + 0.7),
            )
            goals = GoalSet(areas=(square,))
        changed.append(msgspec.structs.replace(episode, goal_set=goals))
    return changed
