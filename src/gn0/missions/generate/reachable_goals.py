"""Algorithm 1: which goals of a scene can be reached, and why the others cannot.

Objects come from labels, rooms from floor polygons. A scene where neither gives a goal has places:
cells spread over its walkable ground, which can only be told by their picture.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from gn0.missions.alike import GoalGatherer
from gn0.missions.generate.object_search import build_searches
from gn0.missions.generate.settings import MissionSettings
from gn0.missions.targets import (
    PLACE_HEIGHT,
    GoalTarget,
    find_standing_cell,
    points_in_polygon,
    room_box,
    wall_cells,
    why_no_goal,
)
from gn0.scenes.scene import ObjectBox, Scene, SceneObject, SceneRoom

if TYPE_CHECKING:
    from gn0.maps.navigation import NavigationMap

AREA_A_PLACE = 6.0  # m² of walkable ground for each place of a scene without labels
FEWEST_PLACES, MOST_PLACES = 4, 64
NAMELESS = frozenset(("", "room", "unknown", "other", "others", "area", "undefined", "misc"))
PLACE_TEXT = "Go to the place in the goal picture."

NO_CELL = "no safe ground in reach on its side of the walls"
SMALL_COMPONENT = "its ground is too small a component"


@dataclass(frozen=True)
class TargetPool:
    """The goals of a scene.

    Attributes:
        targets: what one can be sent to.
        considered: objects, rooms and places looked at.
        fell: why the others are no goals, and how many.
        unreachable: ids of those that would be goals, had they ground to stand on.
        note: what a reader of the manifest should know; "" when nothing.
    """

    targets: tuple[GoalTarget, ...]
    considered: int
    fell: dict[str, int]
    unreachable: tuple[str, ...]
    note: str = ""


def build_pool(
    scene: Scene,
    safe: NavigationMap,
    settings: MissionSettings,
    ground: NavigationMap | None = None,
) -> TargetPool:
    """All goals of a scene (paper, Alg. 'Goal Target Construction and Safe Goal Snapping').

    Args:
        scene: labels, rooms, walls.
        safe: the map inflated by radius and margin.
        settings: reach, smallest component and kinds of goals.
        ground: the map inflated by the radius alone, where one can stand beside a twin, too.
    """
    fell: Counter[str] = Counter()
    lost: list[str] = []
    found: list[GoalTarget] = []

    large = np.flatnonzero(safe.region_areas >= settings.smallest_component)
    allowed = np.isin(safe.regions, large)

    def lose(item: SceneObject, why: str) -> None:
        fell[why] += 1
        lost.append(item.id)

    def offer(item: SceneObject, goal: tuple[float, float], kind: str) -> None:
        target = GoalTarget(item, goal, safe.region_of(*goal), "", kind)  # type: ignore[arg-type]
        found.append(gatherer.complete(target))

    walls = wall_cells(safe.grid, scene.objects)
    gatherer = GoalGatherer(scene, safe, settings.reach, walls, ground)
    considered = 0
    if settings.goals == "categories":
        searches, refused = build_searches(scene, safe, allowed, settings.categories or ())
        found += searches
        considered += len(searches) + len(refused)
        fell.update(refused.values())
        lost += sorted(refused)
    if settings.goals in ("objects", "both"):
        for item in scene.objects:
            considered += 1
            why = why_no_goal(item)
            if why:
                fell[why] += 1
                continue
            goal = find_standing_cell(
                scene, safe, item, reach=settings.reach, walls=walls, allowed=allowed
            )
            if goal is not None:
                offer(item, goal, "object")
            elif find_standing_cell(scene, safe, item, reach=settings.reach, walls=walls):
                lose(item, SMALL_COMPONENT)
            else:
                lose(item, NO_CELL)
    if settings.goals in ("rooms", "both"):
        for room in scene.rooms:
            considered += 1
            kind = room.type.strip().lower()
            if kind in NAMELESS:
                fell["a room of no known type"] += 1
            else:
                middle = find_room_middle(safe, room, allowed)
                if middle is not None:
                    offer(room_box(room), middle, "room")
                else:
                    lose(room_box(room), NO_CELL)
    note = ""
    if settings.goals == "categories":
        if not found:
            note = "nothing to search for: " + (
                "no object is of a category that is searched for"
                if scene.objects
                else "no labelled objects"
            )
    elif not found:
        why = "no labels and no rooms"
        if considered:
            why = f"none of {considered} labelled objects and rooms can be a goal"
        found = build_places(safe, settings.smallest_component)
        note = f"{why}: {len(found)} unnamed places serve as goals"
        considered += len(found)
    elif not scene.objects:
        note = f"no labelled objects: {len(found)} rooms serve as goals"
    return TargetPool(tuple(found), considered, dict(sorted(fell.items())), tuple(lost), note)


def find_room_middle(
    safe: NavigationMap, room: SceneRoom, allowed: NDArray[np.bool_]
) -> tuple[float, float] | None:
    """The allowed cell (x, y) [m] of a room that is farthest from everything; None without one.

    It lies in the component that holds most of the room.
    """
    polygon = np.array(room.polygon, np.float64)
    grid = safe.inflated
    ends = grid.cells_of(np.array([polygon.min(axis=0), polygon.max(axis=0)]))
    (r0, c0), (r1, c1) = np.clip(ends, 0, (grid.shape[0] - 1, grid.shape[1] - 1))
    cells = np.argwhere(allowed[r0 : r1 + 1, c0 : c1 + 1]) + np.array([r0, c0])
    cells = cells[points_in_polygon(grid.centres_of(cells), polygon)]
    if not len(cells):
        return None
    regions = safe.regions[cells[:, 0], cells[:, 1]]
    cells = cells[regions == np.bincount(regions).argmax()]
    best = int(np.argmax(safe.clearance[cells[:, 0], cells[:, 1]]))
    return grid.centre_of(int(cells[best, 0]), int(cells[best, 1]))


def build_places(safe: NavigationMap, smallest: float) -> list[GoalTarget]:
    """Places spread over the walkable ground: each as far from the others as can be.

    The first is where there is most room; their number follows the area.
    """
    grid = safe.inflated
    large = np.flatnonzero(safe.region_areas >= max(smallest, 1e-9))
    cells: NDArray[np.int64] = np.argwhere(np.isin(safe.regions, large))
    if not len(cells):
        return []
    points = grid.centres_of(cells)
    area = len(cells) * grid.resolution**2
    count = min(max(round(area / AREA_A_PLACE), FEWEST_PLACES), MOST_PLACES, len(cells))
    room = safe.clearance[cells[:, 0], cells[:, 1]]
    chosen = [int(np.argmax(room))]
    away = np.hypot(*(points - points[chosen[0]]).T)
    while len(chosen) < count:
        # half a wish for room: a corner is the farthest point, but nowhere to go
        best = int(np.argmax(np.minimum(away, 4.0 * room)))
        chosen.append(best)
        away = np.minimum(away, np.hypot(*(points - points[best]).T))
    places = []
    for number, k in enumerate(chosen):
        x, y = (float(v) for v in points[k])
        box = ObjectBox(centre=(x, y, PLACE_HEIGHT / 2), size=(0.5, 0.5, PLACE_HEIGHT))
        item = SceneObject(id=f"place_{number:02d}", category="place", box=box)
        region = int(safe.regions[cells[k, 0], cells[k, 1]])
        places.append(GoalTarget(item, (x, y), region, PLACE_TEXT, "place"))
    return places
