"""The map from above that Habitat's users know: `info["top_down_map"]`, and pictures of it.

    env = GoalNavEnv(scene, top_down_map=True)
    _, info = env.reset(seed=0)
    Image.fromarray(draw_top_down_map(info["top_down_map"], 480))

Keys, codes, colours and angles are those of habitat-lab's measure `TopDownMap` (0c0743e,
habitat/tasks/nav/nav.py and utils/visualizations/maps.py), so what reads one reads the other. It
says what no robot knows (where the goal is, the shortest way), so it is for people and logs.
"""

from __future__ import annotations

from collections.abc import Mapping
from itertools import pairwise
from typing import TYPE_CHECKING, Any, TypedDict

import numpy as np
from numpy.typing import NDArray

from gn0.errors import ConfigError
from gn0.geometry import F64, U8, Pose2D
from gn0.maps.grid import FREE
from gn0.sim.sensors import MapFrame

if TYPE_CHECKING:
    from gn0.maps.navigation import NavigationMap
    from gn0.missions.episode import Episode

INVALID, VALID, BORDER, SOURCE, TARGET, SHORTEST_PATH = 0, 1, 2, 4, 6, 7
FIRST_STEP = 10  # code of a trail's first step; 255 is that of the last step there may be
STEP_CODES = 245
THICKNESS_SIDE = 128  # a line is two of so many parts of the shorter side
SEEN_ANGLE = 90.0  # degrees that lift the fog
SEEN_FAR = 5.0  # m
UNSEEN = 0.5  # share of brightness that the fog leaves


class TopDownMapInfo(TypedDict):
    """What `info["top_down_map"]` holds.

    Attributes:
        map: uint8 [H, W], north up, a pixel a map cell: 0 not walkable, 1 walkable, 2 border,
            4 start, 6 goal, 7 shortest path, 10 to 255 where the agent went, by its step.
        fog_of_war_mask: uint8 [H, W]: 1 where the agent has looked.
        agent_map_coord: (row, col) of each agent [px]: of the one that there is.
        agent_angle: where it looks [rad], 0 down the picture and positive towards its right side.
    """

    map: U8
    fog_of_war_mask: U8
    agent_map_coord: list[tuple[int, int]]
    agent_angle: list[NDArray[np.float64]]


