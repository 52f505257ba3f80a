"""Semantic targets: what can be a goal, where one stands on arrival, and what to call it."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Literal

import numpy as np
from numpy.typing import NDArray

from gn0.geometry import F64
from gn0.maps.goal_places import GoalSet, points_in_polygon
from gn0.maps.grid import FREE, OccupancyGrid
from gn0.scenes.scene import ObjectBox, Scene, SceneObject, SceneRoom

if TYPE_CHECKING:
    from gn0.maps.navigation import NavigationMap

REACH = 1.5  # m from an object's footprint within which its standing cell must lie
LOWEST_OUT_OF_REACH = 1.8  # m; what hangs above this is not somewhere one goes
NEIGHBOUR_REACH = 2.0  # m within which another object tells two of a kind apart
_OTHER_SIDE, _SIDES_APART = 0.5, 1.5  # m, see `find_standing_cells`
PLACE_HEIGHT = 1.0  # m, of the box that stands for a place or a room
SMALLEST_GOAL = 0.30  # m, longest side: nobody is sent across the house to a cup

# parts of the building and labels that say nothing
NOT_A_GOAL = frozenset((
    "wall", "walls", "floor", "floors", "ceiling", "roof", "door", "doors", "door_frame",
    "doorframe", "window", "windows", "beam", "column", "baseboard", "skirting", "stairs", "other",
    "others", "unknown", "object", "misc", "void", "background", "room", "building", "house",
    "ground", "ground_plane", "ceiling_lamp", "ceiling_light", "chandelier", "downlight", "handle",
    "switch", "socket", "sky", "facade", "grass", "lawn", "path", "paving", "rooflight", "air_vent",
    "smoke_detector", "drain_grate", "balcony", "interior_window", "light_switch", "sprinkler",
    "cable_tray", "handrail", "plinth",
))  # fmt: skip


@dataclass(frozen=True)
class GoalTarget:
    """Something one can go to.

    Attributes:
        object: the instance; a room or a place stands here as a box of its own size.
        goal: centre (x, y) [m] of the nearest safe cell on the object's own side of the walls.
        region: connected region of that cell.
        instruction: what to tell the agent; never empty.
        kind: an object, a room, any object of a category, or an unnamed place of a scene without
            labels.
        goals: all places that its words fit, where there are several, or the areas of rooms.
        places: the instances behind them, rooms in the order of the areas, and where one stands to
            be at each.
        middle: middle of a room, where there is most room; its picture is taken there.
        from_above: whether the bird's-eye view shows it.
        searched: the category, of which any object will do.
    """

    object: SceneObject
    goal: tuple[float, float]
    region: int
    instruction: str
    kind: Literal["object", "room", "category", "place"] = "object"
    goals: GoalSet | None = None
    places: tuple[tuple[SceneObject, tuple[float, float]], ...] = ()
    middle: tuple[float, float] | None = None
    from_above: bool = False
    searched: str = ""

    @property
    def destination(self) -> tuple[float, float] | GoalSet:
        """Whatever counts as the goal."""
        return self.goals or self.goal

    def reached_at(self, x: float, y: float) -> GoalTarget:
        """The same target as a way that ends at (x, y) m comes to it: the instance there."""
        if self.kind in ("object", "category"):
            item = next((o for o, place in self.places if place == (x, y)), self.object)
            return replace(self, object=item, goal=(x, y))
        areas = self.goals.areas if self.goals is not None else ()
        for (room, _), area in zip(self.places, areas, strict=True):
            if (
                room.id != self.object.id
                and points_in_polygon(np.array([(x, y)]), np.array(area))[0]
            ):
                return replace(self, object=room, goal=(x, y), middle=None)
        return replace(self, goal=(x, y))


def distance_to_footprint(points: NDArray[np.floating], item: SceneObject) -> F64:
    """Distance [N] m from points [N, 2] to an object's box seen from above; 0 inside."""
    c, s = np.cos(item.box.yaw), np.sin(item.box.yaw)
    d = np.asarray(points, np.float64).reshape(-1, 2) - np.array(item.box.centre[:2])
    local = np.column_stack([d @ (c, s), d @ (-s, c)])
    outside = np.maximum(np.abs(local) - np.array(item.box.size[:2]) / 2, 0.0)
    return np.hypot(outside[:, 0], outside[:, 1])


