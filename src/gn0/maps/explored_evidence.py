"""What the marks of one picture do to the belief in each cell of an explored map.

Where the scene stands still a hit counts once a place, and one look takes back an eighth of it.
Where people may be about, what is seen now weighs more than what was seen before, in seconds:
* a sure hit takes a cell whatever was believed of it, and a doubtful one beside it is of the same
  body;
* what turns up on floor known to be free has a back: the free cells behind it that it hides are
  taken, too, as weakly as can be;
* each tick without the thing takes back as much as one look does in a still scene, but only as
  much as one look beside what is hit: edges of what stands still are seen through now and then.
"""

from __future__ import annotations

import math

from gn0.jit import njit
from gn0.maps.grid import FREE, OCCUPIED

# weights of one picture's evidence for a cell. A hit counts once a place: from there the same
# mistake would be made again with every turn of the head
SURE, WEAK, FLOOR, PASSED = 8, 3, -1, -1
SOLID = 4  # belief from which a cell is occupied: one sure hit, or weak ones from two places
MOST, LEAST = 20, -10  # belief is kept within
HITS_NEEDED = 2  # pixels of one picture in a cell until they count as a hit
# flags of a cell in one picture; hits are counted above them
SAW_PAST, SAW_BLIND, SAW_FLOOR, SAW_COLOUR, SAW_SURE, HIT = 1, 2, 4, 8, 16, 32

TICKS = 10  # a second
TICKS_MOST = 10  # that one look may take back, however long it was since the last
KNOWN = SOLID - SURE  # nobody is surer than this that nothing has come since: a hit takes the cell
CLEAR = -1  # belief up to which a cell was known to be free: what is hit there has come
BODY = 2  # cells from a sure hit within which a doubtful one is of the same body
EDGE = 2  # cells from a hit within which what stood there first is not taken back faster
BACK = 0.3  # m: how deep what has come is
HIGH, ARM = 100, 60  # cm that a hit on free floor reaches, or one beside it: lower things were
# overlooked till then, or are floor that is seen badly
OVER = 10  # cm: what is seen past this far below a thing's height is not hidden by it


@njit
def settle_still(marks, box, belief, seen_from, place, cells):  # type: ignore[no-untyped-def]
    """Turn the marks of one picture into belief and cells; colour flags stay for the painter."""
    for row in range(box[0], box[1] + 1):
        for col in range(box[2], box[3] + 1):
            mark = marks[row, col]
            if mark == 0:
                continue
            marks[row, col] = mark & SAW_COLOUR
            hits = mark // HIT
            old = new = belief[row, col]
            if hits >= HITS_NEEDED:
                if seen_from[row, col] != place:  # from one place the same mistake is made again
                    new = min(old + (SURE if mark & SAW_SURE else WEAK), MOST)
                seen_from[row, col] = place
            elif hits > 0:
                continue
            elif mark & SAW_FLOOR:
                new = max(old + FLOOR, LEAST)
            elif mark & SAW_PAST:
                new = max(old + PASSED, LEAST)
            elif mark & SAW_BLIND:
                new = min(old, -1) if old <= 0 else old
            belief[row, col] = new
            if new >= SOLID:
                cells[row, col] = OCCUPIED
            elif new < 0:
                cells[row, col] = FREE


@njit(inline="always")
def _beside(marks, row, col, reach, sure):  # type: ignore[no-untyped-def]
    """Whether a hit, or a sure one, is within `reach` cells."""
    tall, wide = marks.shape
    for r in range(max(row - reach, 0), min(row + reach + 1, tall)):
        for c in range(max(col - reach, 0), min(col + reach + 1, wide)):
            mark = marks[r, c]
            if mark // HIT >= HITS_NEEDED and (mark & SAW_SURE or not sure):
                return True
    return False


@njit(inline="always")
def _find_ahead(frame, pose, row, col):  # type: ignore[no-untyped-def]
    """How far ahead of the eye a cell is [m]."""
    x = frame[0] + (col + 0.5) / frame[2] - pose[0]
    y = frame[1] + (row + 0.5) / frame[2] - pose[1]
    return x * pose[2] + y * pose[3]


