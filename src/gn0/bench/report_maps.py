"""Maps of the report as SVG: the scene's BEV and plan once, one path per episode over them.

All text here is made of numbers and of our own words; what comes from data is escaped by the
template that puts these pieces on the page.
"""

from __future__ import annotations

import base64
import io
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from markupsafe import Markup
from numpy.typing import NDArray
from PIL import Image

from gn0.geometry import F64, U8
from gn0.maps.goal_places import GoalSet
from gn0.maps.grid import FREE, OCCUPIED, OccupancyGrid
from gn0.scenes.scene import Scene

UNITS = 20.0  # SVG units a metre: one decimal is 5 mm
MARGIN = 0.6  # m around the walkable ground
CELL = 235.0, 170.0  # width and greatest height of a map in the table, in ratio as in report.css
THIN = 0.5  # a map that covers less of its cell is turned or cut
ROOM = 1.5  # m around an episode where its map is cut
FLAT = 0.02  # m: corners that deviate less are left out of a drawn path


@dataclass(frozen=True)
class MapWindow:
    """The part of the world that a map shows: x_min, y_min, x_max, y_max [m]; north (+y) up."""

    x_min: float
    y_min: float
    x_max: float
    y_max: float

    @property
    def size(self) -> tuple[float, float]:
        """Width and height [SVG units]."""
        return (self.x_max - self.x_min) * UNITS, (self.y_max - self.y_min) * UNITS

    @property
    def view_box(self) -> str:
        """The viewBox attribute."""
        width, height = self.size
        return f"0 0 {width:.1f} {height:.1f}"

    def place(self, points: NDArray[np.floating]) -> F64:
        """World points [N, 2] m in SVG units."""
        p = np.asarray(points, np.float64).reshape(-1, 2)
        return np.column_stack([p[:, 0] - self.x_min, self.y_max - p[:, 1]]) * UNITS


def find_window(grid: OccupancyGrid) -> MapWindow:
    """The walkable ground with a margin, within the grid."""
    x0, y0, x1, y1 = grid.bounds
    free = np.argwhere(grid.cells == FREE)
    if len(free):
        low, high = grid.centres_of(free.min(axis=0))[0], grid.centres_of(free.max(axis=0))[0]
        x0, y0 = max(x0, low[0] - MARGIN), max(y0, low[1] - MARGIN)
        x1, y1 = min(x1, high[0] + MARGIN), min(y1, high[1] + MARGIN)
    return MapWindow(float(x0), float(y0), float(x1), float(y1))


@dataclass(frozen=True)
class MapView:
    """How an episode's map stands in its cell.

    Attributes:
        box: viewBox of the part that the cell shows.
        whole: viewBox of the whole map.
        size: width and height of what is drawn, before it is turned: what the browser would take
            from `box` else.
        turn: transform of what is drawn, "" where north is up; else north is to the left.
        north: where a turned map says so: x, y and the height of letters [SVG units].
        wide: whether the whole map is more than twice as wide as it is high.
    """

    box: str
    whole: str
    size: tuple[float, float]
    turn: str
    north: tuple[float, float, float]
    wide: bool


def fit_view(window: MapWindow, points: NDArray[np.floating]) -> MapView:
    """The view of an episode that goes through `points` [N, 2] m.

    A map that would leave half of its cell empty is turned where that helps, and cut to where the
    episode is where it does not.
    """
    width, height = window.size
    turned = height > width and _cover(width, height) < THIN
    across, up = (height, width) if turned else (width, height)
    left, right, top, bottom = 0.0, across, 0.0, up
    if _cover(across, up) < THIN and len(points):
        spots = window.place(points)
        if turned:
            spots = np.column_stack([spots[:, 1], width - spots[:, 0]])
        (x0, y0), (x1, y1) = spots.min(axis=0) - ROOM * UNITS, spots.max(axis=0) + ROOM * UNITS
        left, right = _stretch(float(x0), float(x1), up * CELL[0] / CELL[1], across)
        top, bottom = _stretch(float(y0), float(y1), across * CELL[1] / CELL[0], up)
    letters = 0.1 * (bottom - top)
    return MapView(
        box=f"{left:.1f} {top:.1f} {right - left:.1f} {bottom - top:.1f}",
        whole=f"0 0 {across:.1f} {up:.1f}",
        size=window.size,
        turn=f"translate(0 {width:.1f}) rotate(-90)" if turned else "",
        north=(round(left + 0.3 * letters, 1), round(top + letters, 1), round(letters, 1)),
        wide=across > 2 * up,
    )


