"""Maps of scenes and distance fields of goals on the host: one store, whoever plays on them.

Batches on the CPU and on a device take maps and fields from here and pack them for their kernels.
"""

from __future__ import annotations

import math
from collections import OrderedDict
from collections.abc import Callable, Iterable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from fractions import Fraction
from functools import partial
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from gn0.errors import EpisodeError, Gn0Error, SceneError, SimError
from gn0.geometry import F64, U8, wrap_angle
from gn0.maps.bends import find_bends
from gn0.maps.distance import GeodesicField
from gn0.maps.field_expert import stop_places
from gn0.maps.goal_places import GoalSet
from gn0.maps.grid import OccupancyGrid
from gn0.maps.navigation import NavigationMap
from gn0.missions.episode import AgentSpec, Episode
from gn0.scenes.scene import Scene
from gn0.sim.kinematics import heading_yaw

CIRCLE_LIMIT = 3600  # turns in a full circle
MAPS_KEPT = 32  # maps held with corners and regions, beside one bit a cell of all
MAPS_TOGETHER = 16  # scenes whose fields are built side by side: their maps stay meanwhile
Destination = tuple[str, tuple[float, float] | GoalSet]  # scene, and what counts there


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


def list_headings(episode: Episode, agent: AgentSpec) -> F64:
    """[T, 3] yaw [rad], its cosine and sine after each number of turns of a full circle.

    Python's own sines and cosines: those of a device differ in the last bit.
    """
    base = wrap_angle(episode.start[2])
    yaws = [
        heading_yaw(base, turns, agent.turn_degrees)
        for turns in range(turns_a_circle(agent.turn_degrees))
    ]
    return np.array([(yaw, math.cos(yaw), math.sin(yaw)) for yaw in yaws])


def destination_of(episode: Episode) -> Destination:
    """What an episode's distance field is of; episodes of one destination share it."""
    return episode.scene_id, episode.destination


class EpisodeNumbers:
    """Episodes by number; equal ones share a number."""

    def __init__(self) -> None:
        self.episodes: list[Episode] = []
        self._number: dict[Episode, int] = {}

    def add(self, episodes: Iterable[Episode]) -> NDArray[np.int64]:
        """Numbers of episodes, those not met before included."""
        numbers = []
        for episode in episodes:
            number = self._number.get(episode)
            if number is None:
                number = self._number[episode] = len(self.episodes)
                self.episodes.append(episode)
            numbers.append(number)
        return np.array(numbers, np.int64)


class PackedField(NamedTuple):
    """A distance field of free cells alone.

    Attributes:
        labels: [F] root of each free cell, uint16, or uint32 where there are too many roots.
        roots: [R, 3] x, y [m] and distance from there to the goal [m]; root 0 is "unreachable".
    """

    labels: NDArray[np.unsignedinteger]
    roots: F64

    @property
    def nbytes(self) -> int:
        """Bytes that it takes."""
        return self.labels.nbytes + self.roots.nbytes


def pack_field(field: GeodesicField, blocked: NDArray[np.bool_]) -> PackedField:
    """The labels of the cells that are not `blocked` [H, W], and the roots that they use."""
    label = field.label[~blocked]
    used = np.zeros(len(field.roots) + 1, np.bool_)
    used[label + 1] = True
    used[0] = True
    roots = np.vstack([[0.0, 0.0, np.inf], field.roots[used[1:]]])
    kind = np.uint32 if len(roots) > 65535 else np.uint16
    return PackedField((np.cumsum(used) - 1)[label + 1].astype(kind), roots)


BEND = np.dtype(
    [("x", np.float64), ("y", np.float64),
     *((name, np.int32) for name in ("parent", "via_begin", "via_end", "unused"))],
    align=True,
)  # fmt: skip


class PackedWays(NamedTuple):
    """What labels need of a field beside its packed labels and roots.

    Attributes:
        bends: [R and more] `BEND`, by root of the packed field: where an agent passes it [m], the
            next one towards the goal or −1, and the points on the way there.
        vias: [V, 2] m.
        stops: [K, 2] m, where the expert stops; none of an area.
    """

    bends: NDArray[np.void]
    vias: F64
    stops: F64

    @property
    def nbytes(self) -> int:
        """Bytes that it takes."""
        return self.bends.nbytes + self.vias.nbytes + self.stops.nbytes


