"""Large homes: a day block, a hall lined with rooms, and often a wing at its end."""

from __future__ import annotations

import numpy as np

from gn0.errors import SceneError
from gn0.scenes.procedural.building import Building, choose_palette
from gn0.scenes.procedural.draft import SceneDraft
from gn0.scenes.procedural.palette import Palette
from gn0.scenes.procedural.plan import OPEN_SHARE, Cell, FloorPlan, Room, Wall
from gn0.scenes.procedural.plan_cells import (
    NO_JOINT,
    Joint,
    WindowRule,
    close_cells,
    spread_windows,
    turn_cells,
)
from gn0.scenes.procedural.rooms_home import furnish_home
from gn0.seeds import random_stream

SIZES = {"small": (112.0, 134.0), "medium": (134.0, 166.0), "large": (166.0, 215.0)}  # m²
WIDTHS = {
    "bedroom": 3.7,
    "bathroom": 2.4,
    "study": 3.0,
    "laundry room": 2.1,
    "dining room": 4.0,
    "closet": 2.0,
}
DAY_ROOMS = {"living room", "kitchen", "dining room", "hallway"}
# rooms along the two sides of the hall; a dining room comes first, beside the day block
STRIPS = {
    "small": (
        (("bathroom", "bedroom", "study"), ("dining room", "bedroom", "laundry room")),
        (("bedroom", "bathroom", "bedroom"), ("dining room", "study", "laundry room")),
        (("laundry room", "bathroom", "bedroom"), ("dining room", "bedroom", "study")),
    ),
    "medium": (
        (
            ("bathroom", "bedroom", "bathroom", "bedroom"),
            ("dining room", "laundry room", "study", "bedroom"),
        ),
        (
            ("laundry room", "bedroom", "bathroom", "bedroom"),
            ("dining room", "study", "bathroom", "bedroom"),
        ),
        (
            ("bedroom", "bathroom", "bedroom", "closet"),
            ("dining room", "bathroom", "laundry room", "bedroom"),
        ),
    ),
    "large": (
        (
            ("bathroom", "bedroom", "laundry room", "bedroom"),
            ("dining room", "study", "bathroom", "bedroom"),
        ),
        (
            ("study", "bathroom", "bedroom", "bedroom"),
            ("dining room", "laundry room", "bathroom", "bedroom"),
        ),
    ),
}
NEEDED = {
    "bedroom": {"bed"},
    "kitchen": {"kitchen counter", "fridge"},
    "bathroom": {"toilet", "washbasin"},
    "living room": {"sofa"},
    "study": {"desk"},
    "dining room": {"dining table"},
    "laundry room": {"washing machine"},
}


def plan_residence(seed: int, size: str = "medium", *, open_plan: bool = False) -> FloorPlan:
    """A floor plan of ten to thirteen rooms.

    Args:
        seed: of all choices.
        size: see `SIZES`.
        open_plan: next to nothing is left of the walls between kitchen, living room, dining room
            and hall.

    Raises:
        SceneError: no plan of the wanted area came out (not known to happen).
    """
    low, high = SIZES[size]
    for attempt in range(80):
        rng = random_stream(seed, "residence", "plan", size, attempt)
        wanted = float(rng.uniform(low + 0.15 * (high - low), high - 0.15 * (high - low)))
        plan = _draw_plan(rng, size, wanted, open_plan)
        if plan is not None and low <= plan.area <= high:
            return plan
    raise SceneError(f"residence {seed}: no plan found", remedy="use another seed or size")


