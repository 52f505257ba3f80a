"""Groups of an office: work places, islands of desks, meeting tables, shelves of files."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from gn0.scenes.procedural import furniture_clutter as clutter
from gn0.scenes.procedural import furniture_decor as decor
from gn0.scenes.procedural import furniture_fixtures as fix
from gn0.scenes.procedural import furniture_office as office
from gn0.scenes.procedural import furniture_seats as seats
from gn0.scenes.procedural import furniture_storage as storage
from gn0.scenes.procedural import furniture_tables as tables
from gn0.scenes.procedural.draft import Material
from gn0.scenes.procedural.layout import RoomLayout, dress, footprint
from gn0.scenes.procedural.palette import Palette, plain
from gn0.scenes.procedural.parts import Item, Placed, Support

CHAIR_OUT = 0.62  # m of floor that a drawn-up chair takes behind its desk


@dataclass(frozen=True)
class OfficeTaste:
    """What all work places of one office have in common.

    Attributes:
        top: of desks.
        frame: of desks.
        cloth: of screens between desks.
        front: of drawers and cabinets.
        chair: seed of the chair model.
        width, depth: of a desk [m].
    """

    top: Material
    frame: Material
    cloth: Material
    front: Material
    chair: int
    width: float
    depth: float


def draw_taste(rng: np.random.Generator, palette: Palette) -> OfficeTaste:
    """The furniture line of an office."""
    tops = (
        palette.wood(rng, 0),
        plain("laminate", "plastic", "#e9e7e2", contrast=0.06),
        plain("laminate", "plastic", "#cfcac0", contrast=0.06),
        palette.wood(rng, 1),
    )
    front = plain("steel front", "plastic", str(rng.choice(["#e4e4e2", "#b9bcbf", "#4a4d52"])))
    return OfficeTaste(
        top=tops[int(rng.integers(4))],
        frame=plain("frame", "metal", str(rng.choice(["#e6e6e4", "#2b2d30", "#a9acb0"]))),
        cloth=palette.bright(rng) if rng.random() < 0.4 else palette.cloth(rng),
        front=front,
        chair=int(rng.integers(2**31)),
        width=float(rng.choice([1.4, 1.5, 1.6])),
        depth=float(rng.choice([0.75, 0.8])),
    )


def draw_chair(taste: OfficeTaste, palette: Palette) -> Item:
    """The office's swivel chair."""
    return seats.build_office_chair(np.random.Generator(np.random.Philox(key=taste.chair)), palette)


Maker = Callable[[np.random.Generator, Palette], Item]
# what lies on a desk: how likely, x and y of its middle in halves of the desk, how far it strays
_LOOSE: tuple[tuple[float, float, float, float, Maker], ...] = (
    (0.75, 0.78, 0.55, 0.03, lambda r, p: office.build_phone()),
    (0.8, -0.6, 0.5, 0.05, lambda r, p: office.build_pen_holder(r)),
    (0.75, 0.58, -0.05, 0.05, clutter.build_cup),
    (0.75, -0.62, -0.35, 0.06, lambda r, p: office.build_notebook(r)),
    (0.65, -0.78, 0.1, 0.03, lambda r, p: office.build_papers(r)),
    (0.5, -0.82, 0.62, 0.02, lambda r, p: office.build_tray(r)),
    (0.6, 0.42, 0.62, 0.03, lambda r, p: office.build_sticky_notes(r)),
    (0.45, 0.66, -0.45, 0.05, lambda r, p: office.build_headphones(r)),
    (0.4, -0.45, 0.72, 0.03, lambda r, p: office.build_calendar(r)),
    (0.3, 0.88, 0.05, 0.02, lambda r, p: office.build_tissue_box(r)),
    (0.45, 0.5, 0.3, 0.04, lambda r, p: office.build_flask(r)),
    (0.35, -0.42, 0.35, 0.04, lambda r, p: office.build_stapler(r)),
    (0.35, 0.62, 0.78, 0.02, decor.build_photo),
    (0.3, -0.88, -0.6, 0.03, lambda r, p: storage.build_book_stack(r, int(r.integers(1, 4)))),
    (0.22, 0.86, 0.7, 0.02, lambda r, p: decor.build_plant(r, p, 0.22)),
    (0.25, 0.82, -0.3, 0.03, lambda r, p: clutter.build_glass(r, p)),
)


