"""`people_seen`: how much of each person is seen, and where."""

from __future__ import annotations

import numpy as np

from gn0.people.person import PEOPLE_MOST
from gn0.sim.sensor.sensor import Sensor, Space

SENSOR = Sensor(
    name="people_seen",
    doc="float32 [16, 6]: of each person by number the share that is seen, its pixels, and their "
    "box: left, top, right, bottom. For policies that are told labels",
    space=lambda settings: Space((PEOPLE_MOST, 6), np.float32, 0.0, 1e9),
    draws=frozenset({"depth"}),  # a renderer is needed
    tells="labels",
    read=lambda here: here.who()[1],
    device=lambda agents: agents.who()[1],
)
