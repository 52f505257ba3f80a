"""Distance fields: exact octile distances, and any-angle geodesics for metrics.

Octile lengths (paths of straight and diagonal moves) overstate a true shortest path by up to 8 %.
A metric that divides by them would flatter whoever cuts the staircase, so `GeodesicField` measures
round the obstacles themselves, taken as the union of blocked cell squares.
"""

from __future__ import annotations

import math
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from gn0.errors import PlanError
from gn0.geometry import F64
from gn0.jit import njit
from gn0.maps.astar import COL_STEP, MOVE_COST, ROW_STEP, build_moves
from gn0.maps.goal_places import GoalSet, GoalSetInner
from gn0.maps.grid import FREE, OccupancyGrid
from gn0.maps.path_smoothing import follow_corners
from gn0.maps.visibility import build_corners, build_runs, spread_distances


@njit
def _spread_octile(moves, height, width, goal):  # type: ignore[no-untyped-def]
    """Dijkstra with buckets as wide as the shortest edge: none in a bucket improves another."""
    n = height * width
    field = np.full(n, np.inf)
    # three buckets hold all open cells, as no edge is longer than √2; a cell enters at most once
    # for each neighbour
    lists = np.empty((3, 8 * n + 8), np.int32)
    sizes = np.zeros(3, np.int64)
    field[goal] = 0.0
    lists[0, 0] = goal
    sizes[0] = 1
    level = 0
    empty = 0
    steps = ROW_STEP * width + COL_STEP
    while empty < 3:
        slot = level % 3
        empty = empty + 1 if sizes[slot] == 0 else 0
        for i in range(sizes[slot]):
            node = lists[slot, i]
            here = field[node]
            if here < level:  # settled in an earlier bucket
                continue
            bits = moves[node]
            for k in range(8):
                if (bits >> k) & 1:
                    near = node + steps[k]
                    cost = here + MOVE_COST[k]
                    if cost < field[near]:
                        field[near] = cost
                        target = int(cost) % 3
                        lists[target, sizes[target]] = near
                        sizes[target] += 1
        sizes[slot] = 0
        level += 1
    return field


def build_octile_field(grid: OccupancyGrid, goal: tuple[int, int]) -> F64:
    """Length [H, W] m of the shortest 8-connected path, without corner cutting, to a goal cell.

    Args:
        grid: occupied and unknown cells are blocked.
        goal: (row, col).

    Returns:
        float64 [H, W]; inf in blocked and unreachable cells.

    Raises:
        PlanError: the goal is blocked or outside the grid.
    """
    row, col = int(goal[0]), int(goal[1])
    if not (grid.contains(row, col) and grid.cells[row, col] == FREE):
        raise PlanError(
            f"goal cell ({row}, {col}) is blocked or outside the grid",
            remedy="move it to the nearest free cell first",
        )
    height, width = grid.shape
    field = _spread_octile(build_moves(grid.blocked), height, width, row * width + col)
    return field.reshape(height, width) * grid.resolution


@njit
def _look_up(points, origin_x, origin_y, resolution, label, roots, out):  # type: ignore[no-untyped-def]
    height, width = label.shape
    for i in range(len(points)):
        u = (points[i, 0] - origin_x) / resolution
        v = (points[i, 1] - origin_y) / resolution
        out[i] = np.inf
        if 0 <= u < width and 0 <= v < height:
            root = label[int(v), int(u)]
            if root >= 0:
                dx, dy = u - roots[root, 0], v - roots[root, 1]
                away = roots[root, 2] + math.sqrt(dx * dx + dy * dy)  # −inf in an area
                out[i] = max(away, 0.0) * resolution


class GeodesicMap:
    """What all geodesic fields of one grid share: runs and convex corners.

    Args:
        grid: occupied and unknown cells are obstacles; inflate it first for an agent with a body.
    """

    def __init__(self, grid: OccupancyGrid) -> None:
        self.grid = grid
        self.blocked = grid.blocked
        self.runs = (self.blocked, *build_runs(self.blocked))
        self.corners = build_corners(self.blocked)

    def build_field(self, goal: tuple[float, float] | GoalSet) -> GeodesicField:
        """The distance field of a goal (x, y) m, or of the nearest place of a set.

        Raises:
            PlanError: the goal is not finite, or not in a free cell; of a set, no place is.
        """
        return GeodesicField(self, goal)


