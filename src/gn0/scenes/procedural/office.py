"""Offices: a hall of desks, a strip of rooms along it, a core with kitchen and toilets."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from gn0.errors import SceneError
from gn0.scenes.procedural.building import Building, choose_palette
from gn0.scenes.procedural.draft import Material, SceneDraft
from gn0.scenes.procedural.groups_office import draw_taste
from gn0.scenes.procedural.palette import Palette, linear_colour, plain, shade
from gn0.scenes.procedural.plan import Cell, FloorPlan, Room, Wall
from gn0.scenes.procedural.plan_cells import (
    NO_JOINT,
    Joint,
    close_cells,
    spread_windows,
    turn_cells,
)
from gn0.scenes.procedural.rooms_office import COMPANIES, OfficeRooms
from gn0.scenes.procedural.shell import SIDES, RoomFinish
from gn0.seeds import random_stream

SIZES = {"small": (205.0, 300.0), "medium": (325.0, 425.0), "large": (460.0, 590.0)}  # m²
HALL_DEPTH = {"small": (7.2, 8.2), "medium": (9.4, 10.6), "large": (10.6, 12.4)}  # m
WIDTHS = {
    "reception": 7.0,
    "meeting room": 5.0,
    "office": 3.5,
    "print room": 2.9,
    "server room": 2.5,
}
STRIPS = {
    "small": ("reception", "meeting room", "office", "print room"),
    "medium": ("reception", "meeting room", "office", "office", "print room", "server room"),
    "large": (
        *("reception", "meeting room", "office", "meeting room", "office", "print room"),
        *("office", "server room"),
    ),
}
NEEDED = {
    "open office": {"desk", "office chair"},
    "reception": {"reception desk", "sofa"},
    "meeting room": {"conference table"},
    "office": {"desk", "office chair"},
    "kitchen": {"kitchen counter", "fridge"},
    "toilet": {"toilet", "washbasin"},
    "print room": {"printer"},
}
DARK_ROOMS = ("print room", "server room", "toilet")  # without windows
CEILING_TILES = Material(
    name="ceiling tiles", pattern="tiles", colour=linear_colour("#f1f1ee"),
    colour2=linear_colour("#c4c5c4"), scale=0.6, contrast=0.08, detail=0.2,
)  # fmt: skip


def plan_office(seed: int, size: str = "medium") -> FloorPlan:
    """A floor plan of nine to thirteen rooms.

    Raises:
        SceneError: no plan of the wanted area came out (not known to happen).
    """
    low, high = SIZES[size]
    for attempt in range(80):
        rng = random_stream(seed, "office", "plan", size, attempt)
        wanted = float(rng.uniform(low + 0.1 * (high - low), high - 0.1 * (high - low)))
        plan = _draw_plan(rng, size, wanted)
        if plan is not None and low <= plan.area <= high:
            return plan
    raise SceneError(f"office {seed}: no plan found", remedy="use another seed or size")


def _draw_plan(rng: np.random.Generator, size: str, wanted: float) -> FloorPlan | None:
    strip, hall = float(rng.uniform(4.0, 4.7)), float(rng.uniform(*HALL_DEPTH[size]))
    core, total = float(rng.uniform(4.1, 4.8)), strip + hall
    length = wanted / 0.955 / total
    if length - core < 12.0:
        return None
    cells: list[Cell] = [("open office", core, strip, length, total)]
    names = list(STRIPS[size])
    rest = names[1:]
    names = [names[0], *(rest[int(k)] for k in rng.permutation(len(rest)))]
    raw = np.array([WIDTHS[name] * rng.uniform(0.93, 1.07) for name in names])
    stops = core + np.concatenate([[0.0], np.cumsum(raw / raw.sum() * (length - core))])
    for name, x0, x1 in zip(names, stops[:-1], stops[1:], strict=True):
        cells.append((name, float(x0), 0.0, float(x1), strip))
    cells.append(("meeting room", 0.0, 0.0, core, strip))
    wc = float(rng.uniform(1.75, 2.0))
    low = strip if rng.random() < 0.5 else total - 2 * wc
    cells += [("toilet", 0.0, low + k * wc, core, low + (k + 1) * wc) for k in range(2)]
    kitchen = (low + 2 * wc, total) if low == strip else (strip, low)
    cells.append(("kitchen", 0.0, kitchen[0], core, kitchen[1]))
    cells = turn_cells(rng, [(n, *(round(v, 2) for v in box)) for n, *box in cells])  # type: ignore[misc]

    def joint(a: Room, b: Room) -> Joint:
        if a.type == "open office":
            if b.type == "reception":
                return Joint("passage", 2.0, top=2.4)
            if b.type in ("meeting room", "office"):
                return Joint("door", glazing=0.85)
            return Joint("door")
        if a.type == "reception" and b.type == "meeting room" and not _touches(b, cells[0]):
            return Joint("door", glazing=0.85)
        return NO_JOINT

    def windows(
        room: Room, wall: Wall, low: float, high: float
    ) -> Sequence[tuple[float, float, float, float]]:
        if room.type in DARK_ROOMS or high - low < 1.4:
            return []
        if room.type == "kitchen":
            return spread_windows(low, high, width=1.3, bottom=1.12, top=2.3, gap=1.2)
        return spread_windows(low, high, width=1.75, bottom=0.86, top=2.4, gap=0.55)

    ceiling = round(float(rng.uniform(2.8, 3.1)), 2)
    return close_cells(
        rng, cells, ceiling=ceiling, joint=joint, windows=windows, entrance="reception"
    )


def _touches(room: Room, cell: Cell) -> bool:
    """Whether a room shares a stretch of wall with a cell."""
    _, x0, y0, x1, y1 = cell
    wide = min(room.x1, x1) - max(room.x0, x0)
    deep = min(room.y1, y1) - max(room.y0, y0)
    return max(wide, deep) > 1.0 and min(wide, deep) > -0.4


def choose_office_finish(
    room: Room, palette: Palette, floor: Material, rng: np.random.Generator
) -> RoomFinish:
    """Carpet tiles under desks, stone or wood in the reception, tiles in the wet rooms."""
    wall = plain(
        "wall paint", "paint", str(rng.choice(["#eceae5", "#e6e7e5", "#ebe7de"])),
        contrast=0.1, scale=0.4, detail=0.0,
    )  # fmt: skip
    walls = dict.fromkeys(SIDES, wall)
    if room.type in ("toilet", "kitchen"):
        tile = palette.tiles(rng, 0.3)
        band = tile if room.type == "toilet" else None
        return RoomFinish(walls, palette.tiles(rng, 0.45), 2.1, band, ceiling=CEILING_TILES)
    if room.type in ("open office", "meeting room", "office", "reception"):
        walls[str(rng.choice(SIDES))] = palette.accent_wall(rng)
    if room.type == "reception":
        return RoomFinish(walls, floor, ceiling=CEILING_TILES)
    if room.type in ("print room", "server room"):
        grey = plain("vinyl", "concrete", "#a3a5a6", second="#8d8f91", contrast=0.2, scale=0.6)
        return RoomFinish(walls, grey, ceiling=CEILING_TILES)
    return RoomFinish(walls, office_carpet(palette), ceiling=CEILING_TILES)


def office_carpet(palette: Palette) -> Material:
    """One carpet for the whole office, of the style's calmest cloth."""
    colour = linear_colour(palette.style.cloths[0])
    return Material(
        name="carpet", pattern="carpet", colour=shade(colour, 1.25), colour2=shade(colour, 0.8),
        scale=0.01, contrast=0.3, seed=3, detail=0.5,
    )  # fmt: skip


def draft_office(
    seed: int, *, size: str = "medium", style: str | Palette | None = None
) -> SceneDraft:
    """A furnished office: geometry, materials, objects, rooms and lamps, before light.

    Args:
        seed: of everything; the same seed gives the same office.
        size: "small", "medium" or "large" (see `SIZES`).
        style: name of one of `palette.STYLES`; drawn when None.

    Raises:
        SceneError: an unknown style, or no walkable office was found (not known to happen).
    """
    palette = choose_palette("office", seed, style)
    plan = plan_office(seed, size)
    rng = random_stream(seed, "office", "taste")
    rooms = OfficeRooms(
        draw_taste(rng, palette),
        float(rng.choice([3500.0, 4000.0, 4500.0])),
        str(rng.choice(COMPANIES)),
    )
    return Building(
        "office", seed, plan, palette, rooms.furnish, choose_office_finish, NEEDED
    ).draft()
