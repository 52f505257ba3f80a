"""Plans of larger buildings: rectangles on a grid of wall centre lines, closed by rules.

A caller lays out cells and says which pairs are joined by what; walls, clear rectangles and the
places of doors and windows follow.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from gn0.scenes.procedural.plan import (
    DOOR_HEIGHT,
    Cell,
    FloorPlan,
    Opening,
    Room,
    Wall,
    build_walls,
    clear_room,
    clear_span,
    fit_openings,
)

LEAST_DOOR = 1.2  # m of bare wall without which no door is cut
CORNER = 0.14  # m between a door and the corner of a room


@dataclass(frozen=True)
class Joint:
    """How two neighbouring rooms are joined.

    Attributes:
        kind: "door", "passage" (no leaf), "open" (a passage as wide as the wall), or "none".
        width: clear width [m]; a share of the wall when at most 1; None draws a usual door.
        leaf: whether a door has a leaf, folded open against a wall where there is room.
        glazing: height [m] from which the rest of the wall is a window between the rooms.
        top: height of the opening [m].
    """

    kind: str
    width: float | None = None
    leaf: bool = True
    glazing: float | None = None
    top: float = DOOR_HEIGHT


NO_JOINT = Joint("none")
JointRule = Callable[[Room, Room], Joint]  # of two neighbours, asked in both orders
# how many windows a room has in an outer wall that is clear from low to high [m]
WindowRule = Callable[[Room, Wall, float, float], Sequence[tuple[float, float, float, float]]]


def turn_cells(rng: np.random.Generator, cells: Sequence[Cell], *, turn: bool = True) -> list[Cell]:
    """The layout mirrored and turned at random, its lower corner at the origin."""
    flips = rng.random(3) < 0.5
    right, top = max(c[3] for c in cells), max(c[4] for c in cells)
    left, bottom = min(c[1] for c in cells), min(c[2] for c in cells)
    out = []
    for name, x0, y0, x1, y1 in cells:
        x0, x1 = (right - x1, right - x0) if flips[0] else (x0 - left, x1 - left)
        y0, y1 = (top - y1, top - y0) if flips[1] else (y0 - bottom, y1 - bottom)
        if flips[2] and turn:
            x0, y0, x1, y1 = y0, x0, y1, x1
        out.append((name, round(x0, 3), round(y0, 3), round(x1, 3), round(y1, 3)))
    return out


def close_cells(
    rng: np.random.Generator,
    cells: Sequence[Cell],
    *,
    ceiling: float,
    joint: JointRule,
    windows: WindowRule,
    entrance: str,
) -> FloorPlan | None:
    """Walls, doors and windows of cells given on wall centre lines.

    Args:
        rng: random stream.
        cells: rooms; ids number each type in this order.
        ceiling: height [m].
        joint: what joins two neighbours.
        windows: of a room in an outer wall: (low, high, bottom, top) [m] along the wall.
        entrance: type of the room that has the door to the outside.

    Returns:
        None when some room cannot be reached through the joints, or no wall has room for the
        entrance.
    """
    counts: dict[str, int] = {}
    ids = []
    for name, *_ in cells:
        counts[name] = counts.get(name, 0) + 1
        ids.append(f"{name.replace(' ', '_')}_{counts[name]}")
    walls = build_walls(list(cells), ids)
    rooms = tuple(clear_room(cell, id, walls) for cell, id in zip(cells, ids, strict=True))
    plan = FloorPlan(rooms, tuple(walls), (), ceiling)
    openings: list[Opening] = []
    reached = {room.id: {room.id} for room in rooms}
    best: dict[frozenset[str], tuple[float, Wall]] = {}
    for wall in walls:  # two rooms are joined once, at the longest wall between them
        a, b = wall.rooms
        if a is not None and b is not None:
            low, high = clear_span(plan, wall)
            pair = frozenset((a, b))
            if pair not in best or high - low > best[pair][0]:
                best[pair] = (high - low, wall)
    for _, wall in best.values():
        a, b = wall.rooms
        assert a is not None and b is not None
        low, high = clear_span(plan, wall)
        rule = joint(plan.room(a), plan.room(b))
        if rule.kind == "none":
            rule = joint(plan.room(b), plan.room(a))
        if rule.kind == "none" or high - low < min(LEAST_DOOR, (rule.width or 9) + 0.25):
            continue
        door = _cut_joint(rng, plan, wall, low, high, rule)
        openings.append(door)
        if rule.glazing is not None:
            openings += _cut_glazing(wall, door, low, high, rule.glazing)
        both = reached[a] | reached[b]
        for id in both:
            reached[id] = both
    if len(reached[rooms[0].id]) < len(rooms):
        return None
    front = _cut_entrance(rng, plan, entrance)
    if front is None:
        return None
    openings.append(front)
    for wall in walls:
        inside = wall.rooms[0] or wall.rooms[1]
        if None not in wall.rooms or inside is None:
            continue
        low, high = clear_span(plan, wall)
        here = wall.axis == front.axis and wall.at == front.at
        if here and low <= front.low and front.high <= high:
            # windows beside the entrance, on its longer side
            if front.low - low > high - front.high:
                high = front.low - 0.3
            else:
                low = front.high + 0.3
        for a0, a1, bottom, top in windows(plan.room(inside), wall, low, high):
            openings.append(
                Opening(
                    "window", wall.axis, wall.at, round(a0, 3), round(a1, 3), bottom, top,
                    wall.thickness, wall.rooms,
                )
            )  # fmt: skip
    return fit_openings(plan, openings)


def _cut_joint(
    rng: np.random.Generator, plan: FloorPlan, wall: Wall, low: float, high: float, rule: Joint
) -> Opening:
    """A door near one end of the wall, or a passage in its middle."""
    a, b = wall.rooms
    assert a is not None and b is not None
    span = high - low
    width = float(rng.uniform(0.88, 0.98)) if rule.width is None else rule.width
    if rule.width is not None and rule.width <= 1.0:
        width = span * rule.width
    width = min(width, span - 0.2)
    free = max(span - width - 2 * CORNER, 0.0)
    share = float(rng.uniform(0.0, 0.2)) if rng.random() < 0.5 else float(rng.uniform(0.8, 1.0))
    if rule.kind in ("passage", "open"):
        share = 0.5
    start = low + (span - width - free) / 2 + free * share
    start, stop = round(start, 3), round(start + width, 3)
    opening = Opening(
        rule.kind, wall.axis, wall.at, start, stop, 0.0, min(rule.top, plan.ceiling - 0.05),
        wall.thickness, (a, b),
    )  # fmt: skip
    if rule.kind in ("passage", "open") or not rule.leaf:
        return opening
    # the leaf opens into the smaller of the two rooms, against the wall beside the door
    into = min((plan.room(a), plan.room(b)), key=lambda r: r.area)
    r0, r1 = (into.x0, into.x1) if wall.axis == "x" else (into.y0, into.y1)
    if start - r0 > width + 0.1:
        return replace(opening, leaf=into.id, hinge="low")
    if r1 - stop > width + 0.1:
        return replace(opening, leaf=into.id, hinge="high")
    return opening


def _cut_glazing(
    wall: Wall, door: Opening, low: float, high: float, bottom: float
) -> list[Opening]:
    """The window that fills the longer part of the wall beside a door and its open leaf."""
    before, after = door.low - low, high - door.high
    wide = door.width + 0.25 if door.leaf is not None else 0.25
    a, b = (low + 0.25, door.low - wide) if before > after else (door.high + wide, high - 0.25)
    if door.leaf is not None:
        opened = "low" if before > after else "high"
        if door.hinge != opened:  # the leaf lies at the other side
            a, b = (a, door.low - 0.25) if before > after else (door.high + 0.25, b)
    if b - a < 0.8:
        return []
    return [
        Opening(
            "glazing", wall.axis, wall.at, round(a, 3), round(b, 3), bottom, 2.15,
            wall.thickness, wall.rooms,
        )
    ]  # fmt: skip


def _cut_entrance(rng: np.random.Generator, plan: FloorPlan, type: str) -> Opening | None:
    """A closed door to the outside in the longest outer wall of a room of that type."""
    spans = []
    for wall in plan.walls:
        inside = wall.rooms[0] or wall.rooms[1]
        if None in wall.rooms and inside is not None and plan.room(inside).type == type:
            low, high = clear_span(plan, wall)
            if high - low > 1.2:
                spans.append((high - low, wall, low, high))
    if not spans:
        return None
    _, wall, low, high = max(spans, key=lambda s: s[0])
    start = low + 0.2 + (high - low - 0.4 - 0.95) * float(rng.uniform(0.1, 0.3))
    return Opening(
        "entrance", wall.axis, wall.at, round(start, 3), round(start + 0.95, 3), 0.0, DOOR_HEIGHT,
        wall.thickness, wall.rooms,
    )  # fmt: skip


def spread_windows(
    low: float, high: float, *, width: float, bottom: float, top: float, gap: float = 0.5
) -> list[tuple[float, float, float, float]]:
    """As many windows of about `width` as fit a stretch of wall, evenly spaced."""
    span = high - low
    count = int((span - gap) / (width + gap))
    if count < 1:
        width, count = span - 2 * gap, 1
        if width < 0.6:
            return []
    pitch = span / count
    return [
        (low + pitch * (k + 0.5) - width / 2, low + pitch * (k + 0.5) + width / 2, bottom, top)
        for k in range(count)
    ]
