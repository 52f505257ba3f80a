"""The building itself: floors, walls with holes, ceilings, skirting, doors and windows."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from gn0.scenes.procedural.assembly import Assembly, Item, Placed
from gn0.scenes.procedural.draft import Lamp, Material
from gn0.scenes.procedural.palette import CEILING, TRIM, Palette, plain
from gn0.scenes.procedural.plan import FloorPlan, Opening, Room
from gn0.scenes.procedural.shapes import (
    Shape,
    arc_path,
    build_box,
    build_moulding,
    build_panel,
    build_tube,
)

SIDES = ("south", "north", "west", "east")  # walls at low y, high y, low x, high x
LONGEST_BOARD, LONGEST_PIECE = 10.5, 3.0  # of skirting: longer ones are laid in pieces [m]
SKY_LIGHT = (1.5, 1.65, 1.95)  # radiance of the sky through a window


@dataclass(frozen=True)
class Side:
    """One wall of a room seen from inside: measured anticlockwise round the room.

    Attributes:
        room: whose wall.
        name: of `SIDES`.
        start: (x, y) [m] of its first end.
        along: unit vector along it; the inward normal is `along` turned by +90°.
        length: [m].
        openings: (low, high, bottom, top, opening) measured from `start`.
    """

    room: Room
    name: str
    start: tuple[float, float]
    along: tuple[float, float]
    length: float
    openings: tuple[tuple[float, float, float, float, Opening], ...]

    @property
    def normal(self) -> tuple[float, float]:
        """Unit vector into the room."""
        return (-self.along[1], self.along[0])

    @property
    def yaw(self) -> float:
        """Yaw [rad] of an item that stands with its back to this wall."""
        nx, ny = self.normal
        return math.atan2(-ny, -nx) - math.pi / 2

    def point(self, t: float, off: float = 0.0) -> tuple[float, float]:
        """World (x, y) at `t` [m] along the wall and `off` [m] into the room."""
        nx, ny = self.normal
        return (
            self.start[0] + self.along[0] * t + nx * off,
            self.start[1] + self.along[1] * t + ny * off,
        )


def room_sides(plan: FloorPlan, room: Room) -> dict[str, Side]:
    """The four sides of a room with their openings."""
    corners = {
        "south": ((room.x0, room.y0), (1.0, 0.0), room.width),
        "east": ((room.x1, room.y0), (0.0, 1.0), room.depth),
        "north": ((room.x1, room.y1), (-1.0, 0.0), room.width),
        "west": ((room.x0, room.y1), (0.0, -1.0), room.depth),
    }
    out = {}
    for name, (start, along, length) in corners.items():
        axis = "x" if name in ("south", "north") else "y"
        at = {"south": room.y0, "north": room.y1, "west": room.x0, "east": room.x1}[name]
        side_of_wall = 1 if name in ("south", "west") else 0  # the room is on the upper side
        found = []
        for o in plan.openings:
            if o.axis != axis or o.rooms[side_of_wall] != room.id or abs(o.at - at) > 0.2:
                continue
            origin, sign = (start[0], along[0]) if axis == "x" else (start[1], along[1])
            a, b = sorted(((o.low - origin) * sign, (o.high - origin) * sign))
            found.append((a, b, o.bottom, o.top, o))
        found.sort(key=lambda f: f[0])
        out[name] = Side(room, name, start, along, length, tuple(found))
    return out


@dataclass(frozen=True)
class RoomFinish:
    """Materials of a room: walls by side, lower wall band up to `band` [m], floor, ceiling."""

    walls: dict[str, Material]
    floor: Material
    band: float = 0.0
    band_material: Material | None = None
    crown: bool = False
    ceiling: Material = CEILING
    rail: Material | None = None  # of a board that covers the edge of the band


def build_room_shell(plan: FloorPlan, room: Room, finish: RoomFinish) -> list[Shape]:
    """Floor, ceiling, walls with holes and skirting of a room."""
    e = 0.01  # floor and ceiling run a little under the walls: no light falls through the seam
    x0, y0, wide, deep = room.x0 - e, room.y0 - e, room.width + 2 * e, room.depth + 2 * e
    out = [
        build_panel((x0, y0, 0), (wide, 0, 0), (0, deep, 0), finish.floor),
        build_panel((x0 + wide, y0, plan.ceiling), (-wide, 0, 0), (0, deep, 0), finish.ceiling),
    ]
    for name, side in room_sides(plan, room).items():
        wall = finish.walls[name]
        bands = [(0.0, plan.ceiling, wall)]
        if finish.band_material is not None:
            top = min(finish.band, plan.ceiling)
            bands = [(0.0, top, finish.band_material), (top, plan.ceiling, wall)]
        for low, high, material in bands:
            out += _wall_panels(side, low, high, material)
        if finish.band_material is None or finish.rail is not None:
            out += _skirting(side, 0.07, 0.014, 0.0)
        if finish.rail is not None:
            out += _skirting(side, 0.09, 0.018, finish.band - 0.045, finish.rail)
        if finish.crown:
            x, y = side.point(side.length / 2, 0.02)
            strip = build_box((side.length, 0.04, 0.07), TRIM, bevel=0.012)
            out.append(strip.moved(x, y, plan.ceiling - 0.07, side.yaw))
    return out


def _wall_panels(side: Side, low: float, high: float, material: Material) -> list[Shape]:
    """The wall between two heights, without its openings."""
    out = []
    cuts = sorted({0.0, side.length, *(v for o in side.openings for v in o[:2])})
    for a, b in pairwise(cuts):
        if b - a < 1e-6:
            continue
        middle = (a + b) / 2
        hole = next((o for o in side.openings if o[0] < middle < o[1]), None)
        parts = [(low, high)]
        if hole is not None:
            parts = [(low, min(high, hole[2])), (max(low, hole[3]), high)]
        for z0, z1 in parts:
            if z1 - z0 < 1e-6:
                continue
            x, y = side.point(b)
            # from the right end to the left: along × up points into the room
            panel = build_panel(
                (x, y, z0),
                (-side.along[0] * (b - a), -side.along[1] * (b - a), 0),
                (0, 0, z1 - z0),
                material,
            )
            uv = panel.uv + np.array([side.length - b, z0], np.float32)
            out.append(Shape(panel.vertices, panel.faces, uv, material))
    return out


def _skirting(
    side: Side, height: float, thick: float, z: float, material: Material = TRIM
) -> list[Shape]:
    """Boards along the wall, at its foot where z is 0, cut at doors and windows in their way."""
    out, start = [], 0.0
    doors = [(o[0] - 0.075, o[1] + 0.075) for o in side.openings if o[2] < z + height]
    for a, b in [*doors, (side.length, side.length)]:
        # the bevel of a board that is longer than a hall is a needle of light across it
        pieces = math.ceil((a - start) / LONGEST_PIECE) if a - start > LONGEST_BOARD else 1
        for k in range(pieces if a - start > 0.02 else 0):
            low = start + (a - start) * k / pieces
            high = a if k + 1 == pieces else start + (a - start) * (k + 1) / pieces
            x, y = side.point((low + high) / 2, thick / 2)
            board = build_box((high - low, thick, height), material, bevel=0.004)
            board = board.without_back(thick / 2)
            out.append(board.moved(x, y, z, side.yaw))
        start = b
    return out


def _opening_frame(opening: Opening) -> tuple[float, float, float]:
    """x, y, yaw of an opening's frame: local x along the wall, local +y to its upper side."""
    x, y = opening.centre
    return (x, y, 0.0) if opening.axis == "x" else (x, y, -math.pi / 2)


