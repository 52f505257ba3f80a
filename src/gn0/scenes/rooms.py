"""Rooms from a building's shell: free space cut where walls come close to each other.

Free space is cut at portals (gaps clearly narrower than the space on both sides of them: doors and
wide passages alike) and at necks no wider than a door; what hangs together is a room. The type is
guessed from the furniture.
"""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from gn0.maps.grid import OCCUPIED, OccupancyGrid
from gn0.scenes.scene import SceneObject, SceneRoom

DOOR_WIDTH = 1.0  # m: necks up to this are doors
ROOM_AREA = 2.5  # m²: smaller patches join a neighbour
_WALL = 0.45  # m: the two sides of a portal lie at most this far apart
_NARROW = 0.85  # of the width on both sides: what makes a gap a portal
_SIDE_WIDTH = 2.0  # m: widest portal beside a wall that runs past it
_OFFSET = 0.15  # m: by how much the wall ends of a portal may be out of line
_REACH = 0.75  # m: an object this near to a room belongs to it

_TYPES: dict[str, dict[str, float]] = {
    "bedroom": {"bed": 4, "nightstand": 2, "wardrobe": 1.5, "pillow": 1, "dresser": 2, "crib": 3},
    "kitchen": {
        "cooking bench": 4, "kitchen cabinet": 3, "refrigerator": 3, "fridge": 3, "range hood": 3,
        "stove": 4, "oven": 3, "kitchen counter": 4, "kitchen utensils": 1, "microwave": 1.5,
        "kitchen table": 1, "seasoning box": 1, "dishwasher": 3, "hob": 3,
    },
    "living room": {
        "sofa": 3, "couch": 3, "coffee table": 2, "tv cabinet": 1.5, "television": 1,
        "armchair": 1.5, "tv stand": 1.5,
    },
    "dining room": {"dining table": 3, "kitchen table": 1.5, "tableware": 1},
    "bathroom": {"toilet": 5, "bathtub": 5, "shower": 5, "washbasin": 3, "bathroom sink": 3},
    "study": {"desk": 2, "reading desk": 2, "office chair": 1.5, "bookshelf": 1, "computer": 1},
    "gym": {"fitness equipment": 3, "dumbbell": 2, "treadmill": 3},
    "hallway": {"shoe rack": 1.5, "coat rack": 1.5},
    "balcony": {"balcony table": 2},
    "storage hall": {"shelf": 1, "pallet jack": 3, "pallet": 2, "clutter": 1},
}  # fmt: skip

_AREAS = {  # m²: sizes that such rooms have, small flats and large houses included
    "bedroom": (4.0, 60.0),
    "kitchen": (3.0, 80.0),
    "living room": (7.0, 150.0),
    "dining room": (5.0, 120.0),
    "bathroom": (1.5, 40.0),
    "study": (3.0, 60.0),
    "gym": (6.0, 400.0),
    "hallway": (1.0, 80.0),
    "balcony": (1.0, 40.0),
    "storage hall": (20.0, math.inf),
}
_SPEAKS = 1.5  # weight of furniture that names a room
_CLEAR = 1.25  # of the next best type's weight
_AREA_PER_THING = 30.0  # m² of floor for which one thing may speak


@dataclass(frozen=True, eq=False)
class RoomMap:
    """Rooms and the cells that belong to them.

    Attributes:
        rooms: rooms, largest first.
        label: index into `rooms` per cell [H, W] int32, −1 outside.
    """

    rooms: tuple[SceneRoom, ...]
    label: NDArray[np.int32]


def build_rooms(
    shell: OccupancyGrid, inside: NDArray[np.bool_], objects: tuple[SceneObject, ...] = ()
) -> RoomMap:
    """Split the inside of a building into rooms.

    Args:
        shell: occupancy of walls, closed doors and windows alone, without furniture.
        inside: cells [H, W] that belong to the building (where its floor is).
        objects: furniture, for the rooms' types.
    """
    size = shell.resolution
    space = inside & (shell.cells != OCCUPIED)
    cut = space & ~_portals(shell.cells == OCCUPIED, space, size)
    clearance = ndimage.distance_transform_edt(np.pad(cut, 1))[1:-1, 1:-1] * size
    seeds, count = ndimage.label(clearance > DOOR_WIDTH / 2)
    if not count:
        seeds, count = ndimage.label(space)
    # first up to the cuts, then over them
    label = _merge_small(_grow(_grow(seeds, cut), space), count, size)
    order = list(np.argsort(-np.bincount(label.ravel())[1:], kind="stable") + 1)
    out = np.full(label.shape, -1, np.int32)
    rooms: list[SceneRoom] = []
    for value in order:
        mask = label == value
        if mask.sum() * size**2 < ROOM_AREA:
            continue
        out[mask] = len(rooms)
        polygon = trace_outline(mask, shell)
        rooms.append(SceneRoom(id=f"room-{len(rooms)}", type="room", polygon=polygon))
    plain = RoomMap(tuple(rooms), out)
    placed = assign_rooms(objects, plain, shell)
    return RoomMap(_with_types(plain.rooms, placed), out)