def build_work_place(rng: np.random.Generator, palette: Palette, taste: OfficeTaste) -> Item:
    """A desk with all that is on and under it, the user towards −y."""
    desk = office.build_work_desk(taste.top, taste.frame, taste.width, taste.depth)
    h, w, d = office.DESK_HEIGHT, taste.width, taste.depth
    parts: list[Placed] = []
    shift = float(rng.uniform(-0.06, 0.06))
    kind = rng.random()
    if kind < 0.5:
        parts.append(Placed(clutter.build_monitor(rng), shift, d * 0.24, h))
    elif kind < 0.85:
        screen = clutter.build_monitor(rng)
        half = screen.size[0] / 2 + 0.01
        for sx in (-1, 1):
            turn = -sx * float(rng.uniform(0.08, 0.2))
            other = clutter.build_monitor(rng) if sx < 0 else screen
            fitted = Item(other.category, tuple(s.stretched(x=0.86) for s in other.shapes))
            parts.append(Placed(fitted, shift + sx * half * 0.86, d * 0.24, h, turn))
    else:
        parts.append(Placed(clutter.build_laptop(rng, palette), shift, 0.0, h))
    if kind < 0.85:
        parts.append(Placed(clutter.build_keyboard(rng), shift, -d * 0.2, h, _stray(rng, 0.05)))
        parts.append(Placed(office.build_mouse_pad(rng), shift + 0.36, -d * 0.2, h))
        parts.append(Placed(clutter.build_mouse(rng), shift + 0.36, -d * 0.19, h + 0.004))
    used = [_reach(p) for p in parts]
    for chance, x, y, stray, maker in _LOOSE:
        if rng.random() > chance:
            continue
        thing = maker(rng, palette)
        at = Placed(
            thing,
            float(x * w / 2 + _stray(rng, stray)),
            float(y * d / 2 + _stray(rng, stray)),
            h,
            _stray(rng, 0.25),
        )
        rect = footprint(at)
        inside = -w / 2 < rect[0] and rect[2] < w / 2 and -d / 2 < rect[1] and rect[3] < d / 2
        if inside and not any(_meet(rect, other) for other in used):
            used.append(rect)
            parts.append(at)
    hand = float(rng.choice([-1, 1]))
    if rng.random() < 0.75:
        parts.append(Placed(office.build_pedestal(taste.front), hand * (w / 2 - 0.3), 0.06))
    if rng.random() < 0.5:
        parts.append(Placed(office.build_tower(), -hand * (w / 2 - 0.2), 0.1))
    elif rng.random() < 0.6:
        parts.append(Placed(clutter.build_bin(rng, palette), -hand * (w / 2 - 0.25), 0.15))
    return desk.with_parts(parts)


def _stray(rng: np.random.Generator, reach: float) -> float:
    return float(rng.uniform(-reach, reach))


def _reach(placed: Placed) -> tuple[float, float, float, float]:
    return footprint(placed)


def _meet(a: tuple[float, ...], b: tuple[float, ...]) -> bool:
    return a[0] < b[2] and b[0] < a[2] and a[1] < b[3] and b[1] < a[3]


