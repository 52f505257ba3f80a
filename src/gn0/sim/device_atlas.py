"""`EgoAtlas`: map pictures of any poses of any episodes on a device, whoever plays there now.

A sample that is drawn long after it was walked through needs its maps again; kept, they would take
six times the memory of the maps that they are cut from. So the map pictures of all scenes are held
on the device once, shared with the environment that plays in them. Squares are drawn when they are
wanted, by the kernel of the sensor `ego_map`, and so are whole maps, the pictures of the sensors
`bev` and `occupancy`, brought to one size.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from gn0.device.device import DeviceArray
from gn0.errors import ConfigError, DeviceMemoryError, SimError
from gn0.missions.episode import Episode
from gn0.sim.device_env import VectorEnvDevice
from gn0.sim.device_eyes import box_weights, draw_squares
from gn0.sim.device_layout import EPISODE, WORLD, blocks_of, pack_struct
from gn0.sim.device_records import ShrinkMaps
from gn0.sim.ego_map import EgoSquare, MapView
from gn0.sim.open import name_look
from gn0.sim.sensors import MapFrame

MEMORY = 2**31  # bytes of map pictures
_PIXELS = 256  # threads of a block that draws


class EgoAtlas:
    """Map pictures of the scenes of an environment, in the lights of its episodes.

    Args:
        env: whose; it carries the sensor `ego_map` (which may be muted).
        view: squares to draw; the environment's when None.
        memory: bytes that the pictures may take. They lie in the environment's memory of maps and
            fields and count there, too.

    Attributes:
        view: squares that can be drawn.
        nbytes: bytes of the pictures.

    Raises:
        ConfigError: the environment carries no maps, or none in colour where a square shows them.
        DeviceMemoryError: the pictures do not fit; says what would.
    """

    def __init__(
        self, env: VectorEnvDevice, view: MapView | None = None, *, memory: int = MEMORY
    ) -> None:
        self._device, self._store = env.device, env.simulator.store
        config = env.simulator.config
        self.view = view or config.map_view
        if self.view.looks_at_bev and self.view.paint != config.map_view.paint:
            raise ConfigError(
                f"squares painted by {self.view.paint!r} of an environment whose maps are painted "
                f"by {config.map_view.paint!r}",
                where="paint",
                remedy="give both the same map view",
            )
        self.nbytes, self._memory = 0, memory
        self._looks: dict[str, tuple[list[int], tuple[float, ...], tuple[int, int]]] = {}
        self._rows = np.zeros(0, EPISODE)
        self._shrunk: dict[tuple[int, int], tuple[DeviceArray, ...]] = {}
        self._radius, self._coloured = config.disc_radius, not config.painted
        self._kernel = self._store.kernels["draw_ego_maps"]
        self._follow()

    def __len__(self) -> int:
        return len(self._rows)

    def _follow(self) -> None:
        """Take up the episodes that are new in the store."""
        fresh = self._store.episodes[len(self._rows) :]
        rows = np.zeros(len(fresh), EPISODE)
        held: list[str] = []
        try:
            for row, episode in zip(rows, fresh, strict=True):
                name = name_look(episode)
                if name not in self._looks:
                    self._hold(name, fresh)
                    held.append(name)
                pointers, frame, shape = self._looks[name]
                row["grey"], row["bev"] = pointers
                row["map_x"], row["map_y"], row["map_scale"] = frame
                row["map_rows"], row["map_cols"] = shape
                row["start_x"], row["start_y"] = episode.start[:2]
        except BaseException:
            for name in held:
                self._let_go(name)
            raise
        self._rows = np.append(self._rows, rows)
        self._shrunk.clear()
        raw = self._rows.view(np.uint8).reshape(len(self._rows), -1)
        self._table = self._device.upload(np.ascontiguousarray(raw))
        self._world = pack_struct(WORLD, episodes=self._table)

    def _hold(self, name: str, wanted: list[Episode]) -> None:
        try:
            found = self._store.hold_look(name)
        except DeviceMemoryError as error:
            raise self._refusal(wanted, error.what) from None
        self._looks[name] = found
        bev = self._store.picture_bytes(name)
        if self.view.looks_at_bev and not bev[1]:
            raise ConfigError(
                "the environment's maps have no colours", remedy="carry ego_map with such a square"
            )
        self._coloured = self._coloured and bool(bev[1])
        self.nbytes += sum(bev)
        if self.nbytes > self._memory:
            raise self._refusal(wanted, f"{self._memory} may be taken")

    def _let_go(self, name: str) -> None:
        if name in self._looks:
            self.nbytes -= sum(self._store.picture_bytes(name))
            del self._looks[name]
            self._store.free_look(name)

    def _refusal(self, wanted: list[Episode], why: str) -> DeviceMemoryError:
        names = len(self._looks.keys() | {name_look(episode) for episode in wanted})
        done = max(len(self._looks), 1)
        each = math.ceil(self.nbytes / done)
        return DeviceMemoryError(
            f"map pictures of {names} scenes and lights take about {each * names} bytes: {why}",
            where=self._device.name,
            remedy=f"give memory={each * names}, or play {max(done - 1, 0)} of them at a time",
        )

    def draw(
        self,
        square: EgoSquare,
        numbers: DeviceArray,
        poses: DeviceArray,
        out: DeviceArray | None = None,
    ) -> DeviceArray:
        """Squares [K, S, S, 3] around poses; waits for nothing.

        Args:
            square: how it is drawn.
            numbers: int32 [K] of episodes, as `infos["episode"]` has them; black where negative.
                They must be of the environment: nothing looks at them on the way.
            poses: float64 [K, 3] x, y [m], yaw [rad].
            out: uint8 [K, S, S, 3] to draw into.

        Raises:
            SimError: arrays of another shape or type.
        """
        count = len(numbers)
        shape = (count, square.size, square.size, 3)
        if out is None:
            out = self._device.empty(shape, np.uint8)
        self._check(numbers, poses, out, shape)
        if len(self._store.episodes) > len(self._rows):
            self._follow()
        if count:
            draw_squares(self._kernel, self._world, square, numbers, poses, out)
        return out

    def _check(
        self, numbers: DeviceArray, poses: DeviceArray, out: DeviceArray, shape: tuple[int, ...]
    ) -> None:
        count = shape[0]
        given = (("numbers", numbers, (count,), np.int32), ("poses", poses, (count, 3), np.float64),
                 ("out", out, shape, np.uint8))  # fmt: skip
        for name, array, wanted, kind in given:
            if array.shape != wanted or array.dtype != kind:
                raise SimError(
                    f"{name} are {array.dtype} {array.shape}",
                    remedy=f"give {np.dtype(kind)} {wanted}",
                )

    @property
    def frames(self) -> tuple[MapFrame, ...]:
        """The frame of the whole map of each episode, by its number."""
        return tuple(
            MapFrame(
                int(row["map_cols"]), int(row["map_rows"]), float(row["map_scale"]),
                float(row["map_x"]), float(row["map_y"]),
            )
            for row in self._rows
        )  # fmt: skip

    def draw_whole(
        self,
        name: str,
        size: tuple[int, int],
        numbers: DeviceArray,
        poses: DeviceArray,
        out: DeviceArray | None = None,
    ) -> DeviceArray:
        """Whole maps [K, H, W, 3], each brought to `size`; waits for nothing.

        The bytes of the sensor's picture of each scene, resized by Pillow's box filter.

        Args:
            name: `bev` or `occupancy`, with start and agent as discs, or as the view says an arrow.
            size: (width, height) [px].
            numbers: int32 [K] of episodes, see `draw`.
            poses: float64 [K, 3] x, y [m], yaw [rad].
            out: uint8 [K, height, width, 3] to draw into.

        Raises:
            ConfigError: no such picture, or the maps have no colours or those of categories.
            SimError: arrays of another shape or type.
        """
        if name not in ("bev", "occupancy"):
            raise ConfigError(f"no whole map {name!r}", remedy="known: bev, occupancy")
        if name == "bev" and not self._coloured:
            raise ConfigError(
                "the environment's maps do not have the scene's colours",
                where="bev",
                remedy='carry ego_map with a square that shows them, and paint="scene"',
            )
        count, (width, height) = len(numbers), size
        shape = (count, height, width, 3)
        if out is None:
            out = self._device.empty(shape, np.uint8)
        self._check(numbers, poses, out, shape)
        if len(self._store.episodes) > len(self._rows):
            self._follow()
        shapes, across, down = self._measure(size)
        if count:
            drawing = ShrinkMaps(
                w=self._world,
                slots=numbers,
                poses=poses,
                shapes=shapes,
                across=across,
                down=down,
                rows=np.int32(height),
                cols=np.int32(width),
                radius=np.int32(self._radius),
                arrow=np.int32(self.view.arrow),
                occupancy=np.int32(name == "occupancy"),
                out=out,
            )
            grid = (count, blocks_of(width * height, _PIXELS))
            self._store.kernels["shrink_maps"].launch(grid, _PIXELS, drawing)
        return out

    def _measure(self, size: tuple[int, int]) -> tuple[DeviceArray, ...]:
        """The shape of each episode's map, and the windows of the shapes along both axes."""
        if size not in self._shrunk:
            sides = [(int(r["map_cols"]), int(r["map_rows"])) for r in self._rows]
            known = {side: number for number, side in enumerate(dict.fromkeys(sides))}
            numbers = np.array([known[side] for side in sides], np.int32)
            tables = [
                np.stack([_windows(side[axis], size[axis]) for side in known]) for axis in (0, 1)
            ]
            self._shrunk[size] = tuple(self._device.upload(one) for one in (numbers, *tables))
        return self._shrunk[size]


def _windows(size: int, out: int) -> NDArray[np.int32]:
    """A box filter's windows [out, 3]: first pixel, number of pixels, and the weight of each."""
    table = box_weights(size, out)
    found = np.zeros((out, 3), np.int32)
    for k, (first, _, *weights) in enumerate(table.tolist()):
        inside = np.flatnonzero(weights)
        found[k] = first + inside[0], len(inside), weights[inside[0]]
    return found
