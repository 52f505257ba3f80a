"""What today's words tell apart: a thing's name, its room, and what it stands next to.

An instance is told by (name, neighbour, room), and whatever these words fit is meant by them: a
coffee table is one of the tables, "a bedroom" is any. Where no words of these fit one instance
alone, all that they fit are one goal.
"""

from __future__ import annotations

import threading
import weakref
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from gn0.maps.goal_places import GoalSet
from gn0.maps.navigation import NavigationMap
from gn0.missions.footprints import Footprints, build_footprints
from gn0.missions.language.surroundings import Surroundings, surroundings_of
from gn0.missions.language.word_forms import definite, indefinite, is_plural, is_stuff, spoken_name
from gn0.missions.targets import (
    NEIGHBOUR_REACH,
    REACH,
    GoalTarget,
    find_standing_cell,
    find_standing_cells,
    is_goal_worthy,
    room_box,
    wall_cells,
)
from gn0.paper import BEV_CUT
from gn0.scenes.scene import Scene, SceneObject, SceneRoom

NEXT_TO = 1.0  # m between two footprints: one would say "next to"; nobody beyond NEIGHBOUR_REACH
SIDES = 4  # places at one instance of several
TWIN_REACH = 2.9  # m: an instance that one cannot walk up to counts from as far as this
SEEN_SHARE = 0.5  # of a footprint that nothing covers from above
SEEN_SIZE = 0.4  # m, longest side of what the bird's-eye view shows well enough
SEEN_DEPTH = 0.15  # m, its other side: pictures, mirrors, towels and curtains are lines from above
_SAMPLES = 9  # points a side of a footprint


class GoalWords(NamedTuple):
    """What is said of a target: its name, what it stands next to, its room; "" where not said."""

    name: str
    near: str = ""
    room: str = ""


def fits_name(name: str, said: str) -> bool:
    """Whether something of this name may be called so: a coffee table is a table."""
    return name == said or name.endswith(f" {said}")


@dataclass(frozen=True, eq=False)
class Likeness:
    """Which objects of a scene the same words fit.

    Attributes:
        surroundings: names and rooms.
        footprints: of each object, seen from above.
    """

    surroundings: Surroundings
    footprints: Footprints
    _near: dict[int, frozenset[str]] = field(default_factory=dict)
    _found: dict[GoalWords, tuple[int, ...]] = field(default_factory=dict)

    def find(self, words: GoalWords) -> tuple[int, ...]:
        """Indices of the objects that words fit."""
        if words not in self._found:
            self._found[words] = self._find(words)
        return self._found[words]

    def _find(self, words: GoalWords) -> tuple[int, ...]:
        s = self.surroundings
        found = []
        for name, group in s.by_name.items():
            if fits_name(name, words.name):
                found += group.tolist()
        if words.room:
            rooms = [r for r, n in enumerate(s.room_names) if fits_name(n, words.room)]
            found = [i for i in found if int(s.room_of[i]) in rooms]
        if words.near:
            found = [i for i in found if words.near in self._names_near(i)]
        return tuple(sorted(found))

    def _neighbours(self, index: int, reach: float) -> list[int]:
        """Objects within a distance [m] of another and not in another room, itself left out."""
        room = self.surroundings.room_of
        near = self.footprints.around(index, reach)
        near = near[self.footprints.gaps(index, near) <= reach]
        return [i for i in near.tolist() if room[i] == room[index] or min(room[i], room[index]) < 0]

    def _names_near(self, index: int) -> frozenset[str]:
        """Names that fit something near an object, shorter ones included."""
        if index not in self._near:
            names: set[str] = set()
            for other in self._neighbours(index, NEIGHBOUR_REACH):
                words = self.surroundings.names[other].split(" ")
                names |= {" ".join(words[k:]) for k in range(len(words))}
            self._near[index] = frozenset(names)
        return self._near[index]

    def tell(self, index: int) -> tuple[GoalWords, tuple[int, ...]]:
        """The words that tell an object, and all objects that they fit: one, where that can be."""
        s = self.surroundings
        name, room = s.names[index], int(s.room_of[index])
        kind = s.room_names[room] if room >= 0 else ""
        words = GoalWords(name, "", "" if kind == name else kind)
        alike = self.find(words)
        if len(alike) == 1:
            return words, alike
        others = [i for i in alike if i != index]
        taken = frozenset().union(*(self._names_near(i) for i in others))
        near = []
        for i in self._neighbours(index, NEXT_TO):
            beside = s.names[i]
            if not s.usable[i] or s.in_room[int(s.room_of[i]), beside] > 1:
                continue
            if names_clash(beside, name) or beside in taken:
                continue
            gap = float(self.footprints.gaps(index, [i])[0])
            near.append((round(gap, 6), beside))
        if near:
            return words._replace(near=min(near)[1]), (index,)
        return words, alike