def build_opening_shell(opening: Opening, finishes: dict[str, RoomFinish]) -> list[Shape]:
    """Lining of a hole: jambs, head, and the floor strip of a door."""
    w, t = opening.width, opening.thickness + 0.003  # stands out by a hair: no open seam
    h = opening.top - opening.bottom
    inside = opening.rooms[0] or opening.rooms[1]
    assert inside is not None
    lining = (
        finishes[inside].walls["south"] if opening.kind in ("window", "passage", "open") else TRIM
    )
    z = opening.bottom
    shapes = [
        build_panel((-w / 2, -t / 2, z), (0, t, 0), (0, 0, h), lining),
        build_panel((w / 2, t / 2, z), (0, -t, 0), (0, 0, h), lining),
        build_panel((w / 2, -t / 2, z + h), (-w, 0, 0), (0, t, 0), lining),
    ]
    base = TRIM if opening.bottom > 0 else finishes[inside].floor
    shapes.append(build_panel((-w / 2, -t / 2, z), (w, 0, 0), (0, t, 0), base).moved(z=0.0005))
    x, y, yaw = _opening_frame(opening)
    return [s.moved(x, y, 0, yaw) for s in shapes]


def _casing(width: float, height: float, side: float, material: Material) -> list[Shape]:
    """Boards round a door on one face of the wall; `side` is the y of that face, signed."""
    y, turn = side + math.copysign(0.008, side), 0.0 if side < 0 else math.pi
    board = 0.065
    post = build_box((board, 0.016, height + board), material, bevel=0.004).without_back(0.008)
    head = build_box((width, 0.016, board), material, bevel=0.004).without_back(0.008)
    return [
        *(post.moved(sx * (width + board) / 2, y, 0, turn) for sx in (-1, 1)),
        head.moved(0, y, height, turn),
    ]


