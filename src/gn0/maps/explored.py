"""A map grown from depth pictures: what a camera at a known pose has seen, and nothing else.

Each picture adds evidence to the cells it speaks of:
* a return inside the agent's height band is a hit: the cell is occupied;
* a return below the band is floor: the cell is free, and so are the cells between two floor
  returns that follow each other in a column of the picture;
* the space before the nearest hit of a direction was passed through: its cells are free. Where the
  picture does not reach down to the floor, only as long as nothing has been seen in them;
* a pixel without a return says nothing. One between two surfaces (at a silhouette the expected
  depth is a mixture of both) is no hit either, but ends what was passed.
Evidence is kept in integers, in the order of the pixels: the same pictures make the same map, bit
for bit.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from gn0.geometry import F32, F64, U8
from gn0.jit import njit
from gn0.maps.explored_evidence import (
    HIT,
    LEAST,
    SAW_BLIND,
    SAW_COLOUR,
    SAW_FLOOR,
    SAW_PAST,
    SAW_SURE,
    TICKS,
    TICKS_MOST,
    settle_moving,
    settle_still,
)
from gn0.maps.grid import FREE, UNKNOWN, OccupancyGrid

COLUMNS, ROWS = 480, 180  # pixels of a picture that are looked at, at most about so many
RAMP = 0.08  # m beside a silhouette in which expected depth slides from one surface to the other
STEP, BEND = 1.0, 0.1  # a surface steps less a metre aside, and bends less, as a share of its slope
EDGE = 0.04  # share of its depth by which a surface may change from one row of pixels to the next
DOUBT = 0.02  # a return so little above the band's foot, a metre of distance, may be floor
VEIL, VEIL_DEPTH = 0.2, 0.6  # m beside, and behind, what is nearer than VEIL_DEPTH: see _find_veils
LEVEL, GAP = 0.02, 0.2  # m: two returns of a column this level and near are one surface: fill it
LAYER = 80  # mm: colours this near to the highest point of a cell are averaged
_BELOW = -0.3  # m: a return deeper than this below the floor is outside the building
_SINK = 0.01  # m: a hit is placed this far behind its surface, inside what it belongs to
_HITS_FULL = 60_000


@dataclass(frozen=True, eq=False)
class DepthFan:
    """The rays of a depth camera, as far as they are looked at; built once a camera.

    Attributes:
        rows, cols: pixels that are looked at.
        forward, up: [R] of a row's rays, metres a metre of depth, in the agent's level frame.
        left: [C] of a column's rays, likewise.
        bins: [R, C] direction of each ray on the floor, as an index into `angles`.
        angles: [B] rad, left of straight ahead.
        blind: distance [m] nearer than which no ray meets the band's foot.
        focal: fx [px].
        height: height of the camera above the floor [m].
        limits: (min, max) depth [m]; at or beyond them a pixel has no return.
        band: (low, high) of the agent's body above the floor [m].
        cut: colours above this height [m] are left out.
        colour_rows, colour_cols: the pixel of the colour picture that each looks at; −1 for none.
    """

    rows: NDArray[np.int64]
    cols: NDArray[np.int64]
    forward: F64
    up: F64
    left: F64
    bins: NDArray[np.int32]
    angles: F64
    blind: float
    focal: float
    height: float
    limits: tuple[float, float]
    band: tuple[float, float]
    cut: float
    colour_rows: NDArray[np.int64]
    colour_cols: NDArray[np.int64]


def build_fan(
    size: tuple[int, int],
    focal: tuple[float, float],
    centre: tuple[float, float],
    *,
    pitch: float,
    height: float,
    limits: tuple[float, float],
    band: tuple[float, float],
    cut: float,
    colour_size: tuple[int, int] | None = None,
    colour_focal: tuple[float, float] = (1.0, 1.0),
    colour_centre: tuple[float, float] = (0.0, 0.0),
) -> DepthFan:
    """The fan of a pinhole depth camera.

    Args:
        size: (width, height) of the depth picture [px].
        focal: fx, fy [px].
        centre: cx, cy [px].
        pitch: how far the camera looks up [rad].
        height: height of the camera above the floor [m].
        limits: see `DepthFan`.
        band: see `DepthFan`.
        cut: see `DepthFan`.
        colour_size: of the colour picture from the same place [px]; None if there is none.
        colour_focal: its fx, fy [px].
        colour_centre: its cx, cy [px].
    """
    width, tall = size
    cols = np.arange(0, width, max(1, math.ceil(width / COLUMNS)))
    rows = np.arange(0, tall, max(1, math.ceil(tall / ROWS)))
    x: F64 = ((cols + 0.5 - centre[0]) / focal[0]).astype(np.float64)
    y: F64 = ((rows + 0.5 - centre[1]) / focal[1]).astype(np.float64)
    forward: F64 = math.cos(pitch) + y * math.sin(pitch)
    up: F64 = math.sin(pitch) - y * math.cos(pitch)
    angle = np.arctan2(-x[None, :], forward[:, None])
    spacing = math.atan((cols[1] - cols[0] if len(cols) > 1 else 1) / focal[0])
    first = angle.min()
    bins = np.rint((angle - first) / spacing).astype(np.int32)
    c_rows, c_cols = np.full(len(rows), -1), np.full(len(cols), -1)
    if colour_size is not None:
        c_rows = np.floor(y * colour_focal[1] + colour_centre[1]).astype(np.int64)
        c_cols = np.floor(x * colour_focal[0] + colour_centre[0]).astype(np.int64)
        c_rows[(c_rows < 0) | (c_rows >= colour_size[1])] = -1
        c_cols[(c_cols < 0) | (c_cols >= colour_size[0])] = -1
    return DepthFan(
        rows=rows.astype(np.int64),
        cols=cols.astype(np.int64),
        forward=forward,
        up=up,
        left=np.negative(x),
        bins=bins,
        angles=first + spacing * np.arange(int(bins.max()) + 1),
        blind=_find_blind(float(height - band[0]), forward[-1], up[-1]),
        focal=float(focal[0]),
        height=float(height),
        limits=(float(limits[0]), float(limits[1])),
        band=(float(band[0]), float(band[1])),
        cut=float(cut),
        colour_rows=c_rows.astype(np.int64),
        colour_cols=c_cols.astype(np.int64),
    )


def _find_blind(drop: float, forward: float, up: float) -> float:
    """Distance [m] nearer than which the lowest ray is still more than the band's foot above it."""
    return drop * forward / -up if up < 0 < forward else (math.inf if up >= 0 else 0.0)


