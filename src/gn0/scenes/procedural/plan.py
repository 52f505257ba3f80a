"""Floor plans: rooms as rectangles, walls between them, doors of a connected graph, windows."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from gn0.seeds import random_stream

INNER_WALL = 0.12  # m
OUTER_WALL = 0.24
DOOR_HEIGHT = 2.05
OPEN_SHARE = 0.94  # of the wall between two day rooms of an open plan that is not there
SIZES = {"small": (46.0, 62.0), "medium": (62.0, 95.0), "large": (95.0, 135.0)}  # m² of floor


@dataclass(frozen=True)
class Room:
    """A room: its clear rectangle between wall faces [m]."""

    id: str
    type: str
    x0: float
    y0: float
    x1: float
    y1: float

    @property
    def width(self) -> float:
        """Extent along x [m]."""
        return self.x1 - self.x0

    @property
    def depth(self) -> float:
        """Extent along y [m]."""
        return self.y1 - self.y0

    @property
    def area(self) -> float:
        """Clear floor area [m²]."""
        return self.width * self.depth

    def contains(self, x: float, y: float, margin: float = 0.0) -> bool:
        """Whether (x, y) lies inside, at least `margin` from the walls."""
        return (
            self.x0 + margin <= x <= self.x1 - margin and self.y0 + margin <= y <= self.y1 - margin
        )


@dataclass(frozen=True)
class Opening:
    """A door, open passage or window in an axis-parallel wall.

    Attributes:
        kind: "door", "passage", "open" (most of a wall; furniture may stand there), "entrance" or
            "window".
        axis: "x" when the wall runs along x (normal ±y), "y" when it runs along y.
        at: position of the wall's centre line on the other axis [m].
        low, high: extent along the wall [m].
        bottom, top: extent in height [m].
        thickness: of the wall [m].
        rooms: ids of the rooms on the lower and the upper side; None outdoors.
        leaf: id of the room into which an open door leaf is folded against the wall; None without.
        hinge: "low" or "high" end of the opening.
    """

    kind: str
    axis: str
    at: float
    low: float
    high: float
    bottom: float
    top: float
    thickness: float
    rooms: tuple[str | None, str | None]
    leaf: str | None = None
    hinge: str = "low"

    @property
    def width(self) -> float:
        """Clear width [m]."""
        return self.high - self.low

    @property
    def centre(self) -> tuple[float, float]:
        """Centre on the floor (x, y) [m]."""
        middle = (self.low + self.high) / 2
        return (middle, self.at) if self.axis == "x" else (self.at, middle)


@dataclass(frozen=True)
class Wall:
    """A wall between two rooms or to the outside; `rooms` on its lower and upper side."""

    axis: str
    at: float
    low: float
    high: float
    thickness: float
    rooms: tuple[str | None, str | None]


@dataclass(frozen=True)
class FloorPlan:
    """Rooms, walls and openings of a flat; ceiling height [m]."""

    rooms: tuple[Room, ...]
    walls: tuple[Wall, ...]
    openings: tuple[Opening, ...]
    ceiling: float

    def room(self, id: str) -> Room:
        """The room of that id."""
        return next(room for room in self.rooms if room.id == id)

    @property
    def area(self) -> float:
        """Clear floor area of all rooms [m²]."""
        return sum(room.area for room in self.rooms)


OPEN_PAIRS = ({"kitchen", "living room"}, {"living room", "hallway"})
Cell = tuple[str, float, float, float, float]  # type, x0, y0, x1, y1 on wall centre lines [m]


def _split(
    rng: np.random.Generator, total: float, types: list[str], widths: dict[str, float]
) -> list[float]:
    """Share `total` metres among rooms in proportion to their usual widths, varied."""
    raw = np.array([widths[t] * rng.uniform(0.9, 1.1) for t in types])
    return [round(float(v), 2) for v in np.cumsum(raw / raw.sum() * total)]


def plan_apartment(seed: int, size: str = "medium", *, open_plan: bool = False) -> FloorPlan:
    """A floor plan of four to eight rooms.

    A day block (living room, kitchen) lies across the end of a hall; bedrooms, bath and study
    line the hall. The plan is mirrored and turned at random.

    Args:
        seed: of all choices.
        size: "small", "medium" or "large": 46–62, 62–95, 95–135 m².
        open_plan: next to nothing is left of the walls between kitchen, living room and hall.
    """
    low, high = SIZES[size]
    for attempt in range(60):
        plan = _draw_plan(random_stream(seed, "plan", size, attempt), size, open_plan)
        if plan is not None and low <= plan.area <= high:
            return plan
    return plan if plan is not None else _draw_plan(random_stream(0, "plan"), "medium", open_plan)  # type: ignore[return-value]


def _draw_plan(rng: np.random.Generator, size: str, open_plan: bool = False) -> FloorPlan | None:
    widths = {"bedroom": 3.5, "bathroom": 2.15, "study": 2.8, "kitchen": 3.2, "storage": 1.7}
    if size == "small":
        north, south = ["bathroom", "bedroom"], list[str]()
        if rng.random() < 0.5:
            north = ["bedroom", "bathroom"]
    elif size == "medium":
        options = [
            (["bathroom", "bedroom"], ["bedroom", "study"]),
            (["bedroom", "bathroom"], ["kitchen", "bedroom"]),
            (["bathroom", "bedroom"], ["kitchen", "bedroom"]),
            (["bathroom", "study"], ["bedroom"]),
            (["bedroom", "bathroom"], ["bedroom"]),
        ]
        north, south = options[int(rng.integers(len(options)))]
    else:
        options = [
            (["bathroom", "bedroom", "bedroom"], ["kitchen", "study", "bedroom"]),
            (["bedroom", "bathroom", "bedroom"], ["bedroom", "study"]),
            (["bathroom", "bedroom", "bathroom"], ["bedroom", "bedroom"]),
            (["kitchen", "bathroom", "bedroom"], ["study", "bedroom", "bedroom"]),
        ]
        north, south = options[int(rng.integers(len(options)))]
    hall = rng.uniform(1.45, 1.85)
    deep_n = rng.uniform(3.1, 3.9)
    deep_s = rng.uniform(3.2, 4.1) if south else 0.0
    length = max(
        sum(widths[t] for t in north), sum(widths[t] for t in south) if south else 0.0
    ) * rng.uniform(0.97, 1.08)
    block = rng.uniform(4.3, 5.6) if size != "large" else rng.uniform(5.0, 6.2)
    total = deep_s + hall + deep_n
    cells: list[Cell] = []
    kitchen_in_block = "kitchen" not in north + south
    if size == "small":
        block = rng.uniform(4.4, 5.4)
        total = hall + deep_n
    # x: 0..block is the day block, block..block+length the private part
    if kitchen_in_block:
        deep_k = float(np.clip(total * rng.uniform(0.36, 0.42), 2.5, 3.6))
        if size == "small":
            # kitchen beside the living room rather than above it: the strip is shallow
            wide_k = rng.uniform(2.4, 2.9)
            deep_k = deep_n
            cells.append(("living room", 0.0, 0.0, block, total))
            cells.append(("kitchen", block, hall, block + wide_k, total))
            left = block + wide_k
        else:
            upper = rng.random() < 0.5
            y = total - deep_k if upper else deep_k
            cells.append(("living room", 0.0, 0.0 if upper else y, block, y if upper else total))
            cells.append(("kitchen", 0.0, y if upper else 0.0, block, total if upper else y))
            left = block
    else:
        cells.append(("living room", 0.0, 0.0, block, total))
        left = block
    end = left + length
    cells.append(("hallway", block, deep_s, end, deep_s + hall))
    for names, y0, y1 in ((north, deep_s + hall, total), (south, 0.0, deep_s)):
        x = left
        for name, stop in zip(names, _split(rng, length, names, widths), strict=True):
            cells.append((name, x, y0, left + stop, y1))
            x = left + stop
    mirror_x, mirror_y, turn = rng.random(3) < 0.5
    placed = []
    for name, x0, y0, x1, y1 in cells:
        if mirror_x:
            x0, x1 = end - x1, end - x0
        if mirror_y:
            y0, y1 = total - y1, total - y0
        if turn:
            x0, y0, x1, y1 = y0, x0, y1, x1
        placed.append((name, round(x0, 3), round(y0, 3), round(x1, 3), round(y1, 3)))
    return _close_plan(rng, placed, open_plan)


def _close_plan(rng: np.random.Generator, cells: list[Cell], open_plan: bool) -> FloorPlan | None:
    """Walls, doors and windows of rooms given on wall centre lines."""
    order = [
        *("living room", "kitchen", "hallway", "bedroom", "bathroom", "study", "storage"),
    ]
    cells = sorted(cells, key=lambda c: (order.index(c[0]), c[1], c[2]))
    counts: dict[str, int] = {}
    ids = []
    for name, *_ in cells:
        counts[name] = counts.get(name, 0) + 1
        ids.append(f"{name.replace(' ', '_')}_{counts[name]}")
    walls = build_walls(cells, ids)
    rooms = [clear_room(cell, id, walls) for cell, id in zip(cells, ids, strict=True)]
    if min(min(r.width, r.depth) for r in rooms) < 1.25:
        return None
    plan = FloorPlan(tuple(rooms), tuple(walls), (), round(float(rng.uniform(2.5, 2.75)), 2))
    doors = _cut_doors(rng, plan, open_plan)
    if doors is None:
        return None
    windows = _cut_windows(rng, plan)
    return fit_openings(plan, (*doors, *windows))


def fit_openings(plan: FloorPlan, openings: Sequence[Opening]) -> FloorPlan:
    """The plan with openings as deep as its walls; a leaf that would bar another door is gone."""
    fitted = tuple(fit_opening(plan, opening) for opening in openings)
    return replace(
        plan, openings=tuple(replace(o, leaf=None) if _bars(o, fitted) else o for o in fitted)
    )


def _bars(opening: Opening, others: Sequence[Opening]) -> bool:
    """Whether the open leaf lies across another way out of the room that it lies in."""
    if opening.leaf is None:
        return False
    low, high = opening.low - opening.width, opening.low
    if opening.hinge == "high":
        low, high = opening.high, opening.high + opening.width
    return any(
        other is not opening
        and other.kind != "window"
        and opening.leaf in other.rooms
        and other.axis == opening.axis
        and abs(other.at - opening.at) < opening.thickness
        and other.low < high
        and low < other.high
        for other in others
    )


def fit_opening(plan: FloorPlan, opening: Opening) -> Opening:
    """The opening reaching exactly from one wall face to the other (walls differ in thickness)."""
    outer = opening.thickness / 2
    low, high = opening.at - outer, opening.at + outer
    if opening.rooms[0] is not None:
        room = plan.room(opening.rooms[0])
        low = room.y1 if opening.axis == "x" else room.x1
    if opening.rooms[1] is not None:
        room = plan.room(opening.rooms[1])
        high = room.y0 if opening.axis == "x" else room.x0
    return replace(opening, at=(low + high) / 2, thickness=high - low)


def build_walls(cells: list[Cell], ids: list[str]) -> list[Wall]:
    """Maximal wall pieces between one pair of neighbours (or a room and the outside)."""
    walls = []
    for axis in ("x", "y"):
        spans = [
            (x0, x1, y0, y1) if axis == "x" else (y0, y1, x0, x1) for _, x0, y0, x1, y1 in cells
        ]
        lines = sorted({v for span in spans for v in span[2:]})
        for at in lines:
            cuts = sorted({v for span in spans for v in span[:2]})
            pieces: list[Wall] = []
            for low, high in pairwise(cuts):
                middle = (low + high) / 2
                sides: list[str | None] = [None, None]
                for (a0, a1, b0, b1), id in zip(spans, ids, strict=True):
                    if a0 < middle < a1:
                        if abs(b1 - at) < 1e-6:
                            sides[0] = id
                        if abs(b0 - at) < 1e-6:
                            sides[1] = id
                if sides == [None, None]:
                    continue
                thick = OUTER_WALL if None in sides else INNER_WALL
                pair = (sides[0], sides[1])
                if pieces and pieces[-1].rooms == pair and abs(pieces[-1].high - low) < 1e-6:
                    pieces[-1] = replace(pieces[-1], high=high)
                else:
                    pieces.append(Wall(axis, at, low, high, thick, pair))
            walls += pieces
    return walls


def clear_room(cell: Cell, id: str, walls: Sequence[Wall]) -> Room:
    """The rectangle between the faces of the walls round a cell."""
    name, x0, y0, x1, y1 = cell
    inset = []
    for axis, at, low, high in (
        ("y", x0, y0, y1),
        ("x", y0, x0, x1),
        ("y", x1, y0, y1),
        ("x", y1, x0, x1),
    ):
        near = [
            w.thickness / 2
            for w in walls
            if w.axis == axis and abs(w.at - at) < 1e-6 and id in w.rooms
            if min(w.high, high) - max(w.low, low) > 1e-6
        ]
        inset.append(max(near))
    return Room(id, name, x0 + inset[0], y0 + inset[1], x1 - inset[2], y1 - inset[3])


def clear_span(plan: FloorPlan, wall: Wall) -> tuple[float, float]:
    """The part of a wall that is clear of corners in both of its rooms."""
    low, high = wall.low, wall.high
    for id in wall.rooms:
        if id is not None:
            room = plan.room(id)
            a, b = (room.x0, room.x1) if wall.axis == "x" else (room.y0, room.y1)
            low, high = max(low, a), min(high, b)
    return low, high


def _cut_doors(rng: np.random.Generator, plan: FloorPlan, open_plan: bool) -> list[Opening] | None:
    """Doors from the hall to every room that it touches, and from kitchen to living room."""
    types = {room.id: room.type for room in plan.rooms}
    wanted: list[tuple[str, str]] = []
    hall = "hallway_1"
    for wall in plan.walls:
        a, b = wall.rooms
        if a is None or b is None:
            continue
        low, high = clear_span(plan, wall)
        if high - low < 1.25:
            continue
        pair = {types[a], types[b]}
        if hall in (a, b) or pair == {"kitchen", "living room"}:
            wanted.append((a, b))
    reached = {hall}
    grown = True
    while grown:
        grown = False
        for a, b in wanted:
            if (a in reached) != (b in reached):
                reached |= {a, b}
                grown = True
    if reached != set(types):
        return None
    doors = []
    for wall in plan.walls:
        a, b = wall.rooms
        if a is None or b is None or (a, b) not in wanted:
            continue
        low, high = clear_span(plan, wall)
        if high - low < 1.25:
            continue
        door = _cut_door(rng, plan, wall, low, high, {types[a], types[b]})
        if open_plan and {types[a], types[b]} in OPEN_PAIRS:
            door = open_wall(plan, door, low, high)
        doors.append(door)
    entrance = _cut_entrance(rng, plan, hall)
    return None if entrance is None else [*doors, entrance]


def open_wall(plan: FloorPlan, opening: Opening, low: float, high: float) -> Opening:
    """The opening in the place of nearly all of the wall, from low to high [m]."""
    left = (1 - OPEN_SHARE) / 2 * (high - low)
    return replace(
        opening, kind="open", low=round(low + left, 3), high=round(high - left, 3),
        top=round(plan.ceiling - 0.05, 3), leaf=None,
    )  # fmt: skip


def _cut_door(
    rng: np.random.Generator, plan: FloorPlan, wall: Wall, low: float, high: float, pair: set[str]
) -> Opening:
    a, b = wall.rooms
    assert a is not None and b is not None
    open_pair = pair in OPEN_PAIRS
    passage = open_pair and rng.random() < 0.6
    width = float(rng.uniform(0.86, 0.95))
    if passage:
        width = float(np.clip((high - low) * rng.uniform(0.45, 0.6), 0.95, 1.9))
    margin = 0.14
    free = high - low - width - 2 * margin
    # near one end, so that a long wall stays free for furniture
    share = float(rng.uniform(0.0, 0.25)) if rng.random() < 0.5 else float(rng.uniform(0.75, 1.0))
    start = low + margin + max(free, 0.0) * (share if not passage else 0.5)
    start, stop = round(start, 3), round(start + width, 3)
    opening = Opening(
        "passage" if passage else "door",
        wall.axis,
        wall.at,
        start,
        stop,
        0.0,
        DOOR_HEIGHT if not passage else 2.2,
        wall.thickness,
        (a, b),
    )
    if passage or rng.random() < 0.15:
        return opening
    # fold the leaf against the wall of the non-hall room if there is room beside the opening
    into = b if plan.room(a).type in ("hallway", "living room") else a
    room = plan.room(into)
    r0, r1 = (room.x0, room.x1) if wall.axis == "x" else (room.y0, room.y1)
    if start - r0 > width + 0.1:
        return replace(opening, leaf=into, hinge="low")
    if r1 - stop > width + 0.1:
        return replace(opening, leaf=into, hinge="high")
    return opening


def _cut_entrance(rng: np.random.Generator, plan: FloorPlan, hall: str) -> Opening | None:
    """The closed entrance door in an outer wall of the hall, its short end first."""
    walls = [w for w in plan.walls if hall in w.rooms and None in w.rooms]
    spans = [(w, *clear_span(plan, w)) for w in walls]
    spans = [s for s in spans if s[2] - s[1] > 1.15]
    if not spans:
        return None
    wall, low, high = min(spans, key=lambda s: s[2] - s[1])
    start = low + 0.12 + (high - low - 0.24 - 0.92) * float(rng.uniform(0.3, 0.7))
    return Opening(
        "entrance",
        wall.axis,
        wall.at,
        round(start, 3),
        round(start + 0.92, 3),
        0.0,
        DOOR_HEIGHT,
        wall.thickness,
        wall.rooms,
    )


def _cut_windows(rng: np.random.Generator, plan: FloorPlan) -> list[Opening]:
    windows: list[Opening] = []
    for wall in plan.walls:
        inside = next((id for id in wall.rooms if id is not None), None)
        if None not in wall.rooms or inside is None:
            continue
        room = plan.room(inside)
        if room.type in ("hallway", "storage"):
            continue
        low, high = clear_span(plan, wall)
        span = high - low
        if span < 1.2:
            continue
        others = [w for w in windows if inside in w.rooms]
        if others and (room.type != "living room" or rng.random() < 0.4 or len(others) > 1):
            continue
        if room.type == "bathroom":
            width, bottom, top = min(0.8, span - 0.5), 1.35, 2.1
        elif room.type == "kitchen":
            width, bottom, top = min(float(rng.uniform(1.1, 1.5)), span - 0.5), 1.12, 2.15
        else:
            width = min(float(rng.uniform(1.4, 2.1)), span - 0.7)
            bottom, top = float(rng.choice([0.45, 0.8, 0.9])), 2.2
        count = 2 if room.type == "living room" and span > 4.6 else 1
        for k in range(count):
            middle = low + span * (k + 0.5) / count + float(rng.uniform(-0.1, 0.1))
            windows.append(
                Opening(
                    "window",
                    wall.axis,
                    wall.at,
                    round(middle - width / 2, 3),
                    round(middle + width / 2, 3),
                    bottom,
                    top,
                    wall.thickness,
                    wall.rooms,
                )
            )
    return windows
