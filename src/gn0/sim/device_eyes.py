"""Pictures of agents on a device: the pixels of `BatchEyes`, in memory of the device.

Colour and depth come from the renderer that is handed in; map pictures and history mosaics from
kernels.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from gn0.device.device import DeviceArray, Kernel
from gn0.errors import ConfigError, SimError
from gn0.geometry import F64, U8, view_from_pose
from gn0.maps.grid import OccupancyGrid
from gn0.maps.inflate import inflate
from gn0.missions.episode import AgentSpec, Episode
from gn0.people.person import PEOPLE_MOST
from gn0.plugins import is_builtin
from gn0.progress import Progress
from gn0.render.camera import Camera
from gn0.render.instance import Parts, PartsDevice
from gn0.render.renderer import Renderer
from gn0.scenes.scene import Scene
from gn0.sim.category_map import paint_categories
from gn0.sim.device_layout import blocks_of
from gn0.sim.device_motion import MotionDevice
from gn0.sim.device_records import (
    BuildViews,
    ClipDepth,
    DrawEgoMaps,
    LayMosaics,
    PaintMaps,
    PlaceParts,
    PlaceRows,
    ReducePictures,
)
from gn0.sim.device_store import MapPictures
from gn0.sim.device_there import AgentsThere
from gn0.sim.device_who import SENSORS, Asked, WhoEyes
from gn0.sim.ego_map import CONTENTS, EgoSquare, find_front
from gn0.sim.history import LENGTH, mosaic_size
from gn0.sim.look_map import draw_map, find_map
from gn0.sim.look_plan import LookPlan, aim_at_goal, check_colour, plan_look
from gn0.sim.open import name_look, split_look
from gn0.sim.scene_looks import SceneLooks
from gn0.sim.sensor.sensor import AgentsDevice, Sensor
from gn0.sim.sensors import MapFrame, SensorConfig, paint_grid
from gn0.sim.simulator import goal_record, goal_view
from gn0.sim.state import OBSERVED

if TYPE_CHECKING:
    from gn0.sim.device_people_eyes import PeopleEyesDevice
    from gn0.sim.device_state import SimulatorDevice

_PIXELS = 256  # threads a block of kernels that have one a pixel
_WORDS = {16: "lay_mosaics", 4: "lay_mosaics_4", 1: "lay_mosaics_1"}  # kernels by bytes a thread
_WEIGHT = 22  # bits of the weights of Pillow's box filter


class EyesDevice:
    """The picture sensors of N agents on a device.

    Args:
        config: which sensors, and their cameras.
        scenes: scene id → how to get the scene.
        agent: the body.
        renderer: draws; None if no sensor needs it.
        map_shape: (H, W) [px] that holds every map picture.
        visible_sets: draw colour and depth from the splats visible near each place.
        motion: what moves in the scenes.
        people: shows people; None where there are none.

    Raises:
        SimError: no renderer for a sensor that needs one.
        ConfigError: visible sets of a renderer that has none, or maps that agents make themselves.
    """

    def __init__(
        self,
        config: SensorConfig,
        scenes: Mapping[str, Callable[[], Scene]],
        agent: AgentSpec,
        renderer: Renderer | None,
        map_shape: tuple[int, int] | None,
        visible_sets: bool = False,
        motion: MotionDevice | None = None,
        people: PeopleEyesDevice | None = None,
    ) -> None:
        carried = config.carried
        drawn = carried.eyes.union(s.name for s in carried.sensors if s.bev)
        if drawn and renderer is None:
            raise SimError(
                f"sensors {sorted(drawn)} need a renderer",
                remedy="hand a RendererBatch to VectorEnvDevice as renderer=",
            )
        if drawn and renderer is not None and renderer.traits.device is None:
            raise ConfigError(
                f"renderer {renderer.name!r} draws in host memory, not on a device",
                remedy="use renderer 'cuda', or VectorEnv",
            )
        if config.painted and "bev" in config.active:
            raise ConfigError(
                "a device keeps one BEV of a scene: as it looks, or painted by categories",
                remedy="leave out sensor 'bev', or use VectorEnv",
            )
        if config.explores:
            raise ConfigError(
                "maps that agents make for themselves are not kept on a device",
                remedy="use map mode 'prior', or VectorEnv",
            )
        if visible_sets and renderer is not None and not renderer.traits.visible_sets:
            raise ConfigError("this renderer has no visible sets", remedy="leave visible_sets off")
        self.config = config
        self._outputs = carried.outputs
        self._carried = carried
        self._painted = sorted(carried.maps & {"bev", "occupancy"})
        self._sensors = tuple(
            (s.name, bool(s.draws), device_reader(s, config))
            for s in carried.sensors
            if s.many is None
        )
        self._looks = SceneLooks(renderer, scenes)
        self._agent, self._renderer = agent, renderer
        self._map_shape = map_shape
        self._visible = visible_sets
        self._kept: dict[str, DeviceArray] = {}
        self._goal_numbers: NDArray[np.int32] | None = None  # whose goal pictures are kept
        self._motion, self.people = motion, people
        self._who: WhoEyes | None = None
        if people is not None and SENSORS.intersection(s.name for s in carried.sensors):
            self._who = WhoEyes(renderer, config.preset.rgb)
        if motion is not None and renderer is not None:
            for name, cloud in motion.clouds.items():
                renderer.name_cloud(name, cloud)
        preset = config.preset
        self._pitch = float(np.radians(preset.pitch_degrees))
        self._rgb: DeviceArray | None = None  # what agents see now
        self._muted: frozenset[str] = frozenset()

    @property
    def roles_of(self) -> Callable[[Episode], NDArray[Any]] | None:
        """Episode → what its people bring to their looks; None where nobody is drawn."""
        return None if self.people is None else self.people.roles_of

    @property
    def shows_map(self) -> bool:
        """Whether scenes are drawn from above."""
        return self._carried.bev and self._renderer is not None

    @property
    def map_settings(self) -> tuple[float, tuple[float, float, float]]:
        """Of these pictures: what lies above this height [m] is left out, and their background."""
        return self.config.cut_height, self.config.preset.background

    def watch_opening(self, progress: Progress) -> None:
        """Tell of looks as their splats are loaded; threads that load them tell it."""
        self._looks.progress = progress

    def lacks_map(self, look: str) -> bool:
        """Whether the cache lacks the picture of a scene in its light."""
        assert self._renderer is not None
        scene = self._looks.scene(split_look(look)[0])
        return not find_map(self._renderer, look, scene, *self.map_settings).exists()

    def open_look(self, look: str) -> MapPictures:
        """Name a scene in its light to the renderer; its static map pictures."""
        scene_id, _ = split_look(look)
        scene = self._looks.scene(scene_id)
        renderer = self._renderer
        if renderer is not None:
            self._looks.add(look)
            if self._visible and self._carried.eyes:
                renderer.limit_to_visible(
                    look,
                    scene.cloud_hash or scene.gaussians.content_hash,
                    inflate(scene.grid, self._agent.radius),
                    self._agent.camera_height,
                )
        frame, bev = MapFrame.of_grid(scene.grid), None
        if self.shows_map:
            assert renderer is not None
            picture = draw_map(renderer, look, scene, *self.map_settings)
            frame, bev = MapFrame.of_bev(picture), picture.rgb
        elif self.config.painted:
            cut = self.config.cut_height
            bev = paint_categories(scene.objects, scene.grid, cut, scene.path or scene.id)
        light = None if self.people is None else self.people.light_of(look)
        return MapPictures(frame, self._paint(scene.grid, frame), bev, light)

    def _paint(self, grid: OccupancyGrid, frame: MapFrame) -> U8 | None:
        if not self._carried.maps:
            return None
        return np.ascontiguousarray(paint_grid(grid, frame)[:, :, 0])

    def mute(self, names: Iterable[str]) -> None:
        """Leave these sensors out of what is drawn from now on, and no others.

        Raises:
            ConfigError: one draws nothing here, or is what `history` is made of.
        """
        known = {name for name, _, _ in self._sensors}
        for name in names:
            if name not in known or (name == "rgb" and self._carried.views):
                raise ConfigError(
                    f"sensor {name!r} cannot be left out",
                    remedy="name picture sensors that are carried; rgb only without history",
                )
        self._muted = frozenset(names)

    def write_tiles(self, simulator: SimulatorDevice, out: DeviceArray) -> None:
        """What each agent sees now, reduced to a tile of the mosaic, into `out` [N, h, w, 3].

        Raises:
            ConfigError: no sensor looks at colours.
            SimError: `out` is of another shape or type.
        """
        if self._rgb is None:
            raise ConfigError("agents see no colours", remedy="carry rgb, and do not leave it out")
        width, height = self.config.preset.history_tile
        shape = (simulator.count, height, width, 3)
        if out.shape != shape or out.dtype != np.uint8:
            raise SimError(f"tiles are {out.dtype} {out.shape}", remedy=f"give uint8 {shape}")
        self._reduce(simulator, self._rgb, width, height, out, None)

    def keep_views(self, simulator: SimulatorDevice) -> None:
        """All agents are about to act: what each sees goes into its history."""
        if not self._carried.views:
            return
        assert self._rgb is not None
        width, height = self.config.preset.history_tile
        self._reduce(simulator, self._rgb, width, height, self._rings(simulator), simulator.views)

    def draw(self, simulator: SimulatorDevice) -> dict[str, DeviceArray]:
        """What agents see where they stand, [N, …] by sensor.

        Colour and depth are other memory with each call, the rest is the same.
        """
        agents = AgentsThere(simulator, self)
        shown = [one for one in self._sensors if one[0] not in self._muted]
        if self._outputs and (self._carried.views or any(draws for _, draws, _ in shown)):
            asked = Asked(*self._ask(simulator))
            there = isinstance(asked.views, DeviceArray)
            asked = asked._replace(parts=self._place_parts(simulator, there=there))
            agents.asked, agents.pictures = asked, self._look(simulator, *asked)
            self._rgb = agents.pictures.get("rgb")
        out = {name: read(agents) for name, _, read in shown}
        assert all(len(value) == simulator.count for value in out.values())
        if self.people is not None:
            self.people.pose_ahead(shown=False)  # who had no room before
        return out

    def draw_final(self, simulator: SimulatorDevice) -> dict[str, Any]:
        """What agents saw last whose episodes ended; waits for the device.

        `agents` [K] are their numbers, on the host; colour and depth are [K, …], the others
        [N, …] as with `draw`. To be called before `draw`.
        """
        ended = simulator.outputs["final_episode"].numpy()
        agents = np.flatnonzero(ended >= 0)
        out: dict[str, Any] = {"agents": agents}
        last = AgentsThere(simulator, self, final=True)
        if self._outputs and len(agents):
            poses = simulator.outputs["final_pose"].numpy()[agents]
            eye = self._agent.camera_height
            views = np.stack(
                [view_from_pose(x, y, eye, yaw, self._pitch) for x, y, yaw in poses.tolist()]
            )
            keys = self._keys(simulator, ended[agents])
            parts: Parts = ()
            if self._motion is not None:  # they ended a step after they last looked
                episodes = simulator.store.episodes
                scenes = [episodes[number].scene_id for number in ended[agents].tolist()]
                parts = self._motion.parts_of(scenes, self._motion.steps.numpy()[agents] + 1)
            last.pictures = self._look(simulator, views, keys, parts=parts)
        for name, draws, read in self._sensors:
            if name not in self._muted and (len(agents) or not draws):
                out[name] = read(last)
        return out

    def tell_who(
        self, simulator: SimulatorDevice, asked: Asked | None
    ) -> tuple[DeviceArray, DeviceArray]:
        """Who is who before agents, see `gn0.sim.sensor.who`; nobody where nothing was `asked`."""
        camera = self.config.preset.rgb
        picture = self._array(simulator, "who", (camera.height, camera.width), np.uint8)
        table = self._array(simulator, "seen", (PEOPLE_MOST, 6), np.float32)
        if self._who is not None and asked is not None:
            self._who.tell(simulator, asked, picture, table)
        return picture, table

    def bytes_of(self, count: int, final: bool = False) -> int:
        """Bytes that the picture arrays of `count` agents take beside what the renderer gives.

        With `final`, those of `draw_final` included.
        """
        each = tiles = 0
        if self._carried.views:
            across, down = mosaic_size(self.config.preset.history_tile)
            each += down * across * 3
            tiles = each  # all of them are in it
        if self._map_shape is not None:
            each += len(self._painted) * self._map_shape[0] * self._map_shape[1] * 3
        if SENSORS.intersection(s.name for s in self._carried.sensors):
            camera = self.config.preset.rgb
            each += camera.height * camera.width + PEOPLE_MOST * 6 * 4
        if "ego_map" in self._carried.maps:
            width, height = self.config.map_view.picture_size
            each += width * height * 3
        if self._carried.goal_view:
            width, height = self.config.preset.picture_size
            each += width * height * 3
        return (each * (1 + final) + tiles) * count

    def tiles(self, simulator: SimulatorDevice) -> DeviceArray | None:
        """Earlier views [N, 16, h, w, 3], a ring for each agent; None where no sensor looks."""
        return self._rings(simulator) if self._carried.views else None

    def _rings(self, simulator: SimulatorDevice) -> DeviceArray:
        width, height = self.config.preset.history_tile
        return self._array(simulator, "tiles", (LENGTH, height, width, 3), np.uint8)

    def _array(
        self, simulator: SimulatorDevice, name: str, shape: tuple[int, ...], kind: Any
    ) -> DeviceArray:
        if name not in self._kept:
            self._kept[name] = simulator.device.zeros((simulator.count, *shape), kind)
        return self._kept[name]

    def _ask(
        self, simulator: SimulatorDevice
    ) -> tuple[Any, Sequence[str | None] | str, DeviceArray | None]:
        """What a renderer is asked for: views [N, 4, 4], keys, and which of them each agent sees.

        All on the device, where episodes begin and end, if the renderer takes that; else the host
        waits for the device to know.
        """
        assert self._renderer is not None
        there = self._renderer.traits.device_views
        looks = simulator.store.looks_in_play()
        known = [look for look in looks if look is not None]
        chosen = None
        if there and len(known) > 1:
            chosen = self._array(simulator, "looks", (), np.int32)
        views = self._array(simulator, "views", (4, 4), np.float64)
        building = BuildViews(
            w=simulator.world,
            height=np.float64(self._agent.camera_height),
            cos_pitch=np.float64(np.cos(self._pitch)),
            sin_pitch=np.float64(np.sin(self._pitch)),
            views=views,
            looks=chosen,
        )
        simulator.launch("build_views", simulator.count, building)
        if len(known) == 1:
            return views if there else views.numpy(), known[0], None
        if chosen is not None:
            return views, looks, chosen
        return views.numpy(), self._keys(simulator, simulator.outputs["episode"].numpy()), None

    def _keys(self, simulator: SimulatorDevice, numbers: NDArray[np.int32]) -> list[str]:
        episodes = simulator.store.episodes
        return [name_look(episodes[number]) for number in numbers.tolist()]

    def _place_parts(self, simulator: SimulatorDevice, *, there: bool) -> Parts | PartsDevice:
        """What stands before each agent now, on the device if the views are `there`."""
        motion = self._motion
        if self.people is not None:
            return self.people.show(simulator)
        if motion is None or motion.now is None:
            return ()
        placing = PlaceParts(simulator.world, motion.tables, motion.targets)
        simulator.launch("place_parts", simulator.count * int(motion.tables.parts), placing)
        if there:
            return motion.now
        episodes, numbers = simulator.store.episodes, simulator.outputs["episode"].numpy()
        scenes = [episodes[number].scene_id for number in numbers.tolist()]
        return motion.parts_of(scenes, motion.steps.numpy())

    def _look(
        self,
        simulator: SimulatorDevice,
        views: Any,
        keys: Sequence[str | None] | str,
        chosen: DeviceArray | None = None,
        parts: Parts | PartsDevice = (),
    ) -> dict[str, DeviceArray]:
        """What is drawn of views, by output; see `plan_look`."""
        renderer = self._renderer
        assert renderer is not None
        plan = plan_look(self.config.preset, self._outputs)
        more: dict[str, Any] = {"visible": True} if self._visible else {}
        more |= {"chosen": chosen} if chosen is not None else {}
        if isinstance(parts, PartsDevice) or any(parts):
            more["parts"] = parts
        found: dict[str, DeviceArray] = {}
        for shot in plan.shots:
            drawn = renderer.draw(
                *(shot.camera, views, keys),
                outputs=shot.outputs,
                background=plan.background,
                **more,
            )
            for output in shot.outputs:
                found[output] = self._finish(simulator, plan, output, getattr(drawn, output))
        return found

    def _finish(
        self, simulator: SimulatorDevice, plan: LookPlan, output: str, drawn: DeviceArray
    ) -> DeviceArray:
        """What `LookPlan.finish` makes of an output in host memory."""
        if output == "rgb":
            check_colour(drawn)
            width, height = plan.size
            if drawn.shape[1:3] != (height, width):
                small = simulator.device.empty((len(drawn), height, width, 3), np.uint8)
                self._reduce(simulator, drawn, width, height, small, None)
                return small
        elif output == "depth" and plan.reach is not None:
            low, high = plan.reach
            clipping = ClipDepth(drawn, low, high, np.uint64(drawn.size), drawn)
            blocks = blocks_of(drawn.size, _PIXELS)
            simulator.kernels["clip_depth"].launch(blocks, _PIXELS, clipping)
        return drawn

    def _reduce(
        self,
        simulator: SimulatorDevice,
        rgb: DeviceArray,
        width: int,
        height: int,
        out: DeviceArray,
        views: DeviceArray | None,
    ) -> None:
        rows, cols = rgb.shape[1:3]
        across, taps_x = self._weights(simulator, cols, width)
        down, taps_y = self._weights(simulator, rows, height)
        reducing = ReducePictures(
            in_=rgb,
            rows=np.int32(rows),
            cols=np.int32(cols),
            across=across,
            across_taps=np.int32(taps_x),
            down=down,
            down_taps=np.int32(taps_y),
            out_rows=np.int32(height),
            out_cols=np.int32(width),
            views=views,
            status=simulator.status,
            out=out,
        )
        grid = (len(rgb), blocks_of(width * height, _PIXELS))
        simulator.kernels["reduce_pictures"].launch(grid, _PIXELS, reducing)

    def _weights(self, simulator: SimulatorDevice, size: int, out: int) -> tuple[DeviceArray, int]:
        name = f"weights {size} {out}"
        if name not in self._kept:
            self._kept[name] = simulator.device.upload(box_weights(size, out))
        return self._kept[name], self._kept[name].shape[1] - 2

    def mosaics(
        self, simulator: SimulatorDevice, prefix: str, views: DeviceArray | None
    ) -> DeviceArray:
        """Mosaics of the last sixteen of so many `views` [N]."""
        width, height = self.config.preset.history_tile
        across, down = mosaic_size((width, height))
        out = self._array(simulator, prefix + "history", (down, across, 3), np.uint8)
        line = width * 3  # bytes of a tile's row, copied in the widest words that it is whole of
        word = next(size for size in _WORDS if line % size == 0)
        laying = LayMosaics(
            tiles=self._rings(simulator),
            views=views,
            rows=np.int32(height),
            words=np.int32(line // word),
            out=out,
        )
        grid = (simulator.count, blocks_of(down * across * 3 // word, _PIXELS))
        simulator.kernels[_WORDS[word]].launch(grid, _PIXELS, laying)
        return out

    def map_pictures(
        self, simulator: SimulatorDevice, prefix: str, slots: DeviceArray, poses: DeviceArray
    ) -> dict[str, DeviceArray]:
        """Map pictures by sensor, of maps in these slots, with agents at these poses."""
        assert self._map_shape is not None
        rows, cols = self._map_shape
        found = {
            name: self._array(simulator, prefix + name, (rows, cols, 3), np.uint8)
            for name in self._painted
        }
        painting = PaintMaps(
            w=simulator.world,
            slots=slots,
            poses=poses,
            rows=np.int32(rows),
            cols=np.int32(cols),
            radius=np.int32(self.config.disc_radius),
            arrow=np.int32(self.config.map_view.arrow),
            bev=found.get("bev"),
            occupancy=found.get("occupancy"),
        )
        grid = (simulator.count, blocks_of(rows * cols, _PIXELS))
        simulator.kernels["paint_maps"].launch(grid, _PIXELS, painting)
        return found

    def ego_maps(
        self, simulator: SimulatorDevice, prefix: str, slots: DeviceArray, poses: DeviceArray
    ) -> DeviceArray:
        """Ego maps, see `gn0.sim.ego_map`, of maps in these slots, with agents at these poses."""
        view = self.config.map_view
        width, height = view.picture_size
        out = self._array(simulator, prefix + "ego_map", (height, width, 3), np.uint8)
        offset = 0
        for square in view.squares:
            kernel = simulator.kernels["draw_ego_maps"]
            draw_squares(kernel, simulator.world, square, slots, poses, out, offset)
            offset += square.size
        return out

    def last_goal_pictures(self, simulator: SimulatorDevice) -> DeviceArray:
        """A copy of the goal pictures as they were before the next `draw`."""
        width, height = self.config.preset.picture_size
        shape = (height, width, 3)
        kept = self._array(simulator, "final_goal_picture", shape, np.uint8)
        simulator.copy(self._array(simulator, "goal_picture", shape, np.uint8), kept)
        return kept

    def goal_pictures(self, simulator: SimulatorDevice, numbers: NDArray[np.int32]) -> DeviceArray:
        """Each agent's goal picture; drawn anew for those whose episode is another."""
        assert self._renderer is not None
        width, height = self.config.preset.picture_size
        out = self._array(simulator, "goal_picture", (height, width, 3), np.uint8)
        fresh = (
            np.arange(simulator.count)
            if self._goal_numbers is None
            else np.flatnonzero(numbers != self._goal_numbers)
        )
        plan = plan_look(self.config.preset, frozenset({"rgb"}))
        groups: dict[Camera, list[tuple[int, str, F64]]] = {}
        for i in fresh.tolist():
            episode = simulator.store.episodes[numbers[i]]
            camera, view = aim_at_goal(
                self.config.preset,
                self._agent.camera_height,
                goal_record(episode),
                goal_view(episode),
            )
            groups.setdefault(camera, []).append((i, name_look(episode), view))
        for camera, group in groups.items():
            drawn = self._renderer.draw(
                camera,
                np.stack([view for _, _, view in group]),
                [look for _, look, _ in group],
                outputs=("rgb",),
                background=plan.background,
            ).rgb
            rgb = self._finish(simulator, plan, "rgb", drawn)
            agents = simulator.device.upload(np.array([i for i, _, _ in group], np.int32))
            placing = PlaceRows(
                in_=rgb,
                to=agents,
                size=np.uint64(height * width * 3),
                entries=np.int32(len(group)),
                out=out,
            )
            blocks = blocks_of(rgb.size, _PIXELS)
            simulator.kernels["place_rows"].launch(blocks, _PIXELS, placing)
        self._goal_numbers = numbers
        return out


