"""Putting fixtures where builders put them: by doors, along walls, in a grid on the ceiling."""

from __future__ import annotations

import math
from collections.abc import Sequence

from gn0.scenes.procedural.assembly import Item, Placed
from gn0.scenes.procedural.catalogue import fixtures as fix
from gn0.scenes.procedural.layout import RoomLayout
from gn0.scenes.procedural.shell import SIDES


def hang_somewhere(
    layout: RoomLayout, item: Item, z: float, *, sides: Sequence[str] = SIDES, middle: bool = False
) -> Placed | None:
    """Hang an item on some bare stretch of wall; in the middle of the longest when asked."""
    low, high = item.full_extent()
    wide = float(high[0] - low[0])
    gaps = []
    for name in sides:
        side = layout.sides[name]
        for a, b in layout.wall_gaps(side, z + float(low[2]), z + float(high[2])):
            if b - a > wide + 0.1:
                gaps.append((b - a, name, a, b))
    gaps.sort(key=lambda g: (-g[0], g[1]))
    order = range(len(gaps)) if middle else layout.rng.permutation(len(gaps))
    for k in order:
        _, name, a, b = gaps[int(k)]
        room = b - a - wide - 0.08
        t = (a + b) / 2 + (0.0 if middle else float(layout.rng.uniform(-room / 2, room / 2)))
        placed = layout.hang(layout.sides[name], item, t, z)
        if placed is not None:
            return placed
    return None


def hang_by_doors(
    layout: RoomLayout, item: Item, z: float, *, off: float = 0.18, most: int = 1
) -> int:
    """Hang an item beside doors, where a hand looks for it; returns how many found a place."""
    done = 0
    for side in layout.sides.values():
        for a, b, bottom, _, _ in side.openings:
            if bottom > 0 or done >= most:
                continue
            for t in (b + off, a - off):
                if layout.hang(side, item, t, z) is not None:
                    done += 1
                    break
    return done


def hang_over_exits(layout: RoomLayout, item: Item) -> int:
    """Hang an item over each passage and outer door of a room; returns how many."""
    done = 0
    for side in layout.sides.values():
        for a, b, _, top, opening in side.openings:
            z = top + 0.1 + float(item.full_extent()[1][2])
            if opening.kind in ("entrance", "passage"):
                done += layout.hang(side, item, (a + b) / 2, z) is not None
    return done


def fit_fixtures(layout: RoomLayout, *, sockets: int | None = None, detector: bool = True) -> None:
    """A light switch, power sockets, a smoke detector: what every room has.

    Args:
        layout: furnished, so that nothing ends up behind a cupboard.
        sockets: how many; by the length of the walls when None.
        detector: whether there is a smoke detector.
    """
    room = layout.room
    hang_by_doors(layout, fix.build_switch(), 1.1)
    count = max(2, round((room.width + room.depth) / 4.0)) if sockets is None else sockets
    for _ in range(count):
        hang_somewhere(layout, fix.build_socket(bool(layout.rng.random() < 0.6)), 0.3)
    if detector:
        across = max(1, round(max(room.width, room.depth) / 8.0))
        put_in_grid(
            layout, fix.build_smoke_detector(), *_split(room.width, room.depth, across), 0.6
        )


def _split(width: float, depth: float, count: int) -> tuple[int, int]:
    return (count, 1) if width >= depth else (1, count)


def put_in_grid(
    layout: RoomLayout, item: Item, columns: int, rows: int, shift: float = 0.0, yaw: float = 0.0
) -> None:
    """Put copies of an item under the ceiling in a regular grid, `shift` [m] off the middles."""
    room = layout.room
    low, high = item.full_extent()
    half = max(float(high[0] - low[0]), float(high[1] - low[1])) / 2 + 0.03
    for i in range(columns):
        for j in range(rows):
            x = room.x0 + room.width * (i + 0.5) / columns + shift
            y = room.y0 + room.depth * (j + 0.5) / rows + shift
            x = min(max(x, room.x0 + half), room.x1 - half)
            y = min(max(y, room.y0 + half), room.y1 - half)
            layout.placed.append(Placed(item, x, y, layout.plan.ceiling - 0.001, yaw))


def light_grid(
    layout: RoomLayout,
    kelvin: float,
    *,
    pitch: float = 2.6,
    flux: float = 0.62,
    long: bool = False,
) -> None:
    """Panel lamps in a grid over a room.

    Args:
        layout: of the room.
        kelvin: colour of the light [K].
        pitch: about how far apart they are [m].
        flux: of all lamps, a square metre of floor.
        long: strips of 1.2 m instead of squares of 0.6 m.
    """
    room = layout.room
    columns, rows = (max(1, round(v / pitch)) for v in (room.width, room.depth))
    share = flux * room.area / (columns * rows)
    wide, deep = (1.2, 0.3) if long else (0.6, 0.6)
    item = fix.build_panel_lamp(kelvin, share, wide, deep)
    yaw = math.pi / 2 if long and room.depth > room.width else 0.0
    put_in_grid(layout, item, columns, rows, 0.0, yaw)


def stand_extinguisher(layout: RoomLayout) -> None:
    """A fire extinguisher on a wall with its sign over it."""
    placed = layout.place_on_wall(fix.build_extinguisher(), gap=0.005, reach=False, prefer="any")
    if placed is None:
        return
    sign = fix.build_sign("FIRE", 0.16, 0.16, ground="#b3201d")
    for side in layout.sides.values():
        if abs(side.yaw - placed.yaw) < 1e-6:
            t = (placed.x - side.start[0]) * side.along[0]
            t += (placed.y - side.start[1]) * side.along[1]
            layout.hang(side, sign, t, 1.75)
