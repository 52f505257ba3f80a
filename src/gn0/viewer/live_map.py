"""Map pictures of the live view: plan or BEV with agents, people, trails, path and goal."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw

from gn0.geometry import F64, U8, Pose2D
from gn0.scenes.scene import Scene
from gn0.viewer.floor_plan import plan_bounds, render_plan

if TYPE_CHECKING:
    from gn0.render.bev import BevPicture

PictureKind = Literal["RGB", "depth", "BEV", "occupancy"]
PICTURES: tuple[PictureKind, ...] = ("RGB", "depth", "BEV", "occupancy")
AGENT = (214, 64, 40)
REFERENCE, GOAL = (26, 28, 34), (34, 150, 84)
FOLLOWED, PERSON = GOAL, (92, 108, 146)  # whom the agent is to follow, and anybody else
_DOUBLE = 2  # drawn twice as large, then reduced


@dataclass(frozen=True)
class MapAgent:
    """An agent on a map: pose, colour, and where it has been [N, 2] m."""

    pose: Pose2D
    colour: tuple[int, int, int] = AGENT
    trail: NDArray[np.floating] | Sequence[tuple[float, float]] = ()


@dataclass(frozen=True)
class MapPerson:
    """A person on a map: pose, whether it is to be followed, and where it has been [N, 2] m."""

    pose: Pose2D
    followed: bool = False
    trail: NDArray[np.floating] | Sequence[tuple[float, float]] = ()

    @property
    def colour(self) -> tuple[int, int, int]:
        """Of its mark and trail."""
        return FOLLOWED if self.followed else PERSON


@dataclass(frozen=True, eq=False)
class LiveMap:
    """A map picture and its frame.

    Attributes:
        rgb: [H, W, 3], north (+y) up.
        scale: pixels a metre.
        left, top: world x of the left edge and world y of the top edge [m].
    """

    rgb: U8
    scale: float
    left: float
    top: float

    def pixels(self, points: NDArray[np.floating] | Sequence[tuple[float, float]]) -> F64:
        """Picture coordinates [N, 2] of world points [N, 2] m."""
        xy = np.asarray(points, np.float64).reshape(-1, 2)
        return np.column_stack([xy[:, 0] - self.left, self.top - xy[:, 1]]) * self.scale

    def draw(
        self,
        agents: Sequence[MapAgent],
        *,
        reference: NDArray[np.floating] | Sequence[tuple[float, float]] = (),
        goal: tuple[float, float] | None = None,
        people: Sequence[MapPerson] = (),
    ) -> U8:
        """The map with trails under agents and people, and a task's path and goal under both.

        People are discs with a nose, whom to follow a larger one in green.
        """
        large = Image.fromarray(np.ascontiguousarray(self.rgb))
        large = large.resize((large.width * _DOUBLE, large.height * _DOUBLE))
        pen = ImageDraw.Draw(large)
        if len(reference) > 1:
            self._line(pen, reference, REFERENCE, 2)
        if goal is not None:
            ((x, y),) = self.pixels([goal]) * _DOUBLE
            pen.polygon(_star(x, y, 9.0 * _DOUBLE), fill=GOAL, outline=(255, 255, 255))
        people = sorted(people, key=lambda person: person.followed)  # whom to follow on top
        for person in people:
            if len(person.trail) > 1:
                self._line(pen, person.trail, person.colour, 2 if person.followed else 1)
        for agent in agents:
            if len(agent.trail) > 1:
                self._line(pen, agent.trail, agent.colour, 3)
        for person in people:
            ((x, y),) = self.pixels([(person.pose.x, person.pose.y)]) * _DOUBLE
            size = (6.5 if person.followed else 5.0) * _DOUBLE
            nose = _nose(x, y, person.pose.yaw, size)
            pen.polygon(nose, fill=person.colour, outline=(255, 255, 255), width=_DOUBLE)
            box = (x - size, y - size, x + size, y + size)
            pen.ellipse(box, fill=person.colour, outline=(255, 255, 255), width=_DOUBLE)
        for agent in agents:
            ((x, y),) = self.pixels([(agent.pose.x, agent.pose.y)]) * _DOUBLE
            corners = _arrow(x, y, agent.pose.yaw, 9.0 * _DOUBLE)
            pen.polygon(corners, fill=agent.colour, outline=(255, 255, 255), width=_DOUBLE)
        small = large.resize((self.rgb.shape[1], self.rgb.shape[0]), Image.Resampling.BOX)
        return np.asarray(small, np.uint8)

    def _line(
        self,
        pen: ImageDraw.ImageDraw,
        points: NDArray[np.floating] | Sequence[tuple[float, float]],
        colour: tuple[int, int, int],
        width: int,
    ) -> None:
        spots = [(float(x), float(y)) for x, y in self.pixels(points) * _DOUBLE]
        pen.line(spots, fill=(255, 255, 255), width=(width + 2) * _DOUBLE, joint="curve")
        pen.line(spots, fill=colour, width=width * _DOUBLE, joint="curve")


def plan_map(scene: Scene, width: int = 520, height_limit: int = 360) -> LiveMap:
    """The scene's plan, at most `width` x `height_limit` [px]."""
    x0, y0, x1, y1 = plan_bounds(scene)
    scale = min(width / (x1 - x0), height_limit / (y1 - y0))
    size = (max(1, round((x1 - x0) * scale)), max(1, round((y1 - y0) * scale)))
    picture = np.asarray(render_plan(scene, *size, names=False), np.uint8)
    return LiveMap(picture, scale, (x0 + x1) / 2 - size[0] / scale / 2, (y0 + y1) / 2
                   + size[1] / scale / 2)  # fmt: skip


def bev_map(bev: BevPicture, width: int = 520, height_limit: int = 420) -> LiveMap:
    """A BEV picture, reduced or enlarged to at most `width` x `height_limit` [px]."""
    full_width, full_height = bev.size
    factor = min(width / full_width, height_limit / full_height)
    size = (max(1, round(full_width * factor)), max(1, round(full_height * factor)))
    way = Image.Resampling.BOX if factor < 1 else Image.Resampling.BICUBIC
    picture = Image.fromarray(np.array(bev.rgb)).resize(size, way)
    top = bev.origin[1] + full_height * bev.metres_per_pixel
    scale = size[0] / (full_width * bev.metres_per_pixel)
    return LiveMap(np.asarray(picture, np.uint8), scale, bev.origin[0], top)


def _arrow(x: float, y: float, yaw: float, size: float) -> list[tuple[float, float]]:
    shape = ((0.0, 1.3), (2.5, 1.0), (math.pi, 0.45), (-2.5, 1.0))
    return [(x + r * size * math.cos(yaw + a), y - r * size * math.sin(yaw + a)) for a, r in shape]


def _nose(x: float, y: float, yaw: float, size: float) -> list[tuple[float, float]]:
    shape = ((0.0, 1.9), (0.75, 1.0), (-0.75, 1.0))
    return [(x + r * size * math.cos(yaw + a), y - r * size * math.sin(yaw + a)) for a, r in shape]


def _star(x: float, y: float, size: float) -> list[tuple[float, float]]:
    turns = [k * math.pi / 5 - math.pi / 2 for k in range(10)]
    radii = [size if k % 2 == 0 else size * 0.45 for k in range(10)]
    return [(x + r * math.cos(a), y + r * math.sin(a)) for a, r in zip(turns, radii, strict=True)]
