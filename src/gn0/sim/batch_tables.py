"""Maps, goals and headings of many episodes, packed for the batch kernels.

A map is packed once a scene. A geodesic field is kept for free cells only, two bytes each, and
shared by all episodes with the same goal; the least recently used fields make room for new ones.
"""

from __future__ import annotations

import math
from collections import OrderedDict
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from fractions import Fraction
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gn0.errors import EpisodeError, SceneError, SimError
from gn0.geometry import F64, wrap_angle
from gn0.maps.distance import GeodesicMap
from gn0.maps.goal_places import GoalSet
from gn0.maps.grid import OccupancyGrid
from gn0.maps.inflate import inflate
from gn0.maps.navigation import NavigationMap
from gn0.missions.episode import AgentSpec, Episode, check_episode
from gn0.scenes.scene import Scene
from gn0.sim.batch_kernels import EpisodeArrays, FieldArrays, MapArrays
from gn0.sim.collision import check_places
from gn0.sim.kinematics import heading_yaw

CIRCLE_LIMIT = 3600  # turns in a full circle
_Goal = tuple[str, tuple[float, float] | GoalSet]  # scene, and what counts there
MAPS_KEPT = 32  # maps held with corners and regions, beside the packed copies of all


def turns_a_circle(turn_degrees: float) -> int:
    """How many turns make full circles, so that headings form a finite table.

    Raises:
        SimError: the angle never comes full circle exactly.
    """
    circle = (Fraction(turn_degrees) / 360).denominator
    if circle > CIRCLE_LIMIT:
        raise SimError(
            f"turns of {turn_degrees} degrees never come exactly full circle",
            remedy="choose an angle such as 15, 22.5 or 30 degrees, or step a Simulator",
        )
    return circle


@dataclass(eq=False)
class _Field:
    """Where a geodesic field lies in the pool, and when it was last begun with."""

    label_at: int
    labels: int
    root_at: int
    roots: int
    used: int
    episodes: list[int]


class MapTable:
    """The inflated maps of all scenes met so far, in one buffer.

    Args:
        scenes: scene id → how to get the scene.
        radius: the agents' radius [m].
    """

    def __init__(self, scenes: Mapping[str, Callable[[], Scene]], radius: float) -> None:
        self._scenes = scenes
        self._radius = radius
        self._index: dict[str, int] = {}
        self._kept: OrderedDict[str, tuple[NavigationMap, GeodesicMap]] = OrderedDict()
        self.arrays = MapArrays(
            np.zeros(0, np.bool_),
            np.zeros(0, np.int32),
            np.zeros(0, np.int64),
            np.zeros((0, 2), np.int64),
            np.zeros((0, 3)),
        )

    @property
    def names(self) -> list[str]:
        """Ids of the packed scenes, in the order of their numbers."""
        return list(self._index)

    def open(self, scene_id: str) -> tuple[NavigationMap, GeodesicMap]:
        """The ground of a scene, inflated, and its corners; the latest few are kept.

        Raises:
            EpisodeError: no such scene here.
            SceneError: nothing is walkable for this agent.
        """
        if scene_id not in self._kept:
            if scene_id in self._index:
                grid = self._unpack(self._index[scene_id])  # no need to read the scene again
            else:
                grid = self._load(scene_id)
            ground = NavigationMap(grid, 0.0)  # is inflated already
            self._kept[scene_id] = (ground, GeodesicMap(ground.inflated))
            while len(self._kept) > MAPS_KEPT:
                self._kept.popitem(last=False)
        self._kept.move_to_end(scene_id)
        return self._kept[scene_id]

    def _load(self, scene_id: str) -> OccupancyGrid:
        """The inflated map of a scene."""
        if scene_id not in self._scenes:
            raise EpisodeError(f"scene {scene_id!r} is not here", remedy="open it with scene=")
        scene = self._scenes[scene_id]()
        grid = inflate(scene.grid, self._radius)
        if not grid.free_area:
            raise SceneError(
                f"nothing is walkable for an agent of radius {self._radius:g} m",
                where=scene.path or scene.id,
                remedy="run `gn0 scene check`, or use a slimmer agent",
            )
        return grid

    def _unpack(self, index: int) -> OccupancyGrid:
        arrays = self.arrays
        height, width = arrays.shapes[index].tolist()
        first = int(arrays.offsets[index])
        x, y, resolution = arrays.frames[index].tolist()
        blocked = arrays.blocked[first : first + height * width].reshape(height, width)
        return OccupancyGrid(blocked.astype(np.uint8), resolution, (x, y))

    def index(self, scene_id: str) -> int:
        """The number of a scene, packed on the first call for it."""
        if scene_id not in self._index:
            self._pack(self.open(scene_id)[0])
            self._index[scene_id] = len(self._index)
        return self._index[scene_id]

    def _pack(self, navigation: NavigationMap) -> None:
        old = self.arrays
        blocked = np.ascontiguousarray(navigation.blocked).ravel()
        compact = (np.cumsum(~blocked, dtype=np.int64) - 1).astype(np.int32)
        grid = navigation.grid
        frame = (*map(float, grid.origin), float(grid.resolution))
        self.arrays = MapArrays(
            np.concatenate([old.blocked, blocked]),
            np.concatenate([old.compact, compact]),
            np.append(old.offsets, len(old.blocked)),
            np.vstack([old.shapes, grid.shape]),
            np.vstack([old.frames, frame]),
        )


