"""A scene from above with a walk on it: where it began, where it is, where it should go."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw

from gn0.geometry import Pose2D
from gn0.maps.grid import FREE
from gn0.render.renderer import Renderer
from gn0.scenes.scene import Scene
from gn0.viewer.floor_plan import PAPER, plan_bounds
from gn0.viewer.overlay import GOAL, START
from gn0.viewer.scene_sheet import draw_bev

Colour = tuple[int, int, int]
Points = NDArray[np.floating]
TRACK, REFERENCE, AGENT = (32, 34, 40), (0, 114, 178), (213, 94, 0)
_BLOCKED = (40, 46, 60, 96)
_SUPER = 2  # drawn twice as large, then reduced: smooth lines


def fit_map(scene: Scene, width: int, height: int, least: int = 160) -> tuple[int, int]:
    """Width, even, and height [px] of a map of a scene that fits into a box."""
    x0, y0, x1, y1 = plan_bounds(scene)
    wide = height * (x1 - x0) / (y1 - y0)
    if wide > width:
        height = max(round(width * (y1 - y0) / (x1 - x0)), least)
    return min(max(round(wide / 2) * 2, least), width // 2 * 2), height


class TrackMap:
    """A scene from above, to be drawn on again and again.

    Args:
        scene: the scene.
        renderer: of its splats.
        width, height: of the picture [px]; the scene is whole and in its middle.
        look: content hash of the renderer's splats, where they are not the scene's own.
    """

    def __init__(
        self, scene: Scene, renderer: Renderer, width: int, height: int, *, look: str = ""
    ) -> None:
        wide, high = width * _SUPER, height * _SUPER
        x0, y0, x1, y1 = plan_bounds(scene)
        self._scale = max((x1 - x0) / wide, (y1 - y0) / high)  # metres a pixel
        self._left = (x0 + x1) / 2 - wide * self._scale / 2
        self._top = (y0 + y1) / 2 + high * self._scale / 2
        self.size = (width, height)
        picture = draw_bev(scene, renderer, wide, high, look=look).convert("RGBA")
        picture.alpha_composite(self._shade(scene, wide, high))
        self._picture = picture.convert("RGB")

    def _shade(self, scene: Scene, wide: int, high: int) -> Image.Image:
        """A tint over what blocks the way."""
        grid = scene.grid
        x = self._left + (np.arange(wide) + 0.5) * self._scale
        y = self._top - (np.arange(high) + 0.5) * self._scale
        columns = np.floor((x - grid.origin[0]) / grid.resolution).astype(np.int64)
        rows = np.floor((y - grid.origin[1]) / grid.resolution).astype(np.int64)
        high_cells, wide_cells = grid.shape
        inside = (
            ((rows >= 0) & (rows < high_cells))[:, None]
            & ((columns >= 0) & (columns < wide_cells))[None]
        )  # fmt: skip
        cells = grid.cells[
            np.clip(rows, 0, high_cells - 1)[:, None], np.clip(columns, 0, wide_cells - 1)[None]
        ]
        layer = np.zeros((high, wide, 4), np.uint8)
        layer[inside & (cells != FREE)] = _BLOCKED
        return Image.fromarray(layer, "RGBA")

    def place(self, points: Points) -> list[tuple[float, float]]:
        """World points [N, 2] m on the picture as it is drawn, before it is reduced."""
        flat = np.asarray(points, np.float64).reshape(-1, 2)
        found = [(flat[:, 0] - self._left) / self._scale, (self._top - flat[:, 1]) / self._scale]
        return list(zip(*(one.tolist() for one in found), strict=True))

    def draw(
        self,
        track: Points,
        pose: Pose2D,
        *,
        goals: Sequence[tuple[float, float]] = (),
        reference: Points | None = None,
        ways: Sequence[tuple[Points, Colour]] = (),
    ) -> Image.Image:
        """The scene with a walk on it.

        Args:
            track: [N, 2] m, the walk so far.
            pose: where the agent stands, drawn as an arrow.
            goals: whatever counts as the goal (x, y) [m], drawn as stars.
            reference: [N, 2] m, a path to compare with, drawn below the walk.
            ways: other lines [N, 2] m, each with its colour, drawn with dots.
        """
        picture = self._picture.copy()
        pen = ImageDraw.Draw(picture)
        unit = max(max(self.size) / 500, 0.7) * _SUPER
        spots = self.place(track)
        lines = [] if reference is None else [(self.place(reference), REFERENCE)]
        for line, colour in [*lines, (spots, TRACK)]:
            if len(line) > 1:
                pen.line(line, fill=PAPER, width=round(4.5 * unit), joint="curve")
                pen.line(line, fill=colour, width=round(2.2 * unit), joint="curve")
        for way, colour in ways:
            draw_way(pen, self.place(way), colour, unit)
        for goal in self.place(np.array(list(goals), np.float64)):
            draw_star(pen, goal, 9 * unit, GOAL)
        if spots:
            draw_dot(pen, spots[0], 5 * unit, START)
        draw_arrow(pen, self.place(np.array([[pose.x, pose.y]]))[0], pose.yaw, 9 * unit, AGENT)
        return picture.resize(self.size, Image.Resampling.LANCZOS)


def draw_way(
    pen: ImageDraw.ImageDraw, spots: Sequence[tuple[float, float]], colour: Colour, unit: float
) -> None:
    """Dots along a line, on a light edge; the first point is where the agent stands."""
    if len(spots) > 1:
        pen.line(list(spots), fill=PAPER, width=round(3.5 * unit))
        pen.line(list(spots), fill=colour, width=round(1.5 * unit))
    for spot in spots[1:]:
        draw_dot(pen, spot, 2.6 * unit, colour)


def draw_dot(
    pen: ImageDraw.ImageDraw, spot: tuple[float, float], radius: float, colour: Colour
) -> None:
    """A dot with a light edge."""
    x, y = spot
    edge = max(round(radius / 3), 1)
    pen.ellipse((x - radius, y - radius, x + radius, y + radius), colour, PAPER, edge)


def draw_star(
    pen: ImageDraw.ImageDraw, spot: tuple[float, float], radius: float, colour: Colour
) -> None:
    """A five-pointed star with a light edge."""
    x, y = spot
    for size, fill in ((radius * 1.25, PAPER), (radius, colour)):
        corners = [
            (x + size * (1, 0.42)[k % 2] * math.sin(k * math.pi / 5),
             y - size * (1, 0.42)[k % 2] * math.cos(k * math.pi / 5))
            for k in range(10)
        ]  # fmt: skip
        pen.polygon(corners, fill=fill)


def draw_arrow(
    pen: ImageDraw.ImageDraw, spot: tuple[float, float], yaw: float, radius: float, colour: Colour
) -> None:
    """A pointed body that looks along `yaw` [rad], north up."""
    x, y = spot
    for size, fill in ((radius * 1.35, PAPER), (radius, colour)):
        corners = [
            (x + size * reach * math.cos(yaw + turn), y - size * reach * math.sin(yaw + turn))
            for turn, reach in ((0.0, 1.2), (2.45, 1.0), (math.pi, 0.45), (-2.45, 1.0))
        ]
        pen.polygon(corners, fill=fill)
