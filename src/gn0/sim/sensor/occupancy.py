"""`occupancy`: the map, with start and agent."""

from __future__ import annotations

from gn0.sim.sensor.sensor import MAP_SIDE, Sensor, picture_space

SENSOR = Sensor(
    name="occupancy",
    doc="the map in the same frame: free white, unknown grey, occupied black; start a green disc, "
    "agent a red one",
    space=lambda _: picture_space(MAP_SIDE, MAP_SIDE),
    explores=frozenset({"depth"}),
    read=lambda here: here.occupancy(),
    device=lambda agents: agents.map_pictures("occupancy"),
)