def names_clash(a: str, b: str) -> bool:
    """Whether one name would be taken for the other: equal, or one within the other."""
    x, y = f" {a} ", f" {b} "
    return x in y or y in x


_kept: weakref.WeakKeyDictionary[Scene, Likeness] = weakref.WeakKeyDictionary()
_lock = threading.Lock()


def likeness_of(scene: Scene) -> Likeness:
    """The likeness of a scene's objects; gathered on first use and kept as long as the scene is."""
    with _lock:
        found = _kept.get(scene)
    if found is None:
        prints = build_footprints([o.box for o in scene.objects])
        found = Likeness(surroundings_of(scene), prints)
        with _lock:
            _kept[scene] = found
    return found


def rooms_like(scene: Scene, room: SceneRoom) -> tuple[SceneRoom, ...]:
    """The rooms that a room's type fits as a word."""
    name = spoken_name(room.type)
    return tuple(r for r in scene.rooms if fits_name(spoken_name(r.type), name))


def describe_target(scene: Scene, item: SceneObject) -> str:
    """A short instruction, such as "Go to the chair next to the desk in the study".

    Names the room where its type is known, and a neighbour that tells it from others of its kind;
    where nothing does, it is "a chair".
    """
    likeness = likeness_of(scene)
    words, alike = likeness.tell(scene.objects.index(item))
    name = definite(words.name) if len(alike) == 1 else indefinite(words.name)
    if len(alike) > 1 and (is_plural(words.name) or is_stuff(words.name)):
        name = definite(words.name)
    text = f"Go to {name}"
    if words.near:
        text += f" next to the {words.near}"
    if words.room:
        shared = sum(fits_name(n, words.room) for n in likeness.surroundings.room_names) > 1
        text += f" in {indefinite(words.room) if shared else definite(words.room)}"
    return text + "."


