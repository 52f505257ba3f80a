"""`bev`: the scene from above."""

from __future__ import annotations

from gn0.sim.sensor.sensor import MAP_SIDE, Sensor, Wire, picture_space

SENSOR = Sensor(
    name="bev",
    doc="uint8 map picture, north up, one pixel per map cell; the [map mode](maps.md) decides what "
    "it shows",
    space=lambda _: picture_space(MAP_SIDE, MAP_SIDE),
    bev=True,
    explores=frozenset({"depth", "rgb"}),
    read=lambda here: here.bev(),
    device=lambda agents: agents.map_pictures("bev"),
    wire=Wire(once=True),
)