def _find_rise(fan: DepthFan, row: int) -> float:
    """What a row's rays rise [cm] a metre ahead; −inf for those that look straight down."""
    forward, up = float(fan.forward[row]), float(fan.up[row])
    return 100.0 * up / forward if forward > 0.0 else -math.inf


@njit(inline="always")
def _flag(marks, row, col, flag, box):  # type: ignore[no-untyped-def]
    """Note that a picture says something of a cell; box grows to hold it."""
    marks[row, col] |= flag
    box[0] = min(box[0], row)
    box[1] = max(box[1], row)
    box[2] = min(box[2], col)
    box[3] = max(box[3], col)


@njit(inline="always")
def _trust(depth, v, u, z, focal):  # type: ignore[no-untyped-def]
    """How far a pixel lies on a surface: 2 surely, 1 perhaps, 0 on the ramp between two of them.

    Splats are soft: across a silhouette the expected depth slides from one surface to the other
    over some `RAMP` metres. A surface goes on without a step on one side at least, or it is seen
    at a slant and its inverse depth has one slope near by and farther off.
    """
    wide = depth.shape[1]
    above = abs(depth[max(v - 1, 0), u] - z)
    below = abs(depth[min(v + 1, depth.shape[0] - 1), u] - z)
    if min(above, below) > EDGE * z:
        return 0
    k = min(max(int(RAMP * focal / z), 1), 64)
    a, b = float(depth[v, max(u - k, 0)]), float(depth[v, min(u + k, wide - 1)])
    left, right = abs(a - z), abs(b - z)
    if max(left, right) <= STEP * RAMP:
        return 2
    if min(left, right) <= STEP * RAMP:
        return 1
    if u < 2 * k or u + 2 * k >= wide:
        return 0
    c, d = float(depth[v, u - 2 * k]), float(depth[v, u + 2 * k])
    inner, outer = 1.0 / b - 1.0 / a, 0.5 * (1.0 / d - 1.0 / c)
    return 1 if abs(inner - outer) <= BEND * abs(inner) else 0


