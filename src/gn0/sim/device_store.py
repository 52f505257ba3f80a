"""Maps, distance fields and headings of the episodes that agents play, resident on a device.

An episode needs the map of its scene (4 bytes a cell), the field of its goal (2 bytes a free
cell, shared by all episodes with that goal) and its headings. What is pinned stays; when the
memory is full, the episodes that nobody has had for the longest time go, and with the last one
of a field or of a map that field or map.
"""

from __future__ import annotations

import logging
import math
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple

import msgspec
import numpy as np
from numpy.typing import NDArray

from gn0.device.device import Device, DeviceArray, Kernel
from gn0.errors import ConfigError, DeviceMemoryError
from gn0.geometry import F64, U8
from gn0.jobs.process import count_cores
from gn0.maps.grid import OccupancyGrid
from gn0.missions.episode import AgentSpec, Episode, MissionFollow, check_episode
from gn0.missions.follow_target import follow_target
from gn0.missions.people import check_people_walls
from gn0.scenes.scene import Scene
from gn0.sim.collision import check_places
from gn0.sim.device_layout import EPISODE, THREADS, blocks_of
from gn0.sim.device_pool import Block, PoolDevice, store_size
from gn0.sim.device_records import StoreRows
from gn0.sim.device_routes import LookLight, mark_walls, pack_routes
from gn0.sim.ground import (
    MAPS_TOGETHER,
    Destination,
    EpisodeNumbers,
    GroundStore,
    destination_of,
    list_headings,
    turns_a_circle,
)
from gn0.sim.open import name_look
from gn0.sim.sensors import MapFrame

_log = logging.getLogger(__name__)
_WORD = 16  # bytes that a thread of `store_rows` copies
_BUILDERS = 16  # threads that build fields at most
_WORTH = 2**26  # bytes on the host that keep as many fields as are built side by side
_MANY, _TOGETHER = 8, 256  # episodes for whose fields threads are worth it, and for how many


class MapPictures(NamedTuple):
    """The static pictures of a scene under a light.

    Attributes:
        frame: where their pixels lie.
        grey: occupancy picture [H, W], or None.
        bev: [H, W, 3], or None.
        light: on people, where they are drawn.
    """

    frame: MapFrame
    grey: U8 | None
    bev: U8 | None
    light: LookLight | None = None


@dataclass(eq=False)
class _Held:
    """A block, where its arrays lie in it, and how many others need it."""

    block: Block
    pointers: list[int]
    users: int = 0
    wide: bool = False
    frame: tuple[float, ...] = ()
    shape: tuple[int, int] = (0, 0)
    number: int = 0  # of a look
    sizes: tuple[int, int] = (0, 0)  # bytes of its pictures
    light: tuple[int, int, int] = (0, 0, 0)  # cells of its probes, and how many there are


