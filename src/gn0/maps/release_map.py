"""The map rules of the official GN-Bench harness, reproduced for profile `gn0-release`.

Written from a description of its behaviour, for comparison only: no other profile uses this. Work
is done in pixels (px, py) of `occupancy.png`: px runs against world x, py along y.

* Passable is a free cell; obstacles grow by discs of 7, 6, 5 and 4 pixels, the map's edge does not.
* A move is tested on the 4 px grid along a Bresenham line and ends in the centre of the last free
  pixel. Inside one pixel everything is allowed, and a point beyond the map counts as its edge.
* A distance is the length of a path of pixels: A* (Euclidean heuristic, no corner cutting) on the
  first of the four grids that has a way, shortened by lines of sight on the 7 px grid (which do cut
  corners), drawn as Bresenham lines. Hence octile: up to 8 % longer than the straight way.

The harness searches anew after every move. Here a Dijkstra field per goal tells beforehand which
pixels lie on any optimal path; the same search then opens only those and finds the same path, and
each pixel is searched once per goal.
"""

from __future__ import annotations

import math
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from gn0.jit import njit
from gn0.maps.grid import FREE, OCCUPIED, OccupancyGrid
from gn0.maps.inflate import squared_distances
from gn0.maps.navigation import NavigationMap

MARGINS = (7, 6, 5, 4)  # px, tried in this order
_SLACK = 1e-6  # px; far below √2 − 1, far above the rounding of a sum of path costs
# order of the neighbours as the harness visits them
_DX = np.array([1, -1, 0, 0, 1, 1, -1, -1], np.int64)
_DY = np.array([0, 0, 1, -1, 1, -1, 1, -1], np.int64)
Pixel = tuple[int, int]


@njit
def _push(keys, nodes, size, key, node):  # type: ignore[no-untyped-def]
    """Heap ordered by (key, node); returns the arrays, grown if need be, and the new size."""
    if size == len(keys):
        more_keys = np.empty(2 * size, np.float64)
        more_nodes = np.empty(2 * size, np.int64)
        more_keys[:size] = keys
        more_nodes[:size] = nodes
        keys, nodes = more_keys, more_nodes
    i = size
    while i > 0:
        up = (i - 1) // 2
        if keys[up] < key or (keys[up] == key and nodes[up] <= node):
            break
        keys[i], nodes[i] = keys[up], nodes[up]
        i = up
    keys[i], nodes[i] = key, node
    return keys, nodes, size + 1


@njit
def _pop(keys, nodes, size):  # type: ignore[no-untyped-def]
    """Take the first entry: (key, node); the heap has one entry less afterwards."""
    key, node = keys[0], nodes[0]
    last_key, last_node = keys[size - 1], nodes[size - 1]
    n = size - 1
    i = 0
    while True:
        child = 2 * i + 1
        if child >= n:
            break
        right = child + 1
        if right < n and (
            keys[right] < keys[child]
            or (keys[right] == keys[child] and nodes[right] < nodes[child])
        ):
            child = right
        if last_key < keys[child] or (last_key == keys[child] and last_node <= nodes[child]):
            break
        keys[i], nodes[i] = keys[child], nodes[child]
        i = child
    keys[i], nodes[i] = last_key, last_node
    return key, node


@njit
def _may_step(passable, x, y, k):  # type: ignore[no-untyped-def]
    """Whether neighbour k of pixel (x, y) may be entered: free, and no corner is cut."""
    height, width = passable.shape
    nx, ny = x + _DX[k], y + _DY[k]
    if nx < 0 or ny < 0 or nx >= width or ny >= height or not passable[ny, nx]:
        return False
    return not (k >= 4 and (not passable[y, nx] or not passable[ny, x]))


