"""`history`: a mosaic of earlier views."""

from __future__ import annotations

from gn0.sim.history import mosaic_size
from gn0.sim.sensor.sensor import Sensor, picture_space

SENSOR = Sensor(
    name="history",
    doc="uint8 [480, 640, 3]: the last sixteen views in 4×4 tiles, newest at the top left, the "
    "current one excluded; smaller with presets of smaller tiles",
    space=lambda settings: picture_space(*mosaic_size(settings.preset.history_tile)),
    views=True,
    read=lambda here: here.mosaic(),
    device=lambda agents: agents.mosaics(),
)
