"""Sensors: what is measured at a pose. Only what is asked for is computed."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING, Any, cast, get_args

import numpy as np
from numpy.typing import NDArray

from gn0.config import Config
from gn0.errors import ConfigError, SimError
from gn0.geometry import F32, F64, U8, Pose2D, view_from_pose
from gn0.maps.grid import GREY_OF_CELL, OCCUPIED, OccupancyGrid
from gn0.maps.ray import cast_rays
from gn0.missions.episode import GoalPicture
from gn0.paper import BEV_CUT
from gn0.sim.category_map import paint_categories
from gn0.sim.ego_map import MapView, draw_arrow, draw_ego_map
from gn0.sim.look_plan import Shot, aim_at_goal, plan_look, render_plan
from gn0.sim.motion import STILL, Moment, Motion, take_moment
from gn0.sim.noise import Noise
from gn0.sim.presets import CameraPreset, find_preset
from gn0.sim.sensor.table import Carried, carry_sensors, check_sensors, join_sensors
from gn0.sim.state import MapMode

if TYPE_CHECKING:
    from gn0.maps.navigation import NavigationMap
    from gn0.people.sight import Sight
    from gn0.render.bev import BevPicture
    from gn0.render.renderer import DrawnScene
    from gn0.scenes.scene import SceneObject
    from gn0.sim.mapping import Mapper
    from gn0.sim.people import Company

MAP_MODES: tuple[MapMode, ...] = get_args(MapMode)
SILENCE = Noise()
GREEN, RED = (0, 255, 0), (255, 0, 0)
NO_BEV = np.zeros((0, 0, 3), np.uint8)
NO_BEV.setflags(write=False)


class SensorConfig(Config, frozen=True):
    """Which sensors an agent carries, and how they are set.

    Attributes:
        active: names out of `gn0 list sensors`.
        preset: cameras and body.
        range_rays: rays of the range ring.
        range_limit: reach of the range ring [m].
        disc_radius: radius of the start and agent discs in the occupancy picture [px].
        map_view: squares of the ego map, and whether the occupancy picture has an arrow.
        map_mode: what bev and occupancy show, see `gn0.sim.state.MapMode`.
        cut_height: what lies higher [m] is left out of an explored BEV.
        noise: what the body adds to depth, pose and moves.
    """

    active: frozenset[str] = frozenset()
    preset: CameraPreset = find_preset("gn_bench")
    range_rays: int = 72
    range_limit: float = 10.0
    disc_radius: int = 3
    map_view: MapView = MapView()
    map_mode: MapMode = "prior"
    cut_height: float = BEV_CUT
    noise: Noise = Noise()

    def __post_init__(self) -> None:
        check_sensors(self.active)
        if not (1 <= self.range_rays <= 4096 and 0 < self.range_limit <= 1000):
            raise ConfigError(
                f"range ring of {self.range_rays} rays and {self.range_limit} m",
                remedy="give 1 to 4096 rays and a reach in metres",
            )
        if not 0 <= self.disc_radius <= 100:
            raise ConfigError(f"disc_radius is {self.disc_radius} px", remedy="give 0 to 100")
        check_map_mode(self.map_mode, self.active)
        if self.map_mode == "explored" and self.painted:
            raise ConfigError(
                "an ego map painted by categories is of the whole scene, and agents in map mode "
                "'explored' know only what they have seen",
                remedy="use map mode 'prior', or paint=\"scene\"",
            )
        if not 0 < self.cut_height <= 100:
            raise ConfigError(
                f"cut_height is {self.cut_height} m", remedy="give a height in metres"
            )

    @property
    def explores(self) -> bool:
        """Whether the agent draws its own map."""
        return self.map_mode == "explored" and bool(self.carried.maps)

    @property
    def painted(self) -> bool:
        """Whether the ego map is painted by categories."""
        return "ego_map" in self.active and self.map_view.painted

    @property
    def carried(self) -> Carried:
        """The sensors themselves, and what they need together."""
        return self.carry(self.active)

    def carry(self, names: frozenset[str]) -> Carried:
        """Some of them, each with its noise."""
        carried = carry_sensors(names)
        if any(sensor.settle for sensor in carried.sensors):
            settled = [s.settle(self) if s.settle else s for s in carried.sensors]
            carried = join_sensors(tuple(settled))
        if self.noise == SILENCE:
            return carried
        return replace(
            carried,
            sensors=tuple(
                self.noise.wrap(sensor, self.preset.depth_range) for sensor in carried.sensors
            ),
        )


def check_map_mode(mode: str, sensors: Iterable[str]) -> MapMode:
    """A map mode that offers these sensors.

    Raises:
        ConfigError: there is no such mode, or it has no maps and a map is asked for.
    """
    if mode not in MAP_MODES:
        raise ConfigError(f"no map mode {mode!r}", remedy="known: " + ", ".join(MAP_MODES))
    maps = sorted(carry_sensors(sensors).maps)
    if mode == "none" and maps:
        raise ConfigError(
            f"map mode 'none' has no {' and no '.join(maps)}: the agent carries no map",
            remedy="use map mode 'prior' or 'explored', or a policy that reads no map",
        )
    return cast(MapMode, mode)


@dataclass(frozen=True)
class MapFrame:
    """A metric map picture, north (+y) up: pixel (0, 0) is the corner of least x and most y.

    Attributes:
        width, height: size [px].
        metres_per_pixel: scale [m].
        x_min, y_min: world point of the picture's lower-left corner [m].
    """

    width: int
    height: int
    metres_per_pixel: float
    x_min: float
    y_min: float

    @classmethod
    def of_grid(cls, grid: OccupancyGrid) -> MapFrame:
        """A pixel a cell."""
        height, width = grid.shape
        return cls(width, height, grid.resolution, *grid.origin)

    @classmethod
    def of_bev(cls, bev: BevPicture) -> MapFrame:
        """The frame of a BEV picture."""
        height, width = bev.rgb.shape[:2]
        return cls(width, height, bev.metres_per_pixel, *bev.origin)

    def pixel_of(self, x: float, y: float) -> tuple[int, int]:
        """(row, col) of the pixel that holds a world point [m]; may lie outside."""
        col = int(np.floor((x - self.x_min) / self.metres_per_pixel))
        row = self.height - 1 - int(np.floor((y - self.y_min) / self.metres_per_pixel))
        return row, col


def draw_disc(picture: U8, row: int, col: int, radius: int, colour: tuple[int, int, int]) -> None:
    """Fill the pixels within `radius` [px] of (row, col), in place, clipped to the picture."""
    height, width = picture.shape[:2]
    top, bottom = max(row - radius, 0), min(row + radius + 1, height)
    left, right = max(col - radius, 0), min(col + radius + 1, width)
    if top < bottom and left < right:
        v, u = np.ogrid[top:bottom, left:right]
        inside = (v - row) ** 2 + (u - col) ** 2 <= radius**2
        picture[top:bottom, left:right][inside] = colour


def paint_grid(grid: OccupancyGrid, frame: MapFrame) -> U8:
    """An occupancy grid as a picture [H, W, 3]: free 255, unknown 127, occupied 0.

    Pixels outside the grid are occupied; others take the cell under their centre.
    """
    s = frame.metres_per_pixel
    xs = frame.x_min + (np.arange(frame.width) + 0.5) * s
    ys = frame.y_min + (np.arange(frame.height)[::-1] + 0.5) * s
    cols = np.floor((xs - grid.origin[0]) / grid.resolution).astype(np.int64)
    rows = np.floor((ys - grid.origin[1]) / grid.resolution).astype(np.int64)
    height, width = grid.shape
    picked = grid.cells[np.ix_(rows.clip(0, height - 1), cols.clip(0, width - 1))]
    inside = ((rows >= 0) & (rows < height))[:, None] & ((cols >= 0) & (cols < width))[None, :]
    grey = GREY_OF_CELL[np.where(inside, picked, OCCUPIED)]
    return np.repeat(grey[:, :, None], 3, axis=2)


class SensorSuite:
    """The sensors of one agent in one scene.

    Args:
        config: what is carried.
        navigation: the map for occupancy picture and range ring.
        camera_height: eye above the floor [m].
        renderer: needed for rgb, depth and history.
        bev: needed for bev; also sets the frame of the occupancy picture.
        motion: what moves in the scene; nothing when None. Maps and goal pictures show none of it.
        objects: needed for ego maps painted by categories.

    Raises:
        SimError: a picture is asked for and nothing was handed in to make it.
        SceneError: categories are to be painted, and there are no objects.
    """

    def __init__(
        self,
        config: SensorConfig,
        navigation: NavigationMap,
        camera_height: float,
        renderer: DrawnScene | None = None,
        bev: BevPicture | None = None,
        motion: Motion | None = None,
        objects: Sequence[SceneObject] = (),
    ) -> None:
        carried = config.carried
        drawn = carried.eyes | (carried.maps if config.explores else frozenset())
        if drawn and renderer is None:
            raise SimError(
                f"sensors {sorted(drawn)} need a renderer",
                remedy="use open_simulator, or hand a renderer to Simulator",
            )
        if carried.bev and bev is None and not config.explores:
            raise SimError(
                "sensor 'bev' needs a BEV picture",
                remedy="use open_simulator, or hand render_bev(...) to Simulator",
            )
        self.config = config
        self.active = config.active
        self.navigation = navigation
        self._camera_height = camera_height
        self.renderer = renderer
        self._bev = bev
        self._objects = objects
        if config.painted:
            self.painted_picture  # noqa: B018 (a scene without objects is refused here)
        self.motion = motion
        if motion is not None and renderer is not None:
            for name, cloud in motion.clouds.items():
                renderer.name_cloud(name, cloud)
        self._ring = 2 * np.pi * np.arange(config.range_rays) / config.range_rays
        self._pitch = float(np.radians(config.preset.pitch_degrees))

    @property
    def grid(self) -> OccupancyGrid:
        """The scene's map, as it was before it was inflated."""
        return self.navigation.grid

    @cached_property
    def map_frame(self) -> MapFrame:
        """The frame shared by BEV and occupancy picture."""
        if self._bev is not None:
            return MapFrame.of_bev(self._bev)
        return MapFrame.of_grid(self.navigation.grid)

    @cached_property
    def _occupancy(self) -> U8:
        return paint_grid(self.navigation.grid, self.map_frame)

    @cached_property
    def _grey(self) -> U8:
        grey = self._occupancy[:, :, 0]
        grey.setflags(write=False)
        return grey

    @cached_property
    def bev_picture(self) -> U8:
        """The scene from above [Hb, Wb, 3].

        Raises:
            SimError: it was not handed in.
        """
        if self._bev is None:
            raise SimError("there is no BEV picture here", remedy="ask for sensor 'bev'")
        rgb = np.array(self._bev.rgb, np.uint8)
        rgb.setflags(write=False)
        return rgb

    @cached_property
    def painted_picture(self) -> U8:
        """The scene from above, painted by categories [Hb, Wb, 3].

        Raises:
            SceneError: it has no objects.
        """
        return paint_categories(self._objects, self.grid, self.config.cut_height)

    def moment_at(self, time: float) -> Moment:
        """Where everything in the scene stands at a time since the episode began [s]."""
        return take_moment(self.motion, time)

    def look(
        self, pose: Pose2D, outputs: frozenset[str], moment: Moment = STILL
    ) -> dict[str, NDArray[Any]]:
        """Draw at a pose: rgb [H, W, 3], depth [Hd, Wd] m, and so on, by output."""
        return {name: drawn[0] for name, drawn in self.look_many([pose], outputs, [moment]).items()}

    def look_many(
        self,
        poses: Sequence[Pose2D],
        outputs: frozenset[str],
        moments: Sequence[Moment] = (),
        millimetres: bool = False,
    ) -> dict[str, NDArray[Any]]:
        """Draw at many poses: rgb [V, H, W, 3], depth [V, Hd, Wd] m, and so on, by output.

        `moments` are those of the poses; without them nothing moves. With `millimetres` depth is
        uint16 and not clipped. One call of the renderer; two where colour and depth have cameras
        of their own.
        """
        assert self.renderer is not None
        moving: dict[str, Any] = {}  # the same call as ever where nothing does
        if any(moment.parts for moment in moments):
            moving = {"parts": [moment.parts for moment in moments]}
        plan = plan_look(self.config.preset, outputs, millimetres)
        return render_plan(plan, self.renderer.render, self.views_of(poses), moving)

    @cached_property
    def sight(self) -> Sight | None:
        """What eyes see of people in colour and depth; None where that is not told."""
        from gn0.people.sight import find_sight  # bodies are needed only where people are

        preset = self.config.preset
        return find_sight((preset.rgb, preset.depth), self._camera_height, self._pitch)

    def views_of(self, poses: Sequence[Pose2D]) -> F64:
        """Where the eyes are at some poses: world to camera [V, 4, 4]."""
        return np.stack(
            [view_from_pose(p.x, p.y, self._camera_height, p.yaw, self._pitch) for p in poses]
        )

    def look_at_goal(self, picture: GoalPicture | None, goal: Pose2D) -> U8:
        """The goal picture [H, W, 3] of an episode: as its record says, else from the goal."""
        preset = self.config.preset
        camera, view = aim_at_goal(preset, self._camera_height, picture, goal)
        plan = plan_look(preset, frozenset({"rgb"}))
        plan = replace(plan, shots=(Shot(camera, plan.shots[0].outputs),))
        assert self.renderer is not None
        drawn: U8 = render_plan(plan, self.renderer.render, view[None], {})["rgb"][0]
        return drawn

    def occupancy_picture(
        self, start: Pose2D, pose: Pose2D, own: U8 | None = None, arrow: bool | None = None
    ) -> U8:
        """The occupancy picture [H, W, 3] with the start in green, then the agent in red.

        Drawn on `own`, the agent's own map, where there is one, and on the scene's else. The agent
        is an `arrow` or a disc; as the settings say when None.
        """
        picture = self._occupancy.copy() if own is None else own
        radius = self.config.disc_radius
        frame, arrow = self.map_frame, self.config.map_view.arrow if arrow is None else arrow
        draw_disc(picture, *frame.pixel_of(start.x, start.y), radius, GREEN)
        if arrow:
            corner, place = (frame.x_min, frame.y_min), (pose.x, pose.y, pose.yaw)
            draw_arrow(picture, corner, frame.metres_per_pixel, place, radius)
        else:
            draw_disc(picture, *frame.pixel_of(pose.x, pose.y), radius, RED)
        return picture

    def ego_picture(
        self,
        start: Pose2D,
        pose: Pose2D,
        mapper: Mapper | None = None,
        view: MapView | None = None,
    ) -> U8:
        """The ego map [H, W, 3] at a pose, see `gn0.sim.ego_map`; read-only.

        Of `mapper`, the agent's own map, where there is one, and of the scene's else; as `view`
        says, or the settings when None.
        """
        view = view or self.config.map_view
        if mapper is not None:
            bev, grey = mapper.layers
        else:
            bev = NO_BEV
            if view.looks_at_bev:
                bev = self.painted_picture if view.painted else self.bev_picture
            grey = self._grey
        frame = self.map_frame
        place = pose.x, pose.y, pose.yaw
        return draw_ego_map(
            view, bev, grey, (frame.x_min, frame.y_min), frame.metres_per_pixel, place, start[:2]
        )

    def ranges(self, pose: Pose2D, company: Company | None = None) -> F32:
        """The range ring [R] m at a pose, on the inflated map, people in the way."""
        angles = pose.yaw + self._ring
        found = cast_rays(self.navigation.inflated, pose.x, pose.y, angles, self.config.range_limit)
        return company.limit_ranges(pose.x, pose.y, angles, found) if company else found
