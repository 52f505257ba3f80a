"""`semantic`: which category each pixel shows."""

from __future__ import annotations

import numpy as np

from gn0.sim.sensor.sensor import Sensor, SensorSettings, Space


def label_space(settings: SensorSettings) -> Space:
    """Numbers of what is seen, in the size of depth."""
    camera = settings.preset.depth
    return Space((camera.height, camera.width), np.uint32, 0, 2**32 - 1)


SENSOR = Sensor(
    name="semantic",
    doc="uint32 [Hd, Wd]: the category that each depth pixel shows, an index into "
    "`scene.categories`, or 0. For policies that are told labels",
    space=label_space,
    draws=frozenset({"semantic"}),
    tells="labels",
    read=lambda here: here.seen("semantic"),
    device=lambda agents: agents.seen("semantic"),
)
