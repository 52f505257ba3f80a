"""A scene as landmarks see it: names, footprints, rooms and doors, gathered once a scene."""

from __future__ import annotations

import threading
import weakref
from collections import Counter
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gn0.geometry import F64
from gn0.missions.language.word_forms import NO_LANDMARK, distinctness, kin_of, spoken_name
from gn0.missions.targets import points_in_polygon, room_of_object
from gn0.scenes.scene import Scene, SceneObject

LARGE_ENOUGH = 0.5  # m, longest side of a landmark
OVERHEAD = 1.6  # m; what hangs above this is no landmark
FLAT = 0.12  # m; what is lower lies on the floor
NO_ROOM_NAMES = frozenset(("", "room", "unknown", "other", "others", "undefined", "none", "object"))
_DOOR_WIDEST = 1.7  # m; wider openings are no doorways
_SEAM = 0.5  # m of path in a room that is only touched


@dataclass(frozen=True, eq=False)
class Surroundings:
    """What a scene offers to tell a route by.

    Attributes:
        scene: the scene.
        names: name of each object [N], as it is said.
        usable: whether each object [N] may be a landmark.
        weight: how well each object [N] serves by kind and size.
        room_of: index of each object's room [N], −1 unknown.
        room_names: type of each room as it is said, "" when it says nothing.
        in_room: how many objects of one name a room holds, by (room, name).
        by_name: indices of the objects of each name.
        rivals: indices of the objects that each may be confused with, itself included.
        doors: doorways [D, 2, 2] m, end points seen from above.
    """

    scene: Scene
    names: tuple[str, ...]
    usable: NDArray[np.bool_]
    weight: F64
    room_of: NDArray[np.int64]
    room_names: tuple[str, ...]
    in_room: Counter[tuple[int, str]]
    by_name: dict[str, NDArray[np.int64]]
    rivals: tuple[NDArray[np.int64], ...]
    doors: F64

    def rooms_at(self, points: NDArray[np.floating]) -> NDArray[np.int64]:
        """Index of the room that holds each point [N, 2] m; −1 in none."""
        out = np.full(len(points), -1, np.int64)
        for index, room in enumerate(self.scene.rooms):
            out[(out < 0) & points_in_polygon(points, np.array(room.polygon))] = index
        return out

    def rooms_along(self, points: NDArray[np.floating], spacing: float) -> NDArray[np.int64]:
        """Index of the room at each point of a path [N, 2] m, without gaps and touches."""
        found = self.rooms_at(points)
        if (found < 0).all():
            return found
        known = np.flatnonzero(found >= 0)
        found = found[
            known[np.clip(np.searchsorted(known, np.arange(len(found))), 0, len(known) - 1)]
        ]
        starts = np.flatnonzero(np.r_[True, np.diff(found) != 0])
        ends = np.r_[starts[1:], len(found)]
        for a, b in zip(starts, ends, strict=True):
            if (b - a) * spacing < _SEAM and a > 0 and b < len(found):
                found[a:b] = found[a - 1]
        return found

    def find_doors(self, path: F64) -> NDArray[np.int64]:
        """Where a path [N, 2] m goes through a doorway: indices of its points, in order."""
        if not len(self.doors) or len(path) < 2:
            return np.zeros(0, np.int64)
        a, b = path[:-1, None], path[1:, None]
        p, q = self.doors[None, :, 0], self.doors[None, :, 1]
        hits = (_side(p, q, a) * _side(p, q, b) <= 0) & (_side(a, b, p) * _side(a, b, q) < 0)
        return np.sort(np.argmax(hits, axis=0)[hits.any(axis=0)])


def _side(o: F64, u: F64, v: F64) -> F64:
    d, e = u - o, v - o
    return d[..., 0] * e[..., 1] - d[..., 1] * e[..., 0]


_kept: weakref.WeakKeyDictionary[Scene, Surroundings] = weakref.WeakKeyDictionary()
_lock = threading.Lock()


def surroundings_of(scene: Scene) -> Surroundings:
    """The surroundings of a scene; gathered on first use and kept as long as the scene is."""
    with _lock:
        found = _kept.get(scene)
    if found is None:
        found = _gather(scene)
        with _lock:
            _kept[scene] = found
    return found


def _rivals(names: tuple[str, ...]) -> tuple[NDArray[np.int64], ...]:
    """Objects that share a name, a kindred name, or the last words of one.

    A coffee table is one of the tables, though a table is no coffee table.
    """
    groups: dict[str, list[int]] = {}
    for index, name in enumerate(names):
        tails = {name[k:] for k in range(len(name)) if k == 0 or name[k - 1] == " "}
        for key in {kin_of(tail) for tail in tails}:
            groups.setdefault(key, []).append(index)
    arrays = {key: np.array(group, np.int64) for key, group in groups.items()}
    return tuple(arrays[kin_of(name)] for name in names)


def is_landmark(item: SceneObject) -> bool:
    """Whether an object is the kind of thing that one tells a way by."""
    name = spoken_name(item.category)
    if (
        name in NO_LANDMARK
        or name.split(" ")[-1] in NO_LANDMARK
        or max(item.box.size) < LARGE_ENOUGH
    ):
        return False
    bottom = item.box.centre[2] - item.box.size[2] / 2
    top = item.box.centre[2] + item.box.size[2] / 2
    return bottom <= OVERHEAD and top >= FLAT and item.box.size[2] >= FLAT


def _gather(scene: Scene) -> Surroundings:
    names = tuple(spoken_name(o.category) for o in scene.objects)
    index_of = {room.id: i for i, room in enumerate(scene.rooms)}
    rooms = [room_of_object(o, scene.rooms) for o in scene.objects]
    room_of = np.array([-1 if r is None else index_of[r.id] for r in rooms], np.int64)
    sizes = np.array([max(o.box.size) for o in scene.objects])
    kinds = np.array([distinctness(n) for n in names])
    every = np.array(names, np.str_)
    doors = []
    for opening in scene.openings:
        if opening.kind.upper() == "WINDOW":
            continue
        flat = np.array(opening.polygon)[:, :2]
        away = np.hypot(*(flat[:, None] - flat[None]).transpose(2, 0, 1))
        a, b = np.unravel_index(int(np.argmax(away)), away.shape)
        if 0.4 <= away[a, b] <= _DOOR_WIDEST:
            doors.append((flat[a], flat[b]))
    kept = [spoken_name(r.type) for r in scene.rooms]
    return Surroundings(
        scene=scene,
        names=names,
        usable=np.array([is_landmark(o) for o in scene.objects], np.bool_),
        weight=kinds * np.clip(sizes, 0.5, 2.0) ** 0.7,
        room_of=room_of,
        room_names=tuple("" if n in NO_ROOM_NAMES else n for n in kept),
        in_room=Counter((int(r), n) for r, n in zip(room_of, names, strict=True)),
        by_name={n: np.flatnonzero(every == n) for n in sorted(set(names))},
        rivals=_rivals(names),
        doors=np.array(doors, np.float64).reshape(-1, 2, 2),
    )