@njit
def _find_veils(depth, focal, fan_rows, fan_cols):  # type: ignore[no-untyped-def]
    """Depth [C] m beyond which the pixels of a column may be seen through something close by.

    The tail of a splat at arm's length spreads over many columns and draws the expected depth of
    all that is behind it towards the eye.
    """
    count = len(fan_cols)
    veil = np.full(count, np.inf)
    nearest = np.full(count, np.inf)
    for i in range(len(fan_rows)):
        for j in range(count):
            nearest[j] = min(nearest[j], depth[fan_rows[i], fan_cols[j]])
    for j in range(count):
        if nearest[j] >= VEIL_DEPTH:
            continue
        reach = VEIL * focal / max(nearest[j], 0.05)
        k = j
        while k >= 0 and fan_cols[j] - fan_cols[k] <= reach:
            veil[k] = min(veil[k], 2.0 * nearest[j] + 0.2)
            k -= 1
        k = j + 1
        while k < count and fan_cols[k] - fan_cols[j] <= reach:
            veil[k] = min(veil[k], 2.0 * nearest[j] + 0.2)
            k += 1
    return veil


@njit
def _scan(  # type: ignore[no-untyped-def]
    depth, rgb, focal, fan_rows, fan_cols, forward, up, left, bins, height, limits, band, cut,
    rgb_rows, rgb_cols, frame, pose, coloured, marks, box, near, far, top, sums, rises,
):  # fmt: skip
    """Mark hits and floor, add colours, and find how far each direction was passed through.

    frame: origin x, y and cells a metre. pose: x, y, cos yaw, sin yaw. near, far [B] m: nearest
    obstacle and farthest return of each direction. sums [H, W, 4]: red, green, blue, count.
    rises [H, W] cm: the highest hit of each cell; empty where nothing moves.
    """
    tall, wide = marks.shape
    moving = rises.shape[0] > 0
    last_range = np.zeros(len(fan_cols))  # of the return in the row above, 0 if there was none
    last_rise = np.zeros(len(fan_cols))
    veil = _find_veils(depth, focal, fan_rows, fan_cols)
    for i in range(len(fan_rows)):
        v = fan_rows[i]
        for j in range(len(fan_cols)):
            u = fan_cols[j]
            z = float(depth[v, u])
            before, level = last_range[j], last_rise[j]
            last_range[j] = 0.0
            if not z < limits[1]:
                continue
            lead, side = z * forward[i], z * left[j]
            rise = height + z * up[i]
            reach = math.sqrt(lead * lead + side * side)
            b = bins[i, j]
            trust = 2
            if rise >= band[0]:
                trust = 0
                if z <= veil[j] and rise >= band[0] + DOUBT * reach:
                    trust = _trust(depth, v, u, z, focal)
            if z <= limits[0] or trust == 0:
                near[b] = min(near[b], reach)
                continue
            if rise < _BELOW:
                continue
            kind = 0
            if rise < band[0]:
                far[b] = max(far[b], reach)
                kind = SAW_FLOOR
            elif rise <= band[1]:
                near[b] = min(near[b], reach)
                far[b] = max(far[b], reach)
                kind = HIT
            else:
                leave = (band[1] - height) / (rise - height) if height < band[1] else 0.0
                far[b] = max(far[b], reach * leave)
            if kind == 0 and not (coloured and rise < cut):
                continue
            if kind == HIT:
                sink = 1.0 + _SINK / max(reach, _SINK)
                lead, side = lead * sink, side * sink
            count = 1
            if kind != 0:
                last_range[j], last_rise[j] = reach, rise
                gap = abs(before - reach)
                most = 0.25 * reach if kind == SAW_FLOOR else GAP
                if before > 0.0 and abs(level - rise) < LEVEL and gap < most:
                    count = min(1 + int(gap * frame[2]), 64)  # one level surface: fill it
            r = g = bl = 0
            paint = coloured and rise < cut and rgb_rows[i] >= 0 and rgb_cols[j] >= 0
            if paint:
                r = rgb[rgb_rows[i], rgb_cols[j], 0]
                g = rgb[rgb_rows[i], rgb_cols[j], 1]
                bl = rgb[rgb_rows[i], rgb_cols[j], 2]
            millimetres = math.floor(min(rise, 30.0) * 1000.0)
            for k in range(count):  # along the ray towards the return before
                scale = 1.0
                if k > 0:
                    scale = (reach + (before - reach) * k / count) / reach
                x = pose[0] + scale * (lead * pose[2] - side * pose[3])
                y = pose[1] + scale * (lead * pose[3] + side * pose[2])
                col = math.floor((x - frame[0]) * frame[2])
                row = math.floor((y - frame[1]) * frame[2])
                if row < 0 or col < 0 or row >= tall or col >= wide:
                    continue
                if kind == HIT:
                    if marks[row, col] < _HITS_FULL:
                        marks[row, col] += HIT
                    if trust == 2:
                        marks[row, col] |= SAW_SURE
                    if moving:
                        rises[row, col] = max(rises[row, col], min(int(100.0 * rise), 255))
                elif kind == SAW_FLOOR:
                    marks[row, col] |= SAW_FLOOR
                if paint:
                    if millimetres > top[row, col] + LAYER:
                        top[row, col] = millimetres
                        sums[row, col] = 0
                    if millimetres >= top[row, col] - LAYER and sums[row, col, 3] < 1_000_000:
                        sums[row, col, 0] += r
                        sums[row, col, 1] += g
                        sums[row, col, 2] += bl
                        sums[row, col, 3] += 1
                        marks[row, col] |= SAW_COLOUR
                if marks[row, col]:
                    _flag(marks, row, col, 0, box)