class GoalGatherer:
    """Completes targets by whatever else their words fit, in one scene.

    Args:
        scene: labels, rooms, walls.
        navigation: where one may stand.
        reach: how near its footprint one stands to be at an object [m].
        walls: see `find_standing_cell`.
        ground: where the agent can stand at all, where that is more than `navigation`: one may
            reach an instance by a gap that no path of ours would take.
    """

    def __init__(
        self,
        scene: Scene,
        navigation: NavigationMap,
        reach: float = REACH,
        walls: NDArray[np.bool_] | None = None,
        ground: NavigationMap | None = None,
    ) -> None:
        self._scene, self._reach = scene, reach
        self._maps = [navigation] if ground is None else [navigation, ground]
        self._walls = wall_cells(navigation.grid, scene.objects) if walls is None else walls
        self._likeness = likeness_of(scene)
        self._cells: dict[tuple[int, int], list[tuple[float, float]]] = {}
        self._grounds: dict[int, list[NDArray[np.bool_]]] = {}

    def _stands(self, index: int, target: GoalTarget) -> list[tuple[float, float]]:
        """Where one stands to be at an object, on ground that is joined to a target's.

        Farther off where it cannot be walked up to.
        """
        key = (index, target.region)
        if target.region not in self._grounds:
            self._grounds[target.region] = [
                ground.regions == ground.region_of(*target.goal) for ground in self._maps
            ]
        if key not in self._cells:
            item = self._scene.objects[index]
            found: list[tuple[float, float]] = []
            for reach in (self._reach, max(self._reach, TWIN_REACH)):
                if not found:
                    for ground, joined in zip(
                        self._maps, self._grounds[target.region], strict=True
                    ):
                        found += find_standing_cells(
                            self._scene, ground, item, SIDES,
                            reach=reach, walls=self._walls, allowed=joined,
                        )  # fmt: skip
            self._cells[key] = found
        return self._cells[key]

    def complete(self, target: GoalTarget) -> GoalTarget:
        """A target with all places that its words fit, and whether it shows from above."""
        if target.kind == "place":
            return target
        if target.kind == "room":
            room = next(r for r in self._scene.rooms if r.id == target.object.id)
            rooms = rooms_like(self._scene, room)
            areas = tuple(tuple((float(x), float(y)) for x, y in r.polygon) for r in rooms)
            return replace(
                target,
                goals=GoalSet(areas=areas),
                places=tuple((room_box(r), target.goal) for r in rooms),
                middle=target.goal,
            )
        index = self._scene.objects.index(target.object)
        _, alike = self._likeness.tell(index)
        places = [(target.object, target.goal)]
        for other in alike if len(alike) > 1 else ():
            places += [(self._scene.objects[other], cell) for cell in self._stands(other, target)]
        points = tuple(sorted({place for _, place in places}))
        return replace(
            target,
            goals=GoalSet(points=points) if len(points) > 1 else None,
            places=tuple(places),
            from_above=self.is_seen_from_above(index),
        )

    def is_seen_from_above(self, index: int) -> bool:
        """Whether the bird's-eye view shows an object: large enough, below the cut, half open."""
        objects = self._scene.objects
        box = objects[index].box
        top = box.centre[2] + box.size[2] / 2
        if max(box.size[:2]) < SEEN_SIZE or box.centre[2] > BEV_CUT:
            return False
        if min(box.size[:2]) < SEEN_DEPTH:
            return False
        t = (np.arange(_SAMPLES) + 0.5) / _SAMPLES - 0.5
        c, s = np.cos(box.yaw), np.sin(box.yaw)
        u, v = (a.ravel() for a in np.meshgrid(t * box.size[0], t * box.size[1]))
        points = np.column_stack([c * u - s * v, s * u + c * v]) + np.array(box.centre[:2])
        seen = np.ones(len(points), np.bool_)
        for i in self._likeness.footprints.around(index).tolist():
            other = objects[i].box
            above = other.centre[2] + other.size[2] / 2 > top + 0.02 and other.centre[2] <= BEV_CUT
            if above:
                oc, os = np.cos(other.yaw), np.sin(other.yaw)
                d = points - np.array(other.centre[:2])
                local = np.abs(np.column_stack([d @ (oc, os), d @ (-os, oc)]))
                seen &= ~(local <= np.array(other.size[:2]) / 2).all(axis=1)
        return bool(seen.mean() >= SEEN_SHARE)


def build_targets(
    scene: Scene, navigation: NavigationMap, *, reach: float = REACH
) -> list[GoalTarget]:
    """All objects of a scene that one can walk up to, in the scene's order."""
    walls = wall_cells(navigation.grid, scene.objects)
    gatherer = GoalGatherer(scene, navigation, reach, walls)
    targets = []
    for item in scene.objects:
        if not is_goal_worthy(item):
            continue
        goal = find_standing_cell(scene, navigation, item, reach=reach, walls=walls)
        if goal is None:
            continue
        region = navigation.region_of(*goal)
        if region >= 0:
            target = GoalTarget(item, goal, region, describe_target(scene, item))
            targets.append(gatherer.complete(target))
    return targets


def category_of(target: GoalTarget) -> str:
    """The kind under which a target takes its turn."""
    return f"{target.kind}: {target.searched or spoken_name(target.object.category)}"


def order_targets(targets: list[GoalTarget], rng: np.random.Generator) -> list[list[GoalTarget]]:
    """Targets by category, both in a drawn order: many binders make no more goals of binders."""
    groups: dict[str, list[GoalTarget]] = {}
    for k in rng.permutation(len(targets)):
        groups.setdefault(category_of(targets[k]), []).append(targets[k])
    names = sorted(groups)
    return [groups[names[k]] for k in rng.permutation(len(names))]