def draw_squares(
    kernel: Kernel,
    world: np.void,
    square: EgoSquare,
    slots: DeviceArray,
    poses: DeviceArray,
    out: DeviceArray,
    offset: int = 0,
) -> None:
    """Draw a square of ego maps from column `offset` on into `out` [K, H, W, 3].

    `slots` [K] are rows of the world's episodes, negative ones black; `poses` [K, 3].
    """
    drawing = DrawEgoMaps(
        w=world,
        slots=slots,
        poses=poses,
        size=np.int32(square.size),
        metres=np.float64(square.metres_per_pixel),
        front=np.int64(find_front(square)),
        content=np.int32(CONTENTS.index(square.content)),
        marker=np.int32(square.marker),
        offset=np.int32(offset),
        high=np.int32(out.shape[1]),
        wide=np.int32(out.shape[2]),
        out=out,
    )
    kernel.launch((len(out), blocks_of(square.size**2, _PIXELS)), _PIXELS, drawing)


def refuse_host_sensors(sensors: Iterable[Sensor]) -> None:
    """Refuse sensors that no device reads.

    Raises:
        ConfigError: one is among them.
    """
    for sensor in sensors:
        if sensor.device is None and is_builtin("sensor", sensor.name):
            raise ConfigError(
                f"sensor {sensor.name!r} is painted on the CPU alone",
                where="sensors",
                remedy="use VectorEnv, or here 'bev' (the map without people), 'who' and "
                "'people_seen' (who is in the picture)",
            )
        if sensor.device is None:
            raise ConfigError(
                f"sensor {sensor.name!r} does not say how a device reads it",
                remedy="use VectorEnv, or give the sensor a device=",
            )