class GeodesicField:
    """Any-angle geodesic distance from every point of a grid to a goal, or the nearest of several.

    At cell centres the distance is the exact shortest path round the blocked squares. A point
    elsewhere in a cell is measured through the root of its cell's centre, which is at most one cell
    diagonal off and never less than the straight line.

    Attributes:
        goal: (x, y) m; of several, the first.
        goals: [K, 2] m; of areas, the centres of the cells through which one enters them.
        inside: [H, W] cells at distance 0, for a goal that is an area; else None.
        label: [H, W] int32 index of the last bend before each cell, −1 where unreachable.
        roots: [R, 3] bends as (x, y, distance to the goal) in cells; row 0 … K−1 are the goals. In
            areas, row K stands for all cells inside, at −inf.
        parents: [R] int32 next bend towards the goal, −1 for the goals themselves.
    """

    def __init__(self, geodesic_map: GeodesicMap, goal: tuple[float, float] | GoalSet) -> None:
        grid = geodesic_map.grid
        self.grid = grid
        self.inside: NDArray[np.bool_] | None = None
        if isinstance(goal, GoalSet) and goal.areas:
            self.inside, self.goals = _enter_areas(grid, goal)
        else:
            self.goals = _free_goals(grid, goal)
        # for rows in another order of memory each kernel that takes them would be compiled again
        self.goals = np.ascontiguousarray(self.goals)
        self.goal = (float(self.goals[0, 0]), float(self.goals[0, 1]))
        s = grid.resolution
        self.label, self.roots, self.parents = spread_distances(
            geodesic_map.runs,
            geodesic_map.corners,
            (self.goals - (float(grid.origin[0]), float(grid.origin[1]))) / s,
            np.zeros((0, 0), np.bool_) if self.inside is None else self.inside,
        )

    def is_inside(self, x: float, y: float) -> bool:
        """Whether a point (x, y) m is in a goal that is an area; never in one that is not."""
        if self.inside is None or not (math.isfinite(x) and math.isfinite(y)):
            return False
        row, col = self.grid.cell_of(x, y)
        return bool(self.grid.contains(row, col) and self.inside[row, col])

    def straight(self, points: NDArray[np.floating]) -> F64:
        """Straight distances [N] m of points [N, 2] m to the nearest goal; 0 in an area."""
        p = np.asarray(points, np.float64).reshape(-1, 2)
        away = np.full(len(p), np.inf)
        for goal in self.goals:
            away = np.minimum(away, np.hypot(*(p - goal).T))
        if self.inside is not None:
            away[[self.is_inside(x, y) for x, y in p.tolist()]] = 0.0
        return away

    def distance(self, points: NDArray[np.floating]) -> F64:
        """Distances [N] m of points [N, 2] m; inf in blocked or unreachable cells and outside."""
        p = np.ascontiguousarray(points, np.float64).reshape(-1, 2)
        out = np.empty(len(p))
        x, y = self.grid.origin
        _look_up(p, float(x), float(y), float(self.grid.resolution), self.label, self.roots, out)
        return out

    def distance_at(self, x: float, y: float) -> float:
        """Distance [m] of one point; inf where unreachable."""
        return float(self.distance(np.array([[x, y]]))[0])

    @cached_property
    def cells(self) -> F64:
        """Distances [H, W] m of all cell centres; inf in blocked and unreachable cells."""
        rows, cols = np.indices(self.label.shape)
        roots = self.roots[np.maximum(self.label, 0)]
        field = roots[..., 2] + np.hypot(cols + 0.5 - roots[..., 0], rows + 0.5 - roots[..., 1])
        return np.where(self.label >= 0, np.maximum(field, 0.0) * self.grid.resolution, np.inf)

    def bends(self, x: float, y: float) -> F64:
        """The taut polyline [N, 2] m from a point to the goal, bending on obstacle corners.

        Its inner points are corners of blocked cells: good for measuring and drawing, not for
        driving; see `path`.

        Raises:
            PlanError: the goal cannot be reached from here.
        """
        row, col = self.grid.cell_of(x, y) if math.isfinite(x) and math.isfinite(y) else (-1, -1)
        root = int(self.label[row, col]) if self.grid.contains(row, col) else -1
        if root < 0:
            raise PlanError(
                f"goal {self.goal} cannot be reached from ({x:g}, {y:g})",
                remedy="choose both in the same connected region",
            )
        corners = []
        while self.parents[root] >= 0:
            corners.append(self.roots[root, :2])
            root = int(self.parents[root])
        if root == len(self.goals):  # in an area: already there
            return np.array([[x, y]])
        inner = np.array(corners).reshape(-1, 2) * self.grid.resolution + self.grid.origin
        return np.vstack([[x, y], inner, self.goals[root]])

    def path(self, x: float, y: float) -> F64:
        """A polyline [N, 2] m to the goal that a point can drive: each leg passes `trace_move`.

        It follows the taut path, with each bend moved off the obstacle's corner to the centre of
        the free cell beside it. One point if (x, y) is the goal itself.

        Raises:
            PlanError: the goal cannot be reached from here.
        """
        return follow_corners(self.grid, self.bends(x, y))


