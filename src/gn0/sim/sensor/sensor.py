"""What a sensor is: one value that says everything any engine needs to know about it.

    SENSOR = Sensor(
        name="nearest",
        doc="float32 [1] m: the nearest thing before the eyes",
        space=lambda settings: Space((1,), np.float32, 0.0, settings.preset.depth_range[1]),
        draws=frozenset({"depth"}),
        read=lambda here: here.seen("depth").min(keepdims=True)[0],
    )
    register("sensor", SENSOR.name, SENSOR)

That is enough for `open_simulator`, the environments, policies that name it, and the wire. A sensor
that says how a device reads it is carried there, too.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, Literal, Protocol

import numpy as np
from numpy.typing import NDArray

from gn0.errors import ConfigError, Gn0Error, SimError
from gn0.geometry import F32, F64, U8, Pose2D
from gn0.plugins import describe_error

if TYPE_CHECKING:
    from gn0.device.device import DeviceArray
    from gn0.maps.navigation import NavigationMap
    from gn0.sim.ego_map import MapView
    from gn0.sim.presets import CameraPreset

MAP_SIDE = -1  # a side of a space that is as long as the scene's map picture
Tells = Literal["", "point", "image", "pose", "labels"]


class SensorSettings(Protocol):
    """What a space may depend on; see `gn0.sim.sensors.SensorConfig`."""

    @property
    def preset(self) -> CameraPreset:
        """Cameras and body."""
        ...

    @property
    def range_rays(self) -> int:
        """Rays of the range ring."""
        ...

    @property
    def range_limit(self) -> float:
        """Reach of the range ring [m]."""
        ...

    @property
    def map_view(self) -> MapView:
        """How maps are shown."""
        ...


@dataclass(frozen=True)
class Space:
    """What values a sensor gives, as an array.

    Attributes:
        shape: sides; `MAP_SIDE` where the scene's map decides.
        dtype: of NumPy.
        low, high: bounds of every value, both included.
    """

    shape: tuple[int, ...]
    dtype: Any
    low: float
    high: float

    def sized(self, map_shape: tuple[int, int] | None) -> Space:
        """The same with the sides of a map picture [px] where the map decides."""
        if MAP_SIDE not in self.shape:
            return self
        sides = iter(map_shape or (1, 1))
        return replace(self, shape=tuple(next(sides) if n == MAP_SIDE else n for n in self.shape))

    @property
    def is_picture(self) -> bool:
        """Whether it is a picture with colours, [H, W, 3]."""
        return len(self.shape) == 3 and self.shape[-1] == 3

    def channels_first(self) -> Space:
        """The same of a picture [3, H, W]; other spaces stay as they are."""
        if not self.is_picture:
            return self
        return replace(self, shape=(self.shape[-1], *self.shape[:-1]))

    def fault(self) -> str:
        """What is wrong with the space itself, in words; empty where nothing is."""
        kind = np.dtype(self.dtype)
        if kind.kind not in "uif":
            return f"has values of type {kind}: whole or floating numbers are meant"
        if not all(isinstance(n, int) and (n > 0 or n == MAP_SIDE) for n in self.shape):
            return f"has the shape {self.shape}: sides are whole numbers above 0"
        if not self.low <= self.high:
            return f"has no values between {self.low} and {self.high}"
        return ""

    def refusal(self, value: NDArray[Any]) -> str:
        """What is wrong with a value, in words; empty where nothing is."""
        wrong = self.misfit(value.shape, value.dtype)
        if wrong:
            return wrong
        if value.size and not (value.min() >= self.low and value.max() <= self.high):
            return (
                f"gives values from {float(value.min()):g} to {float(value.max()):g}, beyond "
                f"{self.low:g} to {self.high:g}"
            )
        return ""

    def misfit(self, shape: tuple[int, ...], dtype: Any) -> str:
        """What is wrong with a value's shape or type, in words; empty where nothing is."""
        if len(shape) != len(self.shape) or any(
            want not in (MAP_SIDE, n) for want, n in zip(self.shape, shape, strict=True)
        ):
            return f"gives shape {list(shape)}, not {list(self.shape)}"
        if dtype != np.dtype(self.dtype):
            return f"gives {np.dtype(dtype)}, not {np.dtype(self.dtype)}"
        return ""


def picture_space(width: int, height: int) -> Space:
    """A colour picture [H, W, 3]."""
    return Space((height, width, 3), np.uint8, 0, 255)


