"""`ego_map`: the map around the agent, its heading up."""

from __future__ import annotations

from dataclasses import replace

from gn0.sim.sensor.sensor import Sensor, SensorSettings, picture_space


def _settle(settings: SensorSettings) -> Sensor:
    """The same; without colours, or painted from labels, nothing has to be drawn for it."""
    if settings.map_view.looks_at_bev and not settings.map_view.painted:
        return SENSOR
    return replace(SENSOR, bev=False, explores=frozenset({"depth"}))


SENSOR = Sensor(
    name="ego_map",
    doc="uint8 map pictures around the agent, its heading up, side by side: 128 px of 0.06 m and "
    "128 px of 0.15 m, or [your own](#ego-maps)",
    space=lambda settings: picture_space(*settings.map_view.picture_size),
    bev=True,
    explores=frozenset({"depth", "rgb"}),
    settle=_settle,
    read=lambda here: here.ego_map(),
    device=lambda agents: agents.ego_maps(),
)
