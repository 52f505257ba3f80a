"""Put people into an episode: some walk back and forth, some stand together, some sit.

All from one seed, on the scene's own map. Nobody starts near the agent, and whoever stands leaves
the agent a way to its goal.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import lru_cache
from itertools import pairwise
from typing import Any, Protocol, TypeVar

import msgspec
import numpy as np

from gn0.avatars.identity import draw_numbers
from gn0.errors import PlanError
from gn0.geometry import F64
from gn0.maps.goal_places import GoalSet
from gn0.maps.grid import OCCUPIED, OccupancyGrid
from gn0.maps.navigation import NavigationMap
from gn0.paper import BODY_RADIUS
from gn0.people.person import (
    RADIUS,
    EpisodePerson,
    PersonStop,
)
from gn0.people.planning import blocked_at, people_map, round_path
from gn0.people.settings import PeopleSettings
from gn0.progress import Progress, no_progress
from gn0.scenes.scene import Scene, SceneObject
from gn0.seeds import derive_seed, random_stream

AT_EASE = 0.42  # m from walls where there is room for it: bends can be rounded there
SEATS = frozenset(
    {"chair", "office chair", "dining chair", "armchair", "sofa", "couch", "bench", "stool"}
)
TABLES = frozenset({"table", "desk", "dining table", "coffee table", "reading desk"})
_SEAT_HEIGHT = 0.45  # m
_TRIES = 60
_WALK_LENGTH = (3.0, 16.0)  # m
_ACTS = ("", "", "", "wave", "point")  # what people of a group do, mostly nothing


class _Tasked(Protocol):
    """What people are planned around: an `Episode`, or something like one."""

    @property
    def id(self) -> str: ...
    @property
    def path_id(self) -> str: ...
    @property
    def start(self) -> tuple[float, float, float]: ...
    @property
    def destination(self) -> tuple[float, float] | GoalSet: ...


def plan_people(
    scene: Scene, episode: _Tasked, settings: PeopleSettings, *, radius: float = BODY_RADIUS
) -> tuple[EpisodePerson, ...]:
    """People for an episode; the same settings, scene and path (or episode) give the same ones.

    Args:
        scene: where.
        episode: that they are for: its start, its goal and its id.
        settings: how many, and of what kind.
        radius: of the agent [m], who must be left a way to its goal.

    Returns:
        `settings.count` people, fewer where there is no room for them.
    """
    return _Planner(scene, episode, settings, radius).plan()


class _Populated(_Tasked, Protocol):
    """An episode that has room for people."""

    @property
    def agent(self) -> Any: ...


_Episode = TypeVar("_Episode", bound=_Populated)


def add_people(
    scene: Scene,
    episodes: Sequence[_Episode],
    settings: PeopleSettings,
    *,
    progress: Progress = no_progress,
) -> list[_Episode]:
    """The episodes with people in them; those of one path have the same ones.

    Args:
        scene: of all of them.
        episodes: in their order.
        settings: how many people, and of what kind.
        progress: progress sink.
    """
    known: dict[str, tuple[EpisodePerson, ...]] = {}
    found = []
    for done, episode in enumerate(episodes):
        name = episode.path_id or episode.id
        if name not in known:
            known[name] = plan_people(scene, episode, settings, radius=episode.agent.radius)
        found.append(msgspec.structs.replace(episode, people=known[name]))  # type: ignore[type-var]
        progress("people", done + 1, len(episodes))
    return found


@lru_cache(8)
def _draw(seed: int, count: int) -> tuple[int, ...]:
    return tuple(draw_numbers(seed, count))


class _Planner:
    def __init__(
        self, scene: Scene, episode: _Tasked, settings: PeopleSettings, radius: float
    ) -> None:
        self.scene, self.episode, self.settings, self.radius = scene, episode, settings, radius
        self.name = name = episode.path_id or episode.id
        self.stream = random_stream(settings.seed, "people", scene.id, name)
        self.start = (float(episode.start[0]), float(episode.start[1]))
        self.near = people_map(scene.grid)
        self.spots: list[tuple[float, float]] = []
        self.standing: list[tuple[float, float, float]] = []  # discs that nobody walks through
        self.people: list[EpisodePerson] = []
        count = settings.count
        if settings.bank:
            order = self.stream.permutation(len(settings.bank))
            names = [settings.bank[int(order[k % len(order)])] for k in range(count)]
        else:
            own = derive_seed(settings.seed, "who") % 2**31
            known = _draw(own, max(settings.variety, count))
            order = self.stream.permutation(len(known))[:count]
            names = [f"drawn:{own}:{known[int(k)]}" for k in order]
        self.names = names

    def plan(self) -> tuple[EpisodePerson, ...]:
        settings, stream = self.settings, self.stream
        left = settings.count
        seated = int(sum(stream.random(left) < settings.seated)) if left else 0
        for seat in self._seats():
            disc = (*seat[:2], RADIUS)
            if len(self.people) < seated and self._passable([*self.standing, disc]):
                self._add(path=(seat[:2],), behaviour="sit", yaw=seat[2], seat=seat[3])
                self.standing.append(disc)
        grouped = stream.random() < settings.groups
        left = settings.count - len(self.people)
        if grouped and left >= 2:
            self._group(int(stream.integers(2, min(left, 3) + 1)))
        walls = self._walls()
        for _ in range(settings.count - len(self.people)):
            self._walker(walls)
        return tuple(self.people)

    def _add(self, **fields: Any) -> None:
        number = len(self.people) + 1
        person = EpisodePerson(
            number=number,
            identity=self.names[number - 1],
            seed=derive_seed(self.settings.seed, "person", self.name, number) % 2**31,
            bank=self.settings.bank_hash,
            **fields,
        )
        self.people.append(person)
        self.spots.append(person.spot)

    def _far_enough(self, x: float, y: float, apart: float = 2 * RADIUS + 0.3) -> bool:
        if math.dist((x, y), self.start) < self.settings.from_start:
            return False
        return all(math.dist((x, y), spot) >= apart for spot in self.spots)

    def _passable(self, discs: Sequence[tuple[float, float, float]]) -> bool:
        """Whether the agent still reaches its goal around discs (x, y, radius) m."""
        grid = with_discs(self.scene.grid, discs)
        around = NavigationMap(grid, self.radius)
        region = around.region_of(*self.start)
        if region < 0:
            return False
        goal = self.episode.destination
        return region in around.regions_of(goal)

    def _seats(self) -> list[tuple[float, float, float, float]]:
        """Seats (x, y [m], yaw [rad], height [m]) beside which one can stand, in random order."""
        found: list[tuple[float, float, float, float]] = []
        things = [thing for thing in self.scene.objects if thing.category in SEATS]
        order = self.stream.permutation(len(things))
        for k in order:
            seat = find_seat(self.scene, things[int(k)], float(self.stream.random()))
            if seat is None or not self._far_enough(*seat[:2], apart=0.6):
                continue
            if all(math.dist(seat[:2], other[:2]) >= 0.6 for other in found):
                found.append(seat)
        return found

    def _group(self, count: int) -> None:
        """Two or three who stand around a space of their own."""
        centres = self._free_places(self.near, _TRIES).tolist()
        for x, y in centres:
            size = 0.45 if count == 2 else 0.55
            begin = float(self.stream.uniform(-math.pi, math.pi))
            ring = [
                (x + size * math.cos(begin + k * 2 * math.pi / count),
                 y + size * math.sin(begin + k * 2 * math.pi / count))
                for k in range(count)
            ]  # fmt: skip
            if not all(self.near.is_free(*spot) and self._far_enough(*spot) for spot in ring):
                continue
            disc = (x, y, size + RADIUS)
            if math.dist((x, y), self.start) < size + RADIUS + 0.6 or not self._passable(
                [*self.standing, disc]
            ):
                continue
            for k, (u, v) in enumerate(ring):
                act = _ACTS[int(self.stream.integers(len(_ACTS)))] if k == 0 else ""
                self._add(
                    path=((u, v),), behaviour="stand", yaw=math.atan2(y - v, x - u), clip=act,
                    o_space=(x, y, size),
                )  # fmt: skip
            self.standing.append(disc)
            return

    def _free_places(self, navigation: NavigationMap, count: int) -> F64:
        """Places [count, 2] m at random where people can be, in the agent's own region."""
        regions = navigation.regions
        here = navigation.nearest_free(*self.start)
        region = -1 if here is None else navigation.region_of(*here)
        cells = np.argwhere(regions == region) if region >= 0 else np.zeros((0, 2), np.int64)
        if not len(cells):
            return np.zeros((0, 2))
        picked = cells[self.stream.integers(len(cells), size=count)]
        return np.asarray(navigation.inflated.centres_of(picked), np.float64)

    def _walls(self) -> NavigationMap:
        """The map that paths are planned on: walls, who sits, who stands."""
        grid = with_discs(self.scene.grid, self.standing) if self.standing else self.scene.grid
        return people_map(grid, AT_EASE) if self._roomy(grid) else people_map(grid)

    def _roomy(self, grid: OccupancyGrid) -> bool:
        wide, near = people_map(grid, AT_EASE), people_map(grid)
        areas = [m.region_areas[0] if len(m.region_areas) else 0.0 for m in (wide, near)]
        return bool(areas[0] >= 0.6 * areas[1] > 0)

    def _walker(self, walls: NavigationMap) -> None:
        stream, settings = self.stream, self.settings
        low, high = _WALK_LENGTH
        for attempt in range(_TRIES):
            start, *ends = self._free_places(walls, 3).tolist() or [(0.0, 0.0)]
            if len(ends) < 2 or not self._far_enough(*start):
                continue
            loop = bool(stream.random() < 0.25)
            corners = [start, *ends, start] if loop else [start, ends[0]]
            path = self._join(walls, corners)
            shortest = low if attempt < _TRIES // 2 else 1.0
            if path is None or not shortest <= _length(path) <= high * (1.5 if loop else 1.0):
                continue
            self._add(
                path=tuple((float(x), float(y)) for x, y in path),
                speed=round(float(stream.uniform(*settings.speeds)), 2),
                stops=self._stops(_length(path)),
                after="loop" if loop else "back",
            )
            return

    def _join(self, walls: NavigationMap, corners: Sequence[Sequence[float]]) -> F64 | None:
        try:
            legs = [walls.plan((a[0], a[1]), (b[0], b[1])) for a, b in pairwise(corners)]
        except PlanError:
            return None
        joined = np.concatenate([leg[:-1] for leg in legs] + [legs[-1][-1:]])
        path = round_path(self.scene.grid, joined)
        path[-1] = joined[-1]
        return path if blocked_at(self.scene.grid, path.tolist()) is None else None

    def _stops(self, length: float) -> tuple[PersonStop, ...]:
        stream = self.stream
        count = int(stream.integers(self.settings.stops + 1)) if length > 3 else 0
        places = np.sort(stream.uniform(1.0, length - 1.0, count)) if count else ()
        stops = []
        for at in places:
            looks = int(stream.integers(3))
            for _ in range(max(looks, 1)):
                look = float(stream.uniform(30, 100)) * (1 if stream.random() < 0.5 else -1)
                stops.append(
                    PersonStop(
                        at=round(float(at), 3),
                        seconds=round(float(stream.uniform(1.0, 3.0)), 1),
                        look=round(look, 1) if looks else 0.0,
                    )
                )
        return tuple(stops)