class Here(Protocol):
    """One agent at its current pose: what a sensor may use."""

    @property
    def pose(self) -> Pose2D:
        """Where it stands."""
        ...

    @property
    def start(self) -> Pose2D:
        """Where its episode began."""
        ...

    @property
    def goal(self) -> tuple[float, float]:
        """The place it is sent to [m]; a sensor that looks at it says so in `Sensor.tells`."""
        ...

    @property
    def steps(self) -> int:
        """Steps taken so far."""
        ...

    @property
    def time(self) -> float:
        """Seconds since its episode began."""
        ...

    @property
    def navigation(self) -> NavigationMap:
        """The scene's map, plain and inflated by the body."""
        ...

    def seen(self, output: str) -> NDArray[Any]:
        """A picture of what lies before the eyes [H, W, …], of those that `Sensor.draws` names."""
        ...

    def views(self) -> tuple[U8, ...]:
        """Earlier views as tiles, newest first; for sensors with `Sensor.views`."""
        ...

    def mosaic(self) -> U8:
        """The same tiles in one picture [H, W, 3]."""
        ...

    def who(self) -> tuple[U8, F32]:
        """Person numbers [H, W], and what is seen of each [16, 6]; see `gn0.sim.sensor.who`."""
        ...

    def goal_picture(self) -> U8:
        """What the goal looks like [H, W, 3]; for sensors with `Sensor.goal_view`."""
        ...

    def bev(self) -> U8:
        """The scene from above [Hb, Wb, 3], or what the agent has seen of it."""
        ...

    def bev_live(self) -> U8:
        """The same with people as they stand now, and the agent."""
        ...

    def occupancy(self) -> U8:
        """The map as a picture [Hb, Wb, 3] with start and agent, or what the agent knows of it."""
        ...

    def ego_map(self) -> U8:
        """Maps around the agent, its heading up, side by side [H, W, 3]."""
        ...

    def ranges(self) -> F32:
        """The range ring [R] m."""
        ...

    def random(self, name: str) -> np.random.Generator:
        """A random stream of this episode, step and name."""
        ...

    def random_walk(self, name: str) -> np.random.Generator:
        """A random stream of this episode and name, the same at each step: for what accumulates."""
        ...


class Agents(Protocol):
    """Many agents at their current poses: what is read for all at once."""

    def poses(self) -> F64:
        """[K, 3] x, y [m], yaw [rad]."""
        ...

    def goal_vectors(self) -> F32:
        """[K, 2] forward, left [m]."""
        ...

    def ranges(self) -> F32:
        """[K, R] m."""
        ...


class AgentsDevice(Protocol):
    """Agents on a device, at their current or their last poses; all arrays are there."""

    def output(self, name: str) -> DeviceArray:
        """What the last step wrote [N, …]: pose, goal_vector, collided; see `device_layout`."""
        ...

    def ranges(self) -> DeviceArray:
        """[N, R] m."""
        ...

    def seen(self, output: str) -> DeviceArray:
        """Pictures of what lies before the eyes [N, H, W, …]."""
        ...

    def mosaics(self) -> DeviceArray:
        """Mosaics of earlier views [N, H, W, 3]."""
        ...

    def who(self) -> tuple[DeviceArray, DeviceArray]:
        """Person numbers [N, H, W], and what is seen of each [N, 16, 6]."""
        ...

    def goal_pictures(self) -> DeviceArray:
        """What goals look like [N, H, W, 3]."""
        ...

    def map_pictures(self, name: str) -> DeviceArray:
        """Pictures bev or occupancy [N, Hb, Wb, 3]."""
        ...

    def ego_maps(self) -> DeviceArray:
        """Maps around the agents, their headings up, side by side [N, H, W, 3]."""
        ...


@dataclass(frozen=True)
class Wire:
    """How a sensor goes over the wire; by default as an array, unchanged.

    Attributes:
        once: sent when it is another object, not with every question.
        pack: what is sent of a value, when not the array itself.
        unpack: the value of what was sent; ValueError where it is invalid.
        holds: what `unpack` takes, in words.
    """

    once: bool = False
    pack: Callable[[Any], Any] | None = None
    unpack: Callable[[Any], Any] | None = None
    holds: str = ""