@njit
def _distance_field(passable, goal):  # type: ignore[no-untyped-def]
    """Octile distance [px] of every pixel (x · H + y) to the goal; inf where there is no way."""
    height, width = passable.shape
    field = np.full(width * height, np.inf)
    if not passable[goal % height, goal // height]:
        return field
    keys, nodes = np.empty(1024, np.float64), np.empty(1024, np.int64)
    field[goal] = 0.0
    keys, nodes, size = _push(keys, nodes, 0, 0.0, goal)
    while size > 0:
        key, node = _pop(keys, nodes, size)
        size -= 1
        if key > field[node]:
            continue
        x, y = node // height, node % height
        for k in range(8):
            if not _may_step(passable, x, y, k):
                continue
            near = (x + _DX[k]) * height + y + _DY[k]
            cost = key + (1.0 if k < 4 else math.sqrt(2.0))
            if cost < field[near]:
                field[near] = cost
                keys, nodes, size = _push(keys, nodes, size, cost, near)
    return field


@njit
def _best_from(passable, field, start):  # type: ignore[no-untyped-def]
    """Cost [px] from a start, which itself may be blocked, to the field's goal."""
    height = passable.shape[0]
    x, y = start // height, start % height
    best = field[start]
    for k in range(8):
        if _may_step(passable, x, y, k):
            cost = 1.0 if k < 4 else math.sqrt(2.0)
            best = min(best, cost + field[(x + _DX[k]) * height + y + _DY[k]])
    return best


@njit
def _find_path(passable, field, start, goal, best, g, came):  # type: ignore[no-untyped-def]
    """The harness's A* path, start first, opening only pixels of optimal paths.

    `g` (inf everywhere) and `came` are buffers; `g` is left clean.
    """
    height = passable.shape[0]
    goal_x, goal_y = goal // height, goal % height
    keys, nodes = np.empty(256, np.float64), np.empty(256, np.int64)
    touched = np.empty(256, np.int64)
    g[start] = 0.0
    came[start] = -1
    touched[0] = start
    count = 1
    dx, dy = start // height - goal_x, start % height - goal_y
    keys, nodes, size = _push(keys, nodes, 0, math.sqrt(float(dx * dx + dy * dy)), start)
    while size > 0:
        _, node = _pop(keys, nodes, size)
        size -= 1
        if node == goal:
            break
        x, y = node // height, node % height
        for k in range(8):
            if not _may_step(passable, x, y, k):
                continue
            nx, ny = x + _DX[k], y + _DY[k]
            near = nx * height + ny
            cost = g[node] + (1.0 if k < 4 else math.sqrt(2.0))
            if cost + field[near] > best + _SLACK or cost >= g[near]:
                continue
            if g[near] == np.inf:
                if count == len(touched):
                    more = np.empty(2 * count, np.int64)
                    more[:count] = touched
                    touched = more
                touched[count] = near
                count += 1
            g[near] = cost
            came[near] = node
            dx, dy = nx - goal_x, ny - goal_y
            f = cost + math.sqrt(float(dx * dx + dy * dy))
            keys, nodes, size = _push(keys, nodes, size, f, near)
    length = 1
    node = goal
    while came[node] >= 0:
        node = came[node]
        length += 1
    path = np.empty(length, np.int64)
    node = goal
    for i in range(length - 1, -1, -1):
        path[i] = node
        node = came[node]
    for i in range(count):
        g[touched[i]] = np.inf
    return path


@njit
def _walk_line(passable, x0, y0, x1, y1):  # type: ignore[no-untyped-def]
    """Follow the harness's Bresenham line: (x, y, blocked) of the last free pixel.

    When the first pixel is blocked, that pixel itself.
    """
    height, width = passable.shape
    dx, dy = abs(x1 - x0), abs(y1 - y0)
    sx = 1 if x1 >= x0 else -1
    sy = 1 if y1 >= y0 else -1
    x, y = x0, y0
    free_x, free_y = x0, y0
    error = (dx if dx >= dy else dy) // 2
    for _ in range(max(dx, dy) + 1):
        if x < 0 or y < 0 or x >= width or y >= height or not passable[y, x]:
            return free_x, free_y, True
        free_x, free_y = x, y
        if dx >= dy:
            x += sx
            error -= dy
            if error < 0:
                y += sy
                error += dx
        else:
            y += sy
            error -= dx
            if error < 0:
                x += sx
                error += dy
    return free_x, free_y, False


@njit
def _smooth(sight, path):  # type: ignore[no-untyped-def]
    """Indices of the path kept by greedy lines of sight, the farthest first."""
    height = sight.shape[0]
    kept = np.empty(len(path), np.int64)
    kept[0] = 0
    count = 1
    here, last = 0, len(path) - 1
    while here < last:
        there = here + 1
        x0, y0 = path[here] // height, path[here] % height
        for candidate in range(last, here, -1):
            end = path[candidate]
            _, _, blocked = _walk_line(sight, x0, y0, end // height, end % height)
            if not blocked:
                there = candidate
                break
        kept[count] = there
        count += 1
        here = there
    return kept[:count]


@njit
def _pixel_length(path, kept, height, lower_x, upper_y, scale_x, scale_y):  # type: ignore[no-untyped-def]
    """Length [m] of the Bresenham lines between the kept pixels, summed as the harness sums."""
    total = 0.0
    for i in range(len(kept) - 1):
        a, b = path[kept[i]], path[kept[i + 1]]
        x, y, x1, y1 = a // height, a % height, b // height, b % height
        dx, dy = abs(x1 - x), abs(y1 - y)
        sx = 1 if x1 >= x else -1
        sy = 1 if y1 >= y else -1
        error = (dx if dx >= dy else dy) // 2
        wx, wy = -(lower_x + (x + 0.5) * scale_x), -(upper_y - (y + 0.5) * scale_y)
        for _ in range(max(dx, dy)):
            if dx >= dy:
                x += sx
                error -= dy
                if error < 0:
                    y += sy
                    error += dx
            else:
                y += sy
                error -= dx
                if error < 0:
                    x += sx
                    error += dy
            vx, vy = -(lower_x + (x + 0.5) * scale_x), -(upper_y - (y + 0.5) * scale_y)
            total += math.hypot(vx - wx, vy - wy)
            wx, wy = vx, vy
    return total


class ReleaseMap:
    """The four grown grids of one map, its pixels, moves and distances.

    Args:
        grid: the raw occupancy; only free cells are passable.
    """

    def __init__(self, grid: OccupancyGrid) -> None:
        self.grid = grid
        self.height, self.width = grid.shape
        x0, y0, x1, y1 = grid.bounds
        self._lower, self._upper = (x0, y0), (x1, y1)
        self._shift = (x0 + x1, y0 + y1)
        self.scale = ((x1 - x0) / self.width, (y1 - y0) / self.height)
        squared = squared_distances(grid.cells != FREE, outside_blocked=False)[:, ::-1]
        self.grids = {m: np.ascontiguousarray(squared > m * m) for m in MARGINS}
        self.passable = self.grids[MARGINS[-1]]

    def pixel_of(self, x: float, y: float) -> Pixel:
        """Pixel (px, py) of a world point [m]: half to even, clamped to the map."""
        px = (-(x - self._shift[0]) - self._lower[0]) / self.scale[0] - 0.5
        py = (self._upper[1] + (y - self._shift[1])) / self.scale[1] - 0.5
        return (
            max(0, min(round(px), self.width - 1)),
            max(0, min(round(py), self.height - 1)),
        )

    def centre_of(self, pixel: Pixel) -> tuple[float, float]:
        """World point [m] at the centre of a pixel."""
        x = -(self._lower[0] + (pixel[0] + 0.5) * self.scale[0]) + self._shift[0]
        y = -(self._upper[1] - (pixel[1] + 0.5) * self.scale[1]) + self._shift[1]
        return x, y

    def is_passable(self, pixel: Pixel) -> bool:
        """Whether a pixel is free on the 4 px grid."""
        return bool(self.passable[pixel[1], pixel[0]])

    def nearest_passable(self, pixel: Pixel) -> Pixel | None:
        """The pixel itself if passable, else the first on growing square rings, or None.

        A ring's rows are looked through first, from small px, the upper before the lower; then its
        columns, from small py, the left before the right.
        """
        if self.is_passable(pixel):
            return pixel
        x0, y0 = pixel
        for r in range(1, max(self.width, self.height) + 1):
            left, right = max(x0 - r, 0), min(x0 + r, self.width - 1)
            top, bottom = max(y0 - r, 0), min(y0 + r, self.height - 1)
            ring = [(x, y) for x in range(left, right + 1) for y in (top, bottom)]
            ring += [(x, y) for y in range(top + 1, bottom) for x in (left, right)]
            for candidate in ring:
                if self.is_passable(candidate):
                    return candidate
        return None

    def move(self, x0: float, y0: float, x1: float, y1: float) -> tuple[float, float, bool]:
        """Move from (x0, y0) towards (x1, y1) m by the harness's rule: (x, y, hit)."""
        start, end = self.pixel_of(x0, y0), self.pixel_of(x1, y1)
        if start == end:
            return x1, y1, False
        px, py, blocked = _walk_line(self.passable, *start, *end)
        if not blocked:
            return x1, y1, False
        return *self.centre_of((int(px), int(py))), True

    def distances(
        self, goal: tuple[float, float], *others: tuple[float, float]
    ) -> ReleaseDistances:
        """Distances to a goal (x, y) m, or the nearest of several, snapped to passable ground."""
        return ReleaseDistances(self, goal, *others)


class ReleaseDistances:
    """The harness's distance to one goal; each pixel is searched once.

    The harness knows one goal only. Where several count, each is measured its way and the least
    taken.

    Attributes:
        goal: pixel of the goal, snapped.
        snapped: whether the goal itself was not passable.
    """

    def __init__(
        self, map: ReleaseMap, goal: tuple[float, float], *others: tuple[float, float]
    ) -> None:
        self.map = map
        self._others = tuple(ReleaseDistances(map, other) for other in others)
        own = map.pixel_of(*goal)
        self.goal = map.nearest_passable(own) or own
        self.snapped = self.goal != own
        self._known: dict[Pixel, float] = {}
        self._fields: dict[int, NDArray[np.float64]] = {}

    @cached_property
    def _buffers(self) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
        size = self.map.width * self.map.height
        return np.full(size, np.inf), np.empty(size, np.int64)

    def from_pixel(self, pixel: Pixel) -> float:
        """Distance [m] from a pixel; 0 in the goal's, inf where no grid has a way."""
        if pixel == self.goal:
            return 0.0
        if pixel not in self._known:
            self._known[pixel] = self._search(pixel)
        return min((self._known[pixel], *(other.from_pixel(pixel) for other in self._others)))

    def _search(self, pixel: Pixel) -> float:
        m = self.map
        start, goal = pixel[0] * m.height + pixel[1], self.goal[0] * m.height + self.goal[1]
        for margin in MARGINS:
            grid = m.grids[margin]
            if margin not in self._fields:
                self._fields[margin] = _distance_field(grid, goal)
            field = self._fields[margin]
            best = _best_from(grid, field, start)
            if best == math.inf:
                continue
            path = _find_path(grid, field, start, goal, best, *self._buffers)
            kept = _smooth(m.grids[MARGINS[0]], path) if len(path) > 2 else np.arange(len(path))
            frame = (m._lower[0], m._upper[1], *m.scale)
            return float(_pixel_length(path, kept, m.height, *frame))
        return math.inf


class DistanceMeter:
    """The harness's distance to the goal along one episode, with its memory.

    A position that is not passable is measured from the last passable one; at the start of an
    episode there is none, and the nearest passable pixel stands in. A shift of less than 0.1 mm is
    not measured again.
    """

    def __init__(self, distances: ReleaseDistances) -> None:
        self.distances = distances
        self._last: tuple[float, float] | None = None
        self._passable: Pixel | None = None
        self._value = math.inf
        self.snapped = False  # whether any position was not passable

    def measure(self, x: float, y: float) -> float:
        """Distance [m] of the position (x, y) m that comes next."""
        m = self.distances.map
        pixel = m.pixel_of(x, y)
        if m.is_passable(pixel):
            self._passable = pixel
        else:
            self.snapped = True
            pixel = self._passable or m.nearest_passable(pixel) or pixel
        nav = (x - m._shift[0], y - m._shift[1])
        if self._last is None or not np.allclose(self._last, nav, rtol=1e-5, atol=1e-4):
            self._last = nav
            self._value = self.distances.from_pixel(pixel)
        return self._value


class ReleaseNavigation(NavigationMap):
    """A navigation map on which an agent moves by the harness's rules, and is never refused.

    Planning (for oracles) sees the 4 px grid. `radius` is what the agent is called, not what
    decides: the margins are in pixels.
    """

    def __init__(self, grid: OccupancyGrid, radius: float = 0.20) -> None:
        super().__init__(grid, radius)
        self.release = ReleaseMap(grid)
        cells = grid.cells.copy()
        cells[(cells == FREE) & ~self.release.passable[:, ::-1]] = OCCUPIED
        self.inflated = grid.with_cells(cells)
        self.blocked = self.inflated.blocked
        self._frame = (self.blocked, *self._frame[1:])

    def move(self, x0: float, y0: float, x1: float, y1: float) -> tuple[float, float, bool]:
        """See `ReleaseMap.move`."""
        return self.release.move(x0, y0, x1, y1)

    def region_of(self, x: float, y: float) -> int:
        """Always 0: the harness starts every episode, whatever start and goal stand on."""
        return 0