def _crosses(a: F64, b: F64, p: F64, q: F64) -> NDArray[np.bool_]:
    """Whether segments a[N]→b crosses segment p→q, properly."""

    def side(o: F64, u: F64, v: F64) -> F64:
        d = u - o
        e = v - o
        return d[..., 0] * e[..., 1] - d[..., 1] * e[..., 0]

    return (side(p, q, a) * side(p, q, b) < 0) & (side(a, b, p) * side(a, b, q) < 0)


def room_box(room: SceneRoom) -> SceneObject:
    """A room as an object: its id, its type, the box round its floor."""
    polygon = np.array(room.polygon, np.float64)
    low, high = polygon.min(axis=0), polygon.max(axis=0)
    x, y = (low + high) / 2
    box = ObjectBox(
        centre=(float(x), float(y), PLACE_HEIGHT / 2),
        size=(float(high[0] - low[0]), float(high[1] - low[1]), PLACE_HEIGHT),
    )
    return SceneObject(id=room.id, category=room.type.strip().lower(), box=box, room=room.id)


def room_of_object(item: SceneObject, rooms: tuple[SceneRoom, ...]) -> SceneRoom | None:
    """The room an object says it is in, else the one whose polygon holds its centre."""
    for room in rooms:
        if room.id == item.room:
            return room
    centre = np.array([item.box.centre[:2]])
    for room in rooms:
        if points_in_polygon(centre, np.array(room.polygon))[0]:
            return room
    return None


def wall_cells(grid: OccupancyGrid, objects: tuple[SceneObject, ...]) -> NDArray[np.bool_]:
    """Blocked cells [H, W] that no goal-worthy object explains: taken for walls."""
    walls = grid.blocked.copy()
    for item in objects:
        if is_goal_worthy(item):
            low, high = item.box.corners().min(axis=0), item.box.corners().max(axis=0)
            (r0, c0), (r1, c1) = grid.cell_of(low[0], low[1]), grid.cell_of(high[0], high[1])
            walls[max(r0 - 1, 0) : r1 + 2, max(c0 - 1, 0) : c1 + 2] = False
    return walls


def sees(grid: OccupancyGrid, walls: NDArray[np.bool_], a: F64, b: F64) -> bool:
    """Whether the straight line a→b [m] meets no wall cell."""
    steps = int(np.hypot(*(b - a)) / grid.resolution * 2) + 2
    cells = grid.cells_of(a + (b - a) * np.linspace(0, 1, steps)[:, None])
    cells = np.clip(cells, 0, (grid.shape[0] - 1, grid.shape[1] - 1))
    return not walls[cells[:, 0], cells[:, 1]].any()


def is_goal_worthy(item: SceneObject) -> bool:
    """Whether one would send somebody to this object."""
    return not why_no_goal(item)


def why_no_goal(item: SceneObject) -> str:
    """Why nobody is sent to this object; "" when one would be."""
    category = item.category.strip().lower()
    if not category:
        return "no category"
    if category.replace(" ", "_") in NOT_A_GOAL:
        return "part of the building, or a label that says nothing"
    if max(item.box.size) < SMALLEST_GOAL:
        return "too small"
    if item.box.centre[2] - item.box.size[2] / 2 > LOWEST_OUT_OF_REACH:
        return "hangs out of reach"
    return ""


def _cells_beside(
    scene: Scene,
    navigation: NavigationMap,
    item: SceneObject,
    reach: float,
    walls: NDArray[np.bool_] | None,
    allowed: NDArray[np.bool_] | None,
) -> tuple[NDArray[np.int64], F64, F64, NDArray[np.bool_] | None]:
    """Safe cells near an object on its own side of the walls.

    Cells [N, 2], their centres [N, 2] m, distances [N] m to its footprint, and the walls [H, W]
    that it must be seen past besides; None where rooms or wall segments have told.
    """
    grid = navigation.inflated
    corners = item.box.corners()[:, :2]
    rows_cols = grid.cells_of(np.array([corners.min(axis=0) - reach, corners.max(axis=0) + reach]))
    (r0, c0), (r1, c1) = np.clip(rows_cols, 0, (grid.shape[0] - 1, grid.shape[1] - 1))
    window = slice(r0, r1 + 1), slice(c0, c1 + 1)
    block = grid.cells[window] == FREE if allowed is None else allowed[window]
    cells = np.argwhere(block) + np.array([r0, c0])
    if not len(cells):
        return cells, np.zeros((0, 2)), np.zeros(0), None
    points = grid.centres_of(cells)
    centre = np.array(item.box.centre[:2])
    away = distance_to_footprint(points, item)
    keep = away <= reach
    room = room_of_object(item, scene.rooms)
    if room is not None:
        keep &= points_in_polygon(points, np.array(room.polygon))
    low = np.minimum(points.min(axis=0), centre)
    high = np.maximum(points.max(axis=0), centre)
    for wall in scene.walls:
        a, b = np.array(wall.a), np.array(wall.b)
        if (np.maximum(a, b) >= low).all() and (np.minimum(a, b) <= high).all():
            keep &= ~_crosses(points, centre[None], a, b)
    solid = None
    if room is None and not scene.walls:
        solid = walls if walls is not None else wall_cells(navigation.grid, scene.objects)
    return cells[keep], points[keep], away[keep], solid


