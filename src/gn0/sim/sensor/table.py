"""The table of sensors: GN0's own and those that others registered, by name."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

from gn0.errors import ConfigError, brief
from gn0.plugins import builtin_names, get_plugin, plugin_names
from gn0.sim.sensor.sensor import Sensor
from gn0.sim.state import OBSERVED, Observation

RESERVED: frozenset[str] = frozenset({"instruction_tokens", "instruction_index", "version", "seed"})
"""Names that environments and the wire use themselves."""


def sensor_names() -> tuple[str, ...]:
    """Names of all sensors: GN0's own in the order of the docs, then others, sorted."""
    own = builtin_names("sensor")
    return (*own, *(name for name in plugin_names("sensor") if name not in own))


def find_sensor(name: str) -> Sensor:
    """The sensor of that name.

    Raises:
        ConfigError: there is none, or what is registered is none.
    """
    sensor = get_plugin("sensor", name)
    if not isinstance(sensor, Sensor):
        raise ConfigError(
            f"what is registered as sensor {name!r} is a {type(sensor).__name__}",
            remedy="register a gn0.sim.Sensor",
        )
    taken = name in RESERVED or (name in Observation.__dataclass_fields__ and name not in OBSERVED)
    if sensor.name != name or taken or not name.isidentifier() or name.startswith("_"):
        raise ConfigError(
            f"sensor {sensor.name!r} cannot go by the name {name!r}",
            remedy="register it under its own name, an identifier that no field of an observation "
            "and no key of the wire has",
        )
    return sensor


def several_names(names: object) -> Iterable[Any]:
    """The names of sensors, where they are several: of one text each letter would be one.

    Raises:
        ConfigError: they are not.
    """
    if isinstance(names, str) or not isinstance(names, Iterable):
        raise ConfigError(
            f"sensors are {brief(names)}", remedy="give a list of names, as sensors=('rgb',)"
        )
    return names


def check_sensors(names: Iterable[str]) -> frozenset[str]:
    """The names as a set of sensors.

    Raises:
        ConfigError: it is one text, not several, or a name is unknown; lists those that exist.
    """
    found = frozenset(several_names(names))
    known = sensor_names()
    unknown = sorted(str(name) for name in found - frozenset(known))
    if unknown:
        raise ConfigError(
            f"no sensor named {unknown[0]!r}", remedy="known: " + ", ".join(sorted(known))
        )
    return found


@dataclass(frozen=True, eq=False)
class Carried:
    """Some sensors, and what they need together.

    Attributes:
        sensors: in the order of the table.
        outputs: outputs of a renderer, where an agent stands.
        explored: outputs that the agent's own map is made of.
        maps: names of those that look at a map.
        eyes: names of those that look through the agent's eyes.
        views, goal_view, bev: whether one looks at that.
    """

    sensors: tuple[Sensor, ...]
    outputs: frozenset[str]
    explored: frozenset[str]
    maps: frozenset[str]
    eyes: frozenset[str]
    views: bool
    goal_view: bool
    bev: bool

    def drawn(self, explores: bool) -> frozenset[str]:
        """Outputs of a renderer, those for the agent's own map included where it makes one."""
        return self.outputs | self.explored if explores else self.outputs

    def needs_renderer(self, explores: bool) -> bool:
        """Whether anything must be drawn."""
        return bool(self.eyes or (self.maps if explores else self.bev))


def carry_sensors(names: Iterable[str]) -> Carried:
    """The sensors of these names.

    Raises:
        ConfigError: a name is unknown; lists those that exist.
    """
    return _carry(frozenset(several_names(names)))


@lru_cache(maxsize=256)
def _carry(names: frozenset[str]) -> Carried:
    check_sensors(names)
    return join_sensors(tuple(find_sensor(name) for name in sensor_names() if name in names))


def join_sensors(sensors: tuple[Sensor, ...]) -> Carried:
    """Sensors in the order of the table, and what they need together."""
    views = any(sensor.views for sensor in sensors)
    drawn = frozenset[str]().union(*(sensor.draws for sensor in sensors))
    return Carried(
        sensors,
        drawn | ({"rgb"} if views else frozenset()),
        frozenset[str]().union(*(sensor.explores for sensor in sensors)),
        frozenset(sensor.name for sensor in sensors if sensor.explores),
        frozenset(sensor.name for sensor in sensors if sensor.looks),
        views,
        any(sensor.goal_view for sensor in sensors),
        any(sensor.bev for sensor in sensors),
    )
