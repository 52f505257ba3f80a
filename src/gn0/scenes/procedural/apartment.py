"""From a seed to a furnished flat whose rooms can all be walked to."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from gn0.errors import SceneError
from gn0.maps.grid import FREE, OccupancyGrid
from gn0.maps.navigation import NavigationMap
from gn0.scenes.occupancy import build_occupancy
from gn0.scenes.procedural.draft import SceneDraft, Sun
from gn0.scenes.procedural.layout import RoomLayout
from gn0.scenes.procedural.palette import STYLES, Palette
from gn0.scenes.procedural.parts import Assembly
from gn0.scenes.procedural.plan import FloorPlan, plan_apartment
from gn0.scenes.procedural.rooms import furnish_room
from gn0.scenes.procedural.shell import add_shell
from gn0.scenes.scene import SceneOpening, SceneRoom, SceneWall
from gn0.seeds import random_stream

AGENT_RADIUS = 0.20  # m, for which every room must be reachable
DRAWS = 8  # furnishings tried for a room until it has all that it needs
NEEDED = {
    "bedroom": {"bed"},
    "kitchen": {"kitchen counter", "fridge"},
    "bathroom": {"toilet", "washbasin"},
    "living room": {"sofa"},
    "study": {"desk"},
}
ATTEMPTS = 6  # of furnishing an offending room before it is left emptier


@dataclass(frozen=True)
class Reach:
    """What an agent of `AGENT_RADIUS` can reach.

    Attributes:
        cut_off: ids of rooms whose free floor is not connected to the hall, or is too small.
        share: part of the inflated free cells that belongs to the main region.
    """

    cut_off: tuple[str, ...]
    share: float


def check_reach(draft: SceneDraft, plan: FloorPlan, grid: OccupancyGrid | None = None) -> Reach:
    """Which rooms an agent cannot reach from the hall."""
    grid = build_occupancy(draft.mesh) if grid is None else grid
    navigation = NavigationMap(grid, AGENT_RADIUS)
    free = np.argwhere(navigation.inflated.cells == FREE)
    xy = grid.centres_of(free)
    regions = navigation.regions[free[:, 0], free[:, 1]]
    if not len(regions):
        return Reach(tuple(r.id for r in plan.rooms), 0.0)
    main = int(np.bincount(regions[regions >= 0]).argmax())
    cut_off = []
    for room in plan.rooms:
        inside = (
            (xy[:, 0] > room.x0)
            & (xy[:, 0] < room.x1)
            & (xy[:, 1] > room.y0)
            & (xy[:, 1] < room.y1)
        )
        mine = (regions[inside] == main).sum() * grid.resolution**2
        if mine < 0.3 or mine < 0.8 * inside.sum() * grid.resolution**2:
            cut_off.append(room.id)
    return Reach(tuple(cut_off), float((regions == main).mean()))


def draft_apartment(seed: int, *, size: str = "medium", style: str | None = None) -> SceneDraft:
    """A furnished flat: geometry, materials, objects, rooms and lamps, before light.

    A room that turns out not to be reachable is furnished again from another stream, and at
    last left with less in it; the same seed gives the same flat.

    Args:
        seed: of everything.
        size: "small", "medium" or "large" (see `plan.SIZES`).
        style: name of one of `palette.STYLES`; drawn when None.

    Raises:
        SceneError: an unknown style, or no walkable flat was found (not known to happen).
    """
    rng = random_stream(seed, "apartment", "style")
    names = [s.name for s in STYLES]
    if style is not None and style not in names:
        raise SceneError(f"unknown style {style!r}", remedy=f"use one of {', '.join(names)}")
    chosen = STYLES[int(rng.integers(len(STYLES))) if style is None else names.index(style)]
    palette = Palette(chosen)
    plan = plan_apartment(seed, size)
    tries = dict.fromkeys((room.id for room in plan.rooms), 0)
    for _ in range(ATTEMPTS * len(tries)):
        draft = _assemble(seed, plan, palette, tries)
        reach = check_reach(draft, plan)
        if not reach.cut_off:
            return draft
        for id in reach.cut_off:
            tries[id] += 1
    raise SceneError(
        f"apartment {seed}: no walkable furnishing found", remedy="use another seed or size"
    )


def _assemble(seed: int, plan: FloorPlan, palette: Palette, tries: dict[str, int]) -> SceneDraft:
    """The flat with each room furnished by its own stream."""
    assembly = Assembly()
    add_shell(assembly, plan, palette, random_stream(seed, "apartment", "shell"))
    for room in plan.rooms:
        for draw in range(DRAWS):  # until the room has what makes it one
            stream = random_stream(seed, "apartment", room.id, tries[room.id], draw)
            layout = RoomLayout(plan, room, stream, palette)
            furnish_room(layout)
            if {p.item.category for p in layout.placed} >= NEEDED.get(room.type, set()):
                break
        placed = layout.placed
        if tries[room.id] >= ATTEMPTS:  # leave out what stands on the floor, last first
            extra = tries[room.id] - ATTEMPTS + 1
            placed = placed[: max(len(placed) - 3 * extra, 0)]
        for item in placed:
            assembly.add_item(item, room.id)
    mesh, materials = assembly.finish()
    rng = random_stream(seed, "apartment", "sun")
    return SceneDraft(
        mesh=mesh,
        materials=materials,
        objects=tuple(assembly.objects),
        rooms=tuple(
            SceneRoom(
                id=r.id,
                type=r.type,
                polygon=tuple(
                    (round(float(x), 4), round(float(y), 4))
                    for x, y in ((r.x0, r.y0), (r.x1, r.y0), (r.x1, r.y1), (r.x0, r.y1))
                ),
            )
            for r in plan.rooms
        ),
        walls=_list_walls(plan),
        openings=_list_openings(plan),
        lamps=tuple(assembly.lamps),
        sun=_draw_sun(rng, plan),
        ceiling=plan.ceiling,
    )


def _list_walls(plan: FloorPlan) -> tuple[SceneWall, ...]:
    walls = []
    for w in plan.walls:
        a, b = ((w.low, w.at), (w.high, w.at)) if w.axis == "x" else ((w.at, w.low), (w.at, w.high))
        walls.append(
            SceneWall(
                a=(float(a[0]), float(a[1])),
                b=(float(b[0]), float(b[1])),
                thickness=w.thickness,
                height=plan.ceiling,
            )
        )
    return tuple(walls)


def _list_openings(plan: FloorPlan) -> tuple[SceneOpening, ...]:
    openings = []
    for o in plan.openings:
        ends = [(t, o.at) if o.axis == "x" else (o.at, t) for t in (o.low, o.high)]
        polygon = tuple(
            (round(float(x), 4), round(float(y), 4), float(z))
            for (x, y), z in (
                (ends[0], o.bottom),
                (ends[1], o.bottom),
                (ends[1], o.top),
                (ends[0], o.top),
            )
        )
        kind = "WINDOW" if o.kind == "window" else "DOOR"
        openings.append(SceneOpening(kind=kind, polygon=polygon, thickness=o.thickness))
    return tuple(openings)


def _draw_sun(rng: np.random.Generator, plan: FloorPlan) -> Sun:
    """Sunlight that comes in through the living room's windows, 22 to 45 degrees high."""
    living = plan.rooms[0]
    window = next((o for o in plan.openings if o.kind == "window" and living.id in o.rooms), None)
    heading = float(rng.uniform(-math.pi, math.pi))
    if window is not None:
        inward = 1.0 if window.rooms[1] == living.id else -1.0
        base = math.atan2(inward, 0.0) if window.axis == "x" else math.atan2(0.0, inward)
        heading = base + float(rng.uniform(-0.9, 0.9))
    height = math.radians(float(rng.uniform(22, 45)))
    c = math.cos(height)
    direction = (
        round(c * math.cos(heading), 6),
        round(c * math.sin(heading), 6),
        round(-math.sin(height), 6),
    )
    return Sun(direction=direction, colour=(7.5, 6.6, 5.2))