def assign_rooms(
    objects: tuple[SceneObject, ...], rooms: RoomMap, grid: OccupancyGrid
) -> tuple[SceneObject, ...]:
    """The objects with the room that each stands in, or is nearest to within 0.75 m."""
    if not rooms.rooms or not objects:
        return objects
    known = rooms.label >= 0
    distance, nearest = ndimage.distance_transform_edt(~known, return_indices=True)
    h, w = known.shape
    out = []
    for thing in objects:
        row, col = grid.cell_of(thing.box.centre[0], thing.box.centre[1])
        room = None
        if 0 <= row < h and 0 <= col < w and distance[row, col] * grid.resolution <= _REACH:
            r, c = nearest[:, row, col]
            room = rooms.rooms[rooms.label[r, c]].id
        out.append(SceneObject(id=thing.id, category=thing.category, box=thing.box, room=room))
    return tuple(out)


def room_at(rooms: tuple[SceneRoom, ...], x: float, y: float) -> str | None:
    """The id of the first room whose polygon holds a point [m] (even–odd rule), or None."""
    for room in rooms:
        p = np.asarray(room.polygon, np.float64)
        q = np.roll(p, -1, axis=0)
        spans = (p[:, 1] > y) != (q[:, 1] > y)
        rise = np.where(spans, q[:, 1] - p[:, 1], 1.0)
        crossing = p[:, 0] + (y - p[:, 1]) / rise * (q[:, 0] - p[:, 0])
        if np.count_nonzero(spans & (x < crossing)) % 2:
            return room.id
    return None


def guess_room_type(categories: list[str], area: float | None = None) -> str:
    """The room type that its furniture speaks for; "room" when nothing does, or not clearly.

    A name is given only when the mix speaks for one type before all others, and when the room is
    of a size that such rooms have, with enough of its furniture for that size: a sofa in a hall
    makes no living room of it.

    Args:
        categories: categories of the things in the room, one entry per thing.
        area: area of the room's floor [m²]; None when unknown.
    """
    scores = {
        kind: sum(weights.get(category, 0.0) for category in sorted(set(categories)))
        for kind, weights in _TYPES.items()
    }
    best, second = sorted(scores, key=lambda kind: -scores[kind])[:2]
    if scores[best] < _SPEAKS or scores[best] < _CLEAR * scores[second]:
        return "room"
    if area is not None:
        low, high = _AREAS[best]
        speaking = sum(category in _TYPES[best] for category in categories)
        if not low <= area <= high or area > _AREA_PER_THING * speaking:
            return "room"
    return best


def polygon_area(polygon: Sequence[tuple[float, float]]) -> float:
    """Area [m²] inside a ring of corners [m]."""
    x, y = np.asarray(polygon, np.float64).T
    return abs(float(np.dot(x, np.roll(y, -1)) - np.dot(y, np.roll(x, -1)))) / 2


def _with_types(
    rooms: tuple[SceneRoom, ...], objects: tuple[SceneObject, ...]
) -> tuple[SceneRoom, ...]:
    found: dict[str | None, list[str]] = defaultdict(list)
    for thing in objects:
        found[thing.room].append(thing.category)
    return tuple(
        SceneRoom(
            id=room.id,
            type=guess_room_type(found[room.id], polygon_area(room.polygon)),
            polygon=room.polygon,
        )
        for room in rooms
    )


def _portals(wall: NDArray[np.bool_], space: NDArray[np.bool_], size: float) -> NDArray[np.bool_]:
    """Cells in gaps that are clearly narrower than the space before and behind them.

    A gap between two wall ends may be of any width; one between a wall end and a wall that runs
    past it is a portal only up to `_SIDE_WIDTH`, else every stub of a wall would cut its room.
    """
    # walls that end opposite each other are rarely in line to the centimetre
    thick = ndimage.binary_dilation(wall, iterations=max(1, round(_OFFSET / size)))
    open_ = space & ~thick
    two_sided = _gaps(open_, thick, size, two_sided=True)
    one_sided = _gaps(open_ & ~two_sided, thick | two_sided, size, two_sided=False)
    return two_sided | one_sided | (space & thick & ~wall)


def _gaps(
    open_: NDArray[np.bool_], wall: NDArray[np.bool_], size: float, *, two_sided: bool
) -> NDArray[np.bool_]:
    step = max(1, round(_WALL / size))
    found = np.zeros_like(open_)
    for turned in (False, True):
        free, solid = (open_.T, wall.T) if turned else (open_, wall)
        start, end = _runs(free, solid)
        width = end - start
        gap = free & (width > 0)
        for shift in (step, -step):  # what lies before, and what behind
            other_start, other_end = (np.roll(edge, shift, axis=0) for edge in (start, end))
            edge_rows = slice(None, step) if shift > 0 else slice(-step, None)
            other_start[edge_rows] = other_end[edge_rows] = 0
            gap &= width < _NARROW * (other_end - other_start)
            if two_sided:
                gap &= (other_start < start - 2) & (other_end > end + 2)
        if not two_sided:
            gap &= width * size <= _SIDE_WIDTH
        found |= gap.T if turned else gap
    return found


