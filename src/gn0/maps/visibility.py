"""The exact any-angle distance field: a Dijkstra over obstacle corners, with shadow cones.

A shortest path among unions of square cells is a chain of straight legs that bends only at convex
corners: lattice points with exactly one blocked cell around them. A corner becomes a *root* when
its distance is final. From there a taut path can only go on into the shadow that the corner casts
for the root before it, a cone between the straight continuation and the obstacle's edge. The cone
is swept row by row, cut by the runs of free cells; each cell centre in it is offered the path
through this root, and each corner in it becomes a candidate. As a corner is swept once, from its
best predecessor, and dominated cones are dropped, a field costs little more than a visit a cell.

All coordinates here are in cells: vertex (x, y) is the corner shared by cells (y−1, x−1) … (y, x).
"""

from __future__ import annotations

import math

import numpy as np

from gn0.jit import njit

_THIN = 1e-10  # narrower slope intervals hold no area; what they show is relayed by a corner
_EDGE = 1e-9  # slack [cells] for a vertex exactly on the edge of a cone


@njit
def build_runs(blocked):  # type: ignore[no-untyped-def]
    """First and one-past-last column [H, W] int32 of the run of equal cells each cell lies in."""
    height, width = blocked.shape
    first = np.empty((height, width), np.int32)
    last = np.empty((height, width), np.int32)
    for row in range(height):
        begin = 0
        for col in range(width):
            if col > 0 and blocked[row, col] != blocked[row, col - 1]:
                begin = col
            first[row, col] = begin
        end = width
        for col in range(width - 1, -1, -1):
            if col < width - 1 and blocked[row, col] != blocked[row, col + 1]:
                end = col + 1
            last[row, col] = end
    return first, last


@njit
def build_corners(blocked):  # type: ignore[no-untyped-def]
    """Convex corners [H+1, W+1] int8: 0 none, else 1 + (blocked is east) + 2·(blocked is north)."""
    height, width = blocked.shape
    corners = np.zeros((height + 1, width + 1), np.int8)
    for y in range(1, height):
        for x in range(1, width):
            sw, se = blocked[y - 1, x - 1], blocked[y - 1, x]
            nw, ne = blocked[y, x - 1], blocked[y, x]
            if sw + se + nw + ne == 1:
                corners[y, x] = 1 + 1 * (se or ne) + 2 * (nw or ne)
    return corners


@njit
def _heap_push(keys, items, count, key, item):  # type: ignore[no-untyped-def]
    i = count
    while i > 0:
        parent = (i - 1) >> 1
        if keys[parent] <= key:
            break
        keys[i], items[i] = keys[parent], items[parent]
        i = parent
    keys[i], items[i] = key, item


@njit
def _heap_pop(keys, items, count):  # type: ignore[no-untyped-def]
    """Remove the root of a heap of `count` entries; the caller has read it."""
    key, item = keys[count - 1], items[count - 1]
    count -= 1
    i = 0
    while True:
        child = 2 * i + 1
        if child >= count:
            break
        if child + 1 < count and keys[child + 1] < keys[child]:
            child += 1
        if keys[child] >= key:
            break
        keys[i], items[i] = keys[child], items[child]
        i = child
    if count > 0:
        keys[i], items[i] = key, item


@njit
def _offer(x, y, rx, ry, g, root, corners, best, parent, queue_keys, queue_items, count):  # type: ignore[no-untyped-def]
    """Offer the vertex (x, y) a path through a root; returns the new queue length."""
    kind = corners[y, x]
    if kind == 0:
        return count
    dx, dy = x - rx, y - ry
    bx = 1 if (kind - 1) & 1 else -1
    by = 1 if (kind - 1) & 2 else -1
    ex, ey = dx * bx, dy * by
    # a taut path grazes the obstacle: it passes along one side and turns round to the other
    if not ((ex >= 0 and ey < 0) or (ex < 0 and ey >= 0)):
        return count
    cost = g + math.sqrt(dx * dx + dy * dy)
    if cost >= best[y, x] - 1e-12:
        return count
    best[y, x] = cost
    parent[y, x] = root
    _heap_push(queue_keys, queue_items, count, cost, y * corners.shape[1] + x)
    return count + 1


@njit
def _grow(keys, items):  # type: ignore[no-untyped-def]
    more_keys = np.empty(2 * len(keys))
    more_items = np.empty(2 * len(items), np.int64)
    more_keys[: len(keys)] = keys
    more_items[: len(items)] = items
    return more_keys, more_items