def find_seat(
    scene: Scene, thing: SceneObject, share: float = 0.5
) -> tuple[float, float, float, float] | None:
    """Where one sits on a piece of furniture: x, y [m], yaw [rad], height [m]; None if one cannot.

    A back is where a table is not, and where nothing can be walked on.

    Args:
        scene: where it stands.
        thing: the piece.
        share: 0..1, which of the places of a wide one.
    """
    box = thing.box
    if thing.category not in SEATS or not 0.35 <= box.centre[2] + box.size[2] / 2 <= 1.4:
        return None
    long, deep = box.size[0], box.size[1]
    turned = deep > 1.3 * long
    if turned:
        long, deep = deep, long
    if deep < 0.3 or deep > 1.3:
        return None
    along = box.yaw + (math.pi / 2 if turned else 0.0)
    aside = (share - 0.5) * max(long - 0.9, 0.0)
    x = box.centre[0] + aside * math.cos(along)
    y = box.centre[1] + aside * math.sin(along)
    ways = [along - math.pi / 2, along + math.pi / 2]
    if long < 1.2 * deep and thing.category in ("chair", "stool", "office chair", "dining chair"):
        ways += [along, along + math.pi]
    best, facing = -math.inf, ways[0]
    for k, yaw in enumerate(ways):
        score = -0.01 * k + _reach(scene.grid, x, y, yaw, deep / 2)
        ahead = (x + 0.6 * math.cos(yaw), y + 0.6 * math.sin(yaw))
        if any(t.category in TABLES and _inside(t, *ahead) for t in scene.objects):
            score += 10.0
        if score > best:
            best, facing = score, yaw
    if best < 0.3:
        return None
    forward = 0.05 if deep < 0.7 else 0.5 * deep - 0.45
    x, y = x + forward * math.cos(facing), y + forward * math.sin(facing)
    return x, y, math.remainder(facing, 2 * math.pi), _SEAT_HEIGHT