def place_islands(layout: RoomLayout, taste: OfficeTaste, *, share: float = 1.0) -> int:
    """Fill a hall with islands of facing desks; returns the number of work places.

    Islands stand across the hall's longer axis, so that light falls in from the side.

    Args:
        layout: of the hall.
        taste: the furniture line.
        share: of the possible islands that are built, from one end; the rest stays open.
    """
    rng, room = layout.rng, layout.room
    along_x = room.width >= room.depth  # islands are spread along x, their rows run along y
    long, deep = (room.width, room.depth) if along_x else (room.depth, room.width)
    low, high = _clear_band(layout, along_x, deep)
    w, d = taste.width, taste.depth
    aisle = float(rng.uniform(0.95, 1.25))
    pitch = 2 * d + 2 * CHAIR_OUT + aisle
    columns = int((long - 1.0) / pitch)
    usable = high - low
    row = max(int(usable / w), 1)
    groups = [row]
    if row >= 5 or (row == 4 and rng.random() < 0.5):
        cross = 1.2  # an aisle through the middle
        row = int((usable - cross) / w)
        groups = [row - row // 2, row // 2]
    start = (long - columns * pitch + aisle) / 2 + CHAIR_OUT + d
    done = 0
    first = bool(rng.random() < 0.5)
    built = max(1, round(columns * share))
    for k in range(columns):
        if (k if first else columns - 1 - k) >= built:
            continue
        at = start + k * pitch
        spare = usable - sum(groups) * w - (1.2 if len(groups) > 1 else 0.0)
        v = low + spare / 2
        for size in groups:
            if size:
                done += _place_island(layout, taste, along_x, at, v, size)
            v += size * w + 1.2
    return done


def _clear_band(layout: RoomLayout, along_x: bool, deep: float) -> tuple[float, float]:
    """The stretch across a hall that is free of doors: lanes stay along walls that have any."""
    names = ("south", "north") if along_x else ("west", "east")
    margin = []
    for name in names:
        doors = sum(o[2] <= 0 for o in layout.sides[name].openings)
        windows = sum(o[4].kind == "window" for o in layout.sides[name].openings)
        margin.append(1.75 if doors else (0.9 if windows else 1.15))
    return margin[0], deep - margin[1]


def _place_island(
    layout: RoomLayout, taste: OfficeTaste, along_x: bool, at: float, v: float, size: int
) -> int:
    """Two rows of `size` desks back to back, centred at `at` along the hall; returns desks."""
    rng, palette, room = layout.rng, layout.palette, layout.room
    chair = draw_chair(taste, palette)
    divider = office.build_divider(taste.cloth, taste.width) if rng.random() < 0.85 else None

    def put(item: Item, u: float, along: float, yaw: float) -> Placed:
        # u across the island, yaw 0 facing −u
        x, y = (room.x0 + u, room.y0 + along) if along_x else (room.x0 + along, room.y0 + u)
        turn = -math.pi / 2 if along_x else 0.0
        return Placed(item, x, y, 0.0, yaw + turn)

    group: list[tuple[Placed, bool]] = []
    for k in range(size):
        along = v + (k + 0.5) * taste.width
        for sign in (-1, 1):
            yaw = 0.0 if sign < 0 else math.pi
            desk = build_work_place(rng, palette, taste)
            group.append((put(desk, at + sign * taste.depth / 2, along, yaw), True))
            if rng.random() < 0.93:
                out = taste.depth + float(rng.uniform(0.16, 0.3))
                turn = float(rng.normal(0.0, 0.35))
                seat = put(chair, at + sign * out, along + _stray(rng, 0.12), yaw + math.pi + turn)
                group.append((seat, True))
        if divider is not None:
            group.append((put(divider, at, along, 0.0), False))
    rects = [footprint(p) for p, solid in group if solid]
    clear = (
        max(min(q[0] for q in rects), room.x0),
        max(min(q[1] for q in rects), room.y0),
        min(max(q[2] for q in rects), room.x1),
        min(max(q[3] for q in rects), room.y1),
    )
    return 2 * size if layout.place_free(group, clear) else 0


def build_file_wall(rng: np.random.Generator, palette: Palette, rows: int = 5) -> Item:
    """A cabinet of files with small things in its gaps."""
    shelf = office.build_file_shelf(rng, palette, float(rng.choice([0.8, 1.0, 1.2])), rows)
    return dress(shelf, "shelf", rng, palette, count=4)


def place_meeting(layout: RoomLayout, *, laptops: float = 0.4) -> bool:
    """A conference table with chairs round it, laid with pads, cups and bottles."""
    rng, palette, room = layout.rng, layout.palette, layout.room
    along_x = room.width >= room.depth
    long, deep = (room.width, room.depth) if along_x else (room.depth, room.width)
    kind, seed = int(rng.choice([1, 2, 5])), int(rng.integers(2**31))
    for shrink in (0.0, 0.4, 0.8, 1.2):
        length = float(np.clip(long - 2.5 - shrink, 1.2, 4.8))
        wide = float(np.clip(deep - 2.3 - shrink / 2, 0.8, 1.35))
        table = office.build_meeting_table(rng, palette, length, wide)
        per_side = max(int((length - 0.1) / 0.75), 1)
        spots = [
            (((k + 0.5) / per_side - 0.5) * (length - 0.2), s * (wide / 2 + 0.16), s)
            for k in range(per_side)
            for s in (-1, 1)
        ]
        yaw = 0.0 if along_x else math.pi / 2
        c, s = math.cos(yaw), math.sin(yaw)
        cx, cy = (room.x0 + room.x1) / 2, (room.y0 + room.y1) / 2
        group: list[tuple[Placed, bool]] = []
        laid: list[Placed] = []
        for x, y, sign in spots:
            model = np.random.Generator(np.random.Philox(key=seed))
            chair = (
                seats.build_office_chair(model, palette)
                if kind == 5
                else seats.build_chair(model, palette, kind)
            )
            turn = (math.pi if sign < 0 else 0.0) + float(rng.normal(0, 0.12))
            px, py = x + _stray(rng, 0.05), y + sign * float(rng.uniform(0.0, 0.1))
            group.append(
                (Placed(chair, cx + c * px - s * py, cy + s * px + c * py, 0.0, yaw + turn), True)
            )
            face = 0.0 if sign < 0 else math.pi
            laid += _lay_seat(rng, palette, x, sign * (wide / 2 - 0.2), face, laptops)
        middle = [clutter.build_bottle(rng, palette) for _ in range(per_side)]
        for k, bottle in enumerate(middle):
            laid.append(Placed(bottle, ((k + 0.5) / per_side - 0.5) * (length - 0.6), 0.09, 0.74))
        group.insert(0, (Placed(table.with_parts(laid), cx, cy, 0.0, yaw), True))
        rects = [footprint(p) for p, _ in group]
        clear = (
            min(q[0] for q in rects),
            min(q[1] for q in rects),
            max(q[2] for q in rects),
            max(q[3] for q in rects),
        )
        if layout.place_free(group, clear):
            return True
    return False


def _lay_seat(
    rng: np.random.Generator, palette: Palette, x: float, y: float, face: float, laptops: float
) -> list[Placed]:
    """What lies before one chair of a meeting."""
    out: list[Placed] = []
    s = 1.0 if face == 0.0 else -1.0
    if rng.random() < laptops:
        out.append(Placed(clutter.build_laptop(rng, palette), x, y + s * 0.03, 0.74, face))
    elif rng.random() < 0.8:
        pad = office.build_notebook(rng) if rng.random() < 0.6 else office.build_papers(rng)
        out.append(Placed(pad, x, y, 0.74, face + _stray(rng, 0.15)))
    if rng.random() < 0.7:
        thing = (
            clutter.build_glass(rng, palette)
            if rng.random() < 0.6
            else clutter.build_cup(rng, palette)
        )
        out.append(Placed(thing, x + s * 0.24, y + s * 0.06, 0.74))
    return out


def build_wall_screen(rng: np.random.Generator, width: float) -> Item:
    """A large screen on the wall, category "tv"; back at y = 0, middle at z = 0."""
    h = width * 0.5625
    tv = tables.build_tv(rng)
    face = next(s.material for s in tv.shapes if s.material.pattern == "screen")
    fields = {f: getattr(face, f) for f in face.__struct_fields__}
    if rng.random() < 0.5:
        fields |= {"emission": (0.4, 0.42, 0.46)}
    shown = Material(**(fields | {"scale": 1.778, "seed": int(rng.integers(99))}))
    dark = plain("bezel", "plastic", "#17181a", contrast=0.05)
    return Item(
        "tv",
        (
            fix.build_box(
                (width + 0.03, 0.05, h + 0.03), dark, bevel=0.006, at=(0, -0.03, -h / 2 - 0.015)
            ),
            fix.build_panel(
                (-width / 2, -0.0565, -h / 2), (width, 0, 0), (0, 0, h), shown, fit=True
            ),
        ),
    )


def build_low_shelf(rng: np.random.Generator, palette: Palette, taste: OfficeTaste) -> Item:
    """A low cabinet with plants, files and trays on it."""
    cabinet = office.build_low_cabinet(rng, taste.front, float(rng.choice([0.8, 1.2, 1.6])))
    top = cabinet.supports[0]
    parts = []
    x = top.x0
    while x < top.x1 - 0.1:
        kind = rng.random()
        if kind < 0.35:
            for _ in range(int(rng.integers(2, 5))):
                item = office.build_binder(rng)
                if x + item.size[0] > top.x1:
                    break
                parts.append(Placed(item, x + item.size[0] / 2, 0.02, top.z))
                x += item.size[0] + 0.003
            x += 0.06
            continue
        if kind < 0.6:
            item = decor.build_plant(rng, palette, float(rng.uniform(0.25, 0.4)))
        elif kind < 0.75:
            item = office.build_tray(rng)
        elif kind < 0.88:
            item = storage.build_storage_box(rng, palette)
        else:
            item = decor.build_vase(rng, palette)
        low, high = item.full_extent()
        wide = float(high[0] - low[0])
        if x + wide > top.x1 + 0.1 or high[1] - low[1] > 0.42:
            x += 0.12
            continue
        parts.append(Placed(item, x - float(low[0]), 0.0, top.z))
        x += wide + 0.05
    return cabinet.with_parts(parts)


def spread(support: Support, count: int) -> list[float]:
    """`count` evenly spaced places along a support [m]."""
    span = support.x1 - support.x0
    return [support.x0 + span * (k + 0.5) / count for k in range(count)]