def _leaf(
    width: float, height: float, material: Material, metal: Material, rng_style: int
) -> list[Shape]:
    """A door leaf: hinge edge at x = 0, running along +x, thickness along y, with handles."""
    thick = 0.04
    shapes = [build_box((width, thick, height), material, bevel=0.003, at=(width / 2, 0, 0.008))]
    fields = {
        0: [(0.16, 0.52, 0.12), (0.62, 0.93, 0.12)],
        1: [(0.1, 0.32, 0.11), (0.38, 0.6, 0.11), (0.66, 0.93, 0.11)],
        2: [],
    }[rng_style % 3]
    for low, high, margin in fields:
        for sign in (-1, 1):
            frame = build_moulding(width - 2 * margin, (high - low) * height, material)
            spin = 0.0 if sign < 0 else math.pi
            shapes += [m.moved(width / 2, sign * thick / 2, low * height, spin) for m in frame]
    for sign in (-1, 1):
        y = sign * (thick / 2 + 0.045)
        path = [(width - 0.06, sign * thick / 2, 1.03), (width - 0.06, y, 1.03)]
        turn = arc_path((width - 0.075, y, 1.03), 0.015, 0, sign * math.pi / 2, "xy", 3)
        path += [tuple(p) for p in turn[1:]] + [(width - 0.17, y + sign * 0.015, 1.03)]
        shapes.append(build_tube(path, 0.009, metal, sides=8))
        shapes.append(
            build_box(
                (0.04, 0.008, 0.16), metal, bevel=0.003, at=(width - 0.06, sign * 0.022, 0.93)
            )
        )
    return shapes