@njit
def _pass(marks, box, frame, pose, angles, near, far, margin, blind):  # type: ignore[no-untyped-def]
    """Mark the cells from the camera to `margin` [m] before the nearest obstacle as passed.

    Nearer than `blind` [m] the picture does not reach down to the floor: something low may stand
    there, and such a cell is believed free only while nothing has been seen in it.
    """
    tall, wide = marks.shape
    u0, v0 = (pose[0] - frame[0]) * frame[2], (pose[1] - frame[1]) * frame[2]
    for b in range(len(angles)):
        limit = min(near[b] - margin, far[b]) * frame[2]
        if not limit > 0.0:
            continue
        c, s = math.cos(angles[b]), math.sin(angles[b])
        dx, dy = c * pose[2] - s * pose[3], c * pose[3] + s * pose[2]
        row, col = math.floor(v0), math.floor(u0)
        step_x = 1 if dx > 0 else -1
        step_y = 1 if dy > 0 else -1
        per_x = abs(1.0 / dx) if dx != 0 else np.inf
        per_y = abs(1.0 / dy) if dy != 0 else np.inf
        next_x = ((col + 1 - u0) if dx > 0 else (u0 - col)) * per_x if dx != 0 else np.inf
        next_y = ((row + 1 - v0) if dy > 0 else (v0 - row)) * per_y if dy != 0 else np.inf
        while 0 <= row < tall and 0 <= col < wide:
            leave = min(next_x, next_y)
            _flag(marks, row, col, SAW_PAST if leave > blind * frame[2] else SAW_BLIND, box)
            if leave > limit:
                break
            if next_x < next_y:
                next_x += per_x
                col += step_x
            else:
                next_y += per_y
                row += step_y


