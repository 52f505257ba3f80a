"""`rgb`: the colour picture."""

from __future__ import annotations

from gn0.sim.sensor.sensor import Sensor, picture_space

SENSOR = Sensor(
    name="rgb",
    doc="uint8 [H, W, 3]",
    space=lambda settings: picture_space(*settings.preset.picture_size),
    draws=frozenset({"rgb"}),
    read=lambda here: here.seen("rgb"),
    device=lambda agents: agents.seen("rgb"),
    wire=None,  # `images` of a request
)