@njit
def spread_distances(blocked, first, last, corners, source_x, source_y):  # type: ignore[no-untyped-def]
    """Distances from a source point to every cell centre, through chains of convex corners.

    Args:
        blocked: bool [H, W].
        first: from `build_runs`.
        last: from `build_runs`.
        corners: from `build_corners`.
        source_x: source [cells], in a free cell.
        source_y: source [cells], in a free cell.

    Returns:
        label [H, W] int32, index of each cell's root, −1 where unreachable; roots [R, 3] float64 of
        (x, y, distance) in the order they became final, the source first; parents [R] int32.
    """
    height, width = blocked.shape
    field = np.full((height, width), np.inf)
    label = np.full((height, width), -1, np.int32)
    best = np.full(corners.shape, np.inf)
    parent = np.full(corners.shape, -1, np.int32)
    keys = np.empty(1024)
    items = np.empty(1024, np.int64)
    count = 0
    roots = np.empty((1024, 3))
    parents = np.empty(1024, np.int32)
    total = 0
    # stack of cones: line, direction, slopes
    stack_line = np.empty(256, np.int64)
    stack_up = np.empty(256, np.int64)
    stack_low = np.empty(256)
    stack_high = np.empty(256)

    row0 = min(max(math.floor(source_y), 0), height - 1)
    col0 = min(max(math.floor(source_x), 0), width - 1)
    # on a cell's edge half the rays would have no first row; a billionth of a cell settles it
    rx = min(max(source_x, col0 + 1e-9), col0 + 1 - 1e-9)
    ry = min(max(source_y, row0 + 1e-9), row0 + 1 - 1e-9)
    roots[0, 0], roots[0, 1], roots[0, 2] = rx, ry, 0.0
    parents[0] = -1
    total = 1
    root = 0
    g = 0.0
    while True:
        depth = 0
        if root == 0:
            begin, end = first[row0, col0], last[row0, col0]
            for col in range(begin, end):
                dx, dy = col + 0.5 - rx, row0 + 0.5 - ry
                field[row0, col] = math.sqrt(dx * dx + dy * dy)
                label[row0, col] = 0
            for up in (1, -1):
                line = row0 + 1 if up > 0 else row0
                rise = abs(line - ry)
                low, high = (begin - rx) / rise, (end - rx) / rise
                for x in range(begin, end + 1):
                    if len(keys) < count + 2:
                        keys, items = _grow(keys, items)
                    count = _offer(
                        x, line, rx, ry, g, root, corners, best, parent, keys, items, count
                    )
                stack_line[depth], stack_up[depth] = line, up
                stack_low[depth], stack_high[depth] = low, high
                depth += 1
        else:
            x0, y0 = int(rx), int(ry)
            kind = corners[y0, x0]
            bx = 1 if (kind - 1) & 1 else -1
            by = 1 if (kind - 1) & 2 else -1
            px, py = roots[parents[root], 0], roots[parents[root], 1]
            dx, dy = rx - px, ry - py
            if dx * bx >= 0 and dy * by < 0:
                # round to the side under the obstacle: from straight on to level
                side, up = bx, -by
                near, far = abs(dx) / abs(dy), np.inf
            else:
                # round to the side beside the obstacle: from straight on to upright
                side, up = -bx, by
                near, far = 0.0, (abs(dx) / abs(dy) if dy != 0 else np.inf)
            row = y0 if up > 0 else y0 - 1
            col = x0 if side > 0 else x0 - 1
            if far == np.inf:
                # level rays: along the line, as far as the cells on the open side reach
                x, c = x0, col
                while 0 <= c < width and not blocked[row, c]:
                    x += side
                    c += side
                    if len(keys) < count + 2:
                        keys, items = _grow(keys, items)
                    count = _offer(
                        x, y0, rx, ry, g, root, corners, best, parent, keys, items, count
                    )
            begin, end = first[row, col], last[row, col]
            low, high = (near, far) if side > 0 else (-far, -near)
            # the first row: rays start in the point itself, so only its far line cuts them
            left = rx + low * 0.5 if low > -np.inf else -np.inf
            right = rx + high * 0.5 if high < np.inf else np.inf
            c0 = begin if left <= begin else max(math.ceil(left - 0.5 - _EDGE), begin)
            c1 = end - 1 if right >= end else min(math.floor(right - 0.5 + _EDGE), end - 1)
            for c in range(c0, c1 + 1):
                ux = c + 0.5 - rx
                cost = g + math.sqrt(ux * ux + 0.25)
                if cost < field[row, c]:
                    field[row, c] = cost
                    label[row, c] = root
            low, high = max(low, begin - rx), min(high, end - rx)
            if high >= low - _THIN:
                line = y0 + up
                v0 = max(math.ceil(rx + low - _EDGE), 0)
                v1 = min(math.floor(rx + high + _EDGE), width)
                for x in range(v0, v1 + 1):
                    if len(keys) < count + 2:
                        keys, items = _grow(keys, items)
                    count = _offer(
                        x, line, rx, ry, g, root, corners, best, parent, keys, items, count
                    )
                if high - low > _THIN:
                    stack_line[0], stack_up[0] = line, up
                    stack_low[0], stack_high[0] = low, high
                    depth = 1
        while depth > 0:
            depth -= 1
            line, up = stack_line[depth], stack_up[depth]
            low, high = stack_low[depth], stack_high[depth]
            row = line if up > 0 else line - 1
            if row < 0 or row >= height:
                continue
            rise = abs(line - ry)
            middle = abs(row + 0.5 - ry)
            next_rise = abs(line + up - ry)
            right_edge = rx + high * rise
            col = min(max(math.floor(rx + low * rise), 0), width - 1)
            while col < width and col < right_edge:
                begin, end = first[row, col], last[row, col]
                if blocked[row, col]:
                    col = end
                    continue
                col = end
                a = max(low, (begin - rx) / rise)
                b = min(high, (end - rx) / rise)
                if b - a <= _THIN:
                    continue
                c0 = max(math.ceil(rx + a * middle - 0.5 - _EDGE), begin)
                c1 = min(math.floor(rx + b * middle - 0.5 + _EDGE), end - 1)
                dominated = c1 >= c0
                for c in range(c0, c1 + 1):
                    ux = c + 0.5 - rx
                    cost = g + math.sqrt(ux * ux + middle * middle)
                    old = field[row, c]
                    if cost < old:
                        field[row, c] = cost
                        label[row, c] = root
                    if cost <= old + 2.0:
                        dominated = False
                if dominated:  # each ray passes within a cell of a centre that another root reaches
                    continue  # more than two cells sooner, so none of them is on a shortest path
                a = max(a, (begin - rx) / next_rise)
                b = min(b, (end - rx) / next_rise)
                if b < a - _THIN:
                    continue
                next_line = line + up
                v0 = max(math.ceil(rx + a * next_rise - _EDGE), 0)
                v1 = min(math.floor(rx + b * next_rise + _EDGE), width)
                for x in range(v0, v1 + 1):
                    if corners[next_line, x] != 0:
                        if len(keys) < count + 2:
                            keys, items = _grow(keys, items)
                        count = _offer(
                            x, next_line, rx, ry, g, root, corners, best, parent, keys, items, count
                        )
                if b - a <= _THIN:
                    continue
                if depth == len(stack_line):
                    more = np.empty(2 * depth, np.int64)
                    more[:depth] = stack_line
                    stack_line = more
                    more = np.empty(2 * depth, np.int64)
                    more[:depth] = stack_up
                    stack_up = more
                    wide = np.empty(2 * depth)
                    wide[:depth] = stack_low
                    stack_low = wide
                    wide = np.empty(2 * depth)
                    wide[:depth] = stack_high
                    stack_high = wide
                stack_line[depth], stack_up[depth] = next_line, up
                stack_low[depth], stack_high[depth] = a, b
                depth += 1
        # the next root: the nearest corner whose distance is final
        found = False
        while count > 0:
            key, item = keys[0], items[0]
            _heap_pop(keys, items, count)
            count -= 1
            y, x = item // corners.shape[1], item % corners.shape[1]
            if key == best[y, x]:
                found = True
                break
        if not found:
            break
        if total == len(roots):
            wider = np.empty((2 * total, 3))
            wider[:total] = roots
            roots = wider
            longer = np.empty(2 * total, np.int32)
            longer[:total] = parents
            parents = longer
        root = total
        rx, ry, g = float(x), float(y), best[y, x]
        roots[root, 0], roots[root, 1], roots[root, 2] = rx, ry, g
        parents[root] = parent[y, x]
        total += 1
    return label, roots[:total].copy(), parents[:total].copy()
