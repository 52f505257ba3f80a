"""`who`: which person each pixel shows."""

from __future__ import annotations

import numpy as np

from gn0.people.person import PEOPLE_MOST
from gn0.sim.sensor.sensor import Sensor, SensorSettings, Space

_DRAWN = frozenset({"depth"})  # a renderer is needed


def _who_space(settings: SensorSettings) -> Space:
    camera = settings.preset.rgb
    return Space((camera.height, camera.width), np.uint8, 0, PEOPLE_MOST)


SENSOR = Sensor(
    name="who",
    doc="uint8 [H, W]: the number of the person that each pixel shows, 0 for none. For policies "
    "that are told labels",
    space=_who_space,
    draws=_DRAWN,
    tells="labels",
    read=lambda here: here.who()[0],
    device=lambda agents: agents.who()[0],
)
