"""Placing furniture in one room: against walls, free-standing, on walls and on surfaces.

Nothing is accepted that would stand in a door, overlap, or narrow the way between two doors.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from scipy import ndimage

from gn0.scenes.procedural.assembly import Item, Placed, Support
from gn0.scenes.procedural.catalogue.clutter.on_table import ON_TABLE, Maker
from gn0.scenes.procedural.palette import Palette
from gn0.scenes.procedural.plan import FloorPlan, Opening, Room
from gn0.scenes.procedural.shell import SIDES, Side, room_sides

CELL = 0.05  # m, raster of the passage check
PASSAGE_RADIUS = 0.33  # half the clear way between the doors of a room [m]
REACH_RADIUS = 0.24  # half the way to the front of a piece of furniture [m]
POCKET = 0.25  # m² of floor that furniture may cut off
LANE = 1.6  # m kept free in an opening as wide as its wall
DOOR_DEPTH = 0.7  # clear depth before a door [m]

Rect = tuple[float, float, float, float]  # x0, y0, x1, y1 [m]


@dataclass(frozen=True)
class Block:
    """Floor covered by a solid up to `height` [m]."""

    rect: Rect
    height: float


def footprint(placed: Placed) -> Rect:
    """Axis-parallel floor rectangle [m] of an item with its parts."""
    low, high = placed.item.full_extent()
    c, s = math.cos(placed.yaw), math.sin(placed.yaw)
    xs = [c * x - s * y + placed.x for x in (low[0], high[0]) for y in (low[1], high[1])]
    ys = [s * x + c * y + placed.y for x in (low[0], high[0]) for y in (low[1], high[1])]
    return (min(xs), min(ys), max(xs), max(ys))


def overlaps(a: Rect, b: Rect, slack: float = 0.0) -> bool:
    """Whether two rectangles share more than an edge, `slack` [m] allowed."""
    return (
        a[0] < b[2] - slack and b[0] < a[2] - slack and a[1] < b[3] - slack and b[1] < a[3] - slack
    )


def draw_between(rng: np.random.Generator, low: float, high: float) -> float:
    """A number from `low` to `high`; `low` where rounding puts the ends the wrong way round.

    In a stretch exactly as wide as what is to stand there they are an ulp apart, either way.
    """
    return float(rng.uniform(low, max(low, high)))


@dataclass
class RoomLayout:
    """The state of furnishing one room."""

    plan: FloorPlan
    room: Room
    rng: np.random.Generator
    palette: Palette
    placed: list[Placed] = field(default_factory=list)
    blocks: list[Block] = field(default_factory=list)
    keep: list[Rect] = field(default_factory=list)
    targets: list[tuple[float, float]] = field(default_factory=list)
    reach: list[tuple[float, float]] = field(default_factory=list)
    hung: dict[str, list[Rect]] = field(default_factory=dict)

    def __post_init__(self) -> None:
        self.sides: dict[str, Side] = room_sides(self.plan, self.room)
        self.hung = {name: [] for name in SIDES}
        for side in self.sides.values():
            for a, b, bottom, _, opening in side.openings:
                if bottom > 0:
                    continue
                low, high = a - 0.05, b + 0.05
                if opening.kind == "open":  # a lane through it will do
                    low, high = max((a + b - LANE) / 2, low), min((a + b + LANE) / 2, high)
                self.keep.append(self.strip(side, low, high, DOOR_DEPTH))
                if opening.kind != "entrance" or not self.targets:
                    x, y = side.point((a + b) / 2, 0.4)
                    self.targets.append((x, y))
                if opening.leaf == self.room.id:
                    span = self._leaf_span(side, a, b, opening)
                    rect = self.strip(side, *span, 0.15)
                    self.blocks.append(Block(rect, 2.05))
                    self.hung[side.name].append((span[0], 0.0, span[1], 2.1))

    def _leaf_span(self, side: Side, a: float, b: float, opening: Opening) -> tuple[float, float]:
        """Where along the wall the open leaf lies."""
        forward = side.along[0] + side.along[1] > 0
        before = (opening.hinge == "low") == forward
        return (a - (b - a) - 0.05, a) if before else (b, b + (b - a) + 0.05)

    def strip(self, side: Side, a: float, b: float, depth: float, off: float = 0.0) -> Rect:
        """Floor rectangle along a wall from a to b, from `off` to `depth` [m] into the room."""
        p, q = side.point(a, off), side.point(b, depth)
        return (min(p[0], q[0]), min(p[1], q[1]), max(p[0], q[0]), max(p[1], q[1]))

    def is_clear(self, rect: Rect, *, ignore_keep: bool = False, margin: float = 0.0) -> bool:
        """Whether a rectangle lies in the room and touches no block and no door zone."""
        r = self.room
        e = 1e-6
        if rect[0] < r.x0 - e or rect[1] < r.y0 - e or rect[2] > r.x1 + e or rect[3] > r.y1 + e:
            return False
        grown = (rect[0] - margin, rect[1] - margin, rect[2] + margin, rect[3] + margin)
        if any(overlaps(grown, b.rect, 1e-4) for b in self.blocks):
            return False
        return ignore_keep or not any(overlaps(rect, k, 1e-4) for k in self.keep)

    def is_passable(
        self, rects: Iterable[Rect] = (), reach: Iterable[tuple[float, float]] = ()
    ) -> bool:
        """Whether all doors, and the fronts of furniture, stay connected with `rects` added."""
        r = self.room
        w, h = int(np.ceil(r.width / CELL)), int(np.ceil(r.depth / CELL))
        free = np.zeros((h + 2, w + 2), bool)
        free[1:-1, 1:-1] = True
        for x0, y0, x1, y1 in [*(b.rect for b in self.blocks), *rects]:
            i0, i1 = int(np.floor((y0 - r.y0) / CELL)) + 1, int(np.ceil((y1 - r.y0) / CELL)) + 1
            j0, j1 = int(np.floor((x0 - r.x0) / CELL)) + 1, int(np.ceil((x1 - r.x0) / CELL)) + 1
            free[max(i0, 0) : max(i1, 0), max(j0, 0) : max(j1, 0)] = False
        distance = ndimage.distance_transform_edt(free) * CELL
        for radius, points in (
            (PASSAGE_RADIUS, self.targets),
            (REACH_RADIUS, [*self.targets[:1], *self.reach, *reach]),
        ):
            label, _ = ndimage.label(distance > radius)
            seen = set()
            for x, y in points:
                i, j = int((y - r.y0) / CELL) + 1, int((x - r.x0) / CELL) + 1
                near = label[max(i - 3, 0) : i + 4, max(j - 3, 0) : j + 4]
                values = near[near > 0]
                if values.size == 0:
                    return False
                seen.add(int(np.bincount(values).argmax()))
            if len(seen) > 1:
                return False
            sizes = np.bincount(label.ravel())[1:] * CELL**2
            if radius == REACH_RADIUS and (np.sort(sizes)[:-1] > POCKET).any():
                return False
        return True

    def add(self, placed: Placed, *, solid: bool = True, height: float | None = None) -> Placed:
        """Record an item; solid ones block the floor."""
        self.placed.append(placed)
        if solid:
            high = placed.item.full_extent()[1][2] + placed.z if height is None else height
            self.blocks.append(Block(footprint(placed), float(high)))
        return placed

    def intervals(
        self, side: Side, depth: float, height: float, *, casing: float = 0.08
    ) -> list[tuple[float, float]]:
        """Free stretches of a wall for something `depth` deep and `height` high."""
        cuts = [
            (a - casing, b + casing)
            for a, b, bottom, _, _ in side.openings
            if bottom <= 0 or bottom - 0.03 < height
        ]
        strip = self.strip(side, 0.0, side.length, depth)
        for rect in [*(b.rect for b in self.blocks), *self.keep]:
            if overlaps(rect, strip, 1e-6):
                ts = [
                    (x - side.start[0]) * side.along[0] + (y - side.start[1]) * side.along[1]
                    for x in (rect[0], rect[2])
                    for y in (rect[1], rect[3])
                ]
                cuts.append((min(ts), max(ts)))
        out, start = [], 0.0
        for a, b in [*sorted(cuts), (side.length, side.length)]:
            if a - start > 0.05:
                out.append((start, a))
            start = max(start, b)
        return out

    def against_wall(self, side: Side, item: Item, t: float, gap: float = 0.02) -> Placed:
        """The item with its back to a wall, its middle at `t` [m] along it."""
        low, high = item.full_extent()
        x, y = side.point(t + float(low[0] + high[0]) / 2, gap + float(high[1]))
        return Placed(item, x, y, 0.0, side.yaw)

    def place_on_wall(
        self,
        item: Item,
        *,
        sides: Sequence[str] = SIDES,
        prefer: str = "any",
        gap: float = 0.02,
        front: float = 0.0,
        margin: float = 0.02,
        reach: bool = True,
    ) -> Placed | None:
        """Stand an item against a wall where it fits; None when it fits nowhere.

        Args:
            item: front towards −y.
            sides: walls to try, in random order.
            prefer: "corner", "centre" or "any" place in a free stretch.
            gap: distance to the wall [m].
            front: clear depth wanted before it [m].
            margin: clear width wanted beside it [m].
            reach: whether one must be able to walk up to its front.
        """
        low, high = item.full_extent()
        width, depth = float(high[0] - low[0]), float(high[1] - low[1])
        options = []
        for name in self.rng.permutation(list(sides)):
            side = self.sides[str(name)]
            for a, b in self.intervals(side, depth + gap, float(high[2])):
                room = b - a - width - 2 * margin
                if room < 0:
                    continue
                ends = [a + margin + width / 2, b - margin - width / 2]
                middle = (a + b) / 2
                spot = {
                    "corner": ends,
                    "centre": [middle],
                    "any": [draw_between(self.rng, *ends), *ends, middle],
                }[prefer]
                options += [(side, t) for t in self.rng.permutation(spot)]
        if prefer == "any":
            options = [options[k] for k in self.rng.permutation(len(options))]
        for side, t in options:
            placed = self.against_wall(side, item, float(t), gap)
            rect = footprint(placed)
            if not self.is_clear(rect):
                continue
            if front and not self._front_clear(side, float(t), width, depth + gap, front):
                continue
            spot_xy = side.point(float(t), depth + gap + 0.32)
            if self.is_passable([rect], [spot_xy] if reach else []):
                if reach:
                    self.reach.append(spot_xy)
                return self.add(placed)
        return None

    def _front_clear(self, side: Side, t: float, width: float, depth: float, front: float) -> bool:
        rect = self.strip(side, t - width / 2, t + width / 2, depth + front, depth)
        return self.is_clear(rect, ignore_keep=True)

    def place_free(self, rects_of: Sequence[tuple[Placed, bool]], clear: Rect) -> bool:
        """Place a ready group if its own rectangles and the wider `clear` are free and passable."""
        if not self.is_clear(clear):
            return False
        solid = [footprint(p) for p, is_solid in rects_of if is_solid]
        if not all(self.is_clear(r) for r in solid) or not self.is_passable(solid):
            return False
        for placed, is_solid in rects_of:
            self.add(placed, solid=is_solid)
        return True

    def hang(self, side: Side, item: Item, t: float, z: float, gap: float = 0.004) -> Placed | None:
        """Hang an item (its back at its largest y) on a wall with its origin at height z."""
        low, high = item.full_extent()
        back = float(high[1])
        item = replace(item, shapes=tuple(s.without_back(back) for s in item.shapes))
        item = replace(item, shapes=tuple(s for s in item.shapes if len(s.faces)))
        half = float(high[0] - low[0]) / 2
        z0, z1 = z + float(low[2]), z + float(high[2])
        rect = (t - half, z0, t + half, z1)
        if t - half < 0.03 or t + half > side.length - 0.03 or z1 > self.plan.ceiling - 0.03:
            return None
        for a, b, bottom, top, _ in side.openings:
            if overlaps(rect, (a - 0.08, bottom - 0.05, b + 0.08, top + 0.08)):
                return None
        if any(overlaps(rect, other) for other in self.hung[side.name]):
            return None
        strip = self.strip(side, t - half, t + half, 0.12)
        if any(overlaps(b.rect, strip) and b.height > z0 - 0.02 for b in self.blocks):
            return None
        x, y = side.point(t + float(low[0] + high[0]) / 2, gap + float(high[1]))
        placed = Placed(item, x, y, z, side.yaw)
        self.hung[side.name].append(
            (rect[0] - 0.06, rect[1] - 0.06, rect[2] + 0.06, rect[3] + 0.06)
        )
        self.placed.append(placed)
        return placed

    def wall_gaps(self, side: Side, z0: float, z1: float) -> list[tuple[float, float]]:
        """Stretches of bare wall between the heights z0 and z1, longest first."""
        cuts = [
            (a - 0.1, b + 0.1) for a, b, bottom, top, _ in side.openings if bottom < z1 and top > z0
        ]
        cuts += [(r[0], r[2]) for r in self.hung[side.name] if r[1] < z1 and r[3] > z0]
        strip = self.strip(side, 0.0, side.length, 0.12)
        for block in self.blocks:
            if block.height > z0 and overlaps(block.rect, strip):
                ts = [
                    (x - side.start[0]) * side.along[0] + (y - side.start[1]) * side.along[1]
                    for x in (block.rect[0], block.rect[2])
                    for y in (block.rect[1], block.rect[3])
                ]
                cuts.append((min(ts), max(ts)))
        out, start = [], 0.0
        for a, b in [*sorted(cuts), (side.length, side.length)]:
            if a - start > 0.3:
                out.append((start, a))
            start = max(start, b)
        return sorted(out, key=lambda g: g[0] - g[1])

    def hang_group(self, side: Side, group: Sequence[Placed], t: float, z: float) -> int:
        """Hang several items around (t, z); returns how many found place."""
        done = 0
        for member in group:
            if self.hang(side, member.item, t - member.x, z + member.z) is not None:
                done += 1
        return done


def dress(
    item: Item,
    kind: str,
    rng: np.random.Generator,
    palette: Palette,
    *,
    count: int,
    first: Sequence[Item] = (),
    turn: float = 0.3,
) -> Item:
    """The item with small things on its supports.

    Args:
        item: with supports.
        kind: of `ON_TABLE`.
        rng: random stream.
        palette: of the flat.
        count: how many to try.
        first: things that must come first, e.g. a lamp.
        turn: largest random yaw [rad].
    """
    makers = ON_TABLE[kind]
    weights = np.array([w for _, w in makers])
    used: list[tuple[float, Rect]] = []
    parts: list[Placed] = []
    queue: list[Item | Maker] = list(first)
    queue += [makers[int(k)][0] for k in rng.choice(len(makers), count, p=weights / weights.sum())]
    for entry in queue:
        thing = entry if isinstance(entry, Item) else entry(rng, palette)
        spot = _spot_on(item.supports, thing, used, rng)
        if spot is None:
            continue
        support, x, y = spot
        low, high = thing.full_extent()
        used.append((support.z, (x + low[0], y + low[1], x + high[0], y + high[1])))
        parts.append(Placed(thing, x, y, support.z, float(rng.uniform(-turn, turn))))
    return item.with_parts(parts)


def _spot_on(
    supports: Sequence[Support],
    thing: Item,
    used: Sequence[tuple[float, Rect]],
    rng: np.random.Generator,
) -> tuple[Support, float, float] | None:
    """A free place for a thing on one of the supports."""
    if not supports:
        return None
    low, high = thing.full_extent()
    areas = np.array([max((s.x1 - s.x0) * (s.y1 - s.y0), 1e-4) for s in supports])
    slack = 0.05  # things may reach a little over a support's rectangle, which is inset
    for _ in range(14):
        support = supports[int(rng.choice(len(supports), p=areas / areas.sum()))]
        if high[2] > support.head:
            continue
        x0, x1 = support.x0 - slack - low[0], support.x1 + slack - high[0]
        y0, y1 = support.y0 - slack - low[1], support.y1 + slack - high[1]
        if x1 < x0 or y1 < y0:
            continue
        x, y = float(rng.uniform(x0, x1)), float(rng.uniform(y0, y1))
        rect = (x + low[0], y + low[1], x + high[0], y + high[1])
        if not any(z == support.z and overlaps(rect, other) for z, other in used):
            return support, x, y
    return None