def draws_people(episodes: Iterable[Episode], sensors: Iterable[Sensor]) -> bool:
    """Whether sensors have to draw people of these episodes."""
    return any(s.draws or s.views for s in sensors) and any(e.people for e in episodes)


def device_reader(sensor: Sensor, settings: SensorConfig) -> Callable[[AgentsDevice], DeviceArray]:
    """How agents on a device read a sensor; a stranger's is held to its space."""
    assert sensor.device is not None
    if sensor.name in OBSERVED:
        return sensor.device
    space = sensor.find_space(settings)
    return lambda agents: sensor.measure_device(agents, space)


def box_weights(size: int, out: int) -> NDArray[np.int32]:
    """Pillow's box filter from `size` to `out` pixels: [out, 2 + taps] first, number, weights.

    Weights are whole numbers of 2⁻²², as Pillow rounds them for 8-bit pictures.
    """
    scale = size / out
    reach = max(scale, 1.0)
    support = 0.5 * reach
    taps = int(np.ceil(support)) * 2 + 1
    table = np.zeros((out, 2 + taps), np.int32)
    for k in range(out):
        centre = (k + 0.5) * scale
        first = max(int(centre - support + 0.5), 0)
        count = min(int(centre + support + 0.5), size) - first
        at = (np.arange(count) + first - centre + 0.5) * (1.0 / reach)
        weights = ((at > -0.5) & (at <= 0.5)).astype(np.float64)
        weights /= weights.sum()
        table[k, :2] = first, count
        table[k, 2 : 2 + count] = (0.5 + weights * (1 << _WEIGHT)).astype(np.int32)
    return table