class EpisodeStore:
    """Episodes by number; those that are pinned are ready to be played by kernels.

    A map or a field that had to make room comes back from host memory; one that is not there
    either is built again, which takes twenty times as long.

    Args:
        device: where they are played.
        kernels: of `device_layout.SOURCE`.
        scenes: scene id → how to get the scene; each is loaded when first needed.
        agent: who plays them.
        memory: bytes that maps, fields and headings may take; what is pinned is never dropped.
        host_memory: bytes of maps and fields kept on the host, beside those on the device.
        rays: angles [R] rad of range rays relative to the yaw, if their directions are wanted.
        pictures: look → the static pictures, if they are wanted.
        roles: episode → what its people bring to their looks, if they are drawn.
    """

    def __init__(
        self,
        device: Device,
        kernels: Mapping[str, Kernel],
        scenes: Mapping[str, Callable[[], Scene]],
        agent: AgentSpec,
        memory: int,
        *,
        host_memory: int = 0,
        rays: F64 | None = None,
        pictures: Callable[[str], MapPictures] | None = None,
        roles: Callable[[Episode], NDArray[Any]] | None = None,
    ) -> None:
        self.device = device
        self.agent = agent
        self.circle = turns_a_circle(agent.turn_degrees)
        self.scene_ids = sorted(scenes)
        self.dropped = 0
        self.pool = PoolDevice(device, memory)
        self.kernels = kernels
        self._host_memory = host_memory
        self.ground = GroundStore(scenes, agent.radius, memory=host_memory)
        self._scene_number = {name: k for k, name in enumerate(self.scene_ids)}
        self._rays, self._pictures, self._roles = rays, pictures, roles
        self._numbers = EpisodeNumbers()
        self._checked: set[int] = set()
        self._slot_of = np.zeros(0, np.int32)  # by episode number; −1: not here
        self._scenes: dict[str, _Held] = {}
        self._walls: dict[str, _Held] = {}  # by scene, where people are
        self._looks: dict[str, _Held] = {}
        self._look_names: list[str | None] = []  # by number; None: free
        self._in_play: list[str | None] | None = None  # forgotten when references change
        self._fields: dict[Destination, _Held] = {}
        self._own: dict[int, _Held] = {}  # by slot: headings
        self._turned: dict[tuple[int, float], int] = {}  # slots of episodes with another heading
        self._base_of: dict[int, float] = {}  # by such a slot: that heading
        self._number_of = np.full(64, -1, np.int32)  # by slot
        self._references = np.zeros(64, np.int64)
        self._used = np.zeros(64, np.int64)  # clock of the last release
        self._clock = 0
        self._rows = np.zeros(64, EPISODE)
        self.rows: DeviceArray = device.zeros((64, EPISODE.itemsize), np.uint8)

    def add(self, episodes: Iterable[Episode]) -> NDArray[np.int64]:
        """Numbers of episodes; equal ones share a number. Nothing is loaded or checked yet."""
        numbers = self._numbers.add(episodes)
        missing = len(self.episodes) - len(self._slot_of)
        if missing > 0:
            self._slot_of = np.append(self._slot_of, np.full(missing, -1, np.int32))
        return numbers

    @property
    def episodes(self) -> list[Episode]:
        """Those met so far, by number."""
        return self._numbers.episodes

    @property
    def fields_built(self) -> int:
        """How many distance fields were built, again or for the first time."""
        return self.ground.fields_built

    @property
    def resident(self) -> int:
        """Episodes that are on the device."""
        return len(self._own)

    def map_frame(self, number: int) -> tuple[int, int, float]:
        """Height and width [px] of the map pictures of a pinned episode, and metres a pixel."""
        row = self._rows[self._slot_of[number]]
        return int(row["map_rows"]), int(row["map_cols"]), float(row["map_scale"])

    def map_origin(self, number: int) -> tuple[float, float]:
        """x, y [m] of the lower left corner of the map pictures of a pinned episode."""
        row = self._rows[self._slot_of[number]]
        return float(row["map_x"]), float(row["map_y"])

    @property
    def seats(self) -> tuple[NDArray[np.int32], NDArray[np.bool_]]:
        """The episode in each slot [S], −1 in an empty one, and whether it is pinned."""
        return self._number_of, self._references > 0

    def hold(self, *arrays: NDArray[Any]) -> tuple[Block, list[int]]:
        """Arrays in a block of the same memory, until `pool.give`, and where each lies.

        Raises:
            DeviceMemoryError: what is pinned does not fit the device.
        """
        held = self._put(*arrays)
        return held.block, held.pointers

    def hold_look(self, name: str) -> tuple[list[int], tuple[float, ...], tuple[int, int]]:
        """Static pictures of a look, kept from now on until `free_look`.

        Where the grey and the coloured one lie; x, y [m] of their corner and m a pixel; (H, W).

        Raises:
            DeviceMemoryError: what is held does not fit the device.
            ConfigError: no sensor looks at maps.
        """
        if self._pictures is None:
            raise ConfigError("no sensor here shows a map", remedy="carry the sensor ego_map")
        look = self._looks.get(name) or self._bring_look(name)
        look.users += 1
        return look.pointers[:2], look.frame, look.shape

    def picture_bytes(self, name: str) -> tuple[int, int]:
        """Bytes of the grey and of the coloured picture of a look that is held; 0 without it."""
        return self._looks[name].sizes

    def free_look(self, name: str) -> None:
        """Take back one `hold_look`."""
        self._looks[name].users -= 1
        self._sweep()

    def looks_in_play(self) -> list[str | None]:
        """Looks by number, as rows of episodes name them; None: of no pinned episode."""
        if self._in_play is None:
            shown = set(self._rows["look"][self._references > 0].tolist())
            self._in_play = [
                name if number in shown else None for number, name in enumerate(self._look_names)
            ]
        return self._in_play

    def pin(self, numbers: NDArray[np.integer]) -> NDArray[np.int32]:
        """Slots [K] of episodes [K], brought here where missing; one reference for each of K.

        Raises:
            EpisodeError, SceneError: see `Simulator.reset`; then nothing is pinned.
            DeviceMemoryError: what is pinned does not fit the device.
        """
        self._clock += 1
        self._in_play = None
        wanted, counts = np.unique(numbers, return_counts=True)
        here = self._slot_of[wanted] >= 0
        self._references[self._slot_of[wanted[here]]] += counts[here]
        missing = sorted(  # scene by scene: few maps are open at a time
            np.flatnonzero(~here).tolist(), key=lambda k: self._order(int(wanted[k]))
        )
        fresh: list[int] = []
        try:
            for part in self._cut(missing, wanted):
                if len(part) >= _MANY:
                    self.build_fields(wanted[part])
                for k in part:
                    slot = self._bring(int(wanted[k]))
                    self._references[slot] = counts[k]
                    here[k] = True
                    fresh.append(slot)
        except BaseException:
            self._references[self._slot_of[wanted[here]]] -= counts[here]
            raise
        finally:
            self._send_rows(fresh)
        return self._slot_of[numbers]

    def _cut(self, missing: list[int], wanted: NDArray[np.integer]) -> Iterator[list[int]]:
        """Those that are brought together: of few scenes, and so many that host memory has room."""
        part: list[int] = []
        scenes: set[str] = set()
        for k in missing:
            scene_id = self.episodes[int(wanted[k])].scene_id
            if len(part) == _TOGETHER or len(scenes | {scene_id}) > MAPS_TOGETHER:
                yield part
                part, scenes = [], set()
            part.append(k)
            scenes.add(scene_id)
        yield part

    def build_fields(self, numbers: NDArray[np.integer]) -> None:
        """Build those fields of episodes that are not here, side by side, where memory keeps them.

        What has none is passed over: `pin` says why.
        """
        goals = [destination_of(self.episodes[number]) for number in numbers.tolist()]
        missing = [goal for goal in goals if goal not in self._fields]
        if self._host_memory >= _WORTH and missing:
            self.ground.build_all(missing, min(count_cores(), _BUILDERS))

    def pin_turned(
        self, numbers: NDArray[np.integer], bases: NDArray[np.float64]
    ) -> NDArray[np.int32]:
        """`pin`, with headings counted from `bases` [K] rad; NaN: from the start's, as ever.

        Headings of earlier calls that nobody plays any more are dropped.

        Raises: see `pin`; then nothing is pinned.
        """
        keys = list(zip(numbers.tolist(), bases.tolist(), strict=True))
        kept = set(keys)
        for key, slot in list(self._turned.items()):
            if not self._references[slot] and key not in kept:
                self._drop(slot)
        slots = self.pin(numbers)  # of turned ones, too: maps and fields stay when these go
        turned = np.flatnonzero(~np.isnan(bases))
        fresh: list[int] = []
        try:
            for k in turned.tolist():
                if keys[k] not in self._turned:
                    fresh.append(self._bring(*keys[k]))
                slot = self._turned[keys[k]]
                self._references[slot] += 1
                self.release(slots[k : k + 1])
                slots[k] = slot
        except BaseException:
            self.release(slots)
            raise
        finally:
            self._in_play = None
            self._send_rows(fresh)
        return slots

    def numbers_at(self, slots: NDArray[np.integer]) -> NDArray[np.int64]:
        """Numbers [K] of the episodes at `slots` [K]."""
        return self._number_of[slots].astype(np.int64)

    def bases_at(self, slots: NDArray[np.integer]) -> NDArray[np.float64]:
        """What headings count from at `slots` [K], rad; NaN: the start's heading."""
        return np.array([self._base_of.get(slot, np.nan) for slot in slots.tolist()])

    def _order(self, number: int) -> tuple[str, tuple[float, ...]]:
        episode = self.episodes[number]
        return episode.scene_id, tuple(episode.goal)

    def release(self, slots: NDArray[np.integer]) -> None:
        """Let go of one reference for each of `slots`."""
        self._clock += 1
        self._in_play = None
        np.subtract.at(self._references, slots, 1)
        self._used[slots] = self._clock

    def _bring(self, number: int, base: float | None = None) -> int:
        episode = self.episodes[number]
        if number not in self._checked:
            check_episode(episode)
            ground = self.ground.open(episode.scene_id)
            check_places(ground, episode, self.agent.radius)
            check_people_walls(episode.people, ground.grid, f"episode {episode.id!r}")
            self._checked.add(number)
        used: list[_Held] = []  # held while others are brought
        try:
            scene = self._scenes.get(episode.scene_id) or self._bring_scene(episode.scene_id)
            scene.users += 1
            used.append(scene)
            key = destination_of(episode)
            field = self._fields.get(key)
            if field is None:
                field = self._fields[key] = self._bring_field(key)
                scene.users += 1  # a field needs its scene
            field.users += 1
            used.append(field)
            look = None
            if self._pictures is not None:
                name = name_look(episode)
                look = self._looks.get(name) or self._bring_look(name)
                look.users += 1
                used.append(look)
            walls = None
            if episode.people:
                walls = self._walls.get(episode.scene_id) or self._bring_walls(episode.scene_id)
                walls.users += 1
                used.append(walls)
            own = self._build_own(episode, base)
        except BaseException:
            for held in used:
                held.users -= 1
            self._sweep()
            raise
        slot = self._seat(number, scene, field, own, look)
        if walls is not None:
            self._seat_people(slot, episode, walls, own)
        if base is None:
            self._slot_of[number] = slot
        else:
            self._turned[number, base] = slot
            self._base_of[slot] = base
        return slot

    def _seat(self, number: int, scene: _Held, field: _Held, own: _Held, look: _Held | None) -> int:
        """Write the row of an episode; its slot."""
        free = np.flatnonzero(self._number_of < 0)
        if not len(free):
            self._grow()
            free = np.flatnonzero(self._number_of < 0)
        slot = int(free[0])
        episode = self.episodes[number]
        row = self._rows[slot]
        row["persons"], row["stays"] = 0, isinstance(episode.mission, MissionFollow)
        row["compact"], row["wide"] = scene.pointers[0], field.wide
        row["labels"], row["roots"] = field.pointers
        row["headings"] = own.pointers[0]
        row["directions"] = own.pointers[1] if self._rays is not None else 0
        row["x"], row["y"], row["resolution"] = scene.frame
        row["rows"], row["cols"] = scene.shape
        row["start_x"], row["start_y"] = episode.start[:2]
        row["goal_x"], row["goal_y"] = episode.goal
        row["reach"] = episode.success_within(0.0)
        row["number"], row["scene"] = number, self._scene_number[episode.scene_id]
        if look is not None:
            row["grey"], row["bev"], *light = look.pointers
            row["light_column"], row["light_places"], row["light_gains"] = light
            row["light_cols"], row["light_rows"], row["light_count"] = look.light
            row["map_x"], row["map_y"], row["map_scale"] = look.frame
            row["map_rows"], row["map_cols"] = look.shape
            row["look"] = look.number
        self._own[slot] = own
        self._number_of[slot] = number
        return slot

    def _seat_people(self, slot: int, episode: Episode, walls: _Held, own: _Held) -> None:
        """Write where the people of an episode are found; their routes are the last of its own."""
        row = self._rows[slot]
        row["walls"], row["persons"] = walls.pointers[0], len(episode.people)
        names = ("people", "lines", "points", "holds", "roles")
        for name, pointer in zip(names, own.pointers[-5:], strict=True):
            row[name] = pointer
        if episode.followed is not None:
            target = follow_target(episode)
            row["followed"] = target.row
            row["keep_distance"], row["keep_lateral"] = target.distance, target.lateral

    def _grow(self) -> None:
        size = len(self._rows)
        self._rows = np.append(self._rows, np.zeros(size, EPISODE))
        self._number_of = np.append(self._number_of, np.full(size, -1, np.int32))
        self._references = np.append(self._references, np.zeros(size, np.int64))
        self._used = np.append(self._used, np.zeros(size, np.int64))
        self.rows = self.device.upload(_bytes_of(self._rows))

    def _send_rows(self, slots: list[int]) -> None:
        if not slots:
            return
        words = EPISODE.itemsize // _WORD
        storing = StoreRows(
            rows=self.device.upload(_bytes_of(self._rows[slots])),
            slots=self.device.upload(np.array(slots, np.int32)),
            table=self.rows,
            words=np.int32(words),
            count_=np.int32(len(slots)),
        )
        self.kernels["store_rows"].launch(blocks_of(len(slots) * words), THREADS, storing)

    def _take(self, size: int) -> Block:
        """A block, for which episodes that nobody plays may have to go."""
        while True:
            try:
                block = self.pool.take(size)
            except DeviceMemoryError:
                if not self._drop_oldest():
                    raise
                continue
            if block is not None:
                return block
            if not self._drop_oldest():
                break
        _log.info(
            "maps and fields in use take more than the %d bytes meant for them", self.pool.limit
        )
        try:
            block = self.pool.take(size, beyond=True)
        except DeviceMemoryError as error:
            raise DeviceMemoryError(
                f"the maps and fields that are played now do not fit: {error.what}",
                where=error.where,
                remedy="play fewer environments or scenes at a time, or with a smaller `ahead`",
            ) from None
        assert block is not None
        return block

    def _drop_oldest(self) -> bool:
        """Drop the episode that nobody has had for the longest time; False if all are played."""
        idle = np.flatnonzero((self._number_of >= 0) & (self._references == 0))
        if not len(idle):
            return False
        self._drop(int(idle[np.argmin(self._used[idle])]))
        self.dropped += 1
        return True

    def _drop(self, slot: int) -> None:
        """Let go of an episode that nobody plays."""
        number = int(self._number_of[slot])
        episode = self.episodes[number]
        if slot in self._base_of:
            del self._turned[number, self._base_of.pop(slot)]
        else:
            self._slot_of[number] = -1
        self._number_of[slot] = -1
        self.pool.give(self._own.pop(slot).block)
        self._fields[destination_of(episode)].users -= 1
        self._scenes[episode.scene_id].users -= 1
        if episode.people:
            self._walls[episode.scene_id].users -= 1
        if self._pictures is not None:
            self._looks[name_look(episode)].users -= 1
        self._sweep(episode)

    def _sweep(self, episode: Episode | None = None) -> None:
        """Give back fields, looks and scenes that nothing needs; of one episode, or any."""
        keys = list(self._fields) if episode is None else [destination_of(episode)]
        for key in keys:
            if not self._fields[key].users:
                self.pool.give(self._fields.pop(key).block)
                self._scenes[key[0]].users -= 1
        looks = [] if self._pictures is None else list(self._looks)
        for name in looks:
            if not self._looks[name].users:
                held = self._looks.pop(name)
                self._look_names[held.number] = None
                self.pool.give(held.block)
        for scene_id in list(self._scenes) if episode is None else [episode.scene_id]:
            if not self._scenes[scene_id].users:
                self.pool.give(self._scenes.pop(scene_id).block)
            if scene_id in self._walls and not self._walls[scene_id].users:
                self.pool.give(self._walls.pop(scene_id).block)

    def _bring_scene(self, scene_id: str) -> _Held:
        grid = self.ground.inflated(scene_id)
        held = self._put(number_cells(grid))
        held.frame, held.shape = (*map(float, grid.origin), float(grid.resolution)), grid.shape
        self._scenes[scene_id] = held
        return held

    def _bring_walls(self, scene_id: str) -> _Held:
        held = self._walls[scene_id] = self._put(mark_walls(self.ground.open(scene_id).grid))
        return held

    def _bring_look(self, name: str) -> _Held:
        assert self._pictures is not None
        frame, grey, bev, light = self._pictures(name)
        shape = (frame.height, frame.width)
        empty = np.zeros(0, np.uint8)
        grey, bev = empty if grey is None else grey, empty if bev is None else bev
        column = np.zeros((0, 0), np.int32) if light is None else light.column
        places, gains = (np.zeros(0),) * 2 if light is None else (light.places, light.gains)
        held = self._put(grey, bev, column, places, gains)
        held.light = (*column.shape, len(places))
        held.sizes = (grey.nbytes, bev.nbytes)
        held.frame = (frame.x_min, frame.y_min, frame.metres_per_pixel)
        held.shape = shape
        if None not in self._look_names:
            self._look_names.append(None)
        held.number = self._look_names.index(None)
        self._look_names[held.number] = name
        self._looks[name] = held
        return held

    def _bring_field(self, key: Destination) -> _Held:
        field = self.ground.field(key)
        held = self._put(*field)
        held.wide = field.labels.dtype == np.uint32
        return held

    def _build_own(self, episode: Episode, base: float | None) -> _Held:
        """Headings after each number of turns, directions of range rays from each, routes."""
        if base is not None:
            episode = msgspec.structs.replace(episode, start=(*episode.start[:2], base))
        headings = list_headings(episode, self.agent)
        routes: tuple[NDArray[Any], ...] = ()
        if episode.people:
            empty = np.zeros(0, np.uint8)
            routes = (
                *pack_routes(episode.people),
                empty if self._roles is None else self._roles(episode),
            )
        if self._rays is None:
            return self._put(headings, *routes)
        angles = (headings[:, :1] + self._rays).ravel().tolist()
        directions = np.empty((len(angles), 2))
        directions[:, 0] = list(map(math.cos, angles))
        directions[:, 1] = list(map(math.sin, angles))
        return self._put(headings, directions, *routes)

    def _put(self, *arrays: NDArray[Any]) -> _Held:
        block = self._take(max(store_size(*arrays), 1))
        return _Held(block, self.pool.store(block, *arrays))


def number_cells(grid: OccupancyGrid) -> NDArray[np.int32]:
    """The number of each free cell among the free cells [H, W]; −1 where blocked."""
    blocked = np.ascontiguousarray(grid.blocked)
    numbers = np.cumsum(~blocked.ravel(), dtype=np.int64) - 1
    return np.where(blocked, -1, numbers.reshape(blocked.shape)).astype(np.int32)


def _bytes_of(rows: NDArray[Any]) -> U8:
    return np.ascontiguousarray(rows).view(np.uint8).reshape(len(rows), -1)