@dataclass(frozen=True, eq=False, kw_only=True)
class Sensor:
    """A sensor: everything that the engines need to know about it.

    Attributes:
        name: in `sensors=`, in observations, spaces and on the wire.
        doc: what it gives, in a line: its row in the docs and in `gn0 list sensors`.
        space: what values it gives, as an array.
        read: what one agent reads, never written to afterwards; equal places and moments, equal
            values. Enough for one agent and for many.
        draws: outputs of a renderer that it looks at; see `gn0.sim.look_plan`.
        views: whether it looks at earlier views.
        goal_view: whether it looks at the goal's picture.
        bev: whether it looks at the scene from above.
        explores: what an agent's own map is made of, for those that look at a map; else empty.
        settle: the sensor as it is with these settings, where they change what it looks at.
        tells: what it says that not every track allows, or that no robot could know (labels).
        many: reads of all agents at once what needs no picture; one by one when None.
        device: reads of all agents on a device; it is not carried there when None.
        array: the array that stands for a missing value.
        wire: how it is sent; None where the released protocol has a place of its own for it.
    """

    name: str
    doc: str
    space: Callable[[SensorSettings], Space]
    read: Callable[[Here], Any]
    draws: frozenset[str] = frozenset()
    views: bool = False
    goal_view: bool = False
    bev: bool = False
    explores: frozenset[str] = frozenset()
    settle: Callable[[SensorSettings], Sensor] | None = None
    tells: Tells = ""
    many: Callable[[Agents], NDArray[Any]] | None = None
    device: Callable[[AgentsDevice], DeviceArray] | None = None
    array: Callable[[Any], NDArray[Any]] | None = None
    wire: Wire | None = Wire()

    @property
    def looks(self) -> bool:
        """Whether it looks through the agent's eyes, so that a renderer is needed."""
        return bool(self.draws) or self.views or self.goal_view

    def as_array(self, value: Any) -> NDArray[Any]:
        """A value as a new array."""
        return np.array(value) if self.array is None else self.array(value)

    def find_space(self, settings: SensorSettings) -> Space:
        """What values it gives with these settings.

        Raises:
            ConfigError: that is no space.
        """
        try:
            space = self.space(settings)
            wrong = space.fault()
        except Exception as error:  # whatever a stranger's code raises
            wrong = f"cannot be had: {describe_error(error)}"
        if wrong:
            raise ConfigError(
                f"the space of sensor {self.name!r} {wrong}",
                remedy="give Space(shape, dtype, low, high)",
            )
        return space

    def measure(self, here: Here, space: Space) -> NDArray[Any]:
        """What a stranger's sensor reads, if it is what its space says; read-only.

        Raises:
            SimError: it is not, or it cannot be read.
        """
        return self._check(self._try(self.read, here), space)

    def measure_many(self, agents: Agents, space: Space, count: int) -> NDArray[Any]:
        """The same of so many agents at once [count, …]; `many` must be there.

        Raises:
            SimError: it is not what its space says, or it cannot be read.
        """
        assert self.many is not None
        return self._check(
            self._try(self.many, agents), replace(space, shape=(count, *space.shape))
        )

    def measure_device(self, agents: AgentsDevice, space: Space) -> DeviceArray:
        """The same of agents on a device, by shape and type alone; `device` must be there.

        Raises:
            SimError: it is not what its space says, or it cannot be read.
        """
        assert self.device is not None
        found = self._try(self.device, agents)
        shape, dtype = getattr(found, "shape", None), getattr(found, "dtype", None)
        if shape is None or dtype is None:
            raise self._refusal(f"gives a {type(found).__name__}, not an array of the device")
        wrong = space.misfit(shape[1:], dtype)
        if wrong:
            raise self._refusal(wrong)
        return found

    def _try(self, read: Callable[[Any], Any], of: Any) -> Any:
        try:
            return read(of)
        except Gn0Error:
            raise
        except Exception as error:  # whatever a stranger's code raises
            raise SimError(
                f"sensor {self.name!r} cannot be read: {describe_error(error)}",
                remedy="fix it; name what it looks at in its draws, views, goal_view or bev",
            ) from error

    def _check(self, value: Any, space: Space) -> NDArray[Any]:
        """A stranger's value, if it is what the space says; it cannot be written to."""
        if not isinstance(value, np.ndarray | np.generic):
            raise self._refusal(f"gives a {type(value).__name__}, not an array")
        array = np.asarray(value)
        wrong = space.refusal(array)
        if wrong:
            raise self._refusal(wrong)
        array = array.view()
        array.setflags(write=False)
        return array

    def _refusal(self, wrong: str) -> SimError:
        return SimError(
            f"sensor {self.name!r} {wrong}",
            remedy="correct what reads it, or its space(); gn0.testing.check_sensor tells more",
        )
