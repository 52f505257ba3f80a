"""`depth`: how far away is what is seen, in metres along the camera's axis.

It is clipped to the preset's `depth_range`, 0 to 10 m in `gn_bench`, where pictures are finished
(`LookPlan.finish`): what is farther, and where nothing is, reads the far limit.
"""

from __future__ import annotations

import numpy as np

from gn0.sim.sensor.sensor import Sensor, SensorSettings, Space


def _space(settings: SensorSettings) -> Space:
    camera = settings.preset.depth
    return Space((camera.height, camera.width), np.float32, *settings.preset.depth_range)


SENSOR = Sensor(
    name="depth",
    doc="float32 [Hd, Wd] m, camera z, clipped to the sensor's range; its own size",
    space=_space,
    draws=frozenset({"depth"}),
    read=lambda here: here.seen("depth"),
    device=lambda agents: agents.seen("depth"),
)