def find_standing_cell(
    scene: Scene,
    navigation: NavigationMap,
    item: SceneObject,
    *,
    reach: float = REACH,
    walls: NDArray[np.bool_] | None = None,
    allowed: NDArray[np.bool_] | None = None,
) -> tuple[float, float] | None:
    """The safe cell (x, y) [m] nearest to an object on its own side of the walls, or None.

    Paper, Alg. 'Goal Target Construction and Safe Goal Snapping' (FindNearestSafe). Rooms decide
    the side where they are known, else wall segments, else blocked cells that are no object.
    `allowed` [H, W] narrows the choice of safe cells, as to those of one component.
    """
    found = find_standing_cells(
        scene, navigation, item, 1, reach=reach, walls=walls, allowed=allowed
    )
    return found[0] if found else None


def find_standing_cells(
    scene: Scene,
    navigation: NavigationMap,
    item: SceneObject,
    most: int,
    *,
    reach: float = REACH,
    walls: NDArray[np.bool_] | None = None,
    allowed: NDArray[np.bool_] | None = None,
) -> list[tuple[float, float]]:
    """Safe cells round an object, the nearest first; see `find_standing_cell`.

    Those after the first are hardly farther from it (0.5 m) and lie 1.5 m apart: its other sides.
    """
    cells, points, away, solid = _cells_beside(scene, navigation, item, reach, walls, allowed)
    centre = np.array(item.box.centre[:2])
    from_centre = np.hypot(*(points - centre).T)
    order = np.lexsort((cells[:, 1], cells[:, 0], from_centre, away))
    found: list[tuple[float, float]] = []
    nearest = 0.0
    for i in order:
        x, y = float(points[i, 0]), float(points[i, 1])
        if found and away[i] > nearest + _OTHER_SIDE:
            break
        if any(math.hypot(x - a, y - b) < _SIDES_APART for a, b in found):
            continue
        if solid is not None and not sees(navigation.grid, solid, points[i], centre):
            continue
        nearest = float(away[i]) if not found else nearest
        found.append((x, y))
        if len(found) == most:
            break
    return found


def find_view_points(
    scene: Scene,
    navigation: NavigationMap,
    item: SceneObject,
    *,
    reach: float,
    farthest: float,
    spacing: float,
    walls: NDArray[np.bool_] | None = None,
    allowed: NDArray[np.bool_] | None = None,
) -> list[tuple[float, float]]:
    """Safe cells (x, y) [m] all round an object, on its own side of the walls.

    Every cell is within `spacing` / √2 of one of them, but for slivers: they lie on a lattice that
    all objects of a scene share. Where no cell of the lattice is safe in reach, the nearest safe
    cell of all, if it is near enough.

    Args:
        scene: rooms, walls and objects.
        navigation: where one may stand.
        item: the object.
        reach: their largest distance from its footprint [m].
        farthest: that of the one cell that is taken where there is none in reach [m].
        spacing: spacing of the lattice [m].
        walls: see `find_standing_cell`.
        allowed: [H, W] cells to choose from instead of all safe ones.
    """
    cells, points, away, solid = _cells_beside(scene, navigation, item, farthest, walls, allowed)
    step = max(round(spacing / navigation.inflated.resolution), 1)
    centre = np.array(item.box.centre[:2])
    nearest = np.lexsort((cells[:, 1], cells[:, 0], away))
    found = [
        (float(points[i, 0]), float(points[i, 1]))
        for i in nearest
        if away[i] <= reach
        and (cells[i] % step == 0).all()
        and (solid is None or sees(navigation.grid, solid, points[i], centre))
    ]
    if found:
        return found
    for i in nearest:
        if solid is None or sees(navigation.grid, solid, points[i], centre):
            return [(float(points[i, 0]), float(points[i, 1]))]
    return []