def _cover(width: float, height: float) -> float:
    """Share of a cell that a map of that shape covers."""
    shape = width / max(height, 1e-9) * CELL[1] / CELL[0]
    return min(shape, 1 / max(shape, 1e-9))


def _stretch(low: float, high: float, least: float, limit: float) -> tuple[float, float]:
    """An interval grown to a length of at least `least`, within 0 and `limit`."""
    grow = max(least - (high - low), 0.0) / 2
    low, high = low - grow, high + grow
    shift = max(-low, 0.0) - max(high - limit, 0.0) if high - low < limit else 0.0
    return max(low + shift, 0.0), min(high + shift, limit)


def data_uri(data: bytes, kind: str) -> str:
    """Bytes as a data URI."""
    return f"data:{kind};base64,{base64.b64encode(data).decode()}"


def encode_jpeg(rgb: U8, quality: int = 82) -> bytes:
    """A picture [H, W, 3] as JPEG."""
    stream = io.BytesIO()
    Image.fromarray(np.ascontiguousarray(rgb)).save(stream, "JPEG", quality=quality, optimize=True)
    return stream.getvalue()


def _plan_png(grid: OccupancyGrid) -> bytes:
    """Occupied cells dark, unknown grey, free transparent; north up."""
    colours = np.zeros((3, 4), np.uint8)
    colours[OCCUPIED] = (86, 96, 112, 255)
    colours[2] = (128, 132, 140, 90)
    stream = io.BytesIO()
    Image.fromarray(colours[grid.cells][::-1], "RGBA").quantize(8).save(
        stream, "PNG", optimize=True
    )
    return stream.getvalue()


def bev_symbol(name: str, window: MapWindow, rgb: U8) -> Markup:
    """The BEV picture [H, W, 3] of the window as an SVG symbol."""
    width, height = window.size
    return Markup(  # noqa: S704 (numbers, base64 and a name of ours)
        f'<symbol id="{name}" viewBox="{window.view_box}">'
        f'<image width="{width:.1f}" height="{height:.1f}" preserveAspectRatio="none" '
        f'href="{data_uri(encode_jpeg(rgb), "image/jpeg")}"/></symbol>'
    )


def plan_symbol(name: str, window: MapWindow, scene: Scene) -> Markup:
    """Rooms, objects and occupied cells as an SVG symbol."""
    parts = [f'<symbol id="{name}" viewBox="{window.view_box}">']
    for room in scene.rooms:
        parts.append(f'<polygon class="room" points="{_points(window, np.array(room.polygon))}"/>')
    x0, _, x1, y1 = scene.grid.bounds
    (left, top), (right, _) = window.place(np.array([[x0, y1], [x1, y1]]))
    height = (scene.grid.bounds[3] - scene.grid.bounds[1]) * UNITS
    parts.append(
        f'<image class="cells" x="{left:.1f}" y="{top:.1f}" width="{right - left:.1f}" '
        f'height="{height:.1f}" preserveAspectRatio="none" '
        f'href="{data_uri(_plan_png(scene.grid), "image/png")}"/>'
    )
    for item in scene.objects:
        corners = item.box.corners()[:4, :2]
        parts.append(f'<polygon class="thing" points="{_points(window, corners)}"/>')
    return Markup("".join([*parts, "</symbol>"]))  # noqa: S704