def _runs(
    free: NDArray[np.bool_], solid: NDArray[np.bool_]
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Per cell the start and end of its row's free run; 0, 0 unless walls end it on both sides."""
    start = np.zeros(free.shape, np.int64)
    end = np.zeros(free.shape, np.int64)
    change = np.diff(np.pad(free, ((0, 0), (1, 1))).astype(np.int8), axis=1)
    rows, starts = np.nonzero(change == 1)
    _, ends = np.nonzero(change == -1)
    w = free.shape[1]
    for row, a, b in zip(rows.tolist(), starts.tolist(), ends.tolist(), strict=True):
        if a > 0 and b < w and solid[row, a - 1] and solid[row, b]:
            start[row, a:b] = a
            end[row, a:b] = b
    return start, end


def _grow(seeds: NDArray[np.integer], space: NDArray[np.bool_]) -> NDArray[np.int64]:
    """Let every seed take the cells nearest to it, going through free cells only."""
    label = np.where(space, seeds, 0).astype(np.int64)
    cross = ndimage.generate_binary_structure(2, 1)
    while True:
        spread = ndimage.grey_dilation(label, footprint=cross)
        fresh = space & (label == 0) & (spread > 0)
        if not fresh.any():
            return label
        label[fresh] = spread[fresh]


def _merge_small(label: NDArray[np.int64], count: int, size: float) -> NDArray[np.int64]:
    """Join patches below `ROOM_AREA` to the neighbour with the longest common border."""
    while True:
        area = np.bincount(label.ravel(), minlength=count + 1) * size**2
        area[0] = np.inf
        small = [i for i in np.argsort(area, kind="stable") if 0 < area[i] < ROOM_AREA]
        merged = False
        for value in small:
            ring = ndimage.binary_dilation(label == value) & (label != value) & (label > 0)
            if ring.any():
                label[label == value] = int(np.argmax(np.bincount(label[ring])))
                merged = True
                break
        if not merged:
            return label


def trace_outline(mask: NDArray[np.bool_], grid: OccupancyGrid) -> tuple[tuple[float, float], ...]:
    """The outer outline [m] of a patch of cells, counter-clockwise, simplified to one cell."""
    parts, count = ndimage.label(mask)
    if count > 1:
        mask = parts == int(np.argmax(np.bincount(parts.ravel())[1:])) + 1
    mask = np.pad(ndimage.binary_fill_holes(mask), 1)
    # directed edges with the patch on their left, from corner to corner
    steps: dict[tuple[int, int], list[tuple[int, int]]] = defaultdict(list)
    for (dr, dc), (ar, ac), (br, bc) in (
        ((-1, 0), (0, 0), (0, 1)),
        ((0, 1), (0, 1), (1, 1)),
        ((1, 0), (1, 1), (1, 0)),
        ((0, -1), (1, 0), (0, 0)),
    ):
        edge = mask & ~np.roll(mask, (-dr, -dc), (0, 1))
        for r, c in np.argwhere(edge).tolist():
            steps[r + ar, c + ac].append((r + br, c + bc))
    start = min(steps)
    ring = [start]
    heading = (0, 1)
    while True:
        here = ring[-1]
        choices = steps[here]
        if len(choices) > 1:  # two corners touch: turn left, so that the ring stays outside
            left = (heading[1], -heading[0])
            choices.sort(key=lambda p: (p[0] - here[0], p[1] - here[1]) != left)
        there = choices.pop(0)
        heading = (there[0] - here[0], there[1] - here[1])
        if there == start:
            break
        ring.append(there)
    corners = np.array(ring, np.float64) - 1
    xy = corners[:, ::-1] * grid.resolution + np.asarray(grid.origin)
    return tuple(
        (round(float(x), 3), round(float(y), 3)) for x, y in _simplify(xy, grid.resolution)
    )


def _simplify(ring: NDArray[np.float64], tolerance: float) -> NDArray[np.float64]:
    """Douglas–Peucker on a closed ring, cut at its two farthest corners."""
    first = int(np.argmin(ring[:, 0] + ring[:, 1]))
    ring = np.roll(ring, -first, axis=0)
    far = int(np.argmax(((ring - ring[0]) ** 2).sum(axis=1)))
    closed = np.vstack([ring, ring[:1]])
    keep = np.zeros(len(closed), bool)
    keep[[0, far, len(closed) - 1]] = True
    stack = [(0, far), (far, len(closed) - 1)]
    while stack:
        a, b = stack.pop()
        if b - a < 2:
            continue
        chord = closed[b] - closed[a]
        offset = closed[a + 1 : b] - closed[a]
        length = np.hypot(*chord)
        if length > 0:
            away = np.abs(chord[0] * offset[:, 1] - chord[1] * offset[:, 0]) / length
        else:
            away = np.hypot(offset[:, 0], offset[:, 1])
        worst = int(np.argmax(away))
        if away[worst] > tolerance:
            middle = a + 1 + worst
            keep[middle] = True
            stack += [(a, middle), (middle, b)]
    return closed[:-1][keep[:-1]]
