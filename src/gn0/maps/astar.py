"""A* on the grid: 8-connected, no corner cutting, octile costs.

A diagonal move needs both of its side cells free. The open list is a ring of buckets over
f = g + h: the octile heuristic is consistent, so all open f lie within 2√2 of the smallest, and a
few buckets of width one half hold them. Inside a bucket the order does not matter for the result,
because the search goes on until no bucket can beat the goal, and a cell that improves is opened
again.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gn0.errors import PlanError
from gn0.jit import njit
from gn0.maps.grid import OccupancyGrid
from gn0.maps.ray import is_blocked

SQRT2 = math.sqrt(2.0)
# moves 0–3 straight (E, N, W, S), 4–7 diagonal (NE, NW, SW, SE); rows run north
ROW_STEP = np.array([0, 1, 0, -1, 1, 1, -1, -1], np.int64)
COL_STEP = np.array([1, 0, -1, 0, 1, -1, -1, 1], np.int64)
MOVE_COST = np.array([1.0, 1.0, 1.0, 1.0, SQRT2, SQRT2, SQRT2, SQRT2])


@njit
def build_moves(blocked):  # type: ignore[no-untyped-def]
    """Allowed moves of each cell [H·W] uint8: bit k set when move k is free of corner cutting."""
    height, width = blocked.shape
    moves = np.zeros(height * width, np.uint8)
    for row in range(height):
        for col in range(width):
            if blocked[row, col]:
                continue
            east = not is_blocked(blocked, row, col + 1)
            north = not is_blocked(blocked, row + 1, col)
            west = not is_blocked(blocked, row, col - 1)
            south = not is_blocked(blocked, row - 1, col)
            bits = east * 1 + north * 2 + west * 4 + south * 8
            if north and east and not blocked[row + 1, col + 1]:
                bits += 16
            if north and west and not blocked[row + 1, col - 1]:
                bits += 32
            if south and west and not blocked[row - 1, col - 1]:
                bits += 64
            if south and east and not blocked[row - 1, col + 1]:
                bits += 128
            moves[row * width + col] = bits
    return moves


_BUCKETS = 8  # buckets in the ring; (2√2 + 1) / width must fit
_WIDTH = 0.5  # of a bucket [cells]


@njit
def _search(moves, width, start, goal, g, before, after, place, came, touched):  # type: ignore[no-untyped-def]
    """Cost of the cheapest path; the buffers are left clean but for `came`. −1 if there is none.

    g: best cost, inf when untouched. before, after: links inside a bucket. place: bucket, −1 when
    closed. came: move that reached the cell. touched: list of touched cells.
    """
    goal_row, goal_col = goal // width, goal % width
    shift = SQRT2 - 1.0
    head = np.full(_BUCKETS, -1, np.int32)
    dr, dc = abs(start // width - goal_row), abs(start % width - goal_col)
    base = max(dr, dc) + shift * min(dr, dc)
    g[start] = 0.0
    touched[0] = start
    count = 1
    head[0] = start
    before[start] = -1
    after[start] = -1
    place[start] = 0
    waiting = 1
    current = 0
    expanded = 0
    while waiting > 0:
        slot = current % _BUCKETS
        if head[slot] < 0:
            current += 1
            # every open f is at least this bucket's lower edge
            if base + current * _WIDTH - 1e-9 >= g[goal]:
                break
            continue
        node = head[slot]
        head[slot] = after[node]
        if after[node] >= 0:
            before[after[node]] = -1
        place[node] = -1
        waiting -= 1
        if node == goal:
            continue
        expanded += 1
        bits = moves[node]
        row, col = node // width, node % width
        here = g[node]
        for k in range(8):
            if not (bits >> k) & 1:
                continue
            cost = here + MOVE_COST[k]
            next_row, next_col = row + ROW_STEP[k], col + COL_STEP[k]
            near = next_row * width + next_col
            old = g[near]
            if cost >= old - 1e-12:
                continue
            dr, dc = abs(next_row - goal_row), abs(next_col - goal_col)
            f = cost + max(dr, dc) + shift * min(dr, dc)
            if f >= g[goal] and near != goal:
                continue
            if old == np.inf:
                touched[count] = near
                count += 1
            elif place[near] >= 0:
                if before[near] >= 0:
                    after[before[near]] = after[near]
                else:
                    head[place[near]] = after[near]
                if after[near] >= 0:
                    before[after[near]] = before[near]
                waiting -= 1
            g[near] = cost
            came[near] = k
            index = max(int((f - base) / _WIDTH), current) % _BUCKETS
            place[near] = index
            before[near] = -1
            after[near] = head[index]
            if head[index] >= 0:
                before[head[index]] = near
            head[index] = near
            waiting += 1
    cost = g[goal]
    for i in range(count):
        g[touched[i]] = np.inf
        place[touched[i]] = -1
    return (cost if cost < np.inf else -1.0), expanded


@njit
def _walk_back(came, width, start, goal):  # type: ignore[no-untyped-def]
    length = 1
    node = goal
    while node != start:
        k = came[node]
        node -= ROW_STEP[k] * width + COL_STEP[k]
        length += 1
    cells = np.empty((length, 2), np.int64)
    node = goal
    for i in range(length - 1, -1, -1):
        cells[i, 0], cells[i, 1] = node // width, node % width
        if node != start:
            k = came[node]
            node -= ROW_STEP[k] * width + COL_STEP[k]
    return cells


@dataclass(frozen=True)
class GridPath:
    """A path over cells.

    Attributes:
        cells: (row, col) [N, 2], start and goal included.
        cost: octile length [cells].
        expanded: cells the search opened up.
    """

    cells: NDArray[np.int64]
    cost: float
    expanded: int


class PlannerAstar:
    """A* over one grid, with buffers that are reused between queries (so: one thread at a time).

    Args:
        grid: occupied and unknown cells are blocked; inflate it first for an agent with a body.
    """

    def __init__(self, grid: OccupancyGrid) -> None:
        self._shape = grid.shape
        self.moves = build_moves(grid.blocked)
        self._blocked = grid.blocked
        n = len(self.moves)
        self._g = np.full(n, np.inf)
        self._before = np.empty(n, np.int32)
        self._after = np.empty(n, np.int32)
        self._place = np.full(n, -1, np.int8)
        self._came = np.zeros(n, np.int8)
        self._touched = np.empty(n, np.int32)

    def _index(self, cell: tuple[int, int], name: str) -> int:
        row, col = int(cell[0]), int(cell[1])
        if not (0 <= row < self._shape[0] and 0 <= col < self._shape[1]):
            raise PlanError(
                f"{name} cell ({row}, {col}) is outside the grid of {self._shape} cells",
                remedy="check the frame of the point",
            )
        if self._blocked[row, col]:
            raise PlanError(
                f"{name} cell ({row}, {col}) is blocked",
                remedy="move it to the nearest free cell first",
            )
        return row * self._shape[1] + col

    def plan(self, start: tuple[int, int], goal: tuple[int, int]) -> GridPath:
        """The cheapest path between two cells (row, col).

        Raises:
            PlanError: start or goal is blocked or outside, or no path joins them.
        """
        a, b = self._index(start, "start"), self._index(goal, "goal")
        width = self._shape[1]
        cost, expanded = _search(
            self.moves,
            width,
            a,
            b,
            self._g,
            self._before,
            self._after,
            self._place,
            self._came,
            self._touched,
        )
        if cost < 0:
            raise PlanError(
                f"no path from cell {tuple(start)} to cell {tuple(goal)}",
                remedy="choose both in the same connected region",
            )
        return GridPath(_walk_back(self._came, width, a, b), float(cost), int(expanded))