def _free_goals(grid: OccupancyGrid, goal: tuple[float, float] | GoalSet) -> F64:
    """The places [K, 2] m of a goal that are in free cells; of a set, those of it that are.

    Raises:
        PlanError: none is.
    """
    places = goal.points if isinstance(goal, GoalSet) else (goal,)
    free = []
    for x, y in places:
        if math.isfinite(x) and math.isfinite(y) and grid.is_free(x, y):
            free.append((float(x), float(y)))
    if not free:
        x, y = places[0]
        raise PlanError(
            f"goal ({x:g}, {y:g}) is not in a free cell"
            + (f", nor is any other of {len(places)}" if len(places) > 1 else ""),
            remedy="move it to the nearest free point first",
        )
    return np.array(free, np.float64)


def find_area(grid: OccupancyGrid, goal: GoalSet) -> NDArray[np.bool_]:
    """The free cells [H, W] whose centres lie in an area of a goal set, deep enough in it."""
    inside = np.zeros(grid.shape, np.bool_)
    cells = np.argwhere(grid.cells == FREE)
    found = cells[goal.cells_in(grid.centres_of(cells))]
    inside[found[:, 0], found[:, 1]] = True
    return _deepen(grid, inside, goal.depth) if isinstance(goal, GoalSetInner) else inside


def _deepen(grid: OccupancyGrid, inside: NDArray[np.bool_], depth: float) -> NDArray[np.bool_]:
    """Those of the cells inside that are so far [m] from free ground outside.

    Half as far where there are none, and so on; in each piece of ground that hangs together, so
    that whoever could get inside still can. A piece without anything outside is left as it is.
    """
    from scipy import ndimage  # only who learns asks for it

    free = grid.cells == FREE
    outside = free & ~inside
    away = ndimage.distance_transform_edt(~outside) * grid.resolution
    pieces, _ = ndimage.label(free)
    deep = inside.copy()
    for piece in np.intersect1d(pieces[inside], pieces[outside]).tolist():
        mine = inside & (pieces == piece)
        least = depth
        while not (mine & (away >= least)).any():
            least /= 2
        deep &= ~mine | (away >= least)
    return deep


def _enter_areas(grid: OccupancyGrid, goal: GoalSet) -> tuple[NDArray[np.bool_], F64]:
    """The free cells [H, W] of areas, and the centres [K, 2] m of those that one enters them by.

    Raises:
        PlanError: nothing in them is free.
    """
    inside = find_area(grid, goal)
    if not inside.any():
        raise PlanError(
            "no cell of the goal's area is free", remedy="name an area with walkable ground"
        )
    outside = np.pad(~inside & (grid.cells == FREE), 1)
    h, w = grid.shape
    beside = np.zeros((h, w), np.bool_)
    for i in range(3):
        for j in range(3):
            beside |= outside[i : i + h, j : j + w]
    rim = inside & beside
    cells = np.argwhere(rim if rim.any() else inside)
    return inside, grid.centres_of(cells if rim.any() else cells[:1])
