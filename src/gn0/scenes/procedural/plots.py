"""Large undivided floors: halls and yards whose parts are zones instead of walled rooms.

A zone becomes a `SceneRoom`, so that instructions can say "in the dairy section" or "on the lawn".
Zones are axis-parallel rectangles that do not overlap. Things are put at exact places, or
scattered where nothing stands yet; a scene in which some zone cannot be reached is drawn again
with less scattered in it.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from gn0.errors import SceneError
from gn0.scenes.procedural.assembly import Assembly, Item, Placed
from gn0.scenes.procedural.building import check_reach, list_openings, list_walls, scene_room
from gn0.scenes.procedural.draft import SceneDraft, Sky, Sun
from gn0.scenes.procedural.layout import Rect, footprint, overlaps
from gn0.scenes.procedural.plan import Cell, FloorPlan, Opening, Room, build_walls, clear_room

ATTEMPTS = 10  # drawings of a floor before giving up; each scatters less


def plan_hall(cells: Sequence[Cell], openings: Sequence[Opening], ceiling: float) -> FloorPlan:
    """Rooms and walls of cells given on wall centre lines, with ready openings.

    Ids of rooms are their types, which must differ.
    """
    ids = [cell[0].replace(" ", "_") for cell in cells]
    walls = build_walls(list(cells), ids)
    rooms = tuple(clear_room(cell, id, walls) for cell, id in zip(cells, ids, strict=True))
    return FloorPlan(rooms, tuple(walls), tuple(openings), ceiling)


@dataclass
class Plot:
    """A floor that is being filled.

    Attributes:
        rng: random stream.
        zones: rectangles that become rooms.
        effort: share of the scattered things that is really put, 0..1.
        assembly: collects geometry and objects.
        taken: floor that is covered.
        keep: floor that must stay free of scattered things.
    """

    rng: np.random.Generator
    zones: list[Room]
    effort: float = 1.0
    assembly: Assembly = field(default_factory=Assembly)
    taken: list[Rect] = field(default_factory=list)
    keep: list[Rect] = field(default_factory=list)

    def zone_at(self, x: float, y: float) -> str | None:
        """Id of the zone that holds a point."""
        return next((z.id for z in self.zones if z.contains(x, y)), None)

    def put(
        self,
        item: Item,
        x: float,
        y: float,
        yaw: float = 0.0,
        *,
        z: float = 0.0,
        solid: bool = True,
        front: float | None = None,
        zone: str | None = None,
    ) -> Placed:
        """Put an item at a place without asking.

        Args:
            item: front towards −y.
            x: of its origin [m].
            y: of its origin [m].
            yaw: its turn [rad].
            z: its height [m].
            solid: whether it covers floor.
            front: the item belongs to the zone so far before its front [m]; to the zone of its
                origin when None.
            zone: the zone, when it is known.
        """
        placed = Placed(item, round(x, 4), round(y, 4), round(z, 4), yaw)
        if zone is None:
            reach = 0.0 if front is None else front - float(item.full_extent()[0][1])
            zone = self.zone_at(x + math.sin(yaw) * reach, y - math.cos(yaw) * reach)
        self.assembly.add_item(placed, zone)
        if solid:
            self.taken.append(footprint(placed))
        return placed

    def is_free(self, rect: Rect, margin: float = 0.0, *, ignore_keep: bool = False) -> bool:
        """Whether nothing stands within `margin` [m] of a rectangle."""
        grown = (rect[0] - margin, rect[1] - margin, rect[2] + margin, rect[3] + margin)
        if any(overlaps(grown, other, 1e-4) for other in self.taken):
            return False
        return ignore_keep or not any(overlaps(rect, other, 1e-4) for other in self.keep)

    def scatter(
        self,
        make: Callable[[], Item],
        count: int,
        within: Rect,
        *,
        margin: float = 0.75,
        turn: Sequence[float] = (0.0,),
        jitter: float = 0.0,
        foot: float | None = None,
        tries: int = 24,
    ) -> int:
        """Put up to `count` items at random free places of a rectangle; how many found one.

        `margin` is the clear way round each [m], `turn` the yaws to choose from, `jitter` their
        random spread [rad]. A `foot` [m] is half the width of what covers the floor when the rest
        is overhead, as with trees.
        """
        done = 0
        for _ in range(count):
            item = make()
            if self.rng.random() > self.effort:
                continue
            for _ in range(tries):
                yaw = float(self.rng.choice(turn)) + float(
                    self.rng.normal(0, jitter) * (jitter > 0)
                )
                origin = footprint(Placed(item, 0, 0, 0, yaw))
                if foot is not None:
                    origin = (-foot, -foot, foot, foot)
                x0, x1 = within[0] - origin[0], within[2] - origin[2]
                y0, y1 = within[1] - origin[1], within[3] - origin[3]
                if x1 < x0 or y1 < y0:
                    continue
                x, y = float(self.rng.uniform(x0, x1)), float(self.rng.uniform(y0, y1))
                rect = (origin[0] + x, origin[1] + y, origin[2] + x, origin[3] + y)
                if self.is_free(rect, margin):
                    self.put(item, x, y, yaw, solid=False)
                    self.taken.append(rect)
                    done += 1
                    break
        return done

    def try_put(
        self, item: Item, x: float, y: float, yaw: float = 0.0, *, margin: float = 0.0
    ) -> bool:
        """Put an item at a place when that is free."""
        if not self.is_free(footprint(Placed(item, x, y, 0, yaw)), margin, ignore_keep=True):
            return False
        self.put(item, x, y, yaw)
        return True

    def finish(
        self,
        plan: FloorPlan,
        *,
        sun: Sun | None,
        sky: Sky | None = None,
    ) -> SceneDraft:
        """The draft: walls and openings from the plan, rooms from the zones."""
        mesh, materials = self.assembly.finish()
        return SceneDraft(
            mesh=mesh,
            materials=materials,
            objects=tuple(self.assembly.objects),
            rooms=tuple(scene_room(zone) for zone in self.zones),
            walls=list_walls(plan),
            openings=list_openings(plan),
            lamps=tuple(self.assembly.lamps),
            sun=sun,
            ceiling=plan.ceiling,
            sky=sky,
        )


def draw_walkable(
    name: str, zones: Sequence[Room], plan: FloorPlan, draw: Callable[[int, float], SceneDraft]
) -> SceneDraft:
    """The first drawing in which every zone can be reached.

    Args:
        name: of the scene, for the error.
        zones: that must be reached.
        plan: gives the ceiling.
        draw: makes a draft from the number of the attempt and the effort of scattering.

    Raises:
        SceneError: no drawing can be walked (not known to happen).
    """
    whole = replace(plan, rooms=tuple(zones), walls=(), openings=())
    cut: tuple[str, ...] = ()
    for attempt in range(ATTEMPTS):
        draft = draw(attempt, 1.0 - attempt / ATTEMPTS)
        reach = check_reach(draft, whole)
        if not reach.cut_off and reach.share > 0.98:
            return draft
        cut = reach.cut_off
    raise SceneError(
        f"{name}: no walkable layout found (cut off: {', '.join(cut) or 'small patches'})",
        remedy="use another seed or size",
    )
