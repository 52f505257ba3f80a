"""Groups of an office: work places, islands of desks, meeting tables, shelves of files."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from gn0.scenes.procedural.assembly import Item, Placed
from gn0.scenes.procedural.catalogue import light, office, tools
from gn0.scenes.procedural.catalogue.clutter import crockery, electronics, on_floor
from gn0.scenes.procedural.catalogue.decor import greenery, pictures
from gn0.scenes.procedural.catalogue.seats import chairs, sofas
from gn0.scenes.procedural.catalogue.storage import books, cupboards
from gn0.scenes.procedural.catalogue.tables import low_tables, rugs
from gn0.scenes.procedural.draft import Material
from gn0.scenes.procedural.groups import stand_at
from gn0.scenes.procedural.layout import RoomLayout, dress, footprint, overlaps
from gn0.scenes.procedural.palette import Palette, plain
from gn0.scenes.procedural.shapes import build_box, build_panel
from gn0.scenes.procedural.shell import SIDES

CHAIR_OUT = 0.58  # m of floor that a drawn-up chair takes behind its desk


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
    return chairs.build_office_chair(
        np.random.Generator(np.random.Philox(key=taste.chair)), palette
    )


Maker = Callable[[np.random.Generator, Palette], Item]
# what lies on a desk: how likely, x and y of its middle in halves of the desk, how far it strays
_LOOSE: tuple[tuple[float, float, float, float, Maker], ...] = (
    (0.9, 0.78, 0.55, 0.03, lambda r, p: office.build_phone()),
    (0.85, -0.6, 0.5, 0.05, lambda r, p: tools.build_pen_holder(r)),
    (0.85, 0.58, -0.05, 0.05, crockery.build_cup),
    (0.8, -0.62, -0.35, 0.06, lambda r, p: tools.build_notebook(r)),
    (0.75, -0.78, 0.1, 0.03, lambda r, p: tools.build_papers(r)),
    (0.5, -0.82, 0.62, 0.02, lambda r, p: tools.build_tray(r)),
    (0.65, 0.42, 0.62, 0.03, lambda r, p: tools.build_sticky_notes(r)),
    (0.5, 0.66, -0.45, 0.05, lambda r, p: tools.build_headphones(r)),
    (0.45, -0.45, 0.72, 0.03, lambda r, p: tools.build_calendar(r)),
    (0.35, 0.88, 0.05, 0.02, lambda r, p: tools.build_tissue_box(r)),
    (0.5, 0.5, 0.3, 0.04, lambda r, p: tools.build_flask(r)),
    (0.4, -0.42, 0.35, 0.04, lambda r, p: tools.build_stapler(r)),
    (0.45, 0.62, 0.78, 0.02, pictures.build_photo),
    (0.35, -0.88, -0.6, 0.03, lambda r, p: books.build_book_stack(r, int(r.integers(1, 4)))),
    (0.3, 0.86, 0.7, 0.02, lambda r, p: greenery.build_plant(r, p, 0.22)),
    (0.25, 0.82, -0.3, 0.03, lambda r, p: crockery.build_glass(r, p)),
    (0.4, -0.85, 0.75, 0.02, lambda r, p: _unlit_lamp(r, p)),
    (0.5, 0.3, 0.85, 0.02, lambda r, p: tools.build_dock()),
    (0.4, 0.7, 0.2, 0.05, lambda r, p: tools.build_calculator(r)),
    (0.4, -0.3, 0.6, 0.04, lambda r, p: tools.build_hole_punch(r)),
    (0.45, -0.7, 0.3, 0.05, lambda r, p: tools.build_tape(r)),
)


def _unlit_lamp(rng: np.random.Generator, palette: Palette) -> Item:
    """A desk lamp that is switched off, as by day."""
    lamp = light.build_desk_lamp(rng, palette, kelvin=3500.0)
    return Item(lamp.category, tuple(s.painted(_off(s.material)) for s in lamp.shapes))


def _off(material: Material) -> Material:
    fields = {f: getattr(material, f) for f in material.__struct_fields__}
    pattern = "plastic" if material.pattern == "lampshade" else material.pattern
    return Material(**(fields | {"emission": (0.0, 0.0, 0.0), "pattern": pattern}))


def build_work_place(rng: np.random.Generator, palette: Palette, taste: OfficeTaste) -> Item:
    """A desk with all that is on and under it, the user towards −y."""
    desk = office.build_work_desk(taste.top, taste.frame, taste.width, taste.depth)
    h, w, d = office.DESK_HEIGHT, taste.width, taste.depth
    parts: list[Placed] = []
    shift = float(rng.uniform(-0.06, 0.06))
    kind = rng.random()
    if kind < 0.5:
        parts.append(Placed(electronics.build_monitor(rng), shift, d * 0.24, h))
    elif kind < 0.85:
        screen = electronics.build_monitor(rng)
        half = screen.size[0] / 2 + 0.01
        for sx in (-1, 1):
            turn = -sx * float(rng.uniform(0.08, 0.2))
            other = electronics.build_monitor(rng) if sx < 0 else screen
            fitted = Item(other.category, tuple(s.stretched(x=0.86) for s in other.shapes))
            parts.append(Placed(fitted, shift + sx * half * 0.86, d * 0.24, h, turn))
    else:
        parts.append(Placed(electronics.build_laptop(rng, palette), shift, 0.0, h))
    if kind < 0.85:
        parts.append(Placed(electronics.build_keyboard(rng), shift, -d * 0.2, h, _stray(rng, 0.05)))
        parts.append(Placed(tools.build_mouse_pad(rng), shift + 0.36, -d * 0.2, h))
        parts.append(Placed(electronics.build_mouse(rng), shift + 0.36, -d * 0.19, h + 0.004))
    used = [footprint(p) for p in parts]
    for chance, x, y, stray, maker in _LOOSE:
        if rng.random() > chance:
            continue
        thing = maker(rng, palette)
        for attempt in range(9):
            if attempt:  # where it usually lies is taken
                x, y = _stray(rng, 0.92), _stray(rng, 0.85)
            at = Placed(
                thing,
                float(x * w / 2 + _stray(rng, stray)),
                float(y * d / 2 + _stray(rng, stray)),
                h,
                _stray(rng, 0.15),
            )
            rect = footprint(at)
            inside = -w / 2 < rect[0] and rect[2] < w / 2 and -d / 2 < rect[1] and rect[3] < d / 2
            if inside and not any(overlaps(rect, other) for other in used):
                used.append(rect)
                parts.append(at)
                break
    hand = float(rng.choice([-1, 1]))
    if rng.random() < 0.75:
        parts.append(Placed(office.build_pedestal(taste.front), hand * (w / 2 - 0.3), 0.06))
    if rng.random() < 0.5:
        parts.append(Placed(office.build_tower(), -hand * (w / 2 - 0.2), 0.1))
    elif rng.random() < 0.6:
        parts.append(Placed(on_floor.build_bin(rng, palette), -hand * (w / 2 - 0.25), 0.15))
    if rng.random() < 0.35:
        bag = tools.build_bag(rng)
        parts.append(Placed(bag, hand * (w / 2 - 0.66), -0.05, 0.0, _stray(rng, 0.4)))
    parts.append(Placed(office.build_cable_tray(w), 0.0, d * 0.36, h - 0.16))
    return desk.with_parts(parts)


def _stray(rng: np.random.Generator, reach: float) -> float:
    return float(rng.uniform(-reach, reach))


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
    aisle = float(rng.uniform(0.85, 1.15))
    pitch = 2 * d + 2 * CHAIR_OUT + aisle
    first_end, last_end = _clear_band(layout, not along_x, long, bare=0.45, window=0.45)
    columns = int((last_end - first_end + aisle) / pitch)
    usable = high - low
    row = max(int(usable / w), 1)
    groups = [row]
    if row >= 5 and int((usable - 1.2) / w) >= 4:  # an aisle through the middle
        row = int((usable - 1.2) / w)
        groups = [row - row // 2, row // 2]
    start = (first_end + last_end - columns * pitch + aisle) / 2 + CHAIR_OUT + d
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


def _clear_band(
    layout: RoomLayout, along_x: bool, deep: float, *, bare: float = 1.15, window: float = 0.9
) -> tuple[float, float]:
    """The stretch across a hall that is free of doors: lanes stay along walls that have any."""
    names = ("south", "north") if along_x else ("west", "east")
    margin = []
    for name in names:
        doors = sum(o[2] <= 0 for o in layout.sides[name].openings)
        windows = sum(o[4].kind == "window" for o in layout.sides[name].openings)
        margin.append(1.75 if doors else (window if windows else bare))
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
    if rng.random() < 0.75:  # files at the end of the island that is nearer to the lane
        ends = (v - 0.24, v + size * taste.width + 0.24)
        low = build_low_shelf(rng, palette, taste, 1.2 if taste.depth < 0.79 else 1.6)
        group.append((put(low, at, ends[int(rng.integers(2))], math.pi / 2), True))
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
                chairs.build_office_chair(model, palette)
                if kind == 5
                else chairs.build_chair(model, palette, kind)
            )
            turn = (math.pi if sign < 0 else 0.0) + float(rng.normal(0, 0.12))
            px, py = x + _stray(rng, 0.05), y + sign * float(rng.uniform(0.0, 0.1))
            group.append(
                (Placed(chair, cx + c * px - s * py, cy + s * px + c * py, 0.0, yaw + turn), True)
            )
            face = 0.0 if sign < 0 else math.pi
            laid += _lay_seat(rng, palette, x, sign * (wide / 2 - 0.2), face, laptops)
        middle = [crockery.build_bottle(rng, palette) for _ in range(per_side)]
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
        out.append(Placed(electronics.build_laptop(rng, palette), x, y + s * 0.03, 0.74, face))
    elif rng.random() < 0.8:
        pad = tools.build_notebook(rng) if rng.random() < 0.6 else tools.build_papers(rng)
        out.append(Placed(pad, x, y, 0.74, face + _stray(rng, 0.15)))
    if rng.random() < 0.7:
        thing = (
            crockery.build_glass(rng, palette)
            if rng.random() < 0.6
            else crockery.build_cup(rng, palette)
        )
        out.append(Placed(thing, x + s * 0.24, y + s * 0.06, 0.74))
    return out


def build_wall_screen(rng: np.random.Generator, width: float) -> Item:
    """A large screen on the wall, category "tv"; back at y = 0, middle at z = 0."""
    h = width * 0.5625
    tv = low_tables.build_tv(rng)
    face = next(s.material for s in tv.shapes if s.material.pattern == "screen")
    fields = {f: getattr(face, f) for f in face.__struct_fields__}
    if rng.random() < 0.5:
        fields |= {"emission": (0.4, 0.42, 0.46)}
    shown = Material(**(fields | {"scale": 1.778, "seed": int(rng.integers(99))}))
    dark = plain("bezel", "plastic", "#17181a", contrast=0.05)
    bar = 0.022
    shapes = [
        build_panel((-width / 2, -0.045, -h / 2), (width, 0, 0), (0, 0, h), shown, fit=True),
        *(
            build_box((width + 2 * bar, 0.05, bar), dark, at=(0, -0.03, z))
            for z in (-h / 2 - bar, h / 2)
        ),
        *(
            build_box((bar, 0.05, h), dark, at=(sx * (width + bar) / 2, -0.03, -h / 2))
            for sx in (-1, 1)
        ),
    ]
    return Item("tv", tuple(shapes))


def place_lounge(layout: RoomLayout, count: int = 2, *, chairs: int = 1) -> bool:
    """A sofa at a wall with a coffee table before it and armchairs across, on a rug at times."""
    rng, palette = layout.rng, layout.palette
    sofa = sofas.build_sofa(rng, palette, seats=count)
    table = dress(
        low_tables.build_coffee_table(rng, palette), "coffee table", rng, palette, count=4
    )
    low, high = sofa.full_extent()
    wide, deep = float(high[0] - low[0]), float(high[1] - low[1])
    t_low, t_high = table.full_extent()
    t_deep = float(t_high[1] - t_low[1])
    reach = deep + 0.38 + t_deep
    for name in rng.permutation(list(SIDES)):
        side = layout.sides[str(name)]
        for a, b in sorted(layout.intervals(side, reach, 0.9), key=lambda g: g[0] - g[1]):
            if b - a < wide + 0.1:
                continue
            for t in (a + wide / 2 + 0.05, b - wide / 2 - 0.05, (a + b) / 2):
                group = [
                    (layout.against_wall(side, sofa, t, 0.05), True),
                    (stand_at(side, t, deep + 0.4 + t_deep / 2, table), True),
                ]
                clear = layout.strip(side, t - wide / 2, t + wide / 2, reach)
                if not layout.place_free(group, clear):
                    continue
                if rng.random() < 0.6:
                    rug = rugs.build_rug(rng, palette, wide * 0.95, 1.3)
                    layout.placed.append(stand_at(side, t, deep + 0.45, rug))
                for k in range(chairs):
                    chair = sofas.build_sofa(rng, palette, seats=1)
                    turn = math.pi + _stray(rng, 0.25)
                    at = stand_at(
                        side, t + (k - (chairs - 1) / 2) * 0.95, reach + 0.75, chair, turn
                    )
                    rect = footprint(at)
                    if layout.is_clear(rect) and layout.is_passable([rect]):
                        layout.add(at)
                return True
    return False


def build_low_shelf(
    rng: np.random.Generator, palette: Palette, taste: OfficeTaste, width: float | None = None
) -> Item:
    """A low cabinet with plants, files and trays on it."""
    wide = float(rng.choice([0.8, 1.2, 1.6])) if width is None else width
    cabinet = office.build_low_cabinet(rng, taste.front, wide)
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
            item = greenery.build_plant(rng, palette, float(rng.uniform(0.25, 0.4)))
        elif kind < 0.75:
            item = tools.build_tray(rng)
        elif kind < 0.88:
            item = cupboards.build_storage_box(rng, palette)
        else:
            item = greenery.build_vase(rng, palette)
        low, high = item.full_extent()
        wide = float(high[0] - low[0])
        if x + wide > top.x1 + 0.1 or high[1] - low[1] > 0.42:
            x += 0.12
            continue
        parts.append(Placed(item, x - float(low[0]), 0.0, top.z))
        x += wide + 0.05
    return cabinet.with_parts(parts)