def build_door(opening: Opening, material: Material, metal: Material, style: int) -> Placed:
    """Casing and leaf of a door or the entrance, as one object "door"."""
    w, h, t = opening.width, opening.top, opening.thickness
    shapes = []
    for sign, room in zip((-1, 1), opening.rooms, strict=True):
        if room is not None:
            shapes += _casing(w, h, sign * t / 2, material if opening.kind == "entrance" else TRIM)
    leaf = _leaf(w - 0.012, h - 0.014, material, metal, style)
    if opening.kind == "entrance":
        inner = -1 if opening.rooms[0] is not None else 1
        shapes += [s.moved(-w / 2 + 0.006, inner * (t / 2 - 0.06), 0) for s in leaf]
    elif opening.leaf is not None:
        # folded flat against the wall of room `leaf`, hinge at one end of the opening
        side = -1 if opening.leaf == opening.rooms[0] else 1
        y = side * (t / 2 + 0.085)
        # the frame of a wall along y runs towards −y: its low end is at local +x
        low_end = (opening.hinge == "low") == (opening.axis == "x")
        turn = math.pi if low_end else 0.0
        # the side towards the wall is never seen, and would show through the thin leaf
        hidden = side * math.cos(turn)
        at_x = (-1 if low_end else 1) * (w / 2 + 0.02)
        for piece in leaf:
            inward = (piece.vertices[piece.faces][..., 1] * hidden < -0.0199).all(axis=1)
            kept = Shape(piece.vertices, piece.faces[~inward], piece.uv[~inward], piece.material)
            if len(kept.faces):
                shapes.append(kept.moved(at_x, y, 0, turn))
    x, y, yaw = _opening_frame(opening)
    return Placed(Item("door", tuple(shapes)), x, y, 0.0, yaw)


def build_window(opening: Opening, rng: np.random.Generator, view: int) -> Placed:
    """Frame, panes showing the sky, sill and its daylight, as one object "window"."""
    w, t = opening.width, opening.thickness
    z0, h = opening.bottom, opening.top - opening.bottom
    inner = -1 if opening.rooms[0] is not None else 1  # side of the room in the local frame
    deep = -inner * (t / 2 - 0.05)  # y of the frame's middle, near the outer face
    bar = 0.055
    shapes = []

    def add(width: float, height: float, x: float, z: float, thick: float = 0.05) -> None:
        shapes.append(build_box((width, thick, height), TRIM, bevel=0.006, at=(x, deep, z)))

    for sx in (-1, 1):
        add(bar, h, sx * (w - bar) / 2, z0)
    add(w - 2 * bar, bar, 0, z0)
    add(w - 2 * bar, bar, 0, z0 + h - bar)
    sashes = 1 if w < 0.95 else (2 if w < 1.75 else 3)
    for k in range(1, sashes):
        add(0.075, h - 2 * bar, -w / 2 + w * k / sashes, z0 + bar, 0.056)
    if h > 1.1 and rng.random() < 0.4:
        add(w - 2 * bar, 0.03, 0, z0 + h * 0.72, 0.045)
    for k in range(sashes):  # one handle a sash
        x = (
            -w / 2 + w * (k + 1) / sashes - 0.02
            if k < sashes - 1
            else -w / 2 + w * k / sashes + 0.02
        )
        if sashes > 1 or k == 0:
            handle = build_box(
                (0.018, 0.02, 0.11), plain("handle", "metal", "#c4c6c8"), bevel=0.004
            )
            shapes.append(handle.moved(x, deep + inner * 0.04, z0 + h * 0.45))
    sky = Material(
        name="daylight",
        pattern="sky",
        colour=(0.55, 0.7, 0.95),
        colour2=(0.25, 0.33, 0.22),
        scale=round(w / h, 3),
        contrast=0.5,
        emission=(1.0, 1.05, 1.15),
        seed=view,
        detail=0.5,
    )
    pane_y = -inner * (t / 2 - 0.045)
    if inner < 0:  # seen from −y: along +x
        shapes.append(build_panel((-w / 2, pane_y, z0), (w, 0, 0), (0, 0, h), sky, fit=True))
    else:
        shapes.append(build_panel((w / 2, pane_y, z0), (-w, 0, 0), (0, 0, h), sky, fit=True))
    reach = 0.1
    sill = build_box((w + 0.1, reach + 0.03, 0.028), TRIM, bevel=0.008)
    shapes.append(sill.moved(0, inner * (t / 2 + (reach - 0.03) / 2), z0 - 0.028))
    lamp = Lamp(
        centre=(0.0, deep + inner * 0.04, z0 + h / 2),
        size=(round(w - 0.1, 3), round(h - 0.1, 3)),
        shape="window",
        colour=SKY_LIGHT,
        direction=(0.0, float(inner), 0.0),
    )
    x, y, yaw = _opening_frame(opening)
    return Placed(Item("window", tuple(shapes), lamps=(lamp,)), x, y, 0.0, yaw)


