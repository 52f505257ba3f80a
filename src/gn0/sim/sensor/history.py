"""`history`: a mosaic of earlier views."""

from __future__ import annotations

from gn0.sim.history import COLUMNS, ROWS, TILE_HEIGHT, TILE_WIDTH, build_mosaic
from gn0.sim.sensor.sensor import Sensor, picture_space

SENSOR = Sensor(
    name="history",
    doc="uint8 [480, 640, 3]: the last sixteen views in 4×4 tiles, newest at the top left, the "
    "current one excluded",
    space=lambda _: picture_space(COLUMNS * TILE_WIDTH, ROWS * TILE_HEIGHT),
    views=True,
    read=lambda here: build_mosaic(here.views()),
    device=lambda agents: agents.mosaics(),
)
