"""The official harness's distances by a literal search: the judge of `gn0.maps.release_map`.

It shares no code with what it judges: sets of pixels, tuples on a heap, a search a question.
"""

from __future__ import annotations

import heapq
import math
from itertools import pairwise

from gn0.maps.grid import OccupancyGrid

Pixel = tuple[int, int]
MARGINS = (7, 6, 5, 4)  # px


class JudgeRelease:
    """One map; pixels are (px, py) of `occupancy.png`.

    Attributes:
        free: passable pixels by margin.
    """

    def __init__(self, grid: OccupancyGrid) -> None:
        self.h, self.w = grid.shape
        self.s = grid.resolution
        blocked = {
            (self.w - 1 - c, r) for r in range(self.h) for c in range(self.w) if grid.cells[r, c]
        }
        self.free: dict[int, set[Pixel]] = {}
        for m in MARGINS:
            disc = [
                (i, j) for i in range(-m, m + 1) for j in range(-m, m + 1) if i * i + j * j <= m * m
            ]
            grown = {(x + i, y + j) for x, y in blocked for i, j in disc}
            self.free[m] = {(x, y) for x in range(self.w) for y in range(self.h)} - grown

    @staticmethod
    def line(a: Pixel, b: Pixel) -> list[Pixel]:
        """Bresenham's line of the harness, both ends included."""
        (x, y), (x1, y1) = a, b
        dx, dy = abs(x1 - x), abs(y1 - y)
        sx, sy = (1 if x1 >= x else -1), (1 if y1 >= y else -1)
        out = [(x, y)]
        error = max(dx, dy) // 2
        while (x, y) != (x1, y1):
            if dx >= dy:
                x, error = x + sx, error - dy
                if error < 0:
                    y, error = y + sy, error + dx
            else:
                y, error = y + sy, error - dx
                if error < 0:
                    x, error = x + sx, error + dy
            out.append((x, y))
        return out

    def astar(self, start: Pixel, goal: Pixel, free: set[Pixel]) -> list[Pixel] | None:
        """A* with a Euclidean heuristic and no corner cutting; ties by (f, pixel)."""
        cost, came = {start: 0.0}, dict[Pixel, Pixel]()
        heap = [(math.dist(start, goal), start)]
        while heap:
            _, here = heapq.heappop(heap)
            if here == goal:
                path = [here]
                while path[-1] in came:
                    path.append(came[path[-1]])
                return path[::-1]
            for dx, dy in ((1, 0), (-1, 0), (0, 1), (0, -1), (1, 1), (1, -1), (-1, 1), (-1, -1)):
                near = (here[0] + dx, here[1] + dy)
                sides = {(near[0], here[1]), (here[0], near[1])} if dx and dy else set()
                if near not in free or not sides <= free:
                    continue
                new = cost[here] + math.hypot(dx, dy)
                if new < cost.get(near, math.inf):
                    cost[near], came[near] = new, here
                    heapq.heappush(heap, (new + math.dist(near, goal), near))
        return None

    def distance(self, start: Pixel, goal: Pixel) -> float:
        """Distance [m] by search, lines of sight and Bresenham; inf where no grid has a way."""
        if start == goal:
            return 0.0
        for m in MARGINS:
            path = self.astar(start, goal, self.free[m])
            if path is None:
                continue
            kept, here = [path[0]], 0
            while here < len(path) - 1:
                there = here + 1
                for candidate in range(len(path) - 1, here, -1):
                    if set(self.line(path[here], path[candidate])) <= self.free[MARGINS[0]]:
                        there = candidate
                        break
                kept.append(path[there])
                here = there
            drawn = [kept[0]]
            for a, b in pairwise(kept):
                drawn += self.line(a, b)[1:]
            return self.s * sum(math.dist(a, b) for a, b in pairwise(drawn))
        return math.inf
