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
HALF_DIAGONAL = math.sqrt(0.5)
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
    """Convex corners, line by line.

    Returns:
        spots [N, 4] int64 of (x, y, bx, by), where (bx, by) = ±1 points at the blocked cell; and
        index [H+1, W+2] int32: corners index[y, a] … index[y, b+1]−1 are those with x in a … b.
    """
    height, width = blocked.shape
    spots = np.empty(((height + 1) * (width + 1), 4), np.int64)
    index = np.empty((height + 1, width + 2), np.int32)
    count = 0
    for y in range(height + 1):
        for x in range(width + 2):
            index[y, x] = count
            if 0 < y < height and 0 < x < width:
                sw, se = blocked[y - 1, x - 1], blocked[y - 1, x]
                nw, ne = blocked[y, x - 1], blocked[y, x]
                if sw + se + nw + ne == 1:
                    spots[count, 0], spots[count, 1] = x, y
                    spots[count, 2] = 1 if se or ne else -1
                    spots[count, 3] = 1 if nw or ne else -1
                    count += 1
    return spots[:count].copy(), index


@njit
def _sift_up(heap, slot, best, i):  # type: ignore[no-untyped-def]
    item = heap[i]
    while i > 0:
        above = (i - 1) >> 1
        if best[heap[above]] <= best[item]:
            break
        heap[i] = heap[above]
        slot[heap[i]] = i
        i = above
    heap[i] = item
    slot[item] = i


@njit
def _pop(heap, slot, best, count):  # type: ignore[no-untyped-def]
    """Take the nearest corner off a heap of `count` corners."""
    top = heap[0]
    slot[top] = -1
    item = heap[count - 1]
    count -= 1
    i = 0
    while True:
        child = 2 * i + 1
        if child >= count:
            break
        if child + 1 < count and best[heap[child + 1]] < best[heap[child]]:
            child += 1
        if best[heap[child]] >= best[item]:
            break
        heap[i] = heap[child]
        slot[heap[i]] = i
        i = child
    if count > 0:
        heap[i] = item
        slot[item] = i
    return top


@njit
def _offer(corners, queue, y, x0, x1, rx, ry, g, root):  # type: ignore[no-untyped-def]
    """Offer the corners x0 … x1 of a line a path through a root."""
    spots, index = corners
    best, parent, heap, slot, size = queue
    for k in range(index[y, x0], index[y, x1 + 1]):
        dx, dy = spots[k, 0] - rx, y - ry
        ex, ey = dx * spots[k, 2], dy * spots[k, 3]
        # a taut path grazes the obstacle: it passes along one side and turns round to the other
        if not ((ex >= 0 and ey < 0) or (ex < 0 and ey >= 0)):
            continue
        cost = g + math.sqrt(dx * dx + dy * dy)
        if cost >= best[k] - 1e-12:
            continue
        best[k] = cost
        parent[k] = root
        if slot[k] < 0:
            heap[size[0]] = k
            slot[k] = size[0]
            size[0] += 1
        _sift_up(heap, slot, best, slot[k])


@njit
def _paint(field, label, c0, c1, rx, rise, g, root):  # type: ignore[no-untyped-def]
    """Offer the centres c0 … c1 of a row a path; the first and last not clearly served better.

    A centre p that another root serves better by more than two cells speaks for the rays near it:
    from p, any ray of the cone within one cell along the row is met sooner than this root meets it,
    so what lies behind such a ray is on no shortest path through this root.
    """
    first, last = c1 + 1, c0 - 1
    for c in range(c0, c1 + 1):
        ux = c + 0.5 - rx
        cost = g + math.sqrt(ux * ux + rise * rise)
        old = field[c]
        field[c] = min(cost, old)
        label[c] = root if cost < old else label[c]
        keep = cost <= old + 2.0
        first = min(first, c) if keep else first
        last = c if keep else last
    return first, last


@njit
def _is_served(field, x, y, cost):  # type: ignore[no-untyped-def]
    """Whether a corner is reached sooner through the centre of a cell beside it."""
    near = min(field[y - 1, x - 1], field[y - 1, x], field[y, x - 1], field[y, x])
    return near + HALF_DIAGONAL < cost - 1e-9