@njit
def _paint(marks, box, cells, sums, greys, unseen, occupancy, bev):  # type: ignore[no-untyped-def]
    """Redraw the box in both pictures (north up) and clear its marks; an empty `bev` is left."""
    tall = cells.shape[0]
    coloured = bev.shape[0] > 0
    for row in range(box[0], box[1] + 1):
        for col in range(box[2], box[3] + 1):
            grey = greys[cells[row, col]]
            if occupancy[tall - 1 - row, col, 0] != grey:
                occupancy[tall - 1 - row, col, :] = grey
            if coloured and marks[row, col] & SAW_COLOUR:
                count = sums[row, col, 3]
                half = count // 2
                for k in range(3):
                    bev[tall - 1 - row, col, k] = (
                        (sums[row, col, k] + half) // count if count else unseen
                    )
            marks[row, col] = 0


@dataclass(frozen=True, eq=False)
class ExploredState:
    """Everything an `ExploredMap` knows.

    Attributes:
        belief: [H, W] evidence, above 0 for occupied.
        seen_from: [H, W] the place from which a cell was hit last.
        place: how many places there were.
        cells: [H, W] as in `OccupancyGrid`.
        occupancy, bev: [H, W, 3] pictures, north up; bev is empty without colours.
        top: [H, W] mm, the highest point seen below the cut.
        sums: [H, W, 4] red, green, blue and count of the colours near it.
        last: pose of the last picture.
        time: of the last picture [s]; None where nothing moves.
        rises: [H, W] cm, the highest hit of each cell; empty where nothing moves.
        came: [H, W] whether what is in a cell came while the agent looked; likewise.
    """

    belief: NDArray[np.int8]
    seen_from: NDArray[np.int32]
    place: int
    cells: U8
    occupancy: U8
    bev: U8
    top: NDArray[np.int16]
    sums: NDArray[np.uint32]
    last: tuple[float, float, float] | None
    time: float | None = None
    rises: U8 = field(default_factory=lambda: np.zeros((0, 0), np.uint8))
    came: U8 = field(default_factory=lambda: np.zeros((0, 0), np.uint8))

    def copy(self) -> ExploredState:
        """An independent copy."""
        return replace(
            self,
            belief=self.belief.copy(),
            seen_from=self.seen_from.copy(),
            cells=self.cells.copy(),
            occupancy=self.occupancy.copy(),
            bev=self.bev.copy(),
            top=self.top.copy(),
            sums=self.sums.copy(),
            rises=self.rises.copy(),
            came=self.came.copy(),
        )


