"""What every generated building shares: furnishing it room by room until all can be walked to."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Set
from dataclasses import dataclass, field

import numpy as np

from gn0.errors import SceneError
from gn0.maps.grid import FREE, OccupancyGrid
from gn0.maps.navigation import NavigationMap
from gn0.scenes.occupancy import build_occupancy
from gn0.scenes.procedural.assembly import Assembly, Placed
from gn0.scenes.procedural.draft import SceneDraft, Sun
from gn0.scenes.procedural.forms import check_forms
from gn0.scenes.procedural.layout import RoomLayout
from gn0.scenes.procedural.palette import STYLES, Palette
from gn0.scenes.procedural.plan import FloorPlan, Room
from gn0.scenes.procedural.shell import Finisher, add_shell, choose_finish
from gn0.scenes.scene import SceneOpening, SceneRoom, SceneWall
from gn0.seeds import random_stream

AGENT_RADIUS = 0.20  # m, for which every room must be reachable
DRAWS = 8  # furnishings tried for a room until it has all that it needs
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


def choose_palette(
    kind: str, seed: int, style: str | Palette | None, without: Iterable[str] = ()
) -> Palette:
    """The palette of a named style, or one drawn from the seed; a palette is taken as it is.

    Raises:
        SceneError: an unknown style.
        ConfigError: an unknown form in `without`.
    """
    if isinstance(style, Palette):
        return style
    rng = random_stream(seed, kind, "style")
    names = [s.name for s in STYLES]
    if style is not None and style not in names:
        raise SceneError(f"unknown style {style!r}", remedy=f"use one of {', '.join(names)}")
    chosen = int(rng.integers(len(STYLES))) if style is None else names.index(style)
    return Palette(STYLES[chosen], check_forms(without))


@dataclass
class Building:
    """A building being furnished.

    Each room has its own random stream, so that only a room that cannot be reached is furnished
    again, from its next stream, and at last left with less in it.

    Attributes:
        kind: names the streams.
        seed: of everything.
        plan: rooms, walls and openings.
        palette: of the furniture.
        furnish: fills one room.
        finish: chooses the materials of a room's shell.
        needed: categories without which a room of some type is drawn again.
        sunlit: id of the room into whose window the sun shines; the plan's first by default.
    """

    kind: str
    seed: int
    plan: FloorPlan
    palette: Palette
    furnish: Callable[[RoomLayout], None]
    finish: Finisher = choose_finish
    needed: Mapping[str, Set[str]] = field(default_factory=dict)
    sunlit: str | None = None

    def __post_init__(self) -> None:
        self._tries = dict.fromkeys((room.id for room in self.plan.rooms), 0)
        self._placed: dict[str, list[Placed]] = {}

    def draft(self) -> SceneDraft:
        """The first furnishing that can be walked, the same for the same seed.

        Raises:
            SceneError: none was found (not known to happen).
        """
        for _ in range(ATTEMPTS * len(self._tries)):
            draft = self._assemble()
            reach = check_reach(draft, self.plan)
            if not reach.cut_off:
                return draft
            for id in reach.cut_off:
                self._tries[id] += 1
                self._placed.pop(id, None)
        raise SceneError(
            f"{self.kind} {self.seed}: no walkable furnishing found",
            remedy="use another seed or size",
        )

    def _fill(self, room: Room) -> list[Placed]:
        """What stands in a room at its present try."""
        tries = self._tries[room.id]
        for draw in range(DRAWS):  # until the room has what makes it one
            stream = random_stream(self.seed, self.kind, room.id, tries, draw)
            layout = RoomLayout(self.plan, room, stream, self.palette)
            self.furnish(layout)
            if {p.item.category for p in layout.placed} >= self.needed.get(room.type, set()):
                break
        placed = layout.placed
        if tries >= ATTEMPTS:  # leave out what stands on the floor, last first
            extra = tries - ATTEMPTS + 1
            placed = placed[: max(len(placed) - 3 * extra, 0)]
        return placed

    def _assemble(self) -> SceneDraft:
        plan = self.plan
        assembly = Assembly()
        stream = random_stream(self.seed, self.kind, "shell")
        add_shell(assembly, plan, self.palette, stream, self.finish)
        for room in plan.rooms:
            if room.id not in self._placed:
                self._placed[room.id] = self._fill(room)
            for item in self._placed[room.id]:
                assembly.add_item(item, room.id)
        mesh, materials = assembly.finish()
        sunlit = plan.rooms[0] if self.sunlit is None else plan.room(self.sunlit)
        return SceneDraft(
            mesh=mesh,
            materials=materials,
            objects=tuple(assembly.objects),
            rooms=tuple(scene_room(room) for room in plan.rooms),
            walls=list_walls(plan),
            openings=list_openings(plan),
            lamps=tuple(assembly.lamps),
            sun=_draw_sun(random_stream(self.seed, self.kind, "sun"), plan, sunlit),
            ceiling=plan.ceiling,
        )


def scene_room(room: Room) -> SceneRoom:
    """A rectangular room as scenes record it."""
    corners = ((room.x0, room.y0), (room.x1, room.y0), (room.x1, room.y1), (room.x0, room.y1))
    return SceneRoom(
        id=room.id,
        type=room.type,
        polygon=tuple((round(float(x), 4), round(float(y), 4)) for x, y in corners),
    )


def list_walls(plan: FloorPlan) -> tuple[SceneWall, ...]:
    """The plan's walls as scenes record them."""
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


def list_openings(plan: FloorPlan) -> tuple[SceneOpening, ...]:
    """The plan's doors and windows as scenes record them."""
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
        kind = "WINDOW" if o.bottom > 0 else "DOOR"
        openings.append(SceneOpening(kind=kind, polygon=polygon, thickness=o.thickness))
    return tuple(openings)


def _draw_sun(rng: np.random.Generator, plan: FloorPlan, room: Room) -> Sun:
    """Sunlight that comes in through the windows of a room, 22 to 45 degrees high."""
    window = next((o for o in plan.openings if o.kind == "window" and room.id in o.rooms), None)
    heading = float(rng.uniform(-math.pi, math.pi))
    if window is not None:
        inward = 1.0 if window.rooms[1] == room.id else -1.0
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
