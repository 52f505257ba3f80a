"""`ranges`: a planar lidar ring."""

from __future__ import annotations

import numpy as np

from gn0.sim.sensor.sensor import Sensor, Space

SENSOR = Sensor(
    name="ranges",
    doc="float32 [72] m: a ring of rays on the inflated map, the first straight ahead, "
    "counter-clockwise",
    space=lambda settings: Space((settings.range_rays,), np.float32, 0.0, settings.range_limit),
    read=lambda here: here.ranges(),
    many=lambda agents: agents.ranges(),
    device=lambda agents: agents.ranges(),
)