@njit(inline="always")
def _has_come(belief, came, rises, row, col, high, arm):  # type: ignore[no-untyped-def]
    """Whether what is hit here has come: on free floor, or beside what came; not at a wall."""
    if belief[row, col] > 0:
        return came[row, col] > 0
    tall, wide = belief.shape
    beside = belief[row, col] <= CLEAR and rises[row, col] >= high
    for r in range(max(row - 1, 0), min(row + 2, tall)):
        for c in range(max(col - 1, 0), min(col + 2, wide)):
            if came[r, c]:
                beside = beside or rises[row, col] >= arm
            elif belief[r, c] >= SOLID:
                return False
    return beside


@njit
def _take_back(marks, box, belief, cells, came, rises, row, col, frame, pose):  # type: ignore[no-untyped-def]
    """Take the hidden cells behind a hit; box grows to hold them."""
    tall, wide = marks.shape
    x, y = (pose[0] - frame[0]) * frame[2], (pose[1] - frame[1]) * frame[2]
    dx, dy = col + 0.5 - x, row + 0.5 - y
    away = math.sqrt(dx * dx + dy * dy)
    if not away > 0.0:
        return
    for k in range(1, math.floor(2.0 * BACK * frame[2]) + 1):
        c = math.floor(col + 0.5 + 0.5 * k * dx / away)
        r = math.floor(row + 0.5 + 0.5 * k * dy / away)
        if r < 0 or c < 0 or r >= tall or c >= wide:
            return
        if marks[r, c] & ~SAW_COLOUR == 0 and belief[r, c] < 0:
            belief[r, c] = SOLID
            cells[r, c] = OCCUPIED
            came[r, c] = 1
            rises[r, c] = 255
            box[0], box[1] = min(box[0], r), max(box[1], r)
            box[2], box[3] = min(box[2], c), max(box[3], c)


@njit
def settle_moving(  # type: ignore[no-untyped-def]
    marks, box, belief, seen_from, place, cells, ticks, frame, pose, sight, top, sums, rises, came
):
    """The same where people may be about, `ticks` of 0.1 s after the picture before.

    Colours of what has gone are forgotten with it. Marks stay for the painter.

    sight: height of the eye [cm], and the rise [cm] a metre ahead of the picture's lowest and of
    its highest ray. rises [H, W] cm: the highest hit of each cell. came [H, W]: whether what is
    there came while the agent looked.
    """
    coloured = top.shape[0] > 0
    first_row, last_row, first_col, last_col = box[0], box[1], box[2], box[3]
    for row in range(first_row, last_row + 1):
        for col in range(first_col, last_col + 1):
            mark = marks[row, col]
            hits = mark // HIT
            if mark == 0 or 0 < hits < HITS_NEEDED:
                continue
            old = new = belief[row, col]
            if hits:
                sure = mark & SAW_SURE != 0
                ahead = _find_ahead(frame, pose, row, col)
                seen = sight[0] + sight[2] * ahead - OVER  # no higher can be asked for
                high = min(HIGH, seen)
                fresh = seen_from[row, col] != place
                seen_from[row, col] = place
                if _has_come(belief, came, rises, row, col, high, min(ARM, seen)):
                    came[row, col] = 1
                    sure = sure or _beside(marks, row, col, BODY, True)
                    gain = SURE if sure else WEAK
                    new = max(old, KNOWN + gain)
                    if sure:
                        _take_back(marks, box, belief, cells, came, rises, row, col, frame, pose)
                elif fresh:
                    if old >= 0 and rises[row, col] >= high:
                        sure = sure or _beside(marks, row, col, BODY, True)
                    new = min(old + (SURE if sure else WEAK), MOST)
                    if old < 0 and new >= SOLID:
                        came[row, col] = 1
            elif mark & (SAW_FLOOR | SAW_PAST | SAW_BLIND):
                if not mark & (SAW_FLOOR | SAW_PAST):  # low things would not be seen
                    ahead = _find_ahead(frame, pose, row, col)
                    over = rises[row, col] < sight[0] + sight[1] * ahead + OVER
                    if old <= 0 or over:
                        if old <= 0:
                            belief[row, col] = min(old, -1)
                            cells[row, col] = FREE
                        continue
                fade = ticks
                if old > 0 and not came[row, col] and _beside(marks, row, col, EDGE, False):
                    fade = 1
                new = max(old - fade, LEAST)
                if new < 0:
                    if coloured and (old >= 0 or rises[row, col]):
                        top[row, col] = -1000
                        sums[row, col] = 0
                        marks[row, col] |= SAW_COLOUR
                    rises[row, col] = came[row, col] = 0
            belief[row, col] = new
            if new >= SOLID:
                cells[row, col] = OCCUPIED
            elif new < 0:
                cells[row, col] = FREE