class EpisodeTable:
    """Episodes by number, with what the kernels need of them.

    Args:
        maps: where they are played.
        agent: who plays them.
        memory: bytes that geodesic fields may take; fields in use are never dropped.
    """

    def __init__(self, maps: MapTable, agent: AgentSpec, memory: int) -> None:
        self.maps = maps
        self.agent = agent
        self.episodes: list[Episode] = []
        self.fields_built = 0
        self._circle = turns_a_circle(agent.turn_degrees)
        self._memory = memory
        self._number: dict[Episode, int] = {}
        self._fields: dict[_Goal, _Field] = {}
        self._clock = 0
        self.fields = FieldArrays(np.zeros(0, np.uint16), np.zeros((0, 3)))
        self._label_end = self._root_end = 0
        self.arrays = self._allocate(0)
        self._checked = np.zeros(0, np.bool_)
        self.reach = np.zeros(0)  # m, of each episode: its own success radius, else 0

    def _allocate(self, size: int) -> EpisodeArrays:
        return EpisodeArrays(
            np.zeros(size, np.int32),
            np.zeros((size, 2)),
            np.zeros((size, 2)),
            np.full(size, -1, np.int64),
            np.full(size, -1, np.int64),
            np.empty((size, self._circle, 3)),  # pages are touched when an episode is prepared
        )

    def add(self, episodes: Iterable[Episode]) -> NDArray[np.int64]:
        """Numbers of episodes; equal ones share a number. Nothing is loaded or checked yet."""
        numbers = []
        for episode in episodes:
            number = self._number.get(episode)
            if number is None:
                number = self._number[episode] = len(self.episodes)
                self.episodes.append(episode)
            numbers.append(number)
        fresh = self.episodes[len(self.reach) :]
        self.reach = np.append(self.reach, [e.success_within(0.0) for e in fresh])
        missing = len(self.episodes) - len(self._checked)
        if missing > 0:
            grown = self._allocate(len(self.episodes) + (missing if len(self._checked) else 0))
            for name in EpisodeArrays._fields:
                old = getattr(self.arrays, name)
                getattr(grown, name)[: len(old)] = old
            self.arrays = grown
            self._checked = np.append(
                self._checked, np.zeros(len(grown.scene) - len(self._checked), np.bool_)
            )
        return np.array(numbers, np.int64)

    def prepare(self, numbers: NDArray[np.int64], in_use: NDArray[np.integer]) -> None:
        """Make episodes ready to be played; `in_use` are those that agents play now.

        Raises:
            EpisodeError: see `Simulator.reset`.
        """
        self._clock += 1
        for number in np.unique(numbers[self.arrays.label_at[numbers] < 0]):
            self._prepare(int(number), numbers, in_use)

    def _prepare(self, number: int, wanted: NDArray[np.int64], in_use: NDArray[np.integer]) -> None:
        episode = self.episodes[number]
        if not self._checked[number]:
            self._fill(number, episode)
        key = _key(episode)
        field = self._fields.get(key)
        if field is None:
            labels, roots = self._build_field(episode)
            self._make_room(len(labels), wanted, in_use)
            field = self._store(labels, roots)
            self._fields[key] = field
        field.used = self._clock
        field.episodes.append(number)
        self.arrays.label_at[number], self.arrays.root_at[number] = field.label_at, field.root_at

    def _fill(self, number: int, episode: Episode) -> None:
        check_episode(episode)
        navigation, _ = self.maps.open(episode.scene_id)
        check_places(navigation, episode, self.agent.radius)
        arrays = self.arrays
        arrays.scene[number] = self.maps.index(episode.scene_id)
        arrays.start[number] = episode.start[:2]
        arrays.goal[number] = episode.goal
        base = wrap_angle(episode.start[2])
        for turns in range(self._circle):
            yaw = heading_yaw(base, turns, self.agent.turn_degrees)
            arrays.headings[number, turns] = yaw, math.cos(yaw), math.sin(yaw)
        self._checked[number] = True

    def _build_field(self, episode: Episode) -> tuple[NDArray[np.int64], F64]:
        """Labels of the free cells and the roots that they use; root 0 is "unreachable"."""
        navigation, geodesic_map = self.maps.open(episode.scene_id)
        field = geodesic_map.build_field(episode.destination)
        self.fields_built += 1
        label = field.label[~navigation.blocked]
        used = np.zeros(len(field.roots) + 1, np.bool_)
        used[label + 1] = True
        used[0] = True
        remap = np.cumsum(used) - 1
        roots = np.vstack([[0.0, 0.0, np.inf], field.roots[used[1:]]])
        return remap[label + 1], roots

    def _store(self, labels: NDArray[np.int64], roots: F64) -> _Field:
        pool, table = self.fields
        if len(roots) > 65535 and pool.dtype == np.uint16:
            pool = pool.astype(np.uint32)
        if self._label_end + len(labels) > len(pool):
            limit = self._memory // pool.itemsize
            pool = _grown(pool, self._label_end + len(labels), limit)
        if self._root_end + len(roots) > len(table):
            table = _grown(table, self._root_end + len(roots))
        pool[self._label_end : self._label_end + len(labels)] = labels
        table[self._root_end : self._root_end + len(roots)] = roots
        self.fields = FieldArrays(pool, table)
        field = _Field(self._label_end, len(labels), self._root_end, len(roots), self._clock, [])
        self._label_end += len(labels)
        self._root_end += len(roots)
        return field

    def _make_room(
        self, labels: int, wanted: NDArray[np.int64], in_use: NDArray[np.integer]
    ) -> None:
        """Drop the least recently used fields when `labels` more would exceed the memory."""
        size = self.fields.labels.itemsize
        if (self._label_end + labels) * size <= self._memory:
            return
        playing = {int(n) for n in in_use if n >= 0} | {int(n) for n in wanted}
        ordered = sorted(self._fields.items(), key=lambda item: -item[1].used)
        kept: dict[_Goal, _Field] = {}
        total = labels
        for key, field in ordered:
            needed = not playing.isdisjoint(field.episodes)
            if needed or (total + field.labels) * size <= self._memory // 2:
                kept[key] = field
                total += field.labels
            else:
                for number in field.episodes:
                    self.arrays.label_at[number] = self.arrays.root_at[number] = -1
        old, table = self.fields
        self._fields, self._label_end, self._root_end = {}, 0, 0
        self.fields = FieldArrays(np.zeros(max(total, 1), old.dtype), np.zeros((0, 3)))
        for key, field in kept.items():
            moved = self._store(
                old[field.label_at : field.label_at + field.labels],  # type: ignore[arg-type]
                table[field.root_at : field.root_at + field.roots],
            )
            moved.used, moved.episodes = field.used, field.episodes
            self._fields[key] = moved
            for number in field.episodes:
                self.arrays.label_at[number] = moved.label_at
                self.arrays.root_at[number] = moved.root_at

    def touch(self, numbers: NDArray[np.int64]) -> None:
        """Note that episodes begin now, so that their fields stay."""
        if (self._label_end * self.fields.labels.itemsize) * 2 < self._memory:
            return  # nothing will be dropped soon
        for number in np.unique(numbers):
            episode = self.episodes[number]
            self._fields[_key(episode)].used = self._clock


def _key(episode: Episode) -> _Goal:
    return episode.scene_id, episode.destination


def _grown(array: NDArray[Any], need: int, limit: int = 2**62) -> NDArray[Any]:
    """A larger copy with room for `need` rows and half as many more, up to `limit`."""
    size = max(need, min(need + need // 2 + 1024, limit))
    grown = np.zeros((size, *array.shape[1:]), array.dtype)
    grown[: len(array)] = array
    return grown