def pack_ways(field: GeodesicField, blocked: NDArray[np.bool_]) -> PackedWays:
    """The ways of a field as its packed labels number the roots; other bends come behind."""
    found = find_bends(field)
    used = np.zeros(len(field.roots) + 1, np.bool_)
    used[field.label[~blocked] + 1] = True
    order = np.flatnonzero(used[1:])
    here, ahead = used[1:].copy(), order
    while len(ahead := np.unique(field.parents[ahead])):
        ahead = ahead[ahead >= 0]
        ahead = ahead[~here[ahead]]
        here[ahead] = True
        order = np.append(order, ahead)
    number = np.full(len(field.roots) + 1, -1, np.int32)  # the last of them is parent −1
    number[order] = np.arange(1, len(order) + 1)
    bends = np.zeros(len(order) + 1, BEND)
    bends["parent"][0] = -1  # root 0 is "unreachable"
    bends["x"][1:], bends["y"][1:] = found.places[order].T
    bends["parent"][1:] = number[field.parents[order]]
    counts = found.via_start[order + 1] - found.via_start[order]
    bends["via_begin"][1:] = found.via_start[order]
    bends["via_end"][1:] = found.via_start[order] + counts
    return PackedWays(bends, found.vias, stop_places(field))


class _Bits(NamedTuple):
    """An inflated map, one bit a cell."""

    bits: U8
    shape: tuple[int, int]
    resolution: float
    origin: tuple[float, float]

    @classmethod
    def of(cls, navigation: NavigationMap) -> _Bits:
        grid = navigation.grid
        return cls(np.packbits(navigation.blocked), grid.shape, grid.resolution, grid.origin)

    def unpack(self) -> OccupancyGrid:
        blocked = np.unpackbits(self.bits, count=self.shape[0] * self.shape[1])
        return OccupancyGrid(blocked.reshape(self.shape), self.resolution, self.origin)