@njit
def _sweep(runs, corners, queue, picture, cones, depth, rx, ry, g, root):  # type: ignore[no-untyped-def]
    """Follow the cones on the stack away from their root, row by row, until walls end them.

    A cone is (line, direction, slopes): its rays cross `line` at rx + slope · |line − ry|.
    Returns the stack, which may have been moved to a larger one.
    """
    blocked, first, last = runs
    field, label = picture
    height, width = blocked.shape
    while depth > 0:
        depth -= 1
        line, up = int(cones[depth, 0]), int(cones[depth, 1])
        low, high = cones[depth, 2], cones[depth, 3]
        row = line if up > 0 else line - 1
        if row < 0 or row >= height:
            continue
        rise, next_rise = abs(line - ry), abs(line + up - ry)
        middle = abs(row + 0.5 - ry)
        right_edge = rx + high * rise
        col = min(max(math.floor(rx + low * rise), 0), width - 1)
        while col < width and col < right_edge:
            begin, end = np.int64(first[row, col]), np.int64(last[row, col])
            shut = blocked[row, col]
            col = end
            if shut:
                continue
            a, b = max(low, (begin - rx) / rise), min(high, (end - rx) / rise)
            if b - a <= _THIN:
                continue
            c0 = max(math.ceil(rx + a * middle - 0.5 - _EDGE), begin)
            c1 = min(math.floor(rx + b * middle - 0.5 + _EDGE), end - 1)
            if c1 >= c0:
                keep0, keep1 = _paint(field[row], label[row], c0, c1, rx, middle, g, root)
                if keep0 > keep1:
                    continue
                if keep0 > c0:
                    a = max(a, (keep0 - 0.5 - rx) / middle)
                if keep1 < c1:
                    b = min(b, (keep1 + 1.5 - rx) / middle)
            a, b = max(a, (begin - rx) / next_rise), min(b, (end - rx) / next_rise)
            if b < a - _THIN:
                continue
            x0 = max(math.ceil(rx + a * next_rise - _EDGE), 0)
            x1 = min(math.floor(rx + b * next_rise + _EDGE), width)
            if x1 >= x0:
                _offer(corners, queue, line + up, x0, x1, rx, ry, g, root)
            if b - a <= _THIN:
                continue
            if depth == len(cones):
                more = np.empty((2 * depth, 4))
                for k in range(depth):  # by loops: assigning arrays takes seconds to compile
                    for part in range(4):
                        more[k, part] = cones[k, part]
                cones = more
            cones[depth, 0], cones[depth, 1] = line + up, up
            cones[depth, 2], cones[depth, 3] = a, b
            depth += 1
    return cones


@njit
def _open_source(runs, corners, queue, picture, cones, rx, ry, root):  # type: ignore[no-untyped-def]
    """Serve the source's own row and put its two half-planes on the stack."""
    _, first, last = runs
    field, label = picture
    row, col = math.floor(ry), math.floor(rx)
    begin, end = np.int64(first[row, col]), np.int64(last[row, col])
    _paint(field[row], label[row], begin, end - 1, rx, abs(row + 0.5 - ry), 0.0, root)
    for k in range(2):
        line, up = row + 1 - k, 1 - 2 * k
        _offer(corners, queue, line, begin, end, rx, ry, 0.0, root)
        rise = abs(line - ry)
        cones[k, 0], cones[k, 1] = line, up
        cones[k, 2], cones[k, 3] = (begin - rx) / rise, (end - rx) / rise
    return np.int64(2)  # a plain 2 is a type of its own, and so another `_sweep` to compile


