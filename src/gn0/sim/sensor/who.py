"""`who` and `people_seen`: which person each pixel shows, and how much of each is seen."""

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
)
SEEN = Sensor(
    name="people_seen",
    doc="float32 [16, 6]: of each person by number the share that is seen, its pixels, and their "
    "box: left, top, right, bottom. For policies that are told labels",
    space=lambda settings: Space((PEOPLE_MOST, 6), np.float32, 0.0, 1e9),
    draws=_DRAWN,
    tells="labels",
    read=lambda here: here.who()[1],
)
