"""What a goal's words fit, by a rule of its own: read from the text, measured on the boxes.

Nothing of the generator is used but the text that it wrote, the scene's labels and the map: names
are cut from the text by patterns, rooms by Shapely, and a thing is next to another at 1.5 m.
"""

from __future__ import annotations

import re
from dataclasses import dataclass

import numpy as np
import shapely

from gn0.geometry import F64
from gn0.maps.navigation import NavigationMap
from gn0.missions.episode import Episode, MissionGoal
from gn0.scenes.scene import Scene, SceneObject

BESIDE = 1.5  # m between two footprints that stand next to each other
STAND = 1.5  # m from its footprint: one stands at a thing
RADIUS = 3.0  # m, of success


def said_as(label: str) -> str:
    """A label in words: "CoffeeTable_01" is a coffee table."""
    words = re.sub(r"(?<=[a-z])(?=[A-Z])", " ", label)
    words = re.sub(r"[_\-\s]+", " ", words).lower().strip()
    return re.sub(r"( \d+)+$", "", words)


def fits(name: str, said: str) -> bool:
    """Whether a thing of this name may be called so."""
    return f" {name}".endswith(f" {said}")


def _names_in(text: str, names: set[str]) -> list[str]:
    """Names in a text, longest first, none within another."""
    found, rest = [], text
    for name in sorted((n for n in names if n), key=len, reverse=True):
        pattern = rf"(?<![\w-]){re.escape(name).replace(chr(92) + ' ', '[ -]')}(?![\w-])"
        if re.search(pattern, rest):
            found.append(name)
            rest = re.sub(pattern, "#", rest)
    return found


def _print_of(item: SceneObject) -> shapely.Polygon:
    corners = item.box.corners()[:, :2]
    return shapely.MultiPoint(corners).convex_hull.buffer(1e-6)


@dataclass(frozen=True)
class Twin:
    """Something that fits a goal's words.

    Attributes:
        id: of the object or room.
        distance: walking distance [m] from where one stands at it to what counts; 0 in an area.
        counts: whether who stops there has arrived.
    """

    id: str
    distance: float
    counts: bool


class JudgeTwins:
    """Finds all that the words of goal episodes fit in one scene.

    Args:
        scene: labels and rooms.
        navigation: where the agent can stand.
    """

    def __init__(self, scene: Scene, navigation: NavigationMap) -> None:
        self._scene, self._navigation = scene, navigation
        self._prints = [_print_of(o) for o in scene.objects]
        self._names = [said_as(o.category) for o in scene.objects]
        self._tree = shapely.STRtree(self._prints)
        self._rooms = [shapely.Polygon(r.polygon).buffer(0) for r in scene.rooms]
        self._kinds = [said_as(r.type) for r in scene.rooms]
        self._room = [self._room_of(o) for o in scene.objects]
        cells = np.argwhere(navigation.regions >= 0)
        self._places: F64 = navigation.inflated.centres_of(cells)
        self._regions = navigation.regions[cells[:, 0], cells[:, 1]]
        self._points = shapely.points(self._places)
        self._ground = shapely.STRtree(self._points)

    def _room_of(self, item: SceneObject) -> int:
        for k, room in enumerate(self._scene.rooms):
            if room.id == item.room:
                return k
        at = shapely.Point(item.box.centre[:2])
        return next((k for k, room in enumerate(self._rooms) if room.contains(at)), -1)

    def read(self, episode: Episode) -> tuple[str, str, str]:
        """(Name, what it is next to, room) as the text says them; "" where it does not."""
        mission = episode.mission
        assert isinstance(mission, MissionGoal)
        text = mission.instruction.lower()
        name = said_as(mission.category)
        near = ""
        rest = _without(text, name)
        for hit in re.finditer(r"next to (?:the|an?|some) ", rest):
            names = [n for n in set(self._names) if rest[hit.end() :].startswith(n)]
            near = max(names, key=len, default="") or near
        rest = _without(rest, near)
        kinds = _names_in(rest, set(self._kinds))
        return name, near, kinds[0] if kinds else ""

    def twins(self, episode: Episode) -> list[Twin]:
        """All else that the words of a goal episode fit, and whether each counts."""
        mission = episode.mission
        assert isinstance(mission, MissionGoal)
        field = self._navigation.geodesic(episode.destination)
        home = self._navigation.region_of(*episode.start[:2])
        reachable = self._regions == home
        if any(room.id == mission.object_id for room in self._scene.rooms) and episode.in_area:
            return self._room_twins(said_as(mission.category), field.distance, reachable)
        name, near, kind = self.read(episode)
        found = []
        for i, called in enumerate(self._names):
            room = self._room[i]
            if not fits(called, name) or self._scene.objects[i].id == mission.object_id:
                continue
            if kind and not (room >= 0 and fits(self._kinds[room], kind)):
                continue
            if near and not self._is_beside(i, near):
                continue
            place = self._stand(i, reachable)
            if place is None:
                continue  # nobody can be there
            away = float(field.distance(place[None])[0])
            there = away < RADIUS if not episode.in_area else away == 0.0
            found.append(Twin(self._scene.objects[i].id, away, there))
        return found

    def _room_twins(self, kind: str, distance, reachable) -> list[Twin]:  # type: ignore[no-untyped-def]
        found = []
        for k, room in enumerate(self._rooms):
            if fits(self._kinds[k], kind):
                inside = reachable & shapely.contains(room, self._points)
                if inside.any():
                    away = float(distance(self._places[inside]).max())
                    found.append(Twin(self._scene.rooms[k].id, away, away == 0.0))
        return found

    def _is_beside(self, index: int, near: str) -> bool:
        hits = self._tree.query(self._prints[index], predicate="dwithin", distance=BESIDE)
        same = self._room[index]
        return any(
            int(i) != index and fits(self._names[int(i)], near)
            and (same < 0 or self._room[int(i)] in (same, -1))
            for i in hits
        )  # fmt: skip

    def _stand(self, index: int, reachable: np.ndarray) -> F64 | None:
        """Where one stands at an object: the nearest ground in its room, or None."""
        shape = self._prints[index]
        hits = self._ground.query(shape, predicate="dwithin", distance=STAND)
        hits = hits[reachable[hits]]
        if self._room[index] >= 0:
            hits = hits[shapely.contains(self._rooms[self._room[index]], self._points[hits])]
        if not len(hits):
            return None
        away = shapely.distance(shape, self._points[hits])
        return np.asarray(self._places[hits[int(np.argmin(away))]], np.float64)


def _without(text: str, name: str) -> str:
    """The text without a name that stands alone: there is no bin in a cabinet."""
    return re.sub(rf"\b{re.escape(name)}\b", "#", text) if name else text
