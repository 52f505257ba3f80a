"""`bev_live`: the scene from above, and everybody where they are now."""

from __future__ import annotations

from gn0.sim.sensor.sensor import MAP_SIDE, Sensor, picture_space

SENSOR = Sensor(
    name="bev_live",
    doc="`bev` with people as discs where they are now, whom to follow green, others blue, a nose "
    "where they look; the agent a red arrow. For policies that are told labels",
    space=lambda _: picture_space(MAP_SIDE, MAP_SIDE),
    bev=True,
    explores=frozenset({"depth", "rgb"}),
    tells="labels",
    read=lambda here: here.bev_live(),
)
