"""Map pictures around an agent that turn with it: its heading is up, most of the picture ahead.

A pixel that is larger than a pixel of the map is the mean of samples on a grid in it, close enough
that none of the map is passed over. From the pose on all arithmetic is in whole numbers, so that
`kernels/ego.cu` and this file give the same bits: lengths in 2⁻¹⁶ pixels, sines in 2⁻³⁰.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Literal, get_args

import msgspec
import numpy as np

from gn0.config import Config
from gn0.errors import ConfigError
from gn0.geometry import U8
from gn0.jit import njit

EgoContent = Literal["bev", "occupancy", "merged"]
CONTENTS: tuple[EgoContent, ...] = get_args(EgoContent)
SIZE_LIMIT, SQUARES_LIMIT = 1024, 8
QUARTER = round(2**51 / np.pi)  # of angles: 2³⁰ a quarter turn, times 2²⁰
SAMPLES = 32  # a side of a pixel at most
TINT = 255  # the blue that is mixed in, half and half, where the map is occupied
# sin(x·π/2) as a series in x², coefficients in 2⁻³⁰: within 2⁻²⁹ for 0 ≤ x ≤ 1
SERIES = tuple(
    round((-1) ** k * (np.pi / 2) ** (2 * k + 1) / np.prod(np.arange(1.0, 2 * k + 2)) * 2**30)
    for k in range(7)
)
_C0, _C1, _C2, _C3, _C4, _C5, _C6 = SERIES


class EgoSquare(Config, frozen=True):
    """A square map picture around the agent, which stands in the middle of a row and looks up.

    Its frame is the `EgoFrame` of the same size, scale and share ahead, see `gn0.data`.

    Attributes:
        size: width and height [px].
        metres_per_pixel: scale [m].
        ahead: the share of the picture that lies before the agent, 0.5 the middle.
        content: `bev`, `occupancy`, or `merged`: the BEV, mixed half and half with blue where the
            map is occupied and with grey where it is unknown.
        marker: radius of the disc at the start, and half the length of the agent's arrow but for
            half a pixel's width [px]; -1 leaves both out.
    """

    size: int = 128
    metres_per_pixel: float = 0.06
    ahead: float = 0.65
    content: EgoContent = "merged"
    marker: int = 2

    def __post_init__(self) -> None:
        if not (
            1 <= self.size <= SIZE_LIMIT
            and 0.005 <= self.metres_per_pixel <= 5
            and 0 <= self.ahead <= 1
            and self.content in CONTENTS
            and -1 <= self.marker <= 100
        ):
            raise ConfigError(
                f"ego map of {self.size} px at {self.metres_per_pixel} m, {self.ahead} ahead, with "
                f"{self.content!r} and markers of {self.marker} px",
                remedy=f"give 1 to {SIZE_LIMIT} px of 0.005 to 5 m, a share of 0 to 1, one of "
                f"{', '.join(CONTENTS)}, and -1 to 100 px",
            )


class MapView(Config, frozen=True):
    """How an agent is shown its maps.

    Attributes:
        squares: of the sensor `ego_map`, side by side from the left.
        arrow: in the occupancy picture the agent is an arrow along its heading, not a disc.
        paint: what squares show as BEV: the `scene`, or the scene painted by the `categories` of
            its labelled objects (`gn0.sim.category_map`), which no robot knows: a control.
    """

    squares: tuple[EgoSquare, ...] = (EgoSquare(), EgoSquare(metres_per_pixel=0.15))
    arrow: bool = False
    paint: Literal["scene", "categories"] = "scene"

    def __post_init__(self) -> None:
        if not 1 <= len(self.squares) <= SQUARES_LIMIT:
            raise ConfigError(
                f"ego map of {len(self.squares)} squares", remedy=f"give 1 to {SQUARES_LIMIT}"
            )

    @property
    def picture_size(self) -> tuple[int, int]:
        """Width and height [px] of all squares side by side, their tops at one height."""
        return sum(s.size for s in self.squares), max(s.size for s in self.squares)

    @property
    def looks_at_bev(self) -> bool:
        """Whether a square shows colours."""
        return any(s.content != "occupancy" for s in self.squares)

    @property
    def painted(self) -> bool:
        """Whether a square shows the colours of categories."""
        return self.looks_at_bev and self.paint == "categories"

    def split(self, picture: U8) -> tuple[U8, ...]:
        """The squares [..., S, S, 3] of what `ego_map` reads [..., H, W, 3]; views, not copies."""
        found, left = [], 0
        for square in self.squares:
            found.append(picture[..., : square.size, left : left + square.size, :])
            left += square.size
        return tuple(found)


_FIELDS = f"squares ({', '.join(EgoSquare.__struct_fields__)} each), arrow and paint"


def read_map_view(view: MapView | Mapping[str, Any] | None) -> MapView:
    """A map view as it is given: itself, its fields as in JSON, or None for that of homes.

    Raises:
        ConfigError: a field is unknown, of the wrong type or out of range; names it.
    """
    if view is None or isinstance(view, MapView):
        return view or MapView()
    try:
        return msgspec.convert(view, MapView)
    except msgspec.ValidationError as error:
        raise ConfigError(str(error), where="map_view", remedy=f"give {_FIELDS}") from None


@njit(inline="always")
def _series(t):  # type: ignore[no-untyped-def]
    """sin(t·π/2) of 0 ≤ t ≤ 1, both in 2⁻³⁰."""
    z = (t * t) >> 30
    p = _C5 + ((_C6 * z) >> 30)
    p = _C4 + ((p * z) >> 30)
    p = _C3 + ((p * z) >> 30)
    p = _C2 + ((p * z) >> 30)
    p = _C1 + ((p * z) >> 30)
    p = _C0 + ((p * z) >> 30)
    return min((t * p) >> 30, 1 << 30)


@njit
def sine(angle):  # type: ignore[no-untyped-def]
    """Sine in 2⁻³⁰ of an angle in quarter turns of 2³⁰."""
    quarter, t = (angle >> 30) & 3, angle & ((1 << 30) - 1)
    if quarter & 1:
        t = (1 << 30) - t
    found = _series(t)
    return -found if quarter & 2 else found


@njit
def find_turn(yaw):  # type: ignore[no-untyped-def]
    """Cosine and sine of a heading [rad] in 2⁻³⁰."""
    angle = np.int64(np.rint(yaw * (QUARTER / 1048576.0)))
    return sine(angle + (1 << 30)), sine(angle)


@njit(inline="always")
def _in_arrow(ahead, left, marker):  # type: ignore[no-untyped-def]
    """Whether a place [2⁻¹⁶ px] from the agent is in its arrow: twice as long before as behind."""
    half = (2 * marker + 1) << 15
    return ahead >= -half and 3 * abs(left) <= 2 * half - ahead


@njit
def _draw_square(  # type: ignore[no-untyped-def]
    bev, grey, corner, scale, pose, start, size, metres, front, content, marker, out, offset
):
    """Draw a square [S, S, 3] from column `offset` on; see `kernels/ego.cu`, which is this again.

    corner: x and y [m] of the map's lower left. front: rows before the agent in 2⁻¹⁶ px. content:
    index in `CONTENTS`.
    """
    rows, cols = grey.shape
    cosine, sin = find_turn(pose[2])
    step = np.int64(np.rint(metres / scale * 65536.0))
    along = (cosine * step + (1 << 21)) >> 22  # pixels of the map a pixel, in 2⁻²⁴
    across = (sin * step + (1 << 21)) >> 22
    u0 = np.int64(np.rint((pose[0] - corner[0]) / scale * 65536.0)) << 24
    v0 = (np.int64(rows) << 40) - (np.int64(np.rint((pose[1] - corner[1]) / scale * 65536.0)) << 24)
    side = (step + 65535) >> 16
    if side < 1:
        side = np.int64(1)
    if side > SAMPLES:
        side = np.int64(SAMPLES)
    count = side * side
    far = np.int64(1) << 28  # beyond any square
    dx = np.int64(min(max(np.rint((start[0] - pose[0]) / metres * 65536.0), -far), far))
    dy = np.int64(min(max(np.rint((start[1] - pose[1]) / metres * 65536.0), -far), far))
    middle = np.int64(size) << 15
    start_row = (front - ((dx * cosine + dy * sin) >> 30)) >> 16
    start_col = (middle - ((dy * cosine - dx * sin) >> 30)) >> 16
    for r in range(size):
        for c in range(size):
            red = green = blue = np.int64(0)
            for i in range(side):
                ahead = front - (np.int64(r) << 16) - ((2 * i + 1) << 15) // side
                for j in range(side):
                    left = middle - (np.int64(c) << 16) - ((2 * j + 1) << 15) // side
                    u = (u0 + ahead * along - left * across) >> 40
                    v = (v0 - ahead * across - left * along) >> 40
                    inside = 0 <= u < cols and 0 <= v < rows
                    cell = np.int64(grey[v, u]) if inside else np.int64(0)
                    if content == 1:
                        red += cell
                        green += cell
                        blue += cell
                        continue
                    a = b = d = np.int64(0)
                    if inside:
                        a = np.int64(bev[v, u, 0])
                        b = np.int64(bev[v, u, 1])
                        d = np.int64(bev[v, u, 2])
                    if content == 2 and cell != 255:
                        a = (a + cell) >> 1
                        b = (b + cell) >> 1
                        d = (d + (cell if cell else TINT)) >> 1
                    red += a
                    green += b
                    blue += d
            red = (red + count // 2) // count
            green = (green + count // 2) // count
            blue = (blue + count // 2) // count
            if marker >= 0:
                down, right = r - start_row, c - start_col
                near = abs(down) <= marker and abs(right) <= marker
                if near and down * down + right * right <= marker * marker:
                    red, green, blue = np.int64(0), np.int64(255), np.int64(0)
                ahead = front - (np.int64(r) << 16) - 32768
                left = middle - (np.int64(c) << 16) - 32768
                if _in_arrow(ahead, left, marker):
                    red, green, blue = np.int64(255), np.int64(0), np.int64(0)
            out[r, offset + c, 0] = red
            out[r, offset + c, 1] = green
            out[r, offset + c, 2] = blue


@njit
def draw_arrow(picture, corner, scale, pose, marker):  # type: ignore[no-untyped-def]
    """Draw the agent's arrow into a north-up map picture [H, W, 3], in place, clipped to it."""
    rows, cols = picture.shape[:2]
    cosine, sin = find_turn(pose[2])
    u0 = np.int64(np.rint((pose[0] - corner[0]) / scale * 65536.0))
    v0 = (np.int64(rows) << 16) - np.int64(np.rint((pose[1] - corner[1]) / scale * 65536.0))
    reach = 2 * marker + 2
    col, row = u0 >> 16, v0 >> 16
    for r in range(max(row - reach, 0), min(row + reach + 1, rows)):
        for c in range(max(col - reach, 0), min(col + reach + 1, cols)):
            du = (np.int64(c) << 16) + 32768 - u0
            dv = v0 - (np.int64(r) << 16) - 32768
            ahead = (du * cosine + dv * sin) >> 30
            left = (dv * cosine - du * sin) >> 30
            if _in_arrow(ahead, left, marker):
                picture[r, c, 0] = 255
                picture[r, c, 1] = 0
                picture[r, c, 2] = 0


def find_front(square: EgoSquare) -> int:
    """Rows before the agent in 2⁻¹⁶ px."""
    return round(square.ahead * square.size * 65536)


def draw_ego_map(
    view: MapView,
    bev: U8,
    grey: U8,
    corner: tuple[float, float],
    scale: float,
    pose: tuple[float, float, float],
    start: tuple[float, float],
) -> U8:
    """All squares side by side [H, W, 3], black below those that are smaller.

    Args:
        view: which squares.
        bev: [Hb, Wb, 3], north up; [0, 0, 3] where no square looks at it.
        grey: [Hb, Wb] free 255, unknown 127, occupied 0, in the same frame.
        corner: x and y [m] of the map's lower left corner.
        scale: metres a pixel of the map.
        pose: x, y [m], yaw [rad] of the agent.
        start: x, y [m] of the start.
    """
    width, height = view.picture_size
    out = np.zeros((height, width, 3), np.uint8)
    offset = 0
    for square in view.squares:
        _draw_square(
            bev, grey, corner, scale, pose, start, square.size, square.metres_per_pixel,
            find_front(square), CONTENTS.index(square.content), square.marker, out, offset,
        )  # fmt: skip
        offset += square.size
    out.setflags(write=False)
    return out