class ExploredMap:
    """What a sequence of depth pictures has shown, as cells and as pictures.

    Args:
        frame: only its shape, resolution and origin are taken, never its cells.
        greys: [3] grey of free, occupied and unknown cells in the occupancy picture.
        unseen: grey of pixels of the colour picture that nothing has been seen of.
        coloured: keep a colour picture too.
    """

    def __init__(self, frame: OccupancyGrid, greys: U8, unseen: int, coloured: bool) -> None:
        self._grid = frame.with_cells(np.full(frame.shape, UNKNOWN, np.uint8))
        self._greys, self._unseen = greys, unseen
        self.coloured = coloured
        self._marks = np.zeros(frame.shape, np.uint16)
        self._frame = np.array([*frame.origin, 1.0 / frame.resolution])
        self.clear()

    def clear(self) -> None:
        """Forget everything."""
        shape = self._grid.shape
        layer = shape if self.coloured else (0, 0)
        self._state = ExploredState(
            belief=np.zeros(shape, np.int8),
            seen_from=np.zeros(shape, np.int32),
            place=0,
            cells=np.full(shape, UNKNOWN, np.uint8),
            occupancy=np.full((*shape, 3), self._greys[UNKNOWN], np.uint8),
            bev=np.full((*layer, 3), self._unseen, np.uint8),
            top=np.full(layer, -1000, np.int16),
            sums=np.zeros((*layer, 4), np.uint32),
            last=None,
        )

    def save(self) -> ExploredState:
        """A copy of what is known, for `restore`."""
        return self._state.copy()

    def restore(self, state: ExploredState) -> None:
        """Go back to a saved state, bit for bit."""
        self._state = state.copy()

    @property
    def occupancy(self) -> U8:
        """The occupancy picture [H, W, 3], north up; a view that later pictures change."""
        return self._state.occupancy

    @property
    def bev(self) -> U8:
        """The colour picture [H, W, 3], north up; a view that later pictures change."""
        return self._state.bev

    @property
    def grid(self) -> OccupancyGrid:
        """The cells known so far, as a grid of its own."""
        return self._grid.with_cells(self._state.cells.copy())

    def add_standing(self, x: float, y: float, radius: float) -> None:
        """Mark the disc of `radius` [m] at (x, y) m as free: the agent's body is there."""
        row, col = self._grid.cell_of(x, y)
        reach = math.floor(radius / self._grid.resolution)
        height, width = self._grid.shape
        top, bottom = max(row - reach, 0), min(row + reach, height - 1)
        left, right = max(col - reach, 0), min(col + reach, width - 1)
        if top > bottom or left > right:
            return
        v, u = np.ogrid[top : bottom + 1, left : right + 1]
        inside = (v - row) ** 2 + (u - col) ** 2 <= reach**2
        area = np.s_[top : bottom + 1, left : right + 1]
        self._state.belief[area][inside] = LEAST
        self._state.cells[area][inside] = FREE
        self._repaint(np.array([top, bottom, left, right], np.int64))

    def add_picture(
        self,
        fan: DepthFan,
        depth: F32,
        rgb: U8 | None,
        x: float,
        y: float,
        yaw: float,
        time: float | None = None,
    ) -> None:
        """Add one depth picture, and its colours, seen from (x, y) m with `yaw` [rad].

        A picture from the very pose of the one before adds nothing: it is the same picture.
        `time` [s] is given where people may be about: then only one of that time is the same, and
        what is seen now weighs more than what was; see `explored_evidence`.
        """
        state = self._state
        if state.last == (x, y, yaw) and state.time == time:
            return
        moved = state.last is None or state.last[:2] != (x, y)
        since = 0.0 if time is None or state.time is None else time - state.time
        self._state = state = replace(state, last=(x, y, yaw), place=state.place + moved, time=time)
        if time is not None and not len(state.came):
            nothing = np.zeros(self._grid.shape, np.uint8)
            self._state = state = replace(state, rises=nothing, came=nothing.copy())
        height, width = self._grid.shape
        box = np.array([height, -1, width, -1], np.int64)
        pose = np.array([x, y, math.cos(yaw), math.sin(yaw)])
        near = np.full(len(fan.angles), np.inf)
        far = np.zeros(len(fan.angles))
        coloured = self.coloured and rgb is not None
        picture = rgb if rgb is not None else np.zeros((0, 0, 3), np.uint8)
        _scan(
            depth, picture, fan.focal, fan.rows, fan.cols, fan.forward, fan.up, fan.left, fan.bins,
            fan.height, fan.limits, fan.band, fan.cut, fan.colour_rows, fan.colour_cols,
            self._frame, pose, coloured, self._marks, box, near, far, state.top, state.sums,
            state.rises,
        )  # fmt: skip
        margin = 0.5 * self._grid.resolution
        _pass(self._marks, box, self._frame, pose, fan.angles, near, far, margin, fan.blind)
        seen = self._marks, box, state.belief, state.seen_from, state.place, state.cells
        if time is None:
            settle_still(*seen)
        else:
            ticks = min(max(round(since * TICKS), 1), TICKS_MOST)
            sight = 100.0 * fan.height, _find_rise(fan, -1), _find_rise(fan, 0)
            settle_moving(
                *seen, ticks, self._frame, pose, sight, state.top, state.sums, state.rises,
                state.came,
            )  # fmt: skip
        self._repaint(box)

    def _repaint(self, box: NDArray[np.int64]) -> None:
        state = self._state
        _paint(
            self._marks, box, state.cells, state.sums, self._greys, self._unseen,
            state.occupancy, state.bev,
        )  # fmt: skip