class TopDownMap:
    """Follows one agent through one episode on the map from above.

    Args:
        navigation: the scene's map; walkable is what the agent's body leaves free.
        max_steps: steps that an episode may take: the trail's colours are spread over them.
        view_angle: what lifts the fog [degrees].
        view_distance: how far the agent lifts it [m].

    Raises:
        ConfigError: a number out of range.
    """

    def __init__(
        self,
        navigation: NavigationMap,
        max_steps: int = 500,
        *,
        view_angle: float = SEEN_ANGLE,
        view_distance: float = SEEN_FAR,
    ) -> None:
        if max_steps < 1 or not 0 < view_angle <= 360 or not 0 < view_distance <= 1000:
            raise ConfigError(
                f"top-down map of {max_steps} steps, {view_angle}°, {view_distance} m",
                remedy="give at least one step, an angle up to 360 and a distance in metres",
            )
        self._navigation = navigation
        self._frame = MapFrame.of_grid(navigation.inflated)
        self._free = np.ascontiguousarray(navigation.inflated.cells[::-1] == FREE)
        self._max_steps = max_steps
        reach = view_distance / self._frame.metres_per_pixel
        half = np.radians(view_angle) / 2
        rays = max(int(np.ceil(2 * half * reach)), 1) + 1
        self._angles = np.linspace(-half, half, rays)
        self._lengths = np.arange(0.0, reach + 0.5, 0.5)  # [px]: no ray steps over a corner
        side = min(self._free.shape)
        self._thickness = max(round(side * 2 / THICKNESS_SIDE), 1)
        self._padding = 2 * int(np.ceil(side / THICKNESS_SIDE))
        self._map: U8 = np.zeros((0, 0), np.uint8)
        self._fog: U8 = self._map
        self._last: tuple[int, int] | None = None

    def reset(self, episode: Episode) -> None:
        """Begin an episode: an untrodden map with its start, its goals and the shortest path."""
        self._map = np.where(self._free, VALID, INVALID).astype(np.uint8)
        self._map[_border(self._free)] = BORDER
        self._fog = np.zeros_like(self._map)
        for goal in episode.goals:
            self._mark(goal, TARGET)
        path = self._navigation.plan(episode.start[:2], episode.destination)
        pixels = [self._frame.pixel_of(x, y) for x, y in np.asarray(path)[:, :2].tolist()]
        for before, after in pairwise(pixels):
            self._line(before, after, SHORTEST_PATH)
        self._mark(episode.start[:2], SOURCE)
        self._last = None

    def update(self, pose: Pose2D, step: int) -> TopDownMapInfo:
        """The map with the agent at a pose after so many steps; arrays are the caller's own."""
        row, col = self._frame.pixel_of(pose.x, pose.y)
        if self._last is not None and self._at(row, col) != SOURCE:
            code = FIRST_STEP + min(step * STEP_CODES // self._max_steps, STEP_CODES)
            self._line(self._last, (row, col), code)
        self._last = row, col
        angle = np.arctan2(np.cos(pose.yaw), -np.sin(pose.yaw))
        self._lift_fog(row, col, float(angle))
        return {
            "map": self._map.copy(),
            "fog_of_war_mask": self._fog.copy(),
            "agent_map_coord": [(row, col)],
            "agent_angle": [np.array(angle, np.float64)],
        }

    def _at(self, row: int, col: int) -> int:
        inside = 0 <= row < self._map.shape[0] and 0 <= col < self._map.shape[1]
        return int(self._map[row, col]) if inside else INVALID

    def _mark(self, place: tuple[float, float], code: int) -> None:
        row, col = self._frame.pixel_of(*place)
        pad = self._padding
        self._map[max(row - pad, 0) : row + pad + 1, max(col - pad, 0) : col + pad + 1] = code

    def _line(self, before: tuple[int, int], after: tuple[int, int], code: int) -> None:
        """A line of the usual thickness, cut to the picture."""
        steps = max(abs(after[0] - before[0]), abs(after[1] - before[1]), 1) + 1
        rows = np.rint(np.linspace(before[0], after[0], steps)).astype(np.int64)
        cols = np.rint(np.linspace(before[1], after[1], steps)).astype(np.int64)
        brush = np.arange(self._thickness) - (self._thickness - 1) // 2
        across = (rows[:, None, None] + brush[:, None], cols[:, None, None] + brush)
        rows, cols = (part.ravel() for part in np.broadcast_arrays(*across))
        inside = (rows >= 0) & (rows < self._map.shape[0]) & (cols >= 0)
        inside &= cols < self._map.shape[1]
        self._map[rows[inside], cols[inside]] = code

    def _lift_fog(self, row: int, col: int, angle: float) -> None:
        """Mark what lies in view: along each ray up to the first cell that is not walkable."""
        directions = angle + self._angles
        rows = np.rint(row + np.cos(directions)[:, None] * self._lengths).astype(np.int64)
        cols = np.rint(col + np.sin(directions)[:, None] * self._lengths).astype(np.int64)
        height, width = self._free.shape
        inside = (rows >= 0) & (rows < height) & (cols >= 0) & (cols < width)
        rows, cols = rows.clip(0, height - 1), cols.clip(0, width - 1)
        seen = np.logical_and.accumulate(inside & self._free[rows, cols], axis=1)
        self._fog[rows[seen], cols[seen]] = 1


def colorize_top_down_map(
    top_down_map: U8, fog_of_war_mask: U8 | None = None, fog_of_war_desat_amount: float = UNSEEN
) -> U8:
    """A map of codes [H, W] as a colour picture [H, W, 3]; darker where the mask is 0.

    Raises:
        ConfigError: map and mask of another shape, or not of whole numbers.
    """
    codes = np.asarray(top_down_map)
    if codes.ndim != 2 or codes.dtype != np.uint8:
        raise ConfigError(
            f"a top-down map of {codes.dtype} {codes.shape}", remedy="give uint8 [H, W]"
        )
    picture: U8 = _COLOURS[codes]
    if fog_of_war_mask is None:
        return picture
    mask = np.asarray(fog_of_war_mask)
    if mask.shape != codes.shape:
        raise ConfigError(
            f"a fog of {mask.shape} over a map of {codes.shape}", remedy="give both of one shape"
        )
    dark = (codes != INVALID) & (mask == 0)
    picture[dark] = (picture[dark] * fog_of_war_desat_amount).astype(np.uint8)
    return picture


def draw_top_down_map(info: Mapping[str, Any], height: int | None = None) -> U8:
    """`info["top_down_map"]` as a picture [height, W, 3] with the agent as an arrow.

    Args:
        info: what the environment gave.
        height: height of the picture [px]; one pixel per map cell when None.

    Raises:
        ConfigError: not a top-down map, or not a height.
    """
    from PIL import Image, ImageDraw

    try:
        codes, mask = info["map"], info["fog_of_war_mask"]
        agents = list(zip(info["agent_map_coord"], info["agent_angle"], strict=True))
    except (KeyError, TypeError, ValueError) as error:
        raise ConfigError(
            f"that is not a top-down map: {type(error).__name__}: {error}",
            remedy='give info["top_down_map"] of an environment with top_down_map=True',
        ) from None
    picture = Image.fromarray(colorize_top_down_map(codes, mask))
    rows, cols = np.shape(codes)
    if height is not None:
        if not 1 <= height <= 16384:
            raise ConfigError(f"a picture {height} px high", remedy="give 1 to 16384")
        picture = picture.resize(
            (max(round(cols * height / rows), 1), height), Image.Resampling.NEAREST
        )
    scale = picture.height / rows
    radius = max(min(picture.size) / 32, 2.0)
    canvas = ImageDraw.Draw(picture)
    for (row, col), angle in agents:
        centre = np.array([(col + 0.5) * scale, (row + 0.5) * scale])
        canvas.polygon(_arrow(centre, float(angle), radius), fill=(20, 60, 220), outline=(0, 0, 0))
    return np.array(picture)


def _arrow(centre: F64, angle: float, radius: float) -> list[tuple[float, float]]:
    """Corners (x, y) [px] of an arrow head that points along an angle of the map."""
    corners = []
    for turn, length in ((0.0, 1.4), (2.4, 1.2), (np.pi, 0.5), (-2.4, 1.2)):
        x, y = np.sin(angle + turn), np.cos(angle + turn)
        corners.append((centre[0] + radius * length * x, centre[1] + radius * length * y))
    return corners


def _border(free: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Walkable pixels beside one that is not."""
    found = np.zeros_like(free)
    found[:, :-1] |= ~free[:, 1:]
    found[:, 1:] |= ~free[:, :-1]
    found[:-1] |= ~free[1:]
    found[1:] |= ~free[:-1]
    return found & free


def _build_colours() -> U8:
    """Colours by code, the trail's from blue over green to red."""
    colours = np.full((256, 3), 150, np.uint8)
    share = np.linspace(0, 1, 256 - FIRST_STEP)[:, None]
    jet = np.clip(1.5 - np.abs(4 * share - np.array([3.0, 2.0, 1.0])), 0, 1)
    colours[FIRST_STEP:] = np.rint(255 * jet)
    for code, colour in (
        (INVALID, (255, 255, 255)),
        (BORDER, (50, 50, 50)),
        (SOURCE, (0, 0, 200)),
        (TARGET, (200, 0, 0)),
        (SHORTEST_PATH, (0, 200, 0)),
    ):
        colours[code] = colour
    return colours


_COLOURS = _build_colours()