@njit
def _open_corner(runs, corners, queue, picture, cones, spot, px, py, g, root):  # type: ignore[no-untyped-def]
    """Serve the first row of a corner's shadow and put its cone on the stack.

    The shadow lies between the straight continuation of (px, py) → corner and the obstacle's edge.
    """
    blocked, first, last = runs
    field, label = picture
    width = blocked.shape[1]
    x0, y0, bx, by = spot[0], spot[1], spot[2], spot[3]
    rx, ry = float(x0), float(y0)
    dx, dy = rx - px, ry - py
    if dx * bx >= 0 and dy * by < 0:  # round to the level edge
        side, up = bx, -by
        near, far = abs(dx) / abs(dy), np.inf
    else:  # round to the upright edge
        side, up = -bx, by
        near, far = 0.0, (abs(dx) / abs(dy) if dy != 0 else np.inf)
    row = y0 if up > 0 else y0 - 1
    col = x0 if side > 0 else x0 - 1
    begin, end = np.int64(first[row, col]), np.int64(last[row, col])
    if far == np.inf:  # level rays run along the line, as far as the cells on the open side reach
        if side > 0:
            _offer(corners, queue, y0, x0 + 1, end, rx, ry, g, root)
        else:
            _offer(corners, queue, y0, begin, x0 - 1, rx, ry, g, root)
    low, high = (near, far) if side > 0 else (-far, -near)
    left, right = max(rx + low * 0.5, float(begin)), min(rx + high * 0.5, float(end))
    c0 = max(math.ceil(left - 0.5 - _EDGE), begin)
    c1 = min(math.floor(right - 0.5 + _EDGE), end - 1)
    _paint(field[row], label[row], c0, c1, rx, 0.5, g, root)
    # rays start in the point itself, so only the far line of the first row cuts them
    low, high = max(low, begin - rx), min(high, end - rx)
    if high < low - _THIN:
        return 0
    v0 = max(math.ceil(rx + low - _EDGE), 0)
    v1 = min(math.floor(rx + high + _EDGE), width)
    if v1 >= v0:
        _offer(corners, queue, y0 + up, v0, v1, rx, ry, g, root)
    cones[0, 0], cones[0, 1], cones[0, 2], cones[0, 3] = y0 + up, up, low, high
    return 1 if high - low > _THIN else 0


@njit
def spread_distances(runs, corners, sources, inside):  # type: ignore[no-untyped-def]
    """Distances from the nearest source to every cell centre, through chains of convex corners.

    Args:
        runs: (blocked [H, W] bool, and what `build_runs` makes of it).
        corners: from `build_corners`.
        sources: [K, 2] x, y [cells], each in a free cell.
        inside: bool [H, W], cells at distance 0, whose rim the sources are; [0, 0] for none.

    Returns:
        label [H, W] int32, index of each cell's root, −1 where unreachable; roots [R, 3] float64 of
        (x, y, distance) in the order they became final, the K sources first, then, if there are
        any, one at distance −inf for all cells inside; parents [R] int32, −1 for all of these.
    """
    height, width = runs[0].shape
    spots = corners[0]
    total = len(spots)
    field = np.full((height, width), np.inf)
    label = np.full((height, width), -1, np.int32)
    picture = (field, label)
    best = np.full(total, np.inf)
    parent = np.full(total, -1, np.int32)
    heap, slot = np.empty(total, np.int32), np.full(total, -1, np.int32)
    size = np.zeros(1, np.int64)
    queue = (best, parent, heap, slot, size)
    count = len(sources)
    most = total + count + 1
    roots, parents = np.empty((most, 3)), np.empty(most, np.int32)
    cones = np.empty((256, 4))

    for row in range(inside.shape[0]):
        for col in range(inside.shape[1]):
            if inside[row, col]:
                field[row, col], label[row, col] = 0.0, count
    for root in range(count):
        # on a cell's edge half the rays would have no first row; a billionth of a cell settles it
        source_x, source_y = sources[root, 0], sources[root, 1]
        col = min(max(math.floor(source_x), 0), width - 1)
        row = min(max(math.floor(source_y), 0), height - 1)
        rx = min(max(source_x, col + 1e-9), col + 1 - 1e-9)
        ry = min(max(source_y, row + 1e-9), row + 1 - 1e-9)
        roots[root, 0], roots[root, 1], roots[root, 2], parents[root] = rx, ry, 0.0, -1
        depth = _open_source(runs, corners, queue, picture, cones, rx, ry, root)
        cones = _sweep(runs, corners, queue, picture, cones, depth, rx, ry, 0.0, root)
    root = count - 1
    if inside.size > 0:
        root = count
        roots[root, 0], roots[root, 1], roots[root, 2] = roots[0, 0], roots[0, 1], -np.inf
        parents[root] = -1
    while size[0] > 0:
        k = _pop(heap, slot, best, size[0])
        size[0] -= 1
        x, y, g = spots[k, 0], spots[k, 1], best[k]
        if _is_served(field, x, y, g):
            continue
        root += 1
        before = parent[k]
        px, py = roots[before, 0], roots[before, 1]
        roots[root, 0], roots[root, 1], roots[root, 2], parents[root] = x, y, g, before
        depth = _open_corner(runs, corners, queue, picture, cones, spots[k], px, py, g, root)
        cones = _sweep(runs, corners, queue, picture, cones, depth, float(x), float(y), g, root)
    return label, roots[: root + 1].copy(), parents[: root + 1].copy()