def _inside(thing: SceneObject, x: float, y: float) -> bool:
    dx, dy = x - thing.box.centre[0], y - thing.box.centre[1]
    c, s = math.cos(thing.box.yaw), math.sin(thing.box.yaw)
    u, v = c * dx + s * dy, -s * dx + c * dy
    return abs(u) <= thing.box.size[0] / 2 + 0.1 and abs(v) <= thing.box.size[1] / 2 + 0.1


def _reach(grid: OccupancyGrid, x: float, y: float, yaw: float, begin: float) -> float:
    """Metres of free floor, at most 1, in a direction from the edge of a piece of furniture."""
    free = 0
    for k in range(20):
        at = begin + 0.05 * (k + 1)
        if grid.is_free(x + at * math.cos(yaw), y + at * math.sin(yaw)):
            free += 1
        elif k > 3:
            break
    return 0.05 * free


def with_discs(grid: OccupancyGrid, discs: Sequence[tuple[float, float, float]]) -> OccupancyGrid:
    """The grid with discs (x, y, radius) [m] occupied."""
    cells = grid.cells.copy()
    rows, cols = np.indices(grid.shape)
    xs = grid.origin[0] + (cols + 0.5) * grid.resolution
    ys = grid.origin[1] + (rows + 0.5) * grid.resolution
    for x, y, radius in discs:
        cells[(xs - x) ** 2 + (ys - y) ** 2 <= radius**2] = OCCUPIED
    return grid.with_cells(cells)


def _length(path: F64) -> float:
    return float(np.linalg.norm(np.diff(path, axis=0), axis=1).sum())
