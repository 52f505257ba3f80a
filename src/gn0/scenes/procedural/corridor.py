"""Corridors of hotels, schools and hospitals: long legs with bends, niches and side rooms."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from gn0.errors import SceneError
from gn0.scenes.procedural.building import Building, choose_palette
from gn0.scenes.procedural.draft import Material, SceneDraft
from gn0.scenes.procedural.office import CEILING_TILES
from gn0.scenes.procedural.palette import CEILING, Palette, linear_colour, plain, shade
from gn0.scenes.procedural.plan import (
    DOOR_HEIGHT,
    Cell,
    FloorPlan,
    Opening,
    Room,
    Wall,
    fit_opening,
)
from gn0.scenes.procedural.plan_cells import (
    NO_JOINT,
    Joint,
    close_cells,
    spread_windows,
    turn_cells,
)
from gn0.scenes.procedural.rooms_corridor import CorridorRooms
from gn0.scenes.procedural.shell import SIDES, RoomFinish
from gn0.seeds import random_stream

SIZES = {"small": (130.0, 210.0), "medium": (225.0, 330.0), "large": (350.0, 480.0)}  # m²
LENGTHS = {"small": (15.0, 19.0), "medium": (22.0, 27.0), "large": (29.0, 36.0)}  # of the main leg


@dataclass(frozen=True)
class Theme:
    """What kind of house a corridor belongs to.

    Attributes:
        name: "hotel", "school" or "hospital".
        width: of the corridor [m].
        depth: of side rooms [m].
        rooms: (type, width [m], how often) of side rooms.
    """

    name: str
    width: tuple[float, float]
    depth: tuple[float, float]
    rooms: tuple[tuple[str, float, float], ...]


THEMES = (
    Theme(
        "hotel",
        (1.9, 2.3),
        (4.6, 5.4),
        (("hotel room", 3.9, 5.0), ("linen room", 2.4, 0.7), ("niche", 3.2, 1.2)),
    ),
    Theme(
        "school",
        (2.5, 3.0),
        (5.2, 6.2),
        (
            ("classroom", 7.0, 3.0),
            ("toilet", 2.3, 0.8),
            ("office", 3.6, 0.8),
            ("niche", 3.4, 1.3),
        ),
    ),
    Theme(
        "hospital",
        (2.4, 2.9),
        (4.4, 5.2),
        (
            ("patient room", 4.4, 4.0),
            ("office", 3.5, 1.0),
            ("toilet", 2.2, 0.8),
            ("linen room", 2.5, 0.7),
            ("niche", 3.4, 1.3),
        ),
    ),
)
DEPTHS = {"niche": 1.9, "toilet": 2.5, "linen room": 3.1, "office": 4.0}  # m, else the theme's
NEEDED = {
    "hotel room": {"bed"},
    "classroom": {"school desk", "blackboard"},
    "patient room": {"hospital bed"},
    "toilet": {"toilet", "washbasin"},
    "office": {"desk"},
}
DARK_ROOMS = ("linen room", "toilet")


def draw_theme(seed: int) -> Theme:
    """The kind of house, the same for all sizes."""
    return THEMES[int(random_stream(seed, "corridor", "theme").integers(len(THEMES)))]


def plan_corridor(seed: int, size: str = "medium") -> FloorPlan:
    """A floor plan of two or three corridor legs and the rooms along them.

    Raises:
        SceneError: no plan of the wanted area came out (not known to happen).
    """
    theme = draw_theme(seed)
    low, high = SIZES[size]
    for attempt in range(300):
        rng = random_stream(seed, "corridor", "plan", size, attempt)
        plan = _draw_plan(rng, size, theme, float(rng.uniform(low, high)))
        if plan is not None and low <= plan.area <= high:
            return _add_closed_doors(rng, plan)
    raise SceneError(f"corridor {seed}: no plan found", remedy="use another seed or size")


def _draw_plan(
    rng: np.random.Generator, size: str, theme: Theme, wanted: float
) -> FloorPlan | None:
    main, width = float(rng.uniform(*LENGTHS[size])), float(rng.uniform(*theme.width))
    deep = float(rng.uniform(*theme.depth))
    leg = main * float(rng.uniform(0.45, 0.65))
    shape = str(rng.choice(["L", "T", "Z"] if size != "small" else ["L", "T"]))
    at = main - width if shape != "T" else main * float(rng.uniform(0.4, 0.6))
    legs: list[Cell] = [
        ("corridor", 0.0, 0.0, main, width),
        ("corridor", at, width, at + width, width + leg),
    ]
    if shape == "Z":
        third = main * float(rng.uniform(0.4, 0.55))
        legs.append(("corridor", at + width, width + leg - width, at + width + third, width + leg))
    legs = [(n, *(round(v, 2) for v in box)) for n, *box in legs]  # type: ignore[misc]
    strips: list[tuple[str, float, float, float]] = []  # side, from, to, wall of the corridor
    for _, x0, y0, x1, y1 in legs:
        if x1 - x0 > y1 - y0:
            strips += [("north", x0, x1, y1), ("south", x0, x1, y0)]
        else:
            strips += [("west", y0, y1, x0), ("east", y0, y1, x1)]
    cells = list(legs)
    area = sum((c[3] - c[1]) * (c[4] - c[2]) for c in cells)
    names = [name for name, _, _ in theme.rooms]
    odds = np.array([often for _, _, often in theme.rooms])
    widths = {name: wide for name, wide, _ in theme.rooms}
    cursor = [low for _, low, _, _ in strips]
    open_ends = True
    while open_ends and area < wanted * 1.03:
        open_ends = False
        for k in (int(v) for v in rng.permutation(len(strips))):
            side, _, high, wall = strips[k]
            name = str(rng.choice(names, p=odds / odds.sum()))
            wide = round(widths[name] * float(rng.uniform(0.92, 1.1)), 2)
            depth = DEPTHS.get(name, round(deep, 2))
            if rng.random() < 0.22:  # a piece of bare wall, for a window or a closed door
                cursor[k] += float(rng.uniform(1.6, 2.8))
            start = round(cursor[k], 2)
            if start + wide > high - 0.1:
                continue
            open_ends = True
            box = _side_box(side, start, wide, wall, depth)
            cursor[k] = start + wide
            if any(_collide(box, c[1:]) for c in cells):
                cursor[k] = start + 0.7
                continue
            cells.append((name, *box))
            area += wide * depth
            if area > wanted * 1.03:
                break
    cells = turn_cells(rng, cells)
    if len({c[0] for c in cells}) < 3:
        return None

    def joint(a: Room, b: Room) -> Joint:
        if a.type == b.type == "corridor":
            return Joint("passage", 1.0, top=2.45)
        if "corridor" in (a.type, b.type):
            if "niche" in (a.type, b.type):
                return Joint("passage", 0.94, top=2.4)
            return Joint("door")
        return NO_JOINT

    def windows(
        room: Room, wall: Wall, low: float, high: float
    ) -> Sequence[tuple[float, float, float, float]]:
        if room.type in DARK_ROOMS or high - low < 1.5:
            return []
        if room.type == "corridor":
            if high - low < 1.9:
                return []
            return spread_windows(low, high, width=1.2, bottom=0.9, top=2.25, gap=2.6)
        back = max(room.width, room.depth) * 0.45 < high - low
        return spread_windows(low, high, width=1.7, bottom=0.86, top=2.3, gap=0.8) if back else []

    ceiling = round(float(rng.uniform(2.6, 2.95)), 2)
    return close_cells(
        rng, cells, ceiling=ceiling, joint=joint, windows=windows, entrance="corridor"
    )


def _side_box(
    side: str, start: float, wide: float, wall: float, depth: float
) -> tuple[float, float, float, float]:
    stop = round(start + wide, 2)
    far = {"north": wall + depth, "east": wall + depth, "south": wall - depth, "west": wall - depth}
    low, high = sorted((round(wall, 2), round(far[side], 2)))
    return (start, low, stop, high) if side in ("north", "south") else (low, start, high, stop)


def _collide(a: Sequence[float], b: Sequence[float]) -> bool:
    """Whether two rectangles overlap, or leave a gap too narrow for two outer walls."""
    gap = max(a[0] - b[2], b[0] - a[2], a[1] - b[3], b[1] - a[3])
    return gap < -0.02 or 0.02 < gap < 0.7


def _add_closed_doors(rng: np.random.Generator, plan: FloorPlan) -> FloorPlan:
    """Locked doors in bare stretches of corridor wall that are too short for a window."""
    added: list[Opening] = []
    for wall in plan.walls:
        inside = wall.rooms[0] or wall.rooms[1]
        if None not in wall.rooms or inside is None or plan.room(inside).type != "corridor":
            continue
        room = plan.room(inside)
        a, b = (room.x0, room.x1) if wall.axis == "x" else (room.y0, room.y1)
        low, high = max(wall.low, a), min(wall.high, b)
        mine = [o for o in plan.openings if o.axis == wall.axis and o.rooms == wall.rooms]
        taken = [o for o in mine if low < (o.low + o.high) / 2 < high and abs(o.at - wall.at) < 0.2]
        if taken or high - low < 1.3 or rng.random() < 0.25:
            continue
        middle = (low + high) / 2 + float(rng.uniform(-0.1, 0.1))
        door = Opening(
            "entrance", wall.axis, wall.at, round(middle - 0.46, 3), round(middle + 0.46, 3), 0.0,
            DOOR_HEIGHT, wall.thickness, wall.rooms,
        )  # fmt: skip
        added.append(fit_opening(plan, door))
    return replace(plan, openings=(*plan.openings, *added))


class CorridorFinish:
    """The materials of a corridor of one theme."""

    def __init__(self, theme: Theme, palette: Palette, rng: np.random.Generator) -> None:
        cloth = linear_colour(str(rng.choice(palette.style.cloths)))
        self.theme = theme
        self.wall = palette.wall(rng)
        self.accent = palette.accent_wall(rng)
        self.band = float(rng.uniform(1.1, 1.3))
        self.rail = palette.wood(rng, 0)
        if theme.name == "hotel":
            self.floor = Material(
                name="carpet", pattern="carpet", colour=shade(cloth, 1.1),
                colour2=shade(cloth, 0.55), scale=0.02, contrast=0.5, seed=5, detail=0.7,
            )  # fmt: skip
        else:
            code = ("#9fa8a3", "#b9b3a4", "#8fa3ad", "#b5a88f")[int(rng.integers(4))]
            self.floor = plain("linoleum", "concrete", code, contrast=0.12, scale=0.8, detail=0.3)

    def __call__(
        self, room: Room, palette: Palette, floor: Material, rng: np.random.Generator
    ) -> RoomFinish:
        """Materials of one room."""
        walls = dict.fromkeys(SIDES, self.wall)
        hotel = self.theme.name == "hotel"
        ceiling = CEILING if hotel else CEILING_TILES
        if room.type == "toilet":
            tile = palette.tiles(rng, 0.2)
            return RoomFinish(walls, palette.tiles(rng, 0.3), 2.1, tile, ceiling=ceiling)
        if room.type in ("corridor", "niche") and not hotel:
            return RoomFinish(
                walls, self.floor, self.band, self.accent, ceiling=ceiling, rail=self.rail
            )
        if room.type in ("hotel room", "office", "classroom", "patient room"):
            walls[str(rng.choice(SIDES))] = palette.accent_wall(rng)
        if room.type in ("hotel room", "office") and rng.random() < 0.6:
            return RoomFinish(walls, floor, crown=hotel, ceiling=ceiling)
        return RoomFinish(walls, self.floor, crown=hotel, ceiling=ceiling)


def draft_corridor(
    seed: int, *, size: str = "medium", style: str | Palette | None = None
) -> SceneDraft:
    """A furnished corridor with its rooms: geometry, materials, objects, rooms, lamps.

    Args:
        seed: of everything; the same seed gives the same corridor.
        size: "small", "medium" or "large" (see `SIZES`).
        style: name of one of `palette.STYLES`; drawn when None.

    Raises:
        SceneError: an unknown style, or no walkable corridor was found (not known to happen).
    """
    palette, theme = choose_palette("corridor", seed, style), draw_theme(seed)
    plan = plan_corridor(seed, size)
    rng = random_stream(seed, "corridor", "taste")
    rooms = CorridorRooms(theme.name, palette, rng)
    finish = CorridorFinish(theme, palette, rng)
    sunlit = next((o.rooms[0] or o.rooms[1] for o in plan.openings if o.kind == "window"), None)
    return Building("corridor", seed, plan, palette, rooms.furnish, finish, NEEDED, sunlit).draft()