class GroundStore:
    """Inflated maps of the scenes met so far, and distance fields on them.

    Args:
        scenes: scene id → how to get the scene; each is loaded when first needed.
        radius: the agents' radius [m].
        memory: bytes of packed fields kept here; the least recently used make room.
        lent: maps that somebody else keeps, too: fields built for them are left with them.

    Attributes:
        with_ways: fields that are built from now on are packed with their ways, see `ways`.
    """

    def __init__(
        self,
        scenes: Mapping[str, Callable[[], Scene]],
        radius: float,
        *,
        memory: int = 0,
        lent: Mapping[str, NavigationMap] | None = None,
    ) -> None:
        self.fields_built = 0
        self._scenes = scenes
        self._radius = radius
        self._lent = dict(lent or {})
        self._kept: OrderedDict[str, NavigationMap] = OrderedDict()
        self._bits: dict[str, _Bits] = {}
        self._fields: OrderedDict[Destination, PackedField] = OrderedDict()
        self._ways: dict[Destination, PackedWays] = {}  # of fields that are kept, and the last
        self._loose: Destination | None = None  # the last of them, whose field may not be kept
        self._room = memory
        self.with_ways = False

    def lend(self, navigation: Mapping[str, NavigationMap]) -> None:
        """Take maps that somebody else keeps, too, for scenes that are not open yet."""
        self._lent.update(navigation)

    def open(self, scene_id: str) -> NavigationMap:
        """The ground of a scene; the latest few are kept.

        Raises:
            EpisodeError: no such scene here.
            SceneError: nothing is walkable for this agent.
        """
        if scene_id in self._lent:
            return self._lent[scene_id]
        if scene_id not in self._kept:
            self._keep(scene_id, self._again(scene_id) or self._load(scene_id))
        self._kept.move_to_end(scene_id)
        return self._kept[scene_id]

    def _keep(self, scene_id: str, navigation: NavigationMap) -> None:
        """Keep a ground, for which the least recently used is kept as bits alone."""
        self._kept[scene_id] = navigation
        while len(self._kept) > MAPS_KEPT:
            gone, ground = self._kept.popitem(last=False)
            self._bits[gone] = _Bits.of(ground)

    def _load(self, scene_id: str) -> NavigationMap:
        if scene_id not in self._scenes:
            raise EpisodeError(f"scene {scene_id!r} is not here", remedy="open it with scene=")
        scene = self._scenes[scene_id]()
        navigation = NavigationMap(scene.grid, self._radius)
        if not navigation.inflated.free_area:
            raise SceneError(
                f"nothing is walkable for an agent of radius {self._radius:g} m",
                where=scene.path or scene.id,
                remedy="run `gn0 scene check`, or use an agent with a smaller radius",
            )
        return navigation

    def inflated(self, scene_id: str) -> OccupancyGrid:
        """The inflated map of a scene, without what paths need.

        Raises:
            EpisodeError, SceneError: see `open`.
        """
        if scene_id not in self._kept and scene_id in self._bits:
            return self._bits[scene_id].unpack()
        return self.open(scene_id).inflated

    def _again(self, scene_id: str) -> NavigationMap | None:
        """The ground of a scene that was open before, which need not be read again."""
        if scene_id not in self._bits:
            return None
        return NavigationMap(self._bits[scene_id].unpack(), 0.0)  # is inflated already

    def field(self, destination: Destination) -> PackedField:
        """The distance field of a destination, packed; built where it is not here any more.

        Raises:
            EpisodeError, SceneError: see `open`.
            PlanError: the goal is not in a free cell; of a set, no place is.
        """
        if destination in self._fields:
            self._fields.move_to_end(destination)
            return self._fields[destination]
        navigation, built = self._build(destination)
        packed = pack_field(built, navigation.blocked)
        self._keep_field(destination, packed)
        if self.with_ways:
            self._keep_ways(destination, pack_ways(built, navigation.blocked))
        return packed

    def build_all(self, destinations: Iterable[Destination], threads: int) -> None:
        """Build the fields of many destinations side by side, in so many threads.

        Those that memory keeps are found by `field` afterwards. A destination that has none is
        passed over, as one whose scene cannot be opened; `field` says why.
        """
        missing: dict[str, list[Destination]] = {}
        for name in dict.fromkeys(destinations):
            if name not in self._fields:
                missing.setdefault(name[0], []).append(name)
        names = list(missing)
        with ThreadPoolExecutor(threads) as pool:
            for begin in range(0, len(names), MAPS_TOGETHER):
                grounds = self._open_all(names[begin : begin + MAPS_TOGETHER], pool)
                wanted = [name for scene_id in grounds for name in missing[scene_id]]
                build = partial(self._build_packed, grounds)
                for name, built in zip(wanted, pool.map(build, wanted), strict=True):
                    if built is None:
                        continue
                    self.fields_built += 1
                    self._keep_field(name, built[0])
                    if built[1] is not None:
                        self._keep_ways(name, built[1])

    def _open_all(self, names: Sequence[str], pool: ThreadPoolExecutor) -> dict[str, NavigationMap]:
        """The grounds of scenes, those that are not open side by side; without those that fail."""
        new = [name for name in names if name not in self._lent and name not in self._kept]

        def open_new(scene_id: str) -> NavigationMap | None:
            try:
                return self._again(scene_id) or self._load(scene_id)
            except Gn0Error:
                return None

        opened = dict(zip(new, pool.map(open_new, new), strict=True))
        found: dict[str, NavigationMap] = {}
        for scene_id in names:
            ground = opened.get(scene_id)
            if ground is not None:
                self._keep(scene_id, ground)
            if scene_id not in opened:
                ground = self.open(scene_id)
            if ground is not None:
                found[scene_id] = ground
        return found

    def _build_packed(
        self, grounds: Mapping[str, NavigationMap], destination: Destination
    ) -> tuple[PackedField, PackedWays | None] | None:
        navigation = grounds[destination[0]]
        try:
            field = navigation.geodesic(destination[1], keep=False)
        except Gn0Error:
            return None
        packed = pack_field(field, navigation.blocked)
        return packed, pack_ways(field, navigation.blocked) if self.with_ways else None

    def _keep_field(self, destination: Destination, packed: PackedField) -> None:
        """Keep a field, for which the least recently used make room."""
        while self._fields and packed.nbytes > self._room:
            gone, field = self._fields.popitem(last=False)
            self._room += field.nbytes
            self._ways.pop(gone, None)
        if packed.nbytes <= self._room:
            self._fields[destination] = packed
            self._room -= packed.nbytes

    def ways(self, destination: Destination) -> PackedWays:
        """The ways of a destination's field, packed; built where they are not here any more.

        Raises:
            EpisodeError, SceneError, PlanError: see `field`.
        """
        if destination not in self._ways:
            navigation, built = self._build(destination)
            self._keep_ways(destination, pack_ways(built, navigation.blocked))
        return self._ways[destination]

    def _keep_ways(self, destination: Destination, ways: PackedWays) -> None:
        """Keep ways, and those of fields that are kept: a hundredth of what the fields take."""
        if self._loose is not None and self._loose not in self._fields:
            self._ways.pop(self._loose, None)
        self._loose = destination
        self._ways[destination] = ways

    def _build(self, destination: Destination) -> tuple[NavigationMap, GeodesicField]:
        scene_id, goal = destination
        navigation = self.open(scene_id)
        built = navigation.geodesic(goal, keep=scene_id in self._lent)
        self.fields_built += 1
        return navigation, built
