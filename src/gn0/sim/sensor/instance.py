"""`instance`: which object each pixel shows."""

from __future__ import annotations

from gn0.sim.sensor.semantic import label_space
from gn0.sim.sensor.sensor import Sensor

SENSOR = Sensor(
    name="instance",
    doc="uint32 [Hd, Wd]: the object that each depth pixel shows, `scene.objects[n - 1]`, or 0. "
    "For policies that are told labels",
    space=label_space,
    draws=frozenset({"instance"}),
    tells="labels",
    read=lambda here: here.seen("instance"),
    device=lambda agents: agents.seen("instance"),
)