def choose_finish(
    room: Room, palette: Palette, floor: Material, rng: np.random.Generator
) -> RoomFinish:
    """Wall paints, tiles and floor of a room."""
    wall = palette.wall(rng)
    walls = dict.fromkeys(SIDES, wall)
    crown = palette.style.name == "classic"
    if room.type == "bathroom":
        tile = palette.tiles(rng, float(rng.choice([0.15, 0.2, 0.3])))
        ground = palette.tiles(rng, float(rng.choice([0.3, 0.45])))
        return RoomFinish(walls, ground, float(rng.choice([1.25, 2.05, 3.0])), tile)
    if room.type == "kitchen":
        ground = palette.tiles(rng, 0.4) if rng.random() < 0.55 else floor
        return RoomFinish(walls, ground, crown=crown)
    if room.type in ("bedroom", "living room", "study") and rng.random() < 0.8:
        walls[str(rng.choice(SIDES))] = palette.accent_wall(rng)
    if room.type == "bedroom" and rng.random() < 0.3:
        carpet = plain(
            "carpet",
            "carpet",
            str(rng.choice(palette.style.cloths)),
            contrast=0.3,
            scale=0.01,
            detail=0.6,
        )
        return RoomFinish(walls, carpet, crown=crown)
    return RoomFinish(walls, floor, crown=crown)


def build_glazing(opening: Opening, material: Material) -> Placed:
    """Frame of a window between two rooms, as one object "interior window".

    It has no pane: splats of clean glass would only dim what is behind it.
    """
    w, t, bar = opening.width, opening.thickness + 0.02, 0.05
    z0, h = opening.bottom, opening.top - opening.bottom
    shapes = []
    for z in (z0, z0 + h - bar):
        shapes.append(build_box((w, t, bar), material, bevel=0.004, at=(0, 0, z)))
    fields = max(1, round(w / 1.2))
    for k in range(fields + 1):
        x = -w / 2 + bar / 2 + (w - bar) * k / fields
        thick = t if k in (0, fields) else 0.06
        post = build_box((bar, thick, h - 2 * bar), material, bevel=0.004, at=(x, 0, z0 + bar))
        shapes.append(post)
    x, y, yaw = _opening_frame(opening)
    return Placed(Item("interior window", tuple(shapes)), x, y, 0.0, yaw)


Finisher = Callable[[Room, Palette, Material, np.random.Generator], RoomFinish]


def add_shell(
    assembly: Assembly,
    plan: FloorPlan,
    palette: Palette,
    rng: np.random.Generator,
    finish: Finisher = choose_finish,
) -> dict[str, RoomFinish]:
    """Add the whole building, its doors and windows; returns the finish of each room."""
    floor = palette.floor(rng)
    finishes = {r.id: finish(r, palette, floor, rng) for r in plan.rooms}
    leaf = plain("door lacquer", "paint", "#f0eee9", contrast=0.05)
    if rng.random() < 0.4:
        leaf = palette.wood(rng, 0)
    style, view = int(rng.integers(3)), int(rng.integers(1000))
    for room in plan.rooms:
        assembly.add_shell(*build_room_shell(plan, room, finishes[room.id]))
    for k, opening in enumerate(plan.openings):
        assembly.add_shell(*build_opening_shell(opening, finishes))
        inside = opening.rooms[0] or opening.rooms[1]
        if opening.kind == "window":
            assembly.add_item(build_window(opening, rng, view + k), inside)
        elif opening.kind == "glazing":
            assembly.add_item(build_glazing(opening, palette.metal()), inside)
        elif opening.kind in ("door", "entrance"):
            front = palette.wood(rng, 0) if opening.kind == "entrance" else leaf
            assembly.add_item(
                build_door(opening, front, palette.metal(), style), opening.leaf or inside
            )
    return finishes
