"""Maps, goals and headings of many episodes, packed for the batch kernels.

A map is packed once a scene. A geodesic field is kept for free cells only, two bytes each, and
shared by all episodes with the same goal; the least recently used fields make room for new ones.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gn0.geometry import F64
from gn0.maps.navigation import NavigationMap
from gn0.missions.episode import AgentSpec, Episode, MissionFollow, check_episode
from gn0.sim.batch_kernels import EpisodeArrays, FieldArrays, MapArrays
from gn0.sim.collision import check_places
from gn0.sim.ground import (
    Destination,
    EpisodeNumbers,
    GroundStore,
    destination_of,
    list_headings,
    turns_a_circle,
)


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
        ground: where they come from.
    """

    def __init__(self, ground: GroundStore) -> None:
        self.ground = ground
        self._index: dict[str, int] = {}
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

    def index(self, scene_id: str) -> int:
        """The number of a scene, packed on the first call for it."""
        if scene_id not in self._index:
            self._pack(self.ground.open(scene_id))
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
        self._circle = turns_a_circle(agent.turn_degrees)
        self._memory = memory
        self._numbers = EpisodeNumbers()
        self._fields: dict[Destination, _Field] = {}
        self._clock = 0
        self.fields = FieldArrays(np.zeros(0, np.uint16), np.zeros((0, 3)))
        self._label_end = self._root_end = 0
        self.arrays = self._allocate(0)
        self._checked = np.zeros(0, np.bool_)
        self.reach = np.zeros(0)  # m, of each episode: its own success radius, else 0

    @property
    def episodes(self) -> list[Episode]:
        """Those met so far, by number."""
        return self._numbers.episodes

    @property
    def fields_built(self) -> int:
        """How many distance fields were built, again or for the first time."""
        return self.maps.ground.fields_built

    def _allocate(self, size: int) -> EpisodeArrays:
        return EpisodeArrays(
            np.zeros(size, np.int32),
            np.zeros((size, 2)),
            np.zeros((size, 2)),
            np.full(size, -1, np.int64),
            np.full(size, -1, np.int64),
            np.empty((size, self._circle, 3)),  # pages are touched when an episode is prepared
            np.zeros(size, np.bool_),
        )

    def add(self, episodes: Iterable[Episode]) -> NDArray[np.int64]:
        """Numbers of episodes; equal ones share a number. Nothing is loaded or checked yet."""
        numbers = self._numbers.add(episodes)
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
        return numbers

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
        key = destination_of(episode)
        field = self._fields.get(key)
        if field is None:
            labels, roots = self.maps.ground.field(key)
            self._make_room(len(labels), wanted, in_use)
            field = self._store(labels, roots)
            self._fields[key] = field
        field.used = self._clock
        field.episodes.append(number)
        self.arrays.label_at[number], self.arrays.root_at[number] = field.label_at, field.root_at

    def _fill(self, number: int, episode: Episode) -> None:
        check_episode(episode)
        check_places(self.maps.ground.open(episode.scene_id), episode, self.agent.radius)
        arrays = self.arrays
        arrays.scene[number] = self.maps.index(episode.scene_id)
        arrays.start[number] = episode.start[:2]
        arrays.goal[number] = episode.goal
        arrays.headings[number] = list_headings(episode, self.agent)
        arrays.stays[number] = isinstance(episode.mission, MissionFollow)
        self._checked[number] = True

    def _store(self, labels: NDArray[np.unsignedinteger], roots: F64) -> _Field:
        pool, table = self.fields
        if len(roots) > 65535 and pool.dtype == np.uint16:
            pool = pool.astype(np.uint32)
        if self._label_end + len(labels) > len(pool):
            limit = self._memory // pool.itemsize
            pool = grow_rows(pool, self._label_end + len(labels), limit)
        if self._root_end + len(roots) > len(table):
            table = grow_rows(table, self._root_end + len(roots))
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
        kept: dict[Destination, _Field] = {}
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
                old[field.label_at : field.label_at + field.labels],
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
            self._fields[destination_of(episode)].used = self._clock


def grow_rows(array: NDArray[Any], need: int, limit: int = 2**62) -> NDArray[Any]:
    """A larger copy with room for `need` rows and half as many more, up to `limit`."""
    size = max(need, min(need + need // 2 + 1024, limit))
    grown = np.zeros((size, *array.shape[1:]), array.dtype)
    grown[: len(array)] = array
    return grown