def _draw_plan(
    rng: np.random.Generator, size: str, wanted: float, open_plan: bool
) -> FloorPlan | None:
    north, south = STRIPS[size][int(rng.integers(len(STRIPS[size])))]
    hall = float(rng.uniform(1.5, 1.8))
    deep_n, deep_s = float(rng.uniform(3.5, 4.1)), float(rng.uniform(3.6, 4.3))
    block = float(rng.uniform(5.2, 6.4))
    total = deep_n + hall + deep_s
    wing = float(rng.uniform(4.0, 4.6)) if size == "large" else 0.0
    length = wanted / 0.925 / total - block - wing
    cells: list[Cell] = []
    deep_k = float(np.clip(total * rng.uniform(0.36, 0.42), 3.2, 4.2))
    cells.append(("living room", 0.0, 0.0, block, total - deep_k))
    cells.append(("kitchen", 0.0, total - deep_k, block, total))
    end = block + length
    cells.append(("hallway", block, deep_s, end, deep_s + hall))
    for names, y0, y1 in ((north, deep_s + hall, total), (south, 0.0, deep_s)):
        raw = np.array([WIDTHS[name] * rng.uniform(0.92, 1.08) for name in names])
        stops = block + np.concatenate([[0.0], np.cumsum(raw / raw.sum() * length)])
        for name, x0, x1 in zip(names, stops[:-1], stops[1:], strict=True):
            if x1 - x0 < 1.75:
                return None
            cells.append((name, round(float(x0), 2), y0, round(float(x1), 2), y1))
    if wing:
        cut = deep_s + hall
        cells.append(("bedroom", end, 0.0, end + wing, cut))
        split = end + wing * float(rng.uniform(0.52, 0.58))
        cells.append(("bathroom", end, cut, split, total))
        cells.append(("closet", split, cut, end + wing, total))
    cells = turn_cells(rng, [(n, *(round(v, 2) for v in box)) for n, *box in cells])  # type: ignore[misc]
    halls = [c for c in cells if c[0] == "hallway"]

    def at_hall(room: Room) -> bool:
        _, x0, y0, x1, y1 = halls[0]
        e = 0.4
        return (
            room.x0 < x1 + e and room.x1 > x0 - e and room.y0 < y1 + e and room.y1 > y0 - e
        ) and not (
            # meeting only at a corner is no neighbourhood
            (room.x0 > x1 - 1 or room.x1 < x0 + 1) and (room.y0 > y1 - 1 or room.y1 < y0 + 1)
        )

    def joint(a: Room, b: Room) -> Joint:
        types = {a.type, b.type}
        if open_plan and types < DAY_ROOMS:
            return Joint("open", OPEN_SHARE, top=ceiling)
        if "hallway" in types:
            if "living room" in types:
                return Joint("passage", 0.75, top=2.25)
            return Joint("door")
        if types == {"living room", "dining room"}:
            return Joint("passage", 0.55, top=2.25)
        if types == {"living room", "kitchen"}:
            return Joint("passage", 0.35, top=2.25)
        if a.type == "bedroom" and b.type in ("bathroom", "closet") and not at_hall(b):
            return Joint("door")
        return NO_JOINT

    ceiling = round(float(rng.uniform(2.6, 2.9)), 2)

    def close(entrance: str) -> FloorPlan | None:
        windows = _windows(rng, open_plan)
        return close_cells(
            rng, cells, ceiling=ceiling, joint=joint, windows=windows, entrance=entrance
        )

    return close("hallway") or close("living room")


def _windows(rng: np.random.Generator, open_plan: bool) -> WindowRule:
    """One window a wall in small rooms, several in the day rooms; of an open plan in one wall."""
    seen: set[str] = set()

    def windows(
        room: Room, wall: Wall, low: float, high: float
    ) -> list[tuple[float, float, float, float]]:
        if room.type in ("hallway", "closet") or high - low < 1.2:
            return []
        if room.id in seen and (
            room.type not in ("living room", "bedroom")
            or rng.random() < 0.4
            or (open_plan and room.type == "living room")  # the television needs a wall
        ):
            return []
        seen.add(room.id)
        if room.type in ("bathroom", "laundry room"):
            middle = (low + high) / 2
            return [(middle - 0.4, middle + 0.4, 1.35, 2.1)]
        if room.type == "kitchen":
            middle, half = (low + high) / 2, min(0.8, (high - low) / 2 - 0.3)
            return [(middle - half, middle + half, 1.12, 2.15)]
        bottom = float(rng.choice([0.45, 0.8, 0.9]))
        width = float(rng.uniform(1.4, 1.9))
        return spread_windows(low, high, width=width, bottom=bottom, top=2.25, gap=0.75)

    return windows


def draft_residence(
    seed: int,
    *,
    size: str = "medium",
    style: str | Palette | None = None,
    open_plan: bool = False,
) -> SceneDraft:
    """A furnished large home: geometry, materials, objects, rooms and lamps, before light.

    Args:
        seed: of everything; the same seed gives the same home.
        size: "small", "medium" or "large" (see `SIZES`).
        style: name of one of `palette.STYLES`; drawn when None.
        open_plan: see `plan_residence`.

    Raises:
        SceneError: an unknown style, or no walkable home was found (not known to happen).
    """
    palette = choose_palette("residence", seed, style)
    plan = plan_residence(seed, size, open_plan=open_plan)
    return Building("residence", seed, plan, palette, furnish_home, needed=NEEDED).draft()