def simplify(points: NDArray[np.floating], tolerance: float = FLAT) -> F64:
    """A polyline [N, 2] m without corners that deviate less than `tolerance` (Douglas–Peucker)."""
    p = np.asarray(points, np.float64).reshape(-1, 2)
    if len(p) < 3:
        return p
    keep = np.zeros(len(p), np.bool_)
    keep[[0, -1]] = True
    stack = [(0, len(p) - 1)]
    while stack:
        a, b = stack.pop()
        if b <= a + 1:
            continue
        chord = p[b] - p[a]
        inner = p[a + 1 : b] - p[a]
        squared = float(chord @ chord)
        t = np.clip(inner @ chord / squared, 0, 1) if squared > 0 else np.zeros(len(inner))
        away = np.hypot(*(inner - t[:, None] * chord).T)
        worst = int(away.argmax())
        if away[worst] > tolerance:
            keep[a + 1 + worst] = True
            stack += [(a, a + 1 + worst), (a + 1 + worst, b)]
    return p[keep]


def path_marks(
    window: MapWindow,
    *,
    reference: NDArray[np.floating],
    path: NDArray[np.floating],
    goal: tuple[float, float],
    collided: Sequence[int],
    success_radius: float,
    goal_set: GoalSet | None = None,
) -> Markup:
    """Reference, path, collisions, start, goal and end as SVG elements.

    Args:
        window: the map.
        reference: reference path [N, 2] m.
        path: positions of the agent [T+1, 2] m; may be empty.
        goal: (x, y) [m].
        collided: indices of cut actions.
        success_radius: drawn round the goal as a straight distance [m].
        goal_set: all that counts: the radius round each, or the outlines of areas.
    """
    gx, gy = window.place(np.array([goal]))[0]
    reach = f'r="{success_radius * UNITS:.1f}"/>'
    if goal_set is None:
        there = [f'<circle class="reach" cx="{gx:.1f}" cy="{gy:.1f}" {reach}']
    else:
        spots = window.place(np.array(goal_set.points).reshape(-1, 2))
        there = [f'<circle class="reach" cx="{x:.1f}" cy="{y:.1f}" {reach}' for x, y in spots]
        there += [
            f'<polygon class="reach" points="{_points(window, np.array(area))}"/>'
            for area in goal_set.areas
        ]
        there += [f'<path class="goal other" d="{_star(x, y, 5.0)}"/>' for x, y in spots]
    parts = [
        *there,
        f'<polyline class="reference" points="{_points(window, simplify(reference))}"/>',
    ]
    if len(path):
        spots = window.place(path)
        parts.append(f'<polyline class="path" points="{_points(window, simplify(path))}"/>')
        hits = {(round(spots[i, 0], 1), round(spots[i, 1], 1)) for i in collided if i < len(spots)}
        parts += [f'<circle class="hit" cx="{x:.1f}" cy="{y:.1f}" r="2"/>' for x, y in sorted(hits)]
        sx, sy = spots[0]
        ex, ey = spots[-1]
        parts.append(f'<circle class="start" cx="{sx:.1f}" cy="{sy:.1f}" r="4.5"/>')
        parts.append(f'<rect class="end" x="{ex - 4:.1f}" y="{ey - 4:.1f}" width="8" height="8"/>')
    parts.append(f'<path class="goal" d="{_star(gx, gy, 8.5)}"/>')
    return Markup("".join(parts))  # noqa: S704


def _points(window: MapWindow, points: NDArray[np.floating]) -> str:
    return " ".join(f"{x:.1f},{y:.1f}" for x, y in window.place(points))


def _star(x: float, y: float, radius: float) -> str:
    angles = np.arange(10) * np.pi / 5 - np.pi / 2
    radii = np.where(np.arange(10) % 2 == 0, radius, radius * 0.45)
    corners = np.column_stack([x + radii * np.cos(angles), y + radii * np.sin(angles)])
    return "M" + "L".join(f"{a:.1f} {b:.1f}" for a, b in corners) + "Z"
